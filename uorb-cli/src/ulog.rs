//! `uorb ulog`: what is in a flight log.

mod info;
mod text;

use std::io::Write;
use std::path::PathBuf;

use crate::flight_log::judge;

/// Look at ULog flight logs, without a bus.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    Info(InfoArgs),
}

/// Show what a log holds: how long it is, what it says of the vehicle, its topics.
#[derive(Debug, clap::Args)]
#[command(after_help = INFO_EXAMPLES)]
struct InfoArgs {
    /// The flight log
    #[arg(value_name = "FILE.ulg")]
    file: PathBuf,

    /// With all parameters, long texts, and what was said in flight
    #[arg(long, short)]
    verbose: bool,

    /// One JSON object, with everything
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  uorb ulog info flight.ulg               what it holds
  uorb ulog info flight.ulg -v            its parameters too
  uorb export flight.ulg --csv            its messages
  uorb replay flight.ulg                  on a bus";

const INFO_EXAMPLES: &str = "\
Examples:
  uorb ulog info flight.ulg
  uorb ulog info flight.ulg --verbose | less
  uorb ulog info flight.ulg --json | jq '.topics[] | select(.rate_hz > 100) | .topic'

RATE is that between a topic's first message and its last; BYTES are those of
all its messages, without the padding at their ends.

A log that was cut off, as by a loss of power, is shown as far as it is whole,
and then it is said. Exit code 0: it is whole; 1: an error, a log that is cut
off among them.";

pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let Command::Info(args) = &args.command;
    let mut looked = info::look(&args.file)?;
    // Of a file that is no log nothing is shown.
    if looked.began_us.is_some() {
        match args.json {
            true => writeln!(out, "{}", looked.json(&args.file))?,
            false => text::print(&looked, args.verbose, out)?,
        }
        out.flush()?;
    }
    let odd = looked.about.odd.take();
    judge(&args.file, looked.ending, odd, looked.messages, "shown")
}
