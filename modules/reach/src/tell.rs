//! Telling the bus how it goes: `reach_status`, a message for each topic and each
//! machine, all of them once a second; or one that says that there is none.
//! `reach status` and `uorb info` read it.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;

use uorb_core::{Error, Instance, Publication, Session, now_us};
use uorb_msg::ReachStatus;

use crate::communicator::lock;
use crate::counts::Counts;
use crate::exports::Exports;
use crate::imports::{Imports, State};

const EVERY_US: u64 = 1_000_000;

pub(crate) struct Telling {
    publication: Publication<ReachStatus>,
    /// Messages and bytes, as they were told before, by what tells one from another.
    before: BTreeMap<Subject, (u64, u64)>,
    told_us: u64,
}

type Subject = (u8, [u8; 32], u32, [u8; 60], u8, u8);

impl Telling {
    pub(crate) fn new(session: &Session) -> Result<Self, Error> {
        let publication = Publication::advertise(session)?;
        Ok(Self { publication, before: BTreeMap::new(), told_us: 0 })
    }

    /// Tells, if it is time to.
    pub(crate) fn tell(&mut self, exports: &Exports, imports: &Imports) -> Result<(), Error> {
        let now_us = now_us();
        if now_us < self.told_us + EVERY_US {
            return Ok(());
        }
        let mut all = Vec::new();
        all.extend(machines(imports));
        all.extend(exports.topics().map(|(source, export)| {
            let machines = export.wanted_by.len();
            let state = match export.is_advertised() {
                false => State::Gone,
                true if machines > 0 => State::Crossing,
                true => State::Idle,
            };
            ReachStatus {
                kind: ReachStatus::KIND_EXPORT,
                topic: text(&source.topic),
                instance: source.instance.number(),
                machines: machines.min(u8::MAX.into()) as u8,
                state: number(state),
                ..counted(&export.counts)
            }
        }));
        all.extend(imports.topics().map(|(remote, import)| ReachStatus {
            kind: ReachStatus::KIND_IMPORT,
            machine: text(&remote.place.machine),
            far_system: remote.place.system,
            topic: text(&remote.source.topic),
            far_instance: remote.source.instance.number(),
            instance: import.instance().map_or(u8::MAX, Instance::number),
            state: number(import.state()),
            ..counted(&import.counts)
        }));
        let seconds = (now_us - self.told_us) as f64 / 1e6;
        let count = all.len().min(u16::MAX.into()) as u16;
        if count == 0 {
            let nothing = ReachStatus { timestamp: now_us, ..ReachStatus::default() };
            self.publication.publish(&nothing)?;
        }
        let before = std::mem::take(&mut self.before);
        for (index, status) in (0..count).zip(all) {
            let told = self.with_rates(status, &before, seconds);
            self.publication.publish(&ReachStatus { timestamp: now_us, index, count, ..told })?;
        }
        self.told_us = now_us;
        Ok(())
    }

    fn with_rates(
        &mut self,
        status: ReachStatus,
        before: &BTreeMap<Subject, (u64, u64)>,
        seconds: f64,
    ) -> ReachStatus {
        let ReachStatus { kind, machine, far_system, topic, far_instance, instance, .. } = status;
        let subject = (kind, machine, far_system, topic, far_instance, instance);
        let now = (status.messages, status.bytes);
        let before = before.get(&subject).copied().unwrap_or_default();
        self.before.insert(subject, now);
        ReachStatus {
            rate_hz: (now.0.saturating_sub(before.0) as f64 / seconds) as f32,
            rate_kb_s: (now.1.saturating_sub(before.1) as f64 / 1e3 / seconds) as f32,
            ..status
        }
    }
}

fn machines(imports: &Imports) -> impl Iterator<Item = ReachStatus> {
    imports.machines().map(|(place, machine)| {
        let difference = lock(&machine.clock).difference(now_us());
        let known = difference.unwrap_or_default();
        let state = if machine.is_there { State::Crossing } else { State::Gone };
        ReachStatus {
            kind: ReachStatus::KIND_MACHINE,
            machine: text(&place.machine),
            far_system: place.system,
            state: number(state),
            offset_us: known.offset_us,
            drift_ppm: known.drift_ppm as f32,
            uncertainty_us: difference.map_or(u32::MAX, |it| small(it.uncertainty_us)),
            round_trip_us: small(known.round_trip_us),
            ..ReachStatus::default()
        }
    })
}

fn counted(counts: &Counts) -> ReachStatus {
    ReachStatus {
        messages: counts.messages.load(Ordering::Relaxed),
        bytes: counts.bytes.load(Ordering::Relaxed),
        lost: counts.lost.load(Ordering::Relaxed),
        refused: counts.refused.load(Ordering::Relaxed),
        ..ReachStatus::default()
    }
}

fn number(state: State) -> u8 {
    match state {
        State::Idle => ReachStatus::STATE_IDLE,
        State::Crossing => ReachStatus::STATE_CROSSING,
        State::Gone => ReachStatus::STATE_GONE,
        State::Refused => ReachStatus::STATE_REFUSED,
    }
}

fn small(number: u64) -> u32 {
    number.try_into().unwrap_or(u32::MAX)
}

/// A name in the bytes of a message, with a NUL behind it.
fn text<const N: usize>(name: &str) -> [u8; N] {
    let mut bytes = [0; N];
    let length = name.len().min(N - 1);
    bytes[..length].copy_from_slice(&name.as_bytes()[..length]);
    bytes
}
