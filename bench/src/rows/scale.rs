//! Many topics: what it takes to make them, to keep them, and to look at them.

use std::borrow::Cow;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::{Duration, Instant};

use nix::sys::time::TimeValLike;
use nix::time::ClockId;
use nix::unistd::Pid;
use uorb_core::{
    AdvertiseOptions, Instance, Layout, Metadata, QueueLength, RawPublication, RawSubscription,
    Session,
};
use uorb_tests::{Bus, heard, number};

use super::Run;
use super::kernel::eventfd_wake;
use crate::doors::eventfd;
use crate::figures::Contestant;
use crate::place::Place;
use crate::role::play;
use crate::times::Times;

const NODES: usize = 1_000;
const BYTES: u32 = 64;
const TOPICS: usize = 200;
const PERIOD: Duration = Duration::from_millis(4);

pub const NODES_ROW: &str = "1,000 nodes";
pub const BROKER: (&str, &str) = ("CPU of the broker", "200 topics at 250 Hz");

pub fn measure(run: &mut Run, bus: &mut Bus) {
    beginning(run, bus);
    nodes(run);
    broker_cpu(run);
}

/// A topic of 64 bytes, as one that is only known at run time is described.
fn metadata(name: String) -> Metadata {
    let fields = Cow::Borrowed(&[][..]);
    let layout = Layout { name: name.clone().into(), size_bytes: BYTES, message_hash: 0, fields };
    let layout = Cow::Owned(layout);
    Metadata { name: name.into(), layout, queue_length: QueueLength::ONE }
}

fn advertise(session: &Session, name: String) -> RawPublication {
    let options = AdvertiseOptions::default();
    RawPublication::advertise(session, &metadata(name), options).expect("advertised")
}

fn subscribe(session: &Session, name: String) -> RawSubscription {
    RawSubscription::subscribe(session, &name, Instance::FIRST).expect("subscribed")
}

/// Advertise, subscribe, and the first publish of new topics.
fn beginning(run: &mut Run, bus: &mut Bus) {
    let count = if run.figures.effort.is_quick { 20 } else { 50 };
    let session = bus.session();
    let bus = &*bus;
    let place = Place::unpinned();
    let counters = eventfd::Counters::new();
    let mut wake = || eventfd_wake(bus, &place, &counters, count);
    let time = |act: &mut dyn FnMut(u32)| {
        let mut times = Times::none();
        for index in 0..count {
            let began = Instant::now();
            act(index);
            times.add_ns(began.elapsed().as_nanos() as f64);
        }
        times
    };
    let (mut publications, mut subscriptions) = (Vec::new(), Vec::new());
    let floor = "eventfd and poll";
    let contestant = Contestant::new("uorb", || {
        time(&mut |_| {
            let name = format!("new_{}", publications.len());
            publications.push(advertise(&session, name));
        })
    });
    run.figures.measure(("advertise", "a new topic"), (floor, &mut wake), vec![contestant]);
    let mut silent = publications.iter_mut();
    let first = Contestant::new("uorb", || {
        time(&mut |_| {
            let publication = silent.next().expect("as many as were advertised");
            publication.publish(&[1; BYTES as usize]).expect("published");
        })
    });
    run.figures.measure(("first publish", "a new topic"), (floor, &mut wake), vec![first]);
    let contestant = Contestant::new("uorb", || {
        time(&mut |_| {
            let name = format!("new_{}", subscriptions.len());
            subscriptions.push(subscribe(&session, name));
        })
    });
    run.figures.measure(("subscribe", "a topic"), (floor, &mut wake), vec![contestant]);
}

/// On a bus of their own, so that what they take can be seen.
fn nodes(run: &mut Run) {
    let mut bus = Bus::start();
    let session = bus.session();
    let before = Seen::of(&bus);
    let began = Instant::now();
    let mut publications: Vec<_> =
        (0..NODES).map(|index| advertise(&session, format!("node_{index}"))).collect();
    let took = began.elapsed();
    for publication in &mut publications {
        publication.publish(&[1; BYTES as usize]).expect("published");
    }
    settle(&bus);
    let advertised = Seen::of(&bus);
    let subscriptions: Vec<_> =
        (0..NODES).map(|index| subscribe(&session, format!("node_{index}"))).collect();
    let subscribed = Seen::of(&bus);
    subscriptions.iter().for_each(|it| it.open_descriptor().expect("there are descriptors left"));
    let slept = Seen::of(&bus);

    let figures = &mut run.figures;
    let mut value = |setting, value, unit| {
        figures.note_value((NODES_ROW, setting), "uorb", value, unit);
    };
    value("time to advertise all", took.as_secs_f64(), "s");
    value("memory of the broker", slept.broker_mib, "MiB");
    value("one refresh of top, CPU time", top(&bus).as_secs_f64() * 1e3, "ms");
    let each = |after: f64, before: f64| (after - before) / NODES as f64;
    let mut value = |setting, value, unit| {
        figures.note_value(("memory and descriptors", setting), "uorb", value, unit);
    };
    value("shared memory a topic of 64 B", each(advertised.shm_kib, before.shm_kib), "KiB");
    value("broker, a topic", each(advertised.broker_mib, before.broker_mib) * 1024.0, "KiB");
    value("descriptors of the broker, a topic", each(advertised.broker, before.broker), "");
    value("descriptors of a publisher, a topic", each(advertised.ours, before.ours), "");
    value("process memory, a publication", each(advertised.our_kib, before.our_kib), "KiB");
    value("descriptors, a subscription", each(subscribed.ours, advertised.ours), "");
    value("process memory, a subscription", each(subscribed.our_kib, advertised.our_kib), "KiB");
    value("descriptors, one that sleeps", each(slept.ours, advertised.ours), "");
}

