//! PX4's minimal example: subscribes to the sensors, waits, prints, and
//! publishes what it has copied as an attitude that is none.
//!
//! A translation line by line of the C program that PX4's developers start
//! with. What is different: poll fails only when the bus has ended or this
//! process has no descriptors left, and then the program ends; and it ends by
//! Ctrl-C.

use std::io::Write;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use uorb_core::{Publication, Session, Subscription, now_us, poll};
use uorb_modules::{Outcome, Stop, run};
use uorb_msg::{SensorCombined, VehicleAttitude};

const EXAMPLES: &str = "\
Examples:
  px4_simple_app            a line a second, until Ctrl-C
  px4_simple_app --count 5  five lines

It needs sensor_combined: start sensor_sim and sensors first (scripts/rc.sensors).
UORB_DIR and UORB_SYSTEM name the system, as for uorb.";

/// Prints what the accelerometer measures and publishes it as an attitude.
#[derive(Parser)]
#[command(name = "px4_simple_app", version, after_help = EXAMPLES)]
struct Arguments {
    /// End after so many lines of measurements
    #[arg(long, value_name = "N")]
    count: Option<u64>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    run(|stop, out| px4_simple_app(&arguments, stop, out))
}

fn px4_simple_app(arguments: &Arguments, stop: &Stop, out: &mut impl Write) -> Outcome {
    writeln!(out, "Hello Sky!")?;

    let session = Session::connect()?;
    let mut sensor_sub = Subscription::<SensorCombined>::subscribe(&session)?;
    sensor_sub.set_interval(Duration::from_millis(1000));

    let mut att = VehicleAttitude::default();
    let mut att_pub = Publication::<VehicleAttitude>::advertise(&session)?;
    att_pub.publish(&att)?;

    let mut left = arguments.count.unwrap_or(u64::MAX);
    while left > 0 && !stop.requested() {
        // There could be more subscriptions here; `updated` says which of them
        // have something.
        let updated = poll(&mut [&mut sensor_sub], Some(Duration::from_millis(1000)))?;
        if let Some(raw) = sensor_sub.update() {
            let [x, y, z] = raw.accelerometer_m_s2;
            writeln!(out, "[px4_simple_app] Accelerometer:\t{x:8.4}\t{y:8.4}\t{z:8.4}")?;

            att.timestamp = now_us();
            [att.roll, att.pitch, att.yaw] = raw.accelerometer_m_s2;
            att_pub.publish(&att)?;
            left -= 1;
        } else if updated == 0 && !stop.requested() {
            writeln!(out, "[px4_simple_app] Got no data within a second")?;
        }
    }
    Ok(())
}
