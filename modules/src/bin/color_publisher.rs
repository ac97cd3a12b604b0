//! One of the three colours that `color_counter` waits for.

use std::process::ExitCode;

use clap::{Parser, ValueEnum};
use uorb_core::{Publication, Session, Topic, now_us};
use uorb_modules::color::{ColorBlue, ColorGreen, ColorRed, ColorUpdate};
use uorb_modules::{Outcome, Stop, Ticks, parse_rate, run};

const EXAMPLES: &str = "\
Examples:
  color_publisher red                     one a second, until Ctrl-C
  color_publisher green --rate 3          three a second
  color_publisher blue --count 1          one, and the node keeps it
  color_counter                           in another shell: who counts them

UORB_DIR and UORB_SYSTEM name the system, as for uorb.";

/// Publishes 1, 2, 3 and so on, on color_red, color_green or color_blue.
#[derive(Parser)]
#[command(name = "color_publisher", version, after_help = EXAMPLES)]
struct Arguments {
    /// Which of the three topics
    color: Color,

    /// How many a second
    #[arg(long, value_name = "HZ", value_parser = parse_rate, allow_negative_numbers = true, default_value = "1")]
    rate: f64,

    /// End after so many
    #[arg(long, value_name = "N")]
    count: Option<u64>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Color {
    Red,
    Green,
    Blue,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    run(|stop, _| match arguments.color {
        Color::Red => publish::<ColorRed>(&arguments, stop),
        Color::Green => publish::<ColorGreen>(&arguments, stop),
        Color::Blue => publish::<ColorBlue>(&arguments, stop),
    })
}

fn publish<T: Topic<Message = ColorUpdate>>(arguments: &Arguments, stop: &Stop) -> Outcome {
    let session = Session::connect()?;
    let mut color_pub = Publication::<T>::advertise(&session)?;
    let mut ticks = Ticks::new(now_us(), arguments.rate);
    let mut update = ColorUpdate { number: 0 };
    let mut left = arguments.count.unwrap_or(u64::MAX);
    while left > 0 && ticks.wait(stop) {
        update.number = update.number.wrapping_add(1);
        color_pub.publish(&update)?;
        left -= 1;
    }
    Ok(())
}
