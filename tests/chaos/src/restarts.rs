//! The broker is killed and started again, over and over, under load: nothing is
//! lost at a queue of 16, and every process re-joins. Every other time it is
//! replaced by another build, as in an upgrade.
//!
//! Publishers wait for the slowest subscription, in the ledger, so that nobody
//! may lose anything by being slow. Whatever is lost all the same is a fault.

use std::time::{Duration, Instant};

use uorb_core::broker_side::{Reply, Request};
use uorb_core::zerocopy::{FromBytes, IntoBytes};
use uorb_core::{
    AdvertiseOptions, Instance, RawPublication, RawSubscription, Session, StreamOptions, now_us,
    poll,
};
use uorb_tests::{Bus, Stamped};

use crate::bus::{Broker, Process};
use crate::ledger::{Cell, Ledger, Word};
use crate::shared_topic::{QUEUE, metadata};

const PATIENCE: Duration = Duration::from_secs(20);
const TOPIC: &str = "stamped";
const KINDS: [&str; 5] = ["pace", "pace", "keep-up", "keep-up", "keep-up-stream"];

/// What the processes do. False: something went wrong, and the cell says what.
pub(crate) fn run(ledger: &Ledger, cell: Cell, sender: u64, kind: &str) -> bool {
    nix::sys::prctl::set_pdeathsig(nix::sys::signal::Signal::SIGKILL).expect("Linux has it");
    let ran = match kind {
        "pace" => pace(ledger, cell, sender),
        kind => keep_up(cell, kind == "keep-up-stream"),
    };
    ran.inspect_err(|error| cell.fail(&format!("{error:?}"))).is_ok()
}

/// Publishes while everybody keeps up: each publisher has half the queue.
fn pace(ledger: &Ledger, cell: Cell, sender: u64) -> Result<(), uorb_core::Error> {
    let session = Session::connect()?;
    let mut publication =
        RawPublication::advertise(&session, &metadata(TOPIC), AdvertiseOptions::default())?;
    cell.set(Word::State, 1);
    // All have subscribed.
    while ledger.cell(0).get(Word::PausedIn) == 0 {
        std::thread::yield_now();
    }
    for count in 0.. {
        // A subscription notes how much it has copied of all.
        let published =
            || -> u64 { (0..KINDS.len()).map(|index| ledger.cell(index).get(Word::Begun)).sum() };
        let slowest = || {
            let cells = (0..KINDS.len()).map(|index| ledger.cell(index));
            let copied = cells.filter(|cell| cell.get(Word::Instance) == 1);
            copied.map(|cell| cell.get(Word::Copied)).min().unwrap_or(0)
        };
        while published() + 2 > slowest() + u64::from(QUEUE) {
            std::thread::yield_now();
        }
        cell.add(Word::Begun, 1);
        publication.publish(Stamped::new(count, sender).as_bytes())?;
        if count % 16 == 0 {
            std::thread::sleep(Duration::from_micros(100));
        }
    }
    Ok(())
}

fn keep_up(cell: Cell, streams: bool) -> Result<(), uorb_core::Error> {
    let session = Session::connect()?;
    let mut subscription = if streams {
        let options = StreamOptions { depth: Some(64), back_pressure: false };
        RawSubscription::subscribe_stream(&session, TOPIC, Instance::FIRST, options)?
    } else {
        RawSubscription::subscribe_described(&session, &metadata(TOPIC), Instance::FIRST)?
    };
    cell.set(Word::Instance, 1);
    cell.set(Word::State, 1);
    let mut bytes = Vec::new();
    loop {
        poll(&mut [&mut subscription], None)?;
        while subscription.updated() {
            let copied = match streams {
                true => subscription.borrow_update().map(Stamped::read_from_bytes),
                false => subscription.copy(&mut bytes).then(|| Stamped::read_from_bytes(&bytes)),
            };
            let Some(Ok(message)) = copied else { continue };
            cell.add(Word::Torn, u64::from(!message.is_whole()));
            cell.set(Word::Lost, subscription.lost());
            cell.add(Word::Copied, 1);
        }
    }
}

/// Restarts the broker so often. What was wrong.
pub(crate) fn restart(times: u64) -> anyhow::Result<Vec<String>> {
    let bus = Bus::without_broker();
    let ledger = Ledger::create(bus.system.base())?;
    let mut broker = Broker::new();
    broker.start(&bus, None)?;
    let keeper = Session::connect_to(&bus.system)?;
    let mut processes = Vec::new();
    for (index, kind) in KINDS.into_iter().enumerate() {
        let (cell, sender) = (ledger.cell(index), index as u64 + 1);
        let of = (TOPIC, 0);
        processes.push(Process::spawn(&bus, &ledger, cell, kind, sender, of, None)?);
    }
    let mut faults = Vec::new();
    let began = Instant::now();
    let copied = || ledger.cell(KINDS.len() - 1).get(Word::Copied);
    wait(&mut faults, "all have begun", || {
        (0..KINDS.len()).all(|index| ledger.cell(index).get(Word::State) == 1)
    });
    ledger.cell(0).set(Word::PausedIn, 1);
    let (mut slowest_us, mut between) = (0, 0);
    for time in 0..times {
        let before = copied();
        if time % 2 == 0 {
            broker.kill();
            // It goes on without a broker.
            wait(&mut faults, "messages flow without a broker", || copied() > before + 20);
            broker.start(&bus, None)?;
        } else {
            broker.upgrade(&bus)?;
        }
        let started_us = now_us();
        wait(&mut faults, "all have re-joined", || match keeper.ask(Request::Peers) {
            Ok(Reply::Peers(peers)) => {
                peers.iter().filter(|peer| peer.connected).count() == KINDS.len() + 1
            }
            _ => false,
        });
        slowest_us = slowest_us.max(now_us() - started_us);
        between += copied() - before;
        if !faults.is_empty() {
            break;
        }
    }
    for process in &mut processes {
        let (kind, cell) = (process.kind, process.cell);
        if !process.lives() {
            faults.push(format!("{kind} has ended: {:?} {:?}", process.ended, cell.failure()));
        }
        if cell.get(Word::Lost) + cell.get(Word::Torn) > 0 {
            let (lost, torn) = (cell.get(Word::Lost), cell.get(Word::Torn));
            faults.push(format!("{kind} lost {lost} and copied {torn} torn ones"));
        }
    }
    println!(
        "{times} restarts of the broker, every other one an upgrade, in {:.1} s: {} messages to each of three, {between} of \
         them between a kill and the last re-joining, which took {slowest_us} us at most; {} \
         faults",
        began.elapsed().as_secs_f64(),
        copied(),
        faults.len(),
    );
    Ok(faults)
}

fn wait(faults: &mut Vec<String>, what: &str, is_so: impl Fn() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !is_so() {
        if Instant::now() > deadline {
            return faults.push(format!("it never came: {what}"));
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}
