//! The `uorb` command: one file a subcommand.
//!
//! Data goes to stdout and words to stderr, so that both `| head` and `>` do
//! what one expects; the exit codes are in `exit.rs`. Installed under the name
//! `listener` or `px4-listener` it is `uorb listener`.

mod context;
mod exit;
mod interrupt;
mod ls;
mod replay;

use std::io::{self, BufWriter, Write};
use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::context::{Context, Place};

/// The uORB message bus: start it, look at it, and feed it.
#[derive(Debug, Parser)]
#[command(name = "uorb", version, after_help = EXAMPLES)]
struct Cli {
    #[command(flatten)]
    place: Place,
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
Examples:
  uorb start                       start the broker
  uorb ls /obj                     list the nodes, as `ls /obj` does

`uorb help COMMAND` has more.";

#[derive(Debug, Subcommand)]
enum Command {
    Ls(ls::Args),
    Replay(replay::Args),
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let mut out = BufWriter::new(io::stdout().lock());
    let ended = run(&cli, &mut out).and_then(|()| Ok(out.flush()?));
    exit::code(ended)
}

fn run(cli: &Cli, out: &mut dyn Write) -> anyhow::Result<()> {
    let context = Context::new(&cli.place)?;
    match &cli.command {
        Command::Ls(args) => ls::run(args, &context, out),
        Command::Replay(args) => replay::run(args, &context, out),
    }
}
