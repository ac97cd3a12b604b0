//! Ways to hand a message to somebody who sleeps, each as its own users write it.
//!
//! Two sides, each with one [`Door`], hand 64 bytes to and fro: who has sent
//! sleeps until the answer comes, so that every message finds a sleeper. A
//! message carries the time at which it was sent, and its way is over when the
//! receiver has its bytes. All sides are processes but those of the mutex ring,
//! which are threads of one, as in PX4.

pub mod datagram;
pub mod eventfd;
pub mod iceoryx;
pub mod line;
pub mod mutex_ring;
pub mod ours;
#[cfg(feature = "zenoh")]
pub mod zenoh;

use std::time::Instant;

use anyhow::bail;
use nix::time::{ClockId, clock_gettime};
use uorb_core::System;
use uorb_tests::{Bus, heard, number};

use crate::place::Place;
use crate::role::{on, role};
use crate::times::Times;

/// 64 bytes, the first eight of which are when it was sent.
pub const WORDS: usize = 8;

/// Exchanges before those that count: connections are made, memory is mapped.
const WARM_UP: usize = 20;

/// Round trips that are timed together where a clock read would show.
const BATCH: usize = 50;

/// One side's end.
pub trait Door {
    /// Sends a message that was made at `sent_ns`.
    fn send(&mut self, sent_ns: u64);
    /// Waits for a message. Returns when it was made.
    fn wait(&mut self) -> u64;
}

/// Which side: it says where what it sends goes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    Ping,
    Pong,
}

impl Side {
    /// The names of the ways out and in.
    pub fn ways(self) -> [&'static str; 2] {
        match self {
            Self::Ping => ["ping", "pong"],
            Self::Pong => ["pong", "ping"],
        }
    }
}

/// Nanoseconds of CLOCK_MONOTONIC, the same in all processes.
pub fn now_ns() -> u64 {
    let now = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("every Linux has this clock");
    now.tv_sec() as u64 * 1_000_000_000 + now.tv_nsec() as u64
}

/// How two sides meet: which door, and what it is to be opened with.
#[derive(Clone, Copy, Debug)]
pub struct Meeting<'a> {
    pub door: &'a str,
    /// What stands behind the command line's words.
    pub extra: [&'a [String]; 2],
    /// How long `poll` spins, where it does.
    pub spin_us: Option<&'a str>,
    /// Whether the way is half a round trip, timed in batches.
    pub spins: bool,
}

impl<'a> Meeting<'a> {
    pub fn by(door: &'a str) -> Self {
        Self { door, extra: [&[], &[]], spin_us: None, spins: false }
    }
}

/// Lets two processes exchange so many messages, and returns how long one was
/// on its way.
pub fn one_way(bus: &Bus, place: &Place, meeting: Meeting<'_>, count: u32) -> Times {
    if meeting.door == mutex_ring::NAME {
        return mutex_ring::one_way(place, count);
    }
    let how = if meeting.spins { "spins" } else { "sleeps" };
    let mut sides = ["ping", "pong"].map(|_| None);
    for (index, name) in ["ping", "pong"].into_iter().enumerate() {
        let core = on(place.cores[index]);
        let count = count.to_string();
        let mut arguments = vec!["wake", &core, meeting.door, name, &count, how];
        arguments.extend(meeting.extra[index].iter().map(String::as_str));
        let mut command = role(Some(bus), &arguments);
        if let Some(spin_us) = meeting.spin_us {
            command.env(uorb_core::SPIN_VARIABLE, spin_us);
        }
        let mut side = uorb_tests::Actor::spawn(command);
        side.expect("ready");
        sides[index] = Some(side);
    }
    let mut times = Times::none();
    for side in sides.iter_mut().flatten().rev() {
        side.say("go");
    }
    for side in sides.iter_mut().flatten() {
        let line = side.line().expect("it says how long it took");
        let ways_ns = line.split_whitespace().map(|word| word.parse().expect("a number"));
        times.add(&Times::of_ns(ways_ns));
    }
    sides.iter_mut().flatten().for_each(|side| drop(side.finish()));
    times
}

/// The role of one side.
pub fn exchange(arguments: &[&str]) -> anyhow::Result<()> {
    let [door, side, count, how, extra @ ..] = arguments else { bail!("no such exchange") };
    let side = if *side == "ping" { Side::Ping } else { Side::Pong };
    let system = System::from_env()?;
    let mut door: Box<dyn Door> = match *door {
        "eventfd" => Box::new(eventfd::Pair::inherit(extra)),
        "futex" => Box::new(line::Futex::open(&system, side)),
        "line" => Box::new(line::Line::open(&system, side)),
        "poll" => ours::by_poll(&system, side)?,
        "epoll" => ours::by_epoll(&system, side)?,
        "tokio" => ours::by_tokio(&system, side)?,
        "iceoryx2" => Box::new(iceoryx::Ends::open(&system, side, iceoryx::Wait::ForEvent)),
        "iceoryx2-spinning" => Box::new(iceoryx::Ends::open(&system, side, iceoryx::Wait::Spin)),
        "datagram" => Box::new(datagram::Sockets::open(&system, side)),
        #[cfg(feature = "zenoh")]
        "zenoh" => Box::new(zenoh::Ends::open(&system, side)),
        other => bail!("no such door: {other}"),
    };
    println!("ready");
    heard();
    let count = number(count) as usize;
    let ways_ns = match *how {
        "spins" => half_round_trips(&mut *door, side, count),
        _ => ways(&mut *door, side, count),
    };
    let words: Vec<String> = ways_ns.iter().map(f64::to_string).collect();
    println!("{}", words.join(" "));
    heard();
    Ok(())
}

/// Exchanges messages; what came in took so long.
pub fn ways(door: &mut dyn Door, side: Side, count: usize) -> Vec<f64> {
    let mut ways_ns = Vec::with_capacity(WARM_UP + count);
    for _ in 0..WARM_UP + count {
        if side == Side::Ping {
            door.send(now_ns());
        }
        let sent_ns = door.wait();
        ways_ns.push(now_ns().saturating_sub(sent_ns) as f64);
        if side == Side::Pong {
            door.send(now_ns());
        }
    }
    ways_ns.split_off(WARM_UP)
}

/// The same without a clock read on the way.
fn half_round_trips(door: &mut dyn Door, side: Side, count: usize) -> Vec<f64> {
    let mut ways_ns = Vec::new();
    let trips = |door: &mut dyn Door, trips: usize| {
        for _ in 0..trips {
            match side {
                Side::Ping => {
                    door.send(1);
                    door.wait();
                }
                Side::Pong => {
                    door.wait();
                    door.send(1);
                }
            }
        }
    };
    trips(door, WARM_UP);
    for _ in 0..count {
        let began = Instant::now();
        trips(door, BATCH);
        ways_ns.push(began.elapsed().as_nanos() as f64 / (2 * BATCH) as f64);
    }
    ways_ns
}
