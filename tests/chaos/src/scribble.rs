//! A process that writes random bytes over every page of the bus that it may
//! write, while others use the bus.
//!
//! It has what any process may have: a publication, whose ring it maps writable,
//! and a subscription, whose doorbell. Nobody else may crash by it: not the
//! broker, and no process on the same node, whose messages may be garbage. On
//! other nodes nobody may notice.
//!
//! The streams' memory is iceoryx2's, whose processes trust each other; it is
//! left alone unless it is asked for.

#![allow(unsafe_code)]

use std::time::{Duration, Instant};

use uorb_core::broker_side::{Reply, Request};
use uorb_core::zerocopy::{FromBytes, IntoBytes};
use uorb_core::{
    AdvertiseOptions, Error, Instance, RawPublication, RawSubscription, Session, now_us, poll,
};
use uorb_tests::{Bus, Stamped};

use crate::bus::{Broker, Process};
use crate::ledger::{Cell, Ledger, Word};
use crate::random::Random;
use crate::shared_topic::metadata;

const SPOILT: &str = "stamped";
const SOUND: &str = "orb_test_medium_wrap_around";
const PATIENCE: Duration = Duration::from_secs(20);

pub(crate) fn run(cell: Cell, sender: u64, kind: &str, topic: &str) -> bool {
    nix::sys::prctl::set_pdeathsig(nix::sys::signal::Signal::SIGKILL).expect("Linux has it");
    let ran = match kind {
        "scribbler" => scribble(cell, sender, topic),
        "honest-publisher" => publish(cell, sender, topic),
        _ => copy(cell, topic),
    };
    ran.inspect_err(|error| cell.fail(&format!("{error:?}"))).is_ok()
}

/// The shared mappings of the bus that this process may write.
fn writable() -> Vec<(usize, usize)> {
    let maps = std::fs::read_to_string("/proc/self/maps").expect("proc is mounted");
    let range = |line: &str| {
        let mut words = line.split_whitespace();
        let (range, rights) = (words.next()?, words.next()?);
        let (start, end) = range.split_once('-')?;
        let parse = |digits| usize::from_str_radix(digits, 16).ok();
        (rights == "rw-s" && line.contains("/obj/")).then_some((parse(start)?, parse(end)?))
    };
    maps.lines().filter_map(range).collect()
}

fn scribble(cell: Cell, sender: u64, topic: &str) -> Result<(), Error> {
    let session = Session::connect()?;
    let metadata = metadata(topic);
    let _publication = RawPublication::advertise(&session, &metadata, AdvertiseOptions::default())?;
    let _subscription = RawSubscription::subscribe_described(&session, &metadata, Instance::FIRST)?;
    let pages = writable();
    assert!(pages.len() >= 2, "a ring and a doorbell");
    cell.set(Word::State, 1);
    let mut random = Random::new(now_us() ^ sender);
    for round in 0_u64.. {
        let (start, end) = *random.of(&pages);
        let words = (end - start) / 8;
        // Mostly the first words, where the counters and tables are.
        let reach = if random.once_in(3) { words } else { words.min(2_048) };
        let word = random.below(reach as u64) as usize;
        let value = match random.below(4) {
            0 => random.next(),
            1 => random.below(64),
            2 => u64::MAX << random.below(64),
            _ => (1 << 48) + random.below(1 << 40),
        };
        // SAFETY: the word lies in a mapping of this process that it may write,
        // and that stays; to write there what nobody expects is the purpose.
        unsafe { std::ptr::write_volatile((start as *mut u64).add(word), value) };
        if round.is_multiple_of(4_096) {
            cell.add(Word::Copied, 4_096);
            std::thread::sleep(Duration::from_micros(200));
        }
    }
    Ok(())
}

fn publish(cell: Cell, sender: u64, topic: &str) -> Result<(), Error> {
    let session = Session::connect()?;
    let metadata = metadata(topic);
    let mut publication = None;
    for count in 0_u64.. {
        // Now and then anew, by way of the broker.
        let mut held = match publication.take() {
            Some(held) => held,
            None => RawPublication::advertise(&session, &metadata, AdvertiseOptions::default())?,
        };
        cell.set(Word::State, 1);
        match held.publish(Stamped::new(count, sender).as_bytes()) {
            Ok(_) => cell.add(Word::Done, 1),
            // All slots look taken: an error with a name.
            Err(Error::Busy { .. }) => cell.add(Word::Lost, 1),
            Err(error) => return Err(error),
        }
        if !count.is_multiple_of(500) {
            publication = Some(held);
        }
        std::thread::sleep(Duration::from_micros(50));
    }
    Ok(())
}

