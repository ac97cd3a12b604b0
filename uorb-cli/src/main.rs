//! The `uorb` command: one file a subcommand.
//!
//! Data goes to stdout and words to stderr, so that both `| head` and `>` do
//! what one expects; the exit codes are in `exit.rs`. Installed under the name
//! `listener` or `px4-listener` it is `uorb listener`.

mod context;
mod exit;
mod fields;
mod interrupt;
mod listener;
mod ls;
mod nearest;
mod print;
mod publish;
mod replay;
mod start;
mod status;
mod stop;
mod top;
mod topics;

use std::io::{self, BufWriter, Write};
use std::path::Path;
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
    Start(start::Args),
    Stop(stop::Args),
    Status(status::Args),
    Top(top::Args),
    Listener(listener::Args),
    Ls(ls::Args),
    Pub(publish::Args),
    Replay(replay::Args),
}

/// What the program is when it is called `listener`.
#[derive(Debug, Parser)]
#[command(name = "listener", version)]
struct ListenerCli {
    #[command(flatten)]
    place: Place,
    #[command(flatten)]
    args: listener::Args,
}

fn main() -> ExitCode {
    let name = std::env::args_os().next().unwrap_or_default();
    let name = Path::new(&name).file_name().unwrap_or_default();
    let cli = if name == "listener" || name == "px4-listener" {
        let ListenerCli { place, args } = ListenerCli::parse();
        Cli { place, command: Command::Listener(args) }
    } else {
        Cli::parse()
    };
    let mut out = BufWriter::new(io::stdout().lock());
    let ended = run(&cli, &mut out).and_then(|()| Ok(out.flush()?));
    exit::code(ended)
}

fn run(cli: &Cli, out: &mut dyn Write) -> anyhow::Result<()> {
    let context = Context::new(&cli.place)?;
    match &cli.command {
        Command::Start(args) => start::run(args, &context),
        Command::Stop(args) => stop::run(args, &context),
        Command::Status(args) => status::run(args, &context, out),
        Command::Top(args) => top::run(args, &context, out),
        Command::Listener(args) => listener::run(args, &context, out),
        Command::Pub(args) => publish::run(args, &context),
        Command::Ls(args) => ls::run(args, &context, out),
        Command::Replay(args) => replay::run(args, &context, out),
    }
}
