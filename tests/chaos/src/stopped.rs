//! One party is stopped for seconds, and nobody else is slower by it: a publisher
//! of the same instance in mid-publish, a subscriber, a follower of the stream,
//! the broker.
//!
//! The controller publishes and copies, and times both. The time with the party
//! running is the control: its windows say how much this machine varies by
//! itself. With the party stopped the usual window (the median) may not be worse
//! than the worst of the control.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use uorb_core::zerocopy::IntoBytes;
use uorb_core::{AdvertiseOptions, Instance, RawPublication, RawSubscription, Session, poll};
use uorb_tests::{Bus, Stamped};

use crate::bus::{Broker, Fate, Process, signal};
use crate::ledger::{Ledger, Phase, Word};
use crate::shared_topic::metadata;

const TOPIC: &str = "stamped";
const WINDOWS: u32 = 10;
const PATIENCE: Duration = Duration::from_secs(20);

/// The 99th percentiles of publishing and of waking, a window each, in
/// nanoseconds.
#[derive(Debug, Default)]
struct Measured {
    publish_ns: Vec<u64>,
    wake_ns: Vec<u64>,
}

/// Publishes and copies for so long. Asks nothing of the broker.
fn measure(
    publication: &mut RawPublication,
    subscription: &mut RawSubscription,
    peer: u64,
    length: Duration,
) -> anyhow::Result<Measured> {
    let mut measured = Measured::default();
    for _ in 0..WINDOWS {
        let over = AtomicBool::new(false);
        subscription.skip();
        let (publishes, wakes) = std::thread::scope(|threads| -> anyhow::Result<_> {
            let reader = threads.spawn(|| -> Result<Vec<u64>, uorb_core::Error> {
                let (mut wakes, mut bytes) = (Vec::new(), Vec::new());
                while !over.load(Ordering::Relaxed) {
                    if poll(&mut [&mut *subscription], Some(Duration::from_millis(20)))? == 0 {
                        continue;
                    }
                    let mut first = true;
                    while subscription.updated() && subscription.copy(&mut bytes) {
                        let copied = subscription.last_copied().expect("it was just copied");
                        // Of our own: another's stamp may be older than its commit.
                        if first && copied.peer == subscription_peer(&bytes) {
                            let age_us = uorb_core::now_us().saturating_sub(copied.publish_time_us);
                            wakes.push(age_us * 1_000);
                        }
                        first = false;
                    }
                }
                Ok(wakes)
            });
            let (mut publishes, end) = (Vec::new(), Instant::now() + length / WINDOWS);
            while Instant::now() < end {
                let message = Stamped::new(publishes.len() as u64, peer);
                let from = Instant::now();
                publication.publish(message.as_bytes())?;
                publishes.push(from.elapsed().as_nanos() as u64);
                std::thread::sleep(Duration::from_micros(200));
            }
            over.store(true, Ordering::Relaxed);
            let wakes = reader.join().expect("it does not panic")?;
            Ok((publishes, wakes))
        })?;
        measured.publish_ns.push(p99(publishes));
        measured.wake_ns.push(p99(wakes));
    }
    Ok(measured)
}

/// The sender that the message itself names: ours names its peer.
fn subscription_peer(bytes: &[u8]) -> u16 {
    bytes.get(8..10).map_or(0, |low| u16::from_ne_bytes([low[0], low[1]]))
}

fn p99(mut all: Vec<u64>) -> u64 {
    all.sort_unstable();
    all.get(all.len() * 99 / 100).copied().unwrap_or(0)
}

fn median(mut all: Vec<u64>) -> u64 {
    all.sort_unstable();
    all[all.len() / 2]
}

/// Stops each party for so long. What was wrong.
pub(crate) fn stop_each(seconds: u64) -> anyhow::Result<Vec<String>> {
    let length = Duration::from_secs(seconds);
    let bus = Bus::without_broker();
    let ledger = Ledger::create(bus.system.base())?;
    ledger.set_phase(0, Phase::Run);
    let mut broker = Broker::new();
    broker.start(&bus, None)?;
    let session = Session::connect_to(&bus.system)?;
    let peer = u64::from(session.peer());
    let metadata = metadata(TOPIC);
    let mut publication =
        RawPublication::advertise(&session, &metadata, AdvertiseOptions::default())?;
    let mut subscription =
        RawSubscription::subscribe_described(&session, &metadata, Instance::FIRST)?;
    let mut faults = Vec::new();
    let parties = [
        ("publisher", Some("publish.claimed:2000")),
        ("publisher", Some("publish.committed:2000")),
        ("subscriber", None),
        ("follower", None),
        ("broker", None),
    ];
    for (index, (kind, place)) in parties.into_iter().enumerate() {
        let cell = ledger.cell(index);
        let mut party = None;
        if kind != "broker" {
            // It stops where it is told to, in the middle of a publish.
            let fate = place.map(|place| Fate { variable: "UORB_STOP_AT", place: place.into() });
            let of = (TOPIC, 0);
            let sender = 1_000 + index as u64;
            let process = Process::spawn(&bus, &ledger, cell, kind, sender, of, fate.as_ref())?;
            wait(&mut faults, "it has begun", || cell.get(Word::State) == 1);
            party = Some(process);
        }
        let pid = party.as_ref().map_or(broker.pid().unwrap_or(0), Process::pid);
        let control = measure(&mut publication, &mut subscription, peer, length)?;
        match (&party, place) {
            (Some(process), Some(_)) => {
                wait(&mut faults, "it has stopped in mid-publish", || process.is_stopped());
            }
            _ => signal(pid, Signal::SIGSTOP),
        }
        let stopped = measure(&mut publication, &mut subscription, peer, length)?;
        let before = cell.get(Word::Done) + cell.get(Word::Copied);
        signal(pid, Signal::SIGCONT);
        if kind != "broker" {
            // A publisher waits for nobody; the others are published for.
            publication.publish(Stamped::new(0, peer).as_bytes())?;
            wait(&mut faults, "it goes on", || {
                cell.get(Word::Done) + cell.get(Word::Copied) > before
            });
        }
        let name = place.map_or(kind.to_string(), |place| format!("{kind} at {place}"));
        for (what, with, without) in [
            ("publish", stopped.publish_ns, control.publish_ns),
            ("wake", stopped.wake_ns, control.wake_ns),
        ] {
            let worst = without.iter().max().copied().unwrap_or(0);
            let (usual, usual_before) = (median(with), median(without));
            println!(
                "{name} stopped for {seconds} s: p99 of {what} {usual} ns, before {usual_before} \
                 (worst window {worst})"
            );
            // The clock of a wake counts microseconds.
            if usual > worst + 1_000 {
                faults.push(format!("{name}, stopped, makes a {what} slower"));
            }
        }
    }
    println!("{} faults", faults.len());
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
