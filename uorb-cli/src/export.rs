//! `uorb export`: a flight log as tables, or as a file for ROS tools.
//!
//! Both are written in one pass over the log, message by message, so a log may be
//! larger than the memory.

mod cdr;
mod csv;
mod mcap;

use std::io::Write;
use std::path::PathBuf;

use clap::ArgGroup;
use uorb_ulog::{Ending, Fault};

use crate::flight_log::judge;

/// Turn a ULog flight log into CSV files or into an MCAP file.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
#[command(group = ArgGroup::new("format").required(true).args(["csv", "mcap"]))]
pub(crate) struct Args {
    /// The flight log
    #[arg(value_name = "FILE.ulg")]
    file: PathBuf,

    /// A CSV file for each topic and instance, named and laid out as by pyulog's
    /// ulog2csv
    #[arg(long)]
    csv: bool,

    /// One MCAP file, for Foxglove and ROS 2
    #[arg(long)]
    mcap: bool,

    /// The directory of the CSV files, or the MCAP file [default: beside the log]
    #[arg(long, short, value_name = "DIR|FILE.mcap")]
    output: Option<PathBuf>,

    /// Only topics of this name; `*` stands for any letters. May be repeated
    #[arg(long, short, value_name = "PATTERN")]
    topic: Vec<String>,

    /// Do not say what was written
    #[arg(long, short)]
    quiet: bool,
}

const EXAMPLES: &str = "\
Examples:
  uorb export flight.ulg --csv                          flight_sensor_accel_0.csv, ...
  uorb export flight.ulg --csv -o tables -t 'sensor_*' -t vehicle_attitude
  uorb export flight.ulg --mcap                         flight.mcap

CSV: the file is LOG_TOPIC_INSTANCE.csv, its first column the timestamp, in
microseconds since the start of the vehicle, and then the other fields in the
log's order: x[0], x[1], esc[0].esc_rpm. A float has the fewest digits that read
back the same; a text with a comma is in quotes. Files that are there are written
over.

MCAP: a channel /TOPIC_INSTANCE for each topic and instance, in ROS 2's own
encoding (ros2msg, cdr), in which every value stays what it was: JSON, which
MCAP could hold as well, has no NaN, with which PX4 says \"not set\", and many of
its readers round 64 bits. A message's type is px4_msgs/msg/SensorAccel with the
log's own fields, capitals made small; its time is its timestamp. What the log says of
the vehicle is in the metadata `info`, `parameters` (the first values),
`parameter_changes` (TIME NAME) and `dropouts`.

A log that was cut off, as by a loss of power, is exported as far as it is
whole, and then it is said. Exit code 0: to its end; 1: an error, a log that is
cut off among them.";

/// What came of reading a log to its end.
struct Exported {
    messages: u64,
    ending: Result<Ending, Fault>,
    /// A note that makes no sense.
    odd: Option<Fault>,
}

pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let Exported { messages, ending, odd } = match args.csv {
        true => csv::export(args, out)?,
        false => mcap::export(args, out)?,
    };
    out.flush()?;
    judge(&args.file, ending, odd, messages, "exported")
}
