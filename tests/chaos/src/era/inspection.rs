//! What must be so when everybody has paused.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use uorb_core::Instance;
use uorb_core::broker_side::{Node, Reply, Request, Role};
use uorb_tests::instance;

use super::{Era, HELD_MAX, HELD_ON_STREAM_MAX, LIMIT_US, RESTART_US, TICK, Totals};
use crate::accounts::Accounts;
use crate::actor::CLAIMED;
use crate::bus::Process;
use crate::ledger::Word;
use crate::shared_topic::{self, is_large, is_pressed};
use crate::traces::Traces;

impl Era<'_> {
    fn node(&self) -> Option<Node> {
        Node::open(&self.bus.system, self.topic, Instance::FIRST, Role::Observer).ok()
    }

    pub(super) fn published(&self) -> u64 {
        self.node().map_or(0, |node| node.status().published)
    }

    pub(super) fn newest(&self) -> u32 {
        self.node().map_or(0, |node| (node.identity.base + node.status().published) as u32)
    }

    /// Every message of the round.
    pub(super) fn count(&mut self, totals: &mut Totals) {
        let (base, newest) = (self.base, self.newest());
        let mut accounts = Accounts::since(base);
        let killed = self.killed_publishers();
        let may_be_lost = is_large(self.topic) && killed > 0;
        let has_no_keeper = may_be_lost && self.broker.down_us.len() > self.downs;
        for process in self.processes.iter_mut().filter(|process| process.kind == "publisher") {
            let lives = process.lives();
            let (begun, done) = (process.cell.get(Word::Begun), process.cell.get(Word::Done));
            let in_flight = (begun > done).then_some((process.sender, done));
            if lives && begun > done {
                accounts.fault(format!("{} has paused in mid-publish", process.sender));
            }
            // Noted, and killed before it could say that it was.
            let in_flight = in_flight.filter(|message| {
                !process.cell.logged().iter().any(|noted| (noted.1, noted.2) == *message)
            });
            accounts.published(&process.cell.logged(), in_flight);
        }
        for process in self.processes.iter_mut().filter(|process| process.copies()) {
            let cell = process.cell;
            let who = format!("{} {} (pid {})", process.kind, process.sender, process.pid());
            accounts.copied(&who, &cell.logged());
            if cell.get(Word::Torn) > 0 {
                accounts.fault(format!("{who} copied {} torn messages", cell.get(Word::Torn)));
            }
            if process.lives() && cell.get(Word::State) == 1 {
                let [copied, lost, before, pending] =
                    [Word::Copied, Word::Lost, Word::LostBefore, Word::Pending]
                        .map(|w| cell.get(w));
                let published = newest.wrapping_sub(cell.get(Word::First) as u32);
                let sum = copied + lost - before + pending;
                // What one who was killed has not sent, the broker sends, if there
                // is one then.
                if is_pressed(self.topic) && process.kind == "follower" && lost - before > killed {
                    accounts.fault(format!("{who} lost {} in spite of all", lost - before));
                }
                if u64::from(published) != sum {
                    accounts.fault(format!(
                        "{who}: {published} published, {copied} copied + {} lost + {pending} \
                         pending",
                        lost - before,
                    ));
                }
            }
        }
        totals.messages += accounts.close(newest);
        if let Some(keeper) = &mut self.keeper
            && newest != base
        {
            keeper.skip();
            let mut bytes = Vec::new();
            let last = keeper.copy(&mut bytes).then(|| shared_topic::read(&bytes));
            match last.flatten() {
                // It was its publisher's and the broker's, and both have died.
                None if has_no_keeper => {}
                Some(last) if last.is_whole() => {
                    let message = (last.sender, last.count);
                    let known = accounts.message(newest).filter(|_| !has_no_keeper);
                    // A large one that was committed and never sent is lost.
                    let known = known.or(may_be_lost.then_some(message));
                    if known.map_or(!accounts.may_be(message), |known| known != message) {
                        accounts.fault(format!("the last value is {message:?}, not {known:?}"));
                    }
                }
                last => accounts.fault(format!("the last value cannot be read: {last:?}")),
            }
        }
        self.faults.append(&mut accounts.faults);
    }

    /// Whoever outlived many brokers and neighbours has kept nothing of them. Ports
    /// whose publications are gone linger for a second.
    pub(super) fn look_at_what_survivors_hold(&mut self) {
        let mut found = Vec::new();
        self.wait("survivors hold what they need", |era| {
            let is_large = is_large(era.topic);
            let held = era.processes.iter_mut().filter_map(|process| {
                let streams = is_large || matches!(process.kind, "publisher" | "follower");
                let (open_max, mapped_max) = if streams { HELD_ON_STREAM_MAX } else { HELD_MAX };
                let (open, mapped) = Traces::held_by(process.lives().then(|| process.pid())?);
                let kind = process.kind;
                let is_much = open > open_max || mapped > mapped_max;
                is_much.then(|| format!("a {kind} has {open} descriptors and {mapped} mappings"))
            });
            found = held.collect();
            found.is_empty()
        });
        self.faults.append(&mut found);
    }

    /// How many of those who publish to the shared topic have died in this round.
    pub(super) fn killed_publishers(&mut self) -> u64 {
        let publishers = self.processes.iter_mut().filter(|process| process.kind == "publisher");
        publishers.filter_map(|process| (!process.lives()).then_some(())).count() as u64
    }

    /// The broker's own words, and the counts in the nodes.
    pub(super) fn look_at_the_bus(&mut self, restarted: bool) -> anyhow::Result<()> {
        let more_us = if restarted { RESTART_US } else { 0 };
        // Who was to die where it re-joins may do it now.
        let (mut told, mut living) = (BTreeSet::new(), BTreeSet::new());
        self.wait_shortly("the broker knows who lives", more_us, |era| {
            era.keep_a_broker();
            told = era.connected();
            living = era.living();
            told == living
        });
        if told != living {
            self.fault(format!("the broker knows {told:?}, and {living:?} live"));
        }
        let (mut counts, mut held) = ((0, 0), (0, 0));
        self.wait_shortly("the counts are true", more_us, |era| {
            era.keep_a_broker();
            let Some(status) = era.node().map(|node| node.status()) else { return false };
            counts = (status.publishers.len() as u64, status.subscribers);
            held = era.held();
            counts == held
        });
        if counts != held {
            self.fault(format!("counts are {counts:?}, not {held:?}"));
        }
        let mut holders = Vec::new();
        self.wait_shortly("no slot is held", more_us, |era| {
            era.keep_a_broker();
            holders = era.node().map(|node| node.slot_holders()).unwrap_or_default();
            holders.is_empty()
        });
        if !holders.is_empty() {
            self.fault(format!("slots are held by {holders:?}, and nobody publishes"));
        }
        self.look_at_the_claimed(more_us);
        self.wait_for_the_last_large_message();
        Ok(())
    }

    /// Where all publishers of a large topic are gone, the broker is about to keep
    /// its newest message; or that was never sent, and is lost.
    fn wait_for_the_last_large_message(&mut self) {
        if !is_large(self.topic) || self.held().0 > 0 {
            return;
        }
        let newest = self.newest();
        let deadline = Instant::now() + Duration::from_micros(LIMIT_US);
        let is_kept =
            |era: &Self| era.node().is_none_or(|node| node.last_generation() as u32 == newest);
        while !is_kept(self) && Instant::now() < deadline {
            std::thread::sleep(TICK);
        }
    }

    fn look_at_the_claimed(&mut self, more_us: u64) {
        let _ = self.living();
        let held = |process: &Process| {
            (process.kind == "claimer" && process.ended.is_none())
                .then(|| process.cell.get(Word::Instance) as u8)
        };
        let claimed: Vec<u8> = self.processes.iter().filter_map(held).collect();
        let mut free: Vec<u8> = (0..10).collect();
        for instance in &claimed {
            let Some(index) = free.iter().position(|one| one + 1 == *instance) else {
                return self.fault(format!("instances {claimed:?} (from 1) are held"));
            };
            free.remove(index);
        }
        let mut dark = Vec::new();
        self.wait_shortly("instances of the dead are free", more_us, |era| {
            era.keep_a_broker();
            let Some(session) = &era.session else { return true };
            let advertised =
                |number: &u8| session.exists(CLAIMED, instance(*number)).unwrap_or(false);
            dark = free.iter().copied().filter(advertised).collect();
            dark.is_empty()
        });
    }

    /// Publications and subscriptions of the shared topic, the controller's too.
    fn held(&mut self) -> (u64, u64) {
        let holds = |process: &mut Process| process.lives() && process.cell.get(Word::State) == 1;
        let holding: Vec<&str> = self
            .processes
            .iter_mut()
            .filter_map(|process| holds(process).then_some(process.kind))
            .collect();
        let publishers = holding.iter().filter(|kind| **kind == "publisher").count();
        let others = holding
            .iter()
            .filter(|kind| !["publisher", "claimer", "changer"].contains(kind))
            .count();
        (publishers as u64, others as u64 + 1)
    }

    /// The processes that live, the controller included.
    pub(super) fn living(&mut self) -> BTreeSet<u32> {
        let living = self.processes.iter_mut().filter_map(|process| {
            let pid = process.pid();
            process.lives().then_some(pid)
        });
        living.chain([std::process::id()]).collect()
    }

    /// The processes that the broker knows, 0 for those that are not connected.
    /// It may die of the question; then the next one is asked.
    pub(super) fn connected(&mut self) -> BTreeSet<u32> {
        let Some(session) = self.session.clone() else { return BTreeSet::new() };
        let question = std::thread::spawn(move || session.ask(Request::Peers));
        while !question.is_finished() {
            self.keep_a_broker();
            std::thread::sleep(TICK);
        }
        match question.join() {
            Ok(Ok(Reply::Peers(peers))) => {
                peers.iter().map(|peer| if peer.connected { peer.pid } else { 0 }).collect()
            }
            _ => BTreeSet::new(),
        }
    }
}