/// Waits until the broker has made the streams of what was advertised: it does
/// so in its own time, and as fast as it can.
fn settle(bus: &Bus) {
    let look = Duration::from_millis(200);
    loop {
        let before = cpu(bus.broker_pid());
        std::thread::sleep(look);
        if cpu(bus.broker_pid()) - before < look / 4 {
            return;
        }
    }
}

/// What one can see of memory and descriptors.
struct Seen {
    shm_kib: f64,
    broker_mib: f64,
    broker: f64,
    ours: f64,
    our_kib: f64,
}

impl Seen {
    fn of(bus: &Bus) -> Self {
        let (broker, ours) = (bus.broker_pid(), std::process::id());
        Self {
            shm_kib: blocks_of(bus.system.base()) as f64 / 2.0,
            broker_mib: resident_kib(broker) / 1024.0,
            broker: descriptors(broker),
            ours: descriptors(ours),
            our_kib: resident_kib(ours),
        }
    }
}

/// Blocks of 512 bytes that a folder's files have.
fn blocks_of(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .map(|entry| match entry.metadata() {
            Ok(it) if it.is_dir() => blocks_of(&entry.path()),
            Ok(it) => it.blocks(),
            Err(_) => 0,
        })
        .sum()
}

fn resident_kib(pid: u32) -> f64 {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).expect("it lives");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("it has some");
    line.split_whitespace().next().and_then(|word| word.parse().ok()).expect("a number")
}

fn descriptors(pid: u32) -> f64 {
    fs::read_dir(format!("/proc/{pid}/fd")).expect("it lives").count() as f64
}

/// The processor time of a process until now.
pub fn cpu(pid: u32) -> Duration {
    let clock = ClockId::pid_cpu_clock_id(Pid::from_raw(pid as i32)).expect("it lives");
    Duration::from_nanos(clock.now().expect("it has a clock").num_nanoseconds() as u64)
}

/// The processor time of one refresh of `uorb top`.
fn top(bus: &Bus) -> Duration {
    let mut top = bus.spawn_uorb(&["top", "--all", "--json"]);
    top.line().expect("an update");
    let before = cpu(top.pid());
    let refreshes = 2;
    for _ in 0..refreshes {
        top.line().expect("an update");
    }
    (cpu(top.pid()) - before) / refreshes
}

fn broker_cpu(run: &mut Run) {
    let bus = Bus::start();
    let ms = run.figures.effort.watch_ms.to_string();
    let mut publisher = play(Some(&bus), &["topics", "any", &ms]);
    publisher.expect("ready");
    settle(&bus);
    let (before, began) = (cpu(bus.broker_pid()), Instant::now());
    publisher.say("go");
    publisher.expect("published");
    let (took, passed) = (cpu(bus.broker_pid()) - before, began.elapsed());
    let percent = took.as_secs_f64() / passed.as_secs_f64() * 100.0;
    run.figures.note_value(BROKER, "uorb", percent, "%");
}

/// The role of one who publishes many topics at 250 Hz.
pub fn publish_topics(arguments: &[&str]) -> anyhow::Result<()> {
    let session = Session::connect()?;
    let mut publications: Vec<_> =
        (0..TOPICS).map(|index| advertise(&session, format!("topic_{index}"))).collect();
    println!("ready");
    heard();
    let began = Instant::now();
    let mut next = began;
    while began.elapsed() < Duration::from_millis(number(arguments[0])) {
        for publication in &mut publications {
            publication.publish(&[1; BYTES as usize])?;
        }
        next += PERIOD;
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
    println!("published");
    heard();
    Ok(())
}
