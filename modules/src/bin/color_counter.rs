//! uORB's own example of waiting for several topics at once: three colours,
//! and a count of the seconds in which none of them came.

use std::io::Write;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use uorb_core::{Publication, Session, Subscription, poll};
use uorb_modules::color::{ColorBlue, ColorGreen, ColorRed, ColorTimeouts, ColorUpdate};
use uorb_modules::{Outcome, Stop, run};

const EXAMPLES: &str = "\
Examples:
  color_counter                  until Ctrl-C
  color_counter --count 3        until there were three updates
  color_publisher red --rate 3   in another shell: something to count

UORB_DIR and UORB_SYSTEM name the system, as for uorb.";

/// Prints the updates of three colours, and counts the seconds without any.
#[derive(Parser)]
#[command(name = "color_counter", version, after_help = EXAMPLES)]
struct Arguments {
    /// End after so many updates
    #[arg(long, value_name = "N")]
    count: Option<u64>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    run(|stop, out| count_colors(&arguments, stop, out))
}

fn count_colors(arguments: &Arguments, stop: &Stop, out: &mut impl Write) -> Outcome {
    let session = Session::connect()?;
    // It does not matter whether anybody publishes these yet.
    let mut red = Subscription::<ColorRed>::subscribe(&session)?;
    let mut green = Subscription::<ColorGreen>::subscribe(&session)?;
    let mut blue = Subscription::<ColorBlue>::subscribe(&session)?;

    let mut timeouts = ColorUpdate { number: 0 };
    let mut timeouts_pub = Publication::<ColorTimeouts>::advertise(&session)?;
    timeouts_pub.publish(&timeouts)?;

    let mut left = arguments.count.unwrap_or(u64::MAX);
    while left > 0 && !stop.requested() {
        let timeout = Some(Duration::from_secs(1));
        let updated = poll(&mut [&mut red, &mut green, &mut blue], timeout)?;
        if updated == 0 && !stop.requested() {
            writeln!(out, "timeout")?;
            timeouts.number += 1;
            timeouts_pub.publish(&timeouts)?;
        }
        if let Some(update) = red.update() {
            writeln!(out, "red is now {}", update.number)?;
        }
        if let Some(update) = green.update() {
            writeln!(out, "green is now {}", update.number)?;
        }
        if let Some(update) = blue.update() {
            writeln!(out, "blue is now {}", update.number)?;
        }
        left = left.saturating_sub(updated as u64);
    }
    Ok(())
}
