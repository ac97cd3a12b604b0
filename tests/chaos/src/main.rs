//! `scripts/chaos`: kills and stops the processes of a bus, and accounts for
//! every message.
//!
//! The seed is printed, and the same seed draws the same schedule; what becomes
//! of it is up to the machine. A run ends with its totals, and with exit code 1
//! if anything was wrong.

mod accounts;
mod actor;
mod bus;
mod era;
mod judge;
mod ledger;
mod noise;
mod plan;
mod random;
mod restarts;
mod scribble;
mod shared_topic;
mod stopped;
mod traces;

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use clap::Parser;
use uorb_core::fail_points::FAIL_POINTS;
use uorb_core::now_us;

use crate::era::{Era, Totals};
use crate::ledger::Ledger;
use crate::noise::Noise;

/// Rounds that one bus lasts.
pub(crate) const ERA: u64 = 25;

/// Kills and stops the processes of a bus, and accounts for every message.
#[derive(Parser, Debug)]
#[command(name = "chaos")]
struct Args {
    /// Rounds, of some tens of milliseconds each
    #[arg(long, default_value_t = 300)]
    rounds: u64,

    /// The round to begin with: those before it are left out
    #[arg(long, default_value_t = 0)]
    first: u64,

    /// What the schedule is drawn from [default: the time]
    #[arg(long)]
    seed: Option<u64>,

    /// Instead, restart the broker so often under load
    #[arg(long, value_name = "TIMES")]
    restarts: Option<u64>,

    /// Instead, scribble over shared memory for so long
    #[arg(long, value_name = "SECONDS")]
    scribble: Option<u64>,

    /// Instead, stop each kind of process for so long, and time the others
    #[arg(long, value_name = "SECONDS")]
    stop: Option<u64>,

    /// What CI runs: 300 rounds, 50 restarts, half a minute of scribbling, each
    /// party stopped for a second
    #[arg(long)]
    ci: bool,
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    if arguments.get(1).is_some_and(|word| word == "actor") {
        return run_actor(&arguments[2..]);
    }
    if arguments.get(1).is_some_and(|word| word == "publish") {
        return actor::publish_until_killed(&arguments[2]);
    }
    if arguments.get(1).is_some_and(|word| word == "follow") {
        return actor::follow_until_killed(&arguments[2]);
    }
    let args = Args::parse();
    uorb_tests::raise_descriptor_limit();
    let seed = args.seed.unwrap_or_else(|| now_us() % 1_000_000);
    let tell = |faults: Vec<String>| {
        faults.iter().for_each(|fault| eprintln!("{fault}"));
        faults.len()
    };
    let found = match args {
        Args { ci: true, .. } => rounds(seed, 0, 300).and_then(|found| {
            let restarted = tell(restarts::restart(50)?);
            let stopped = tell(stopped::stop_each(1)?);
            Ok(found + restarted + stopped + tell(scribble::scribble_for(30)?))
        }),
        Args { restarts: Some(times), .. } => restarts::restart(times).map(tell),
        Args { scribble: Some(seconds), .. } => scribble::scribble_for(seconds).map(tell),
        Args { stop: Some(seconds), .. } => stopped::stop_each(seconds).map(tell),
        _ => rounds(seed, args.first, args.rounds),
    };
    match found {
        Ok(0) => ExitCode::SUCCESS,
        Ok(faults) => {
            eprintln!("chaos: {faults} faults; repeat with --seed {seed}");
            ExitCode::FAILURE
        }
        Err(error) => {
            eprintln!("chaos: {error:#}; repeat with --seed {seed}");
            ExitCode::FAILURE
        }
    }
}

fn run_actor(words: &[String]) -> ExitCode {
    let [path, cell, sender, kind, topic, storm_us] = words else { panic!("{words:?}") };
    let number = |word: &String| word.parse().expect("a number");
    let ledger = Ledger::open(PathBuf::from(path)).expect("the ledger is there");
    let (cell, sender) = (ledger.cell(number(cell) as usize), number(sender));
    let ran = match kind.as_str() {
        "pace" | "keep-up" | "keep-up-stream" => restarts::run(&ledger, cell, sender, kind),
        "scribbler" | "honest-publisher" | "honest-subscriber" => {
            scribble::run(cell, sender, kind, topic)
        }
        kind => actor::run(ledger, cell, sender, kind, topic, number(storm_us)),
    };
    if ran { ExitCode::SUCCESS } else { ExitCode::from(3) }
}

fn rounds(seed: u64, first: u64, rounds: u64) -> anyhow::Result<usize> {
    println!("chaos: --seed {seed} --first {first} --rounds {rounds}");
    let began = Instant::now();
    let noise = Noise::listen();
    let (mut totals, mut found) = (Totals::default(), 0);
    let mut round = first;
    while round < first + rounds {
        let mut era = Era::begin(round, &noise)?;
        let mut tell = |round: u64, faults: Vec<String>| {
            found += faults.len();
            faults.iter().for_each(|fault| eprintln!("round {round}: {fault}"));
            !faults.is_empty()
        };
        let end = (round + ERA - round % ERA).min(first + rounds);
        let mut is_spoilt = false;
        while round < end && !is_spoilt {
            let faults = era.round(seed, &mut totals)?;
            is_spoilt = tell(round, faults);
            totals.noise_us = totals.noise_us.max(noise.take_longest());
            round += 1;
        }
        let (deaths, places) = era.broker_deaths();
        totals.broker_deaths += deaths;
        totals.deaths_at_fail_points += places.len() as u64;
        let names = places.iter().filter_map(|place| place.split(':').next());
        totals.places.extend(names.map(ToString::to_string));
        if !is_spoilt {
            let faults = era.end(seed, &mut totals)?;
            tell(round - 1, faults);
        }
    }
    let Totals { rounds, messages, kills, deaths_at_fail_points, places, .. } = &totals;
    println!(
        "{rounds} rounds in {:.1} s: {messages} messages; {kills} kills at a moment, \
         {deaths_at_fail_points} deaths at {} fail points, {} stops, {} deaths of the broker; \
         {} requests, the slowest {} us while one broker lived; the machine's own longest pause \
         {} us; {found} faults",
        began.elapsed().as_secs_f64(),
        places.len(),
        totals.stops,
        totals.broker_deaths,
        totals.requests,
        totals.slowest_us,
        totals.noise_us,
    );
    let unreached: Vec<_> = FAIL_POINTS.iter().filter(|name| !places.contains(**name)).collect();
    if !unreached.is_empty() {
        println!("nobody died at {unreached:?}");
    }
    Ok(found)
}
