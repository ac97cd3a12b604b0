//! The processor time of a loop that does its work a thousand times a second:
//! one process publishes, the other polls and copies.

use std::time::{Duration, Instant};

use anyhow::bail;
use nix::sys::time::TimeValLike;
use nix::time::{ClockId, clock_gettime};
use uorb_core::System;
use uorb_tests::{Bus, heard, number};

use super::Run;
use crate::doors::{Door, Side, eventfd, iceoryx, now_ns, ours};
use crate::role::play;

const PERIOD: Duration = Duration::from_millis(1);

/// Later than any time.
const OVER: u64 = 1 << 62;

pub fn measure(run: &mut Run, bus: &mut Bus) {
    let messages = run.figures.effort.watch_ms.to_string();
    let counters = eventfd::Counters::new();
    for (who, door) in
        [("floor, eventfd and poll", "eventfd"), ("uorb", "poll"), ("iceoryx2", "iceoryx2")]
    {
        let mut sides = ["ping", "pong"].map(|side| {
            let index = usize::from(side == "pong");
            let mut arguments = vec!["every-millisecond", "any", door, side, &messages];
            arguments.extend(counters.arguments()[index].iter().map(String::as_str));
            let mut actor = play(Some(bus), &arguments);
            actor.expect("ready");
            actor
        });
        sides.iter_mut().rev().for_each(|side| side.say("go"));
        for (what, side) in ["publisher", "poll and copy"].into_iter().zip(&mut sides) {
            let percent = side.line().expect("its share").parse().expect("a number");
            let setting = format!("64 B at 1 kHz, {what}");
            run.figures.note_value(("CPU of a pair", &setting), who, percent, "%");
        }
    }
}

/// The role of either: how much of a processor it took, in percent.
pub fn every_millisecond(arguments: &[&str]) -> anyhow::Result<()> {
    let [door, side, messages, counters @ ..] = arguments else { bail!("no such pair") };
    let side = if *side == "ping" { Side::Ping } else { Side::Pong };
    let system = System::from_env()?;
    let mut door: Box<dyn Door> = match *door {
        "eventfd" => Box::new(eventfd::Pair::inherit(counters)),
        "poll" => ours::by_poll(&system, side)?,
        "iceoryx2" => Box::new(iceoryx::Ends::open(&system, side, iceoryx::Wait::ForEvent)),
        other => bail!("no such door: {other}"),
    };
    println!("ready");
    heard();
    let (began, before) = (Instant::now(), processor_time()?);
    match side {
        Side::Ping => {
            let mut next = began;
            for _ in 0..number(messages) {
                next += PERIOD;
                std::thread::sleep(next.saturating_duration_since(Instant::now()));
                door.send(now_ns());
            }
            std::thread::sleep(PERIOD);
            door.send(OVER);
        }
        // Some may have been overtaken, so they are not counted.
        Side::Pong => while door.wait() < OVER {},
    }
    let share = (processor_time()? - before).as_secs_f64() / began.elapsed().as_secs_f64();
    println!("{}", share * 100.0);
    heard();
    Ok(())
}

fn processor_time() -> nix::Result<Duration> {
    let time = clock_gettime(ClockId::CLOCK_PROCESS_CPUTIME_ID)?;
    Ok(Duration::from_nanos(time.num_nanoseconds() as u64))
}
