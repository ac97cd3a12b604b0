//! `scripts/soak`: a hundred topics at their rates for a long time, and a line a
//! minute of what everybody holds, loses and waits.
//!
//! Four processes publish 25 topics each (2,240 messages a second together), two
//! copy all hundred by `poll`, one follows all hundred streams. It ends with
//! `flat`, or with what grew by the rule in `held.rs`, or was lost: then the exit
//! code is 1. Ctrl-C ends it cleanly, with 130.

mod held;
mod latencies;
mod roles;

use std::io::{self, Write};
use std::os::unix::process::CommandExt;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use clap::{Parser, Subcommand};
use signal_hook::consts::{SIGINT, SIGTERM};
use uorb_core::Session;
use uorb_tests::{Actor, Bus};

use crate::held::Held;
use crate::latencies::Latencies;

const PUBLISHERS: usize = 4;
const SUBSCRIBERS: usize = 2;

const INTERRUPTED: u8 = 130;

/// A hundred topics at their rates for a long time: what grows?
#[derive(Parser, Debug)]
#[command(name = "soak")]
struct Args {
    /// How long
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..))]
    minutes: u64,

    #[command(subcommand)]
    role: Option<Role>,
}

/// What one of its processes does. `soak` itself starts them.
#[derive(Subcommand, Debug)]
#[command(hide = true)]
enum Role {
    Publish { first: usize },
    Poll,
    Follow,
}

fn main() -> ExitCode {
    let args = Args::parse();
    let ended = match args.role {
        Some(role) => serve(&role).map(|()| ExitCode::SUCCESS),
        None => soak(args.minutes),
    };
    ended.unwrap_or_else(|error| {
        eprintln!("soak: {error:#}");
        ExitCode::FAILURE
    })
}

fn serve(role: &Role) -> Result<()> {
    let session = Session::connect()?;
    match *role {
        Role::Publish { first } => roles::publish(&session, first, PUBLISHERS),
        Role::Poll => roles::copy(&session, false),
        Role::Follow => roles::copy(&session, true),
    }
}

/// One of the processes, as `soak` sees it.
struct Process {
    actor: Actor,
    kind: Kind,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Publisher,
    Subscriber,
    Follower,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Publisher => "publisher",
            Self::Subscriber => "subscriber",
            Self::Follower => "follower",
        }
    }
}

fn spawn(bus: &Bus, kind: Kind, arguments: &[&str]) -> Result<Process> {
    let program = std::env::current_exe().context("this program has no file")?;
    let mut command = bus.command(&program);
    // Ctrl-C is for `soak` alone; they end when their input does.
    command.args(arguments).process_group(0);
    let mut actor = Actor::spawn(command);
    let line = actor.line();
    anyhow::ensure!(line.as_deref() == Some("ready"), "a {} does not start", kind.name());
    Ok(Process { actor, kind })
}

fn soak(minutes: u64) -> Result<ExitCode> {
    let interrupted = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, interrupted.clone()).context("no signal handler")?;
    }
    let bus = Bus::start();
    let mut processes = Vec::new();
    for first in 0..PUBLISHERS {
        processes.push(spawn(&bus, Kind::Publisher, &["publish", &first.to_string()])?);
    }
    for _ in 0..SUBSCRIBERS {
        processes.push(spawn(&bus, Kind::Subscriber, &["poll"])?);
    }
    processes.push(spawn(&bus, Kind::Follower, &["follow"])?);
    // Some messages were published before everybody was there.
    minute(&mut processes)?;

    let mut out = io::stdout().lock();
    writeln!(
        out,
        "memory in KiB and descriptors of: broker | publishers | subscribers | follower"
    )?;
    let mut first = None;
    let mut lost = 0;
    let mut held = Vec::new();
    let start = Instant::now();
    for number in 0..=minutes {
        // The line of minute 0 is what a soak of one minute compares with.
        let until = Duration::from_secs(if number == 0 { 10 } else { 60 * number });
        while start.elapsed() < until {
            if interrupted.load(Ordering::Relaxed) {
                writeln!(out, "interrupted after {} s", start.elapsed().as_secs())?;
                return Ok(INTERRUPTED.into());
            }
            thread::sleep(Duration::from_millis(100).min(until - start.elapsed().min(until)));
        }
        let tally = minute(&mut processes)?;
        held = look(&bus, &processes)?;
        lost += tally.lost;
        writeln!(out, "{}", line(number, &held, &tally))?;
        out.flush()?;
        if first.is_none() || number == 1 && minutes > 1 {
            first = Some(held.clone());
        }
    }
    let before = first.unwrap_or_default();
    let mut faults: Vec<String> = before
        .iter()
        .zip(&held)
        .filter_map(|((who, before), (_, now))| {
            Some(format!("{who}: {}", now.grown_since(*before)?))
        })
        .collect();
    if lost > 0 {
        faults.push(format!("{lost} messages were lost"));
    }
    if faults.is_empty() {
        writeln!(out, "flat")?;
        return Ok(ExitCode::SUCCESS);
    }
    writeln!(out, "not flat: {}", faults.join("; "))?;
    Ok(ExitCode::FAILURE)
}

/// What all processes did since the last time.
struct Tally {
    published: u64,
    copied: u64,
    followed: u64,
    lost: u64,
    latencies: Latencies,
}

fn minute(processes: &mut [Process]) -> Result<Tally> {
    let (mut published, mut copied, mut followed, mut lost) = (0, 0, 0, 0);
    let mut latencies = Latencies::new();
    for Process { actor, kind } in processes {
        actor.say("");
        let answer = actor.line().with_context(|| format!("a {} has ended", kind.name()))?;
        let mut words = answer.splitn(3, ' ');
        let mut number = || words.next().and_then(|word| word.parse::<u64>().ok()).unwrap_or(0);
        let (messages, lost_here) = (number(), number());
        match kind {
            Kind::Publisher => published += messages,
            Kind::Subscriber => copied += messages,
            Kind::Follower => followed += messages,
        }
        lost += lost_here;
        latencies.add_printed(words.next().unwrap_or_default());
    }
    Ok(Tally { published, copied, followed, lost, latencies })
}

fn look(bus: &Bus, processes: &[Process]) -> Result<Vec<(String, Held)>> {
    let mut held = vec![("broker".to_string(), Held::by(bus.broker_pid())?)];
    for (number, Process { actor, kind }) in processes.iter().enumerate() {
        held.push((format!("{} {number}", kind.name()), Held::by(actor.pid())?));
    }
    Ok(held)
}

fn line(number: u64, held: &[(String, Held)], tally: &Tally) -> String {
    let of = |kind: &str| {
        let ours = held.iter().filter(|(who, _)| who.starts_with(kind));
        let shown = ours.map(|(_, held)| format!("{}/{}", held.memory_kib, held.descriptors));
        shown.collect::<Vec<_>>().join(" ")
    };
    let p999 = tally.latencies.within_us(999).map_or("none".into(), |us| format!("{us} us"));
    format!(
        "minute {number}: {} | {} | {} | {}; published {}, copied {}, followed {}, lost {}, p99.9 {p999}",
        of("broker"),
        of("publisher"),
        of("subscriber"),
        of("follower"),
        tally.published,
        tally.copied,
        tally.followed,
        tally.lost,
    )
}
