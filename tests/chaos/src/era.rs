//! One bus and its rounds: everybody runs, some die, the rest pauses and is
//! counted.

mod ending;
mod inspection;
mod violence;

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use uorb_core::{Instance, RawSubscription, Session, World, now_us};
use uorb_tests::Bus;

use crate::bus::{Broker, Process, signal};
use crate::judge::{Judge, Stopped};
use crate::ledger::{CELLS, Ledger, Phase, Word};
use crate::noise::Noise;
use crate::plan::Plan;
use crate::random::Random;
use crate::shared_topic;

/// How long the controller waits for what must come before it calls it missing.
/// What it took is judged by other means.
const PATIENCE: Duration = Duration::from_secs(10);

/// Nobody waits longer for anything, and what the machine adds.
pub(crate) const LIMIT_US: u64 = 100_000;

/// How long whoever uses streams may wait for a file that somebody who was killed
/// has left unfinished, until the broker removes it.
const UNFINISHED_US: u64 = 1_300_000;

/// How long it takes at most until everybody has re-joined a new broker.
const RESTART_US: u64 = 400_000;

/// Processes beyond which no newcomer is kept.
const CROWD: usize = 12;

/// Descriptors, and mappings of shared memory, that a process has at most at the
/// end of a bus. After some ten brokers, what it kept of each would be more.
const HELD_MAX: (usize, usize) = (16, 6);

/// The same for one with an end of a stream, which is connected with all others, and
/// with those who died since it looked last.
const HELD_ON_STREAM_MAX: (usize, usize) = (72, 48);

const TICK: Duration = Duration::from_micros(200);

/// What a run has seen.
#[derive(Debug, Default)]
pub(crate) struct Totals {
    pub(crate) rounds: u64,
    pub(crate) messages: u64,
    pub(crate) kills: u64,
    pub(crate) deaths_at_fail_points: u64,
    pub(crate) places: BTreeSet<String>,
    pub(crate) stops: u64,
    pub(crate) broker_deaths: u64,
    pub(crate) requests: u64,
    pub(crate) slowest_us: u64,
    pub(crate) noise_us: u64,
}

/// What is dropped goes in this order: the bus last, which removes all.
pub(crate) struct Era<'n> {
    processes: Vec<Process>,
    keeper: Option<RawSubscription>,
    session: Option<Session>,
    broker: Broker,
    ledger: Ledger,
    stopped: Vec<Stopped>,
    next_sender: u64,
    topic: &'static str,
    round: u64,
    /// The generation before the round.
    base: u32,
    /// How often there was no broker before the round.
    downs: usize,
    /// How often the broker had removed something unfinished before the round.
    removals: usize,
    noise: &'n Noise,
    world: World,
    faults: Vec<String>,
    bus: Bus,
}

impl<'n> Era<'n> {
    pub(crate) fn begin(first_round: u64, noise: &'n Noise) -> anyhow::Result<Self> {
        let topic = shared_topic::of_bus(first_round / crate::ERA);
        let bus = Bus::without_broker();
        let ledger = Ledger::create(bus.system.base())?;
        ledger.set_phase(first_round, Phase::Run);
        let mut broker = Broker::new();
        broker.start(&bus, None)?;
        let session = Session::connect_to(&bus.system)?;
        let keeper = RawSubscription::subscribe_described(
            &session,
            &shared_topic::metadata(topic),
            Instance::FIRST,
        )?;
        let mut era = Self {
            world: World::of(&bus.system),
            bus,
            broker,
            ledger,
            session: Some(session),
            keeper: Some(keeper),
            processes: Vec::new(),
            stopped: Vec::new(),
            next_sender: 1,
            topic,
            round: first_round,
            base: 0,
            downs: 0,
            removals: 0,
            noise,
            faults: Vec::new(),
        };
        era.base = era.newest();
        for kind in ["publisher", "publisher", "claimer", "subscriber", "descriptor", "follower"] {
            era.spawn(kind, 0, None)?;
        }
        era.wait("the first six have begun", |era| {
            era.processes.iter().all(|process| process.cell.get(Word::State) == 1)
        });
        Ok(era)
    }

    fn spawn(
        &mut self,
        kind: &'static str,
        storm_us: u64,
        fate: Option<&crate::bus::Fate>,
    ) -> anyhow::Result<()> {
        let used: BTreeSet<usize> =
            self.processes.iter().map(|process| process.cell.index).collect();
        let Some(free) = (0..CELLS).find(|index| !used.contains(index)) else { return Ok(()) };
        let (cell, sender) = (self.ledger.cell(free), self.next_sender);
        self.next_sender += 1;
        let of = (self.topic, storm_us);
        let process = Process::spawn(&self.bus, &self.ledger, cell, kind, sender, of, fate)?;
        self.processes.push(process);
        Ok(())
    }

