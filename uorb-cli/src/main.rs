//! The `uorb` command: one file a subcommand.
//!
//! Data goes to stdout and words to stderr, so that both `| head` and `>` do
//! what one expects; the exit codes are in `exit.rs`. Installed under the name
//! `listener` or `px4-listener` it is `uorb listener`.

// What stands above an argument is its help: `esc[0]` is no link there, and
// `<uid>` no HTML.
#![allow(rustdoc::broken_intra_doc_links, rustdoc::invalid_html_tags)]

mod completions;
mod context;
mod exit;
mod export;
mod fields;
mod flight_log;
mod info;
mod interrupt;
mod listener;
mod ls;
mod man;
mod msg;
mod nearest;
mod plot;
mod print;
mod publish;
mod record;
mod replay;
mod start;
mod status;
mod stop;
mod test;
mod top;
mod topics;
mod ulog;
mod unreadable;

use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};

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
  uorb start                              start the broker
  uorb listener sensor_accel 5            show five messages
  uorb pub orb_test val=5                 publish one
  uorb info sensor_accel                  fields, publishers, subscribers
  uorb ls /obj                            list the nodes, as `ls /obj` does
  uorb top                                watch how much is published, and lost
  uorb plot sensor_accel x y z            watch fields over time
  uorb record -o flight.ulg               record a flight log
  uorb replay flight.ulg --speed 4        publish a flight log
  uorb ulog info flight.ulg               what is in a flight log
  uorb export flight.ulg --csv            its messages as tables
  uorb msg my_messages                    compile .msg files to C and C++
  uorb stop                               stop the broker

`uorb help COMMAND` has more, with examples.

Exit codes: 0 done, 1 an error, 2 a command line that makes no sense, 124 a
timeout, 130 Ctrl-C before what was asked for was done.";

#[derive(Debug, Subcommand)]
enum Command {
    Start(start::Args),
    Stop(stop::Args),
    Status(status::Args),
    Top(top::Args),
    Listener(listener::Args),
    Ls(ls::Args),
    Info(info::Args),
    Pub(publish::Args),
    Record(record::Args),
    Replay(replay::Args),
    Plot(plot::Args),
    Export(export::Args),
    Ulog(ulog::Args),
    Test(test::Args),
    Msg(msg::Args),
    Completions(completions::Args),
    Man(man::Args),
}

// What the program is when it is called `listener`. The words are those of the
// subcommand, which a doc comment here would replace.
#[derive(Debug, Parser)]
#[command(name = "listener", version)]
struct ListenerCli {
    #[command(flatten)]
    args: listener::Args,
    #[command(flatten)]
    place: Place,
}

fn main() -> ExitCode {
    let name = std::env::args_os().next().unwrap_or_default();
    let name = Path::new(&name).file_name().unwrap_or_default();
    let is_listener = name == "listener" || name == "px4-listener";
    completions::answer(if is_listener { ListenerCli::command } else { Cli::command });
    let cli = if is_listener {
        let ListenerCli { args, place } = ListenerCli::parse();
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
        Command::Info(args) => info::run(args, &context, out),
        Command::Pub(args) => publish::run(args, &context),
        Command::Test(args) => test::run(args, &context, out),
        Command::Msg(args) => msg::run(args),
        Command::Completions(args) => completions::run(args, out),
        Command::Man(args) => man::run(args, Cli::command(), out),
        Command::Ls(args) => ls::run(args, &context, out),
        Command::Record(args) => record::run(args, &context),
        Command::Plot(args) => plot::run(args, &context),
        Command::Export(args) => export::run(args, out),
        Command::Ulog(args) => ulog::run(args, out),
        Command::Replay(args) => replay::run(args, &context, out),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_sound() {
        Cli::command().debug_assert();
        ListenerCli::command().debug_assert();
    }

    #[test]
    fn every_command_has_help_with_examples() {
        let uorb = Cli::command();
        for command in uorb.get_subcommands().chain([&uorb, &ListenerCli::command()]) {
            let name = command.get_name();
            assert!(command.get_about().is_some(), "{name} does not say what it does");
            let after = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            assert!(after.contains("Examples:\n"), "{name} has no examples");
        }
    }
}