fn copy(cell: Cell, topic: &str) -> Result<(), Error> {
    let session = Session::connect()?;
    loop {
        let mut subscription =
            RawSubscription::subscribe_described(&session, &metadata(topic), Instance::FIRST)?;
        cell.set(Word::State, 1);
        let mut bytes = Vec::new();
        let until = Instant::now() + Duration::from_millis(50);
        while Instant::now() < until {
            match poll(&mut [&mut subscription], Some(Duration::from_millis(5))) {
                Ok(_) => {}
                // The ring contradicts itself, and says so.
                Err(Error::CorruptNode { .. }) => {
                    cell.add(Word::Lost, 1);
                    break;
                }
                Err(error) => return Err(error),
            }
            let mut most = 100;
            while most > 0 && subscription.updated() && subscription.copy(&mut bytes) {
                let whole = Stamped::read_from_bytes(&bytes).is_ok_and(|copy| copy.is_whole());
                cell.add(Word::Torn, u64::from(!whole));
                cell.add(Word::Copied, 1);
                most -= 1;
            }
            cell.set(Word::Seen, now_us());
        }
    }
}

/// Lets two scribble for so long. What was wrong.
pub(crate) fn scribble_for(seconds: u64) -> anyhow::Result<Vec<String>> {
    let bus = Bus::without_broker();
    let ledger = Ledger::create(bus.system.base())?;
    let mut broker = Broker::new();
    broker.start(&bus, None)?;
    let keeper = Session::connect_to(&bus.system)?;
    let mut processes = Vec::new();
    let kinds = [
        ("honest-publisher", SOUND),
        ("honest-subscriber", SOUND),
        ("honest-publisher", SPOILT),
        ("honest-subscriber", SPOILT),
        ("honest-subscriber", SPOILT),
        ("scribbler", SPOILT),
        ("scribbler", SPOILT),
    ];
    for (index, (kind, topic)) in kinds.into_iter().enumerate() {
        let (cell, sender) = (ledger.cell(index), index as u64 + 1);
        let of = (topic, 0);
        processes.push(Process::spawn(&bus, &ledger, cell, kind, sender, of, None)?);
    }
    let mut faults = Vec::new();
    let end = Instant::now() + Duration::from_secs(seconds);
    let mut last_copied = 0;
    let mut scribblers = 0;
    while Instant::now() < end && faults.is_empty() {
        std::thread::sleep(Duration::from_millis(250));
        if !broker.runs() {
            faults.push("the broker has died".into());
            break;
        }
        let asked = Instant::now();
        if !matches!(keeper.ask(Request::Status), Ok(Reply::Status(_))) {
            faults.push(format!("the broker does not answer, after {:?}", asked.elapsed()));
        }
        for process in &mut processes {
            if !process.lives() {
                let (kind, ended, why) = (process.kind, process.ended, process.cell.failure());
                faults.push(format!("{kind} has ended: {ended:?} {why:?}"));
            }
            // It looks every 5 ms.
            let seen_us = process.cell.get(Word::Seen);
            let idle_us = now_us().saturating_sub(seen_us);
            if process.kind == "honest-subscriber" && seen_us > 0 && idle_us > 5_000_000 {
                faults.push(format!("an {} hangs", process.kind));
            }
        }
        let copied = processes[1].cell.get(Word::Copied);
        if copied == last_copied {
            faults.push("nothing flows on the other node".into());
        }
        last_copied = copied;
        // A scribbler dies, and another comes.
        scribblers += 1;
        let turn = 5 + scribblers % 2;
        processes[turn].kill();
        let cell = processes[turn].cell;
        let of = (SPOILT, 0);
        let scribbled = cell.get(Word::Copied);
        ledger.shared(0).fetch_add(scribbled, std::sync::atomic::Ordering::Relaxed);
        processes[turn] =
            Process::spawn(&bus, &ledger, cell, "scribbler", 100 + turn as u64, of, None)?;
    }
    if processes[1].cell.get(Word::Torn) > 0 {
        faults.push("the other node has torn messages".into());
    }
    let spoilt = [2, 3, 4].map(|index: usize| processes[index].cell);
    println!(
        "{seconds} s of scribbling by {} processes, {} words: on the same node {} messages \
         published, {} times busy, {} copied, {} of them garbage, {} times told that it is \
         corrupt; on another one {} copied, all whole; {} faults",
        scribblers + 2,
        ledger.shared(0).load(std::sync::atomic::Ordering::Relaxed),
        spoilt[0].get(Word::Done),
        spoilt[0].get(Word::Lost),
        spoilt[1].get(Word::Copied) + spoilt[2].get(Word::Copied),
        spoilt[1].get(Word::Torn) + spoilt[2].get(Word::Torn),
        spoilt[1].get(Word::Lost) + spoilt[2].get(Word::Lost),
        processes[1].cell.get(Word::Copied),
        faults.len(),
    );
    // Everybody goes before the broker: it buries them.
    processes.clear();
    let deadline = Instant::now() + PATIENCE;
    let buried =
        || matches!(keeper.ask(Request::Peers), Ok(Reply::Peers(peers)) if peers.len() == 1);
    while !buried() && Instant::now() < deadline {
        std::thread::sleep(Duration::from_millis(5));
    }
    if !buried() {
        faults.push("the broker has not buried everybody".into());
    }
    if !broker.stop()?.success() {
        faults.push("the broker did not end well".into());
    }
    Ok(faults)
}