    fn fault(&mut self, what: String) {
        if self.faults.len() < 20 {
            self.faults.push(what);
        }
    }

    /// Shows where something is wrong who there is, and the broker's last words.
    fn show(&self) {
        self.processes.iter().for_each(|process| eprintln!("{}", process.describe()));
        let log = std::fs::read_to_string(self.bus.system.log()).unwrap_or_default();
        let last: Vec<&str> = log.lines().rev().take(60).collect();
        last.into_iter().rev().for_each(|line| eprintln!("  {line}"));
    }

    /// Waits until something is so. What never comes is a fault. How long it
    /// took, in microseconds.
    fn wait(&mut self, what: &str, mut is_so: impl FnMut(&mut Self) -> bool) -> u64 {
        let (from, deadline) = (now_us(), Instant::now() + PATIENCE);
        while !is_so(self) {
            if Instant::now() > deadline {
                self.fault(format!("it never came: {what}"));
                self.show();
                if std::env::var_os("CHAOS_HOLD").is_some() {
                    eprintln!("held, pid {}", std::process::id());
                    std::thread::sleep(Duration::from_secs(600));
                }
                break;
            }
            std::thread::sleep(TICK);
        }
        now_us() - from
    }

    /// As `wait`, for what must come within the limit.
    fn wait_shortly(&mut self, what: &str, more_us: u64, is_so: impl FnMut(&mut Self) -> bool) {
        let from = now_us();
        self.wait(what, is_so);
        // A broker that was to die somewhere may have done it meanwhile.
        let up = self.broker.up_us();
        let more_us = if up > from { more_us.max(RESTART_US) } else { more_us };
        let more_us = more_us + self.unfinished_us();
        let from = from.max(up);
        let took_us = now_us() - from;
        let noise_us = self.noise.between(from, now_us());
        if took_us > LIMIT_US + more_us + noise_us {
            self.fault(format!("it took {took_us} us (noise {noise_us}): {what}"));
        }
    }

    /// How often the broker has removed what somebody did not live to finish.
    fn removals(&self) -> usize {
        let log = std::fs::read_to_string(self.bus.system.log()).unwrap_or_default();
        log.matches("was begun by somebody who was killed").count()
    }

    /// How much longer things may take in this round, because of such a file.
    fn unfinished_us(&self) -> u64 {
        if self.removals() > self.removals { UNFINISHED_US } else { 0 }
    }

    /// One round. What was wrong in it.
    pub(crate) fn round(&mut self, seed: u64, totals: &mut Totals) -> anyhow::Result<Vec<String>> {
        self.recruit()?;
        let plan = Plan::draw(&mut Random::of_round(seed, self.round));
        let began_us = now_us();
        self.stopped.clear();
        self.downs = self.broker.down_us.len();
        self.removals = self.removals();
        if let Some(fate) = &plan.burial {
            self.broker.kill();
            while !self.broker.start(&self.bus, Some(fate))? {}
        }
        for (kind, storm_us, fate) in &plan.newcomers {
            self.spawn(kind, *storm_us, fate.as_ref())?;
        }
        let started = Instant::now();
        for moment in &plan.moments {
            let at = started + Duration::from_micros(moment.at_us);
            std::thread::sleep(at.saturating_duration_since(Instant::now()));
            self.act(moment, totals);
        }
        let end = started + Duration::from_micros(plan.lasts_us);
        std::thread::sleep(end.saturating_duration_since(Instant::now()));
        let restarted = self.end_of_the_violence(&plan, totals)?;
        self.settle(restarted);
        // First: the broker keeps the last message of who has just died.
        self.look_at_the_bus(restarted)?;
        self.count(totals);
        let judge = Judge {
            noise: self.noise,
            stopped: &self.stopped,
            down: &self.broker.down_us,
            unfinished_us: self.unfinished_us(),
        };
        let verdicts: Vec<String> =
            self.processes.iter().flat_map(|process| judge.lates(process, began_us)).collect();
        verdicts.into_iter().for_each(|verdict| self.fault(verdict));
        let described = format!("{plan:?}");
        if !self.faults.is_empty() {
            self.show();
        }
        self.bury(totals);
        self.next_round();
        totals.rounds += 1;
        let faults = std::mem::take(&mut self.faults);
        if !faults.is_empty() {
            eprintln!("the plan was {described}");
        }
        Ok(faults)
    }

