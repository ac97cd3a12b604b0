//! Who is killed or stopped in a round, and what goes on when it is over.

use nix::sys::signal::Signal;
use uorb_core::now_us;

use super::{CROWD, Era, Totals};
use crate::bus::signal;
use crate::judge::Stopped;
use crate::plan::{Deed, Moment, Plan};

impl Era<'_> {
    pub(super) fn act(&mut self, moment: &Moment, totals: &mut Totals) {
        let Some(whom) = moment.whom else {
            match moment.deed {
                Deed::Kill => self.broker.kill(),
                Deed::Stop => {
                    if let Some(pid) = self.broker.pid() {
                        totals.stops += 1;
                        signal(pid, Signal::SIGSTOP);
                        self.stopped.push(Stopped::broker(pid));
                    }
                }
            }
            return;
        };
        let living: Vec<usize> =
            (0..self.processes.len()).filter(|index| self.processes[*index].lives()).collect();
        if living.is_empty() {
            return;
        }
        let process = &mut self.processes[living[whom as usize % living.len()]];
        match moment.deed {
            Deed::Kill => {
                process.fate = Some("a moment".into());
                process.kill();
                totals.kills += 1;
            }
            Deed::Stop => {
                totals.stops += 1;
                process.was_stopped = true;
                signal(process.pid(), Signal::SIGSTOP);
                self.stopped.push(Stopped::process(process));
            }
        }
    }

    /// Everybody who is stopped goes on or dies; who was to die and did not, too;
    /// and there is a broker again. Whether it is another one.
    pub(super) fn end_of_the_violence(
        &mut self,
        plan: &Plan,
        totals: &mut Totals,
    ) -> anyhow::Result<bool> {
        let crowd = self.processes.iter_mut().filter(|process| process.ended.is_none()).count();
        for process in &mut self.processes {
            if !process.lives() {
                continue;
            }
            let was_to_die = process.fate.is_some();
            if was_to_die && process.is_stopped() && !process.was_stopped {
                totals.stops += 1;
                process.was_stopped = true;
                self.stopped.push(Stopped::process(process));
            }
            let dies = plan.kills_all
                || (process.was_stopped && plan.kills_the_stopped)
                || (was_to_die && (!plan.keeps_survivors || crowd > CROWD));
            if dies {
                process.fate.get_or_insert_with(|| "the end".into());
                process.kill();
                totals.kills += 1;
            } else if process.was_stopped {
                signal(process.pid(), Signal::SIGCONT);
            }
        }
        for stopped in &mut self.stopped {
            stopped.until_us = now_us();
            if stopped.is_broker {
                signal(stopped.pid, Signal::SIGCONT);
            }
        }
        let downs = self.broker.down_us.len();
        let mut fate = plan.next_broker.as_ref();
        while !self.broker.runs() {
            self.broker.start(&self.bus, fate.take())?;
        }
        // Its fate may be to die of what the others ask of it.
        Ok(self.broker.down_us.len() > downs
            || self
                .broker
                .down_us
                .last()
                .is_some_and(|down| down.1 == u64::MAX || now_us() - down.1 < 1_000_000))
    }

    /// A broker whose fate is to die of what it is asked dies now or later, and
    /// there must always be one.
    /// And who is to stop where it re-joins stops now: it goes on at once.
    pub(super) fn keep_a_broker(&mut self) {
        for process in self.processes.iter_mut().filter(|process| process.is_to_stop()) {
            if process.is_stopped() {
                process.was_stopped = true;
                signal(process.pid(), Signal::SIGCONT);
            }
        }
        while !self.broker.runs() {
            if let Err(error) = self.broker.start(&self.bus, None) {
                return self.fault(format!("{error:#}"));
            }
        }
    }
}
