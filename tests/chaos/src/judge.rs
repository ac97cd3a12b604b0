//! What took long, and whether anybody is to blame.
//!
//! Each process notes by its own clock what took more than 50 ms. Nothing may
//! take more than 100, except what the machine has added: the time in which the
//! process was ready to run and had no core, and what the control has overslept.
//! Without a broker the time counts from its next start, and who was stopped
//! was late by our doing.

use uorb_core::now_us;

use crate::bus::Process;
use crate::era::LIMIT_US;
use crate::ledger::{Late, LateWhat};
use crate::noise::Noise;

/// How long sessions take at most to find a new broker.
const REJOIN_US: u64 = 300_000;

/// How long a new stream waits for publishers that do not open their ports.
const STREAM_US: u64 = 100_000;

/// When somebody was stopped.
#[derive(Debug)]
pub(crate) struct Stopped {
    pub(crate) pid: u32,
    pub(crate) is_broker: bool,
    pub(crate) from_us: u64,
    pub(crate) until_us: u64,
}

impl Stopped {
    pub(crate) fn broker(pid: u32) -> Self {
        Self { pid, is_broker: true, from_us: now_us(), until_us: u64::MAX }
    }

    pub(crate) fn process(process: &Process) -> Self {
        let pid = process.pid();
        Self { pid, is_broker: false, from_us: now_us(), until_us: u64::MAX }
    }
}

pub(crate) struct Judge<'e> {
    pub(crate) noise: &'e Noise,
    pub(crate) stopped: &'e [Stopped],
    pub(crate) down: &'e [(u64, u64)],
    /// How long everybody may have waited for what one who was killed has begun.
    pub(crate) unfinished_us: u64,
}

impl Judge<'_> {
    /// What of a process's long waits nothing excuses.
    pub(crate) fn lates(&self, process: &Process, began_us: u64) -> Vec<String> {
        if process.was_stopped {
            return Vec::new();
        }
        let late = process.cell.lates().into_iter().filter_map(|late| self.late(late, began_us));
        late.map(|what| format!("{} {}: {what}", process.kind, process.sender)).collect()
    }

    fn late(&self, late: Late, began_us: u64) -> Option<String> {
        let Late { what, from_us, to_us, off_cpu_us } = late;
        let needs_broker = what != LateWhat::Publish;
        let overlaps = |from: u64, until: u64| from <= to_us && until >= from_us;
        let mut from = from_us;
        let mut more_us = 0;
        if needs_broker {
            // Sessions find a new broker a little after its start.
            let back = |up: u64| up.saturating_add(REJOIN_US);
            for (_, up) in self.down.iter().filter(|(down, up)| overlaps(*down, back(*up))) {
                from = from.max(*up);
                more_us = REJOIN_US;
            }
            // A message whose publisher was stopped in mid-publish, too; and what
            // was there before the round.
            let stopped = self.stopped.iter();
            for stopped in stopped.filter(|stopped| overlaps(stopped.from_us, stopped.until_us)) {
                from = from.max(stopped.until_us);
            }
        }
        if what == LateWhat::Copy {
            // The first copy of a new subscription is of what there was.
            from = from.max(began_us);
        }
        if what == LateWhat::StreamRequest {
            more_us += STREAM_US;
        }
        let noise_us = self.noise.between(from, to_us);
        let took_us = to_us.saturating_sub(from);
        let allowed_us = LIMIT_US + more_us + self.unfinished_us + noise_us + off_cpu_us;
        (took_us > allowed_us).then(|| {
            format!("{what:?} took {took_us} us (noise {noise_us}, without a core {off_cpu_us})")
        })
    }
}
