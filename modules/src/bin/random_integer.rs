//! A topic of one's own, without a .msg file: defined here, exactly these four
//! bytes, published by one process and looked at by another.
//!
//! The one that looks does not wait for the topic. It has a beat of its own,
//! and asks at each whether there is anything new.

use std::io::Write;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use uorb_core::{Error, Publication, Session, Subscription, now_us};
use uorb_modules::random::Random;
use uorb_modules::{Outcome, Stop, Ticks, parse_rate, run};

uorb_core::topic! {
    /// One random number.
    pub(crate) struct RandomInteger = "random_integer" {
        pub(crate) r: i32,
    }
}

const EXAMPLES: &str = "\
Examples:
  random_integer publish                 one a second, until Ctrl-C
  random_integer publish --seed 1        the same numbers every time
  random_integer check                   in another shell: prints them
  random_integer check --rate 0.5        looks every two seconds only

UORB_DIR and UORB_SYSTEM name the system, as for uorb.";

const PUBLISH_EXAMPLES: &str = "\
Examples:
  random_integer publish                 one a second, until Ctrl-C
  random_integer publish --rate 10       ten a second
  random_integer publish --seed 1        the same numbers every time";

const CHECK_EXAMPLES: &str = "\
Examples:
  random_integer check                   prints them, until Ctrl-C
  random_integer check --rate 0.5        looks every two seconds only
  random_integer check --count 5         ends after five";

/// Publishes random numbers, or prints them.
#[derive(Parser)]
#[command(name = "random_integer", version, after_help = EXAMPLES)]
struct Arguments {
    #[command(subcommand)]
    role: Role,
}

#[derive(Subcommand)]
enum Role {
    /// Publish random numbers
    #[command(after_help = PUBLISH_EXAMPLES)]
    Publish {
        /// How many a second
        #[arg(long, value_name = "HZ", value_parser = parse_rate, allow_negative_numbers = true, default_value = "1")]
        rate: f64,
        /// End after so many
        #[arg(long, value_name = "N")]
        count: Option<u64>,
        /// Where to begin; the time, if it is not given
        #[arg(long)]
        seed: Option<u64>,
    },
    /// Print a number whenever there is a new one
    #[command(after_help = CHECK_EXAMPLES)]
    Check {
        /// How often a second to look
        #[arg(long, value_name = "HZ", value_parser = parse_rate, allow_negative_numbers = true, default_value = "10")]
        rate: f64,
        /// End after so many numbers
        #[arg(long, value_name = "N")]
        count: Option<u64>,
    },
}

fn main() -> ExitCode {
    let Arguments { role } = Arguments::parse();
    run(|stop, out| match role {
        Role::Publish { rate, count, seed } => {
            let random = Random::new(seed.unwrap_or_else(now_us));
            publish(random, Ticks::new(now_us(), rate), count.unwrap_or(u64::MAX), stop)
        }
        Role::Check { rate, count } => {
            check(Ticks::new(now_us(), rate), count.unwrap_or(u64::MAX), stop, out)
        }
    })
}

fn publish(mut random: Random, mut ticks: Ticks, count: u64, stop: &Stop) -> Outcome {
    let session = Session::connect()?;
    let mut random_pub = Publication::<RandomInteger>::advertise(&session)?;
    for _ in 0..count {
        if !ticks.wait(stop) {
            break;
        }
        random_pub.publish(&RandomInteger { r: random.integer() })?;
    }
    Ok(())
}

fn check(mut ticks: Ticks, count: u64, stop: &Stop, out: &mut impl Write) -> Outcome {
    let session = Session::connect()?;
    let mut random_sub = Subscription::<RandomInteger>::subscribe(&session)?;
    let mut left = count;
    while left > 0 && ticks.wait(stop) {
        if random_sub.updated() {
            if let Some(random) = random_sub.copy() {
                writeln!(out, "Random integer is now {}", random.r)?;
                left -= 1;
            }
        } else if random_sub.has_ended() {
            // Who polls is told; who only looks has to ask.
            return Err(Error::Ended { path: session.system().dir() }.into());
        }
    }
    Ok(())
}
