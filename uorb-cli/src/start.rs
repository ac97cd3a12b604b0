//! `uorb start`: starts the broker and returns when it is ready.
//!
//! The broker is a program of its own, `uorbd`. It gets a pipe on which it says
//! one line: `ready`, `running` (another one has the system already), or
//! `error: ` and what is wrong. So nobody waits longer than it takes.

#![allow(unsafe_code)]

use std::fs::File;
use std::io::Read;
use std::os::fd::AsRawFd;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use anyhow::{Context as _, bail};
use nix::fcntl::{FcntlArg, FdFlag, OFlag, fcntl};

use crate::context::Context;
use crate::exit::say;

/// Start the broker and return when it is ready.
///
/// A second start says that it is running already, and succeeds. With --replace
/// the broker that runs is replaced, modules go on and lose nothing: what an
/// upgrade of uORB ends with.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// Become the broker instead of starting one: for a service manager
    #[arg(long)]
    foreground: bool,

    /// Replace the broker that runs, if one does, by the one that is installed now
    #[arg(long)]
    replace: bool,
}

const EXAMPLES: &str = "\
Examples:
  uorb start                            system 0
  uorb --system 1 start                 another one, beside it
  uorb start --replace                  after an upgrade
  UORB_LOG=debug uorb start --foreground

The broker is `uorbd`, looked for beside this program, then on PATH. It logs to
broker.log in the directory of the system, which `uorb status` shows.";

pub(crate) fn run(args: &Args, context: &Context) -> anyhow::Result<()> {
    let program = program()?;
    let system = &context.system;
    // The broker may be started from anywhere and lives elsewhere.
    let base = std::path::absolute(system.base())
        .with_context(|| format!("cannot find {}", system.base().display()))?;
    let mut broker = Command::new(&program);
    broker.arg("--dir").arg(base).args(["--system", &system.number().to_string()]);
    if args.replace {
        broker.arg("--replace");
    }
    if args.foreground {
        let error = broker.arg("--foreground").exec();
        return Err(error).with_context(|| format!("cannot run {}", program.display()));
    }

    let (read_end, write_end) =
        nix::unistd::pipe2(OFlag::O_CLOEXEC).context("cannot make a pipe")?;
    // This end alone is passed on.
    fcntl(&write_end, FcntlArg::F_SETFD(FdFlag::empty())).context("cannot pass on a pipe")?;
    broker
        .args(["--ready-fd", &write_end.as_raw_fd().to_string()])
        .current_dir("/")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    // SAFETY: between fork and exec only what is safe in a signal handler may
    // be called, and setsid is one system call.
    unsafe { broker.pre_exec(|| Ok(nix::unistd::setsid().map(|_| ())?)) };
    let mut broker = broker.spawn().with_context(|| format!("cannot run {}", program.display()))?;
    drop(write_end);

    let mut word = String::new();
    File::from(read_end).read_to_string(&mut word).context("cannot hear the broker")?;
    match word.trim_end() {
        "ready" => say(format_args!("broker started at {system}, pid {}", broker.id())),
        "running" => say(format_args!("already running at {system}")),
        "" => {
            let ended = broker.wait().context("cannot wait for the broker")?;
            bail!("the broker ended without a word ({ended}); see {}", system.log().display());
        }
        other => bail!("{}", other.strip_prefix("error: ").unwrap_or(other)),
    }
    Ok(())
}

/// The broker's program.
fn program() -> anyhow::Result<PathBuf> {
    const NAME: &str = "uorbd";
    let ours = std::env::current_exe().context("cannot find out where this program is")?;
    let beside = ours.with_file_name(NAME);
    let path = std::env::var_os("PATH").unwrap_or_default();
    let on_path = std::env::split_paths(&path).map(|dir| dir.join(NAME));
    let mut places = std::iter::once(beside.clone()).chain(on_path);
    match places.find(|place| place.is_file()) {
        Some(place) => Ok(place),
        None => bail!("there is no {} and no {NAME} on PATH: install it", beside.display()),
    }
}
