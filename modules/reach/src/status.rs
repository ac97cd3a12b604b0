//! `reach status`: what the reach of this machine says of itself.

use std::io::{self, Write};
use std::time::Duration;

use anyhow::bail;
use serde_json::{Value, json};
use uorb_core::{Instance, Session, StreamSubscription, Topic, now_us, poll};
use uorb_msg::ReachStatus;

/// It is said once a second, so this is long.
const PATIENCE_US: u64 = 5_000_000;

pub(crate) fn print(session: &Session, as_json: bool, out: &mut impl Write) -> anyhow::Result<()> {
    let all = hear(session)?;
    if as_json {
        let all: Vec<Value> = all.iter().map(json_of).collect();
        writeln!(out, "{}", json!({ "links": all }))?;
        return Ok(());
    }
    print_text(&all, out)?;
    Ok(())
}

/// All that is said within one second.
fn hear(session: &Session) -> anyhow::Result<Vec<ReachStatus>> {
    let topic = &ReachStatus::METADATA.name;
    let mut status = StreamSubscription::<ReachStatus>::subscribe(session)?;
    let mut all: Vec<ReachStatus> = Vec::new();
    let begun_us = now_us();
    while now_us() < begun_us + PATIENCE_US {
        if !session.exists(topic, Instance::FIRST)? {
            bail!("no reach runs here; `reach --help` says how to start one");
        }
        poll(&mut [&mut status], Some(Duration::from_millis(100)))?;
        while let Some(said) = status.update() {
            // The first one may be the last of a second that is over.
            if said.index == 0 {
                all.clear();
            }
            // There is nothing to say of.
            if said.count == 0 {
                return Ok(all);
            }
            if all.len() == usize::from(said.index) {
                all.push(*said);
            }
            if all.len() == usize::from(said.count) {
                return Ok(all);
            }
        }
    }
    if all.is_empty() {
        bail!("the reach that runs here says nothing: nobody has let it in yet, or it is stopped")
    }
    Ok(all)
}

fn json_of(status: &ReachStatus) -> Value {
    let (machine, system) = (text(&status.machine), status.far_system);
    let state = state(status);
    match status.kind {
        ReachStatus::KIND_MACHINE => json!({
            "kind": "machine", "machine": machine, "system": system, "state": state,
            "offset_us": status.offset_us, "uncertainty_us": known(status),
            "drift_ppm": status.drift_ppm, "round_trip_us": status.round_trip_us,
        }),
        kind => {
            let mut link = json!({
                "kind": "export", "topic": text(&status.topic), "state": state,
                "instance": (status.instance != u8::MAX).then_some(status.instance),
                "messages": status.messages, "bytes": status.bytes, "lost": status.lost,
                "refused": status.refused, "rate_hz": status.rate_hz,
                "rate_kb_s": status.rate_kb_s,
            });
            if kind == ReachStatus::KIND_IMPORT {
                link["kind"] = "import".into();
                link["machine"] = machine.into();
                link["system"] = system.into();
                link["far_instance"] = status.far_instance.into();
            } else {
                link["machines"] = status.machines.into();
            }
            link
        }
    }
}

fn known(status: &ReachStatus) -> Option<u32> {
    (status.uncertainty_us != u32::MAX).then_some(status.uncertainty_us)
}

fn print_text(all: &[ReachStatus], out: &mut impl Write) -> io::Result<()> {
    let of = |kind| all.iter().filter(move |status| status.kind == kind);
    for machine in of(ReachStatus::KIND_MACHINE) {
        let (name, system) = (text(&machine.machine), machine.far_system);
        write!(out, "machine {name}/{system}: ")?;
        match (state(machine), known(machine)) {
            ("gone", _) => writeln!(out, "gone")?,
            (_, None) => writeln!(out, "its clock is not known yet")?,
            (_, Some(uncertainty_us)) => writeln!(
                out,
                "clock {:+.6} s (+- {:.6} s), drift {:+.2} ppm, round trip {:.3} ms",
                machine.offset_us as f64 / 1e6,
                f64::from(uncertainty_us) / 1e6,
                machine.drift_ppm,
                f64::from(machine.round_trip_us) / 1e3
            )?,
        }
    }
    let topics: Vec<_> = all.iter().filter(|it| it.kind != ReachStatus::KIND_MACHINE).collect();
    let width = topics.iter().map(|it| text(&it.topic).len()).max().unwrap_or(0).max(10);
    writeln!(
        out,
        "{:6} {:width$} INST {:>9} {:>9} {:>10} {:>6} {:>6}  STATE",
        "WAY", "TOPIC NAME", "MSG/S", "kB/s", "#MSG", "#LOST", "#REF"
    )?;
    for status in topics {
        let way = if status.kind == ReachStatus::KIND_EXPORT { "export" } else { "import" };
        let instance = match status.instance {
            u8::MAX => "-".to_string(),
            number => number.to_string(),
        };
        let ReachStatus { rate_hz, rate_kb_s, messages, lost, refused, .. } = status;
        let name = text(&status.topic);
        write!(
            out,
            "{way:6} {name:width$} {instance:>4} {rate_hz:9.1} {rate_kb_s:9.1} {messages:10} \
             {lost:6} {refused:6}  {}",
            state(status)
        )?;
        match status.kind {
            ReachStatus::KIND_EXPORT if status.machines > 0 => {
                writeln!(out, " to {} machine{}", status.machines, plural(status.machines))?;
            }
            ReachStatus::KIND_EXPORT => writeln!(out)?,
            _ => {
                let (machine, system) = (text(&status.machine), status.far_system);
                writeln!(out, " from {machine}/{system}, instance {}", status.far_instance)?;
            }
        }
    }
    Ok(())
}

fn plural(count: u8) -> &'static str {
    if count == 1 { "" } else { "s" }
}

fn state(status: &ReachStatus) -> &'static str {
    match status.state {
        ReachStatus::STATE_IDLE => "idle",
        ReachStatus::STATE_CROSSING => "crossing",
        ReachStatus::STATE_GONE => "gone",
        _ => "refused",
    }
}

fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}