    fn settle(&mut self, restarted: bool) {
        let round = self.round;
        self.wait("newcomers have begun", |era| {
            era.keep_a_broker();
            era.processes.iter_mut().all(|process| {
                !process.lives()
                    || process.cell.get(Word::State) > 0
                    || process.publishes() && process.cell.get(Word::Requests) > 2
            })
        });
        // A publisher that unadvertises waits for the broker, too.
        let more_us = if restarted { RESTART_US } else { 0 };
        self.ledger.set_phase(round, Phase::Quiet);
        self.wait_shortly("publishers pause", more_us, |era| {
            era.keep_a_broker();
            era.processes
                .iter_mut()
                .filter(|process| process.publishes())
                .all(|process| !process.lives() || process.cell.get(Word::PausedIn) == round + 1)
        });
        let newest = u64::from(self.newest());
        let published = self.published();
        // A large message whose publisher was killed before it was sent is lost.
        let may_be_lost = shared_topic::is_large(self.topic) && self.killed_publishers() > 0;
        self.wait_shortly("whoever sleeps is woken for what is there", more_us, |era| {
            era.keep_a_broker();
            published == 0
                || may_be_lost
                || era.processes.iter_mut().filter(|process| process.copies()).all(|process| {
                    !process.lives()
                        || process.cell.get(Word::State) != 1
                        || process.cell.get(Word::Seen) == newest
                })
        });
        self.ledger.set_phase(round, Phase::Drain);
        let mut ticks = 0_u64;
        self.wait("everybody pauses", |era| {
            era.keep_a_broker();
            ticks += 1;
            let mut all = true;
            for process in era.processes.iter_mut().filter(|process| process.copies()) {
                if process.lives() && process.cell.get(Word::PausedIn) != round + 1 {
                    all = false;
                    if ticks.is_multiple_of(10) && process.cell.get(Word::State) == 1 {
                        signal(process.pid(), Signal::SIGUSR1);
                    }
                }
            }
            all
        });
    }

    /// Who has ended, and why.
    fn bury(&mut self, totals: &mut Totals) {
        let down = self.broker.down_us.len();
        for process in std::mem::take(&mut self.processes) {
            totals.requests += process.cell.get(Word::Requests);
            let slowest_us = process.cell.get(Word::SlowestRequest);
            if self.broker.down_us.len() == 1 {
                totals.slowest_us = totals.slowest_us.max(slowest_us);
            }
            let Some(status) = process.ended else {
                self.processes.push(process);
                continue;
            };
            let failure = process.cell.failure();
            let is_killed = std::os::unix::process::ExitStatusExt::signal(&status)
                == Some(Signal::SIGKILL as i32);
            match (&process.fate, failure, is_killed) {
                (Some(fate), _, true) => {
                    if let Some(place) = fate.strip_prefix("UORB_DIE_AT ") {
                        totals.deaths_at_fail_points += 1;
                        totals.places.insert(place.split(':').next().unwrap_or(place).into());
                    }
                }
                // Who starts while no broker runs is told so.
                (_, Some(failure), _) if failure.starts_with("NoBroker") && down > 1 => {}
                (fate, failure, _) => {
                    let (kind, pid) = (process.kind, process.pid());
                    let why = failure.unwrap_or_default();
                    self.fault(format!("{kind} {pid} ended: {status} {why} (fate: {fate:?})"));
                }
            }
        }
    }

    fn next_round(&mut self) {
        self.base = self.newest();
        for process in &self.processes {
            let cell = process.cell;
            cell.set(Word::First, self.base.into());
            cell.set(Word::LostBefore, cell.get(Word::Lost));
            for word in [Word::Copied, Word::Logged, Word::Lates, Word::Torn] {
                cell.set(word, 0);
            }
        }
        for process in &mut self.processes {
            process.was_stopped = false;
        }
        self.round += 1;
        self.ledger.set_phase(self.round, Phase::Run);
    }

    /// Fills the crew up again after many deaths.
    fn recruit(&mut self) -> anyhow::Result<()> {
        for (kind, wanted) in [
            ("publisher", 2),
            ("claimer", 1),
            ("subscriber", 1),
            ("descriptor", 1),
            ("follower", 1),
        ] {
            let there = self.processes.iter().filter(|process| process.kind == kind).count();
            for _ in there..wanted {
                self.spawn(kind, 0, None)?;
            }
        }
        Ok(())
    }

    /// How often the broker died, and where it was told to.
    pub(crate) fn broker_deaths(&self) -> (u64, &[String]) {
        (self.broker.down_us.len() as u64 - 1, &self.broker.died_at)
    }
}
