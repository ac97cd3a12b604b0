//! The end of a bus: everybody goes, and nothing is left.

use std::collections::BTreeSet;

use super::{Era, Totals};
use crate::bus::Process;
use crate::plan::end_of_a_system;
use crate::random::Random;
use crate::traces::Traces;

impl Era<'_> {
    /// Everybody goes, and nothing is left. What was wrong.
    pub(crate) fn end(mut self, seed: u64, totals: &mut Totals) -> anyhow::Result<Vec<String>> {
        let fate = end_of_a_system(&mut Random::of_round(seed, self.round));
        self.broker.replace_the_fated(&self.bus)?;
        // Who is to die where it re-joins might do it while it is counted.
        let fated = self.processes.iter_mut().filter(|process| process.fate.is_some());
        fated.for_each(Process::kill);
        let mut living = 0;
        self.wait("all have re-joined", |era| {
            let connected = era.connected();
            living = connected.len();
            connected == era.living()
        });
        let status = self.bus.uorb(&["status", "--json"]);
        let json: Result<serde_json::Value, _> = serde_json::from_str(&status.out);
        let peers = json.as_ref().ok().and_then(|json| json["peers"].as_array().map(Vec::len));
        if status.code != 0 || peers != Some(living) {
            let said = status.out + &status.words;
            let connected = self.connected();
            self.fault(format!("uorb status knows not the {living} in {connected:?}: {said}"));
        }
        self.look_at_what_survivors_hold();
        self.processes.clear();
        let ours = BTreeSet::from([std::process::id()]);
        self.wait("the broker knows that all are gone", |era| era.connected() == ours);
        let broker = self.broker.pid().unwrap_or(0);
        let mut held = Vec::new();
        self.wait("the broker holds nothing of the dead", |_| {
            held = Traces::of_the_dead(broker);
            held.is_empty()
        });
        if !held.is_empty() {
            self.fault(format!("the broker still holds {held:?}"));
        }
        self.keeper = None;
        self.session = None;
        if let Some(fate) = fate {
            self.broker.kill();
            self.broker.start(&self.bus, Some(&fate))?;
            let ended = self.broker.stop()?;
            if ended.success() {
                self.fault(format!("the broker was to die at {}, and ended", fate.place));
            }
            totals.places.extend(fate.place.split(':').next().map(ToString::to_string));
            self.broker.start(&self.bus, None)?;
        }
        let ended = self.broker.stop()?;
        if !ended.success() {
            self.fault(format!("the broker ended: {ended}"));
        }
        if self.bus.system.dir().exists() {
            self.fault("the system's directory is left".into());
        }
        let left = Traces::of_world(&self.world.prefix);
        if !left.is_empty() {
            self.fault(format!("left behind: {left:?}"));
        }
        Ok(std::mem::take(&mut self.faults))
    }
}
