//! What crosses to other machines: what the `reach` of this one says of a topic.

use std::io::{self, Write};
use std::time::{Duration, Instant};

use serde::Serialize;
use uorb_core::{Instance, Session, StreamSubscription, Topic, poll};
use uorb_msg::ReachStatus;

/// It is said once a second.
const PATIENCE: Duration = Duration::from_millis(1_500);

/// One way of an instance.
#[derive(Debug, Serialize)]
pub(super) struct Crossing {
    #[serde(skip)]
    instance: u8,
    /// Of what comes in: where from.
    from: Option<String>,
    /// Of what leaves: how many machines want it.
    machines: Option<u8>,
    rate_hz: f32,
    rate_kb_s: f32,
    lost: u64,
    refused: u64,
}

/// How a topic crosses, of all its instances. Nothing, where no reach runs.
pub(super) fn crossings(session: &Session, topic: &str) -> anyhow::Result<Vec<Crossing>> {
    let mut crossings = Vec::new();
    if !session.exists(&ReachStatus::METADATA.name, Instance::FIRST)? {
        return Ok(crossings);
    }
    let mut status = StreamSubscription::<ReachStatus>::subscribe(session)?;
    let deadline = Instant::now() + PATIENCE;
    let (mut heard, mut count) = (0, u16::MAX);
    while heard < count && Instant::now() < deadline {
        poll(&mut [&mut status], Some(deadline - Instant::now()))?;
        while heard < count
            && let Some(said) = status.update()
        {
            // The first may be the last of a second that is over.
            if said.index == 0 {
                (heard, crossings) = (0, Vec::new());
            }
            if said.index == heard {
                (heard, count) = (heard + 1, said.count);
                crossings.extend(Crossing::of(said, topic));
            }
        }
    }
    Ok(crossings)
}

impl Crossing {
    fn of(said: &ReachStatus, topic: &str) -> Option<Self> {
        if said.kind == ReachStatus::KIND_MACHINE || text(&said.topic) != topic {
            return None;
        }
        let is_export = said.kind == ReachStatus::KIND_EXPORT;
        let (machine, system) = (text(&said.machine), said.far_system);
        let from = format!("{machine}/{system}, instance {}", said.far_instance);
        Some(Self {
            instance: said.instance,
            from: (!is_export).then_some(from),
            machines: is_export.then_some(said.machines),
            rate_hz: said.rate_hz,
            rate_kb_s: said.rate_kb_s,
            lost: said.lost,
            refused: said.refused,
        })
    }

    pub(super) fn is_of(&self, instance: Instance) -> bool {
        self.instance == instance.number()
    }

    pub(super) fn print(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { rate_hz, rate_kb_s, lost, refused, .. } = self;
        match (&self.from, self.machines) {
            (Some(from), _) => write!(out, "  reach      from {from}")?,
            (None, machines) => {
                write!(out, "  reach      to {} other machines", machines.unwrap_or(0))?;
            }
        }
        writeln!(out, ": {rate_hz:.1} Hz, {rate_kb_s:.1} kB/s, {lost} lost, {refused} refused")
    }
}

fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}
