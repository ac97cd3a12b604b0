//! `uorb completions`: what the shell completes, names of topics among it.
//!
//! The script that it prints asks this program at every Tab: the program finds
//! [`VARIABLE`] in its environment and answers instead of running. So topics
//! that live on the bus are completed as well as those compiled in.

use std::io::Write;

use anyhow::Context as _;
use clap::builder::PossibleValuesParser;
use clap_complete::engine::CompletionCandidate;
use clap_complete::env::{CompleteEnv, Shells};

use crate::context::{Context, Place};
use crate::topics;

/// By which the shell's script asks.
const VARIABLE: &str = "UORB_COMPLETE";

/// Print a script that lets the shell complete commands, options and topics.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The shell
    #[arg(value_parser = PossibleValuesParser::new(Shells::builtins().names()))]
    shell: String,
}

const EXAMPLES: &str = "\
Examples:
  source <(uorb completions bash)                 in ~/.bashrc
  uorb completions fish | source                  in ~/.config/fish/config.fish
  source <(UORB_COMPLETE=bash listener)           under its other name

The topics are those of the system that UORB_DIR and UORB_SYSTEM name.";

pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let ours = std::env::current_exe().context("cannot find out where this program is")?;
    let shells = Shells::builtins();
    // clap has let no other through.
    let shell = shells.completer(&args.shell).context("there is no such shell")?;
    let mut out = out;
    shell.write_registration(VARIABLE, "uorb", "uorb", &ours.to_string_lossy(), &mut out)?;
    Ok(())
}

/// Answers the shell and exits, if it is the shell that asks.
pub(crate) fn answer(command: fn() -> clap::Command) {
    CompleteEnv::with_factory(command).var(VARIABLE).complete();
}

/// All topics, for arguments that take one.
pub(crate) fn topic_names() -> Vec<CompletionCandidate> {
    let Ok(context) = Context::new(&Place { dir: None, system: None }) else { return Vec::new() };
    topics::names(&context).into_iter().map(CompletionCandidate::new).collect()
}
