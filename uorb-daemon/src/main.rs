//! `uorbd`, the broker of one system. `uorb start` starts it.

#![deny(unsafe_code)]

mod broker;
mod connection;
mod directory;
mod limits;
mod log;
mod registry;
mod streams;

use std::fs::File;
use std::io::Write;
use std::os::fd::{FromRawFd, RawFd};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::Parser;
use nix::sys::resource::{Resource, getrlimit, setrlimit};
use tracing::error;
use uorb_core::{Session, System};

use crate::broker::{Broker, kernel_rings_bells};
use crate::directory::{Found, Survivor};
use crate::limits::RUNNING_TIMEOUT;

const EXAMPLES: &str = "\
Examples:
  uorb start                             what people use: returns when it is ready
  uorbd --foreground                     for a service manager
  uorbd --foreground --replace           the same, after an upgrade
  uorbd --dir /run/uorb --system 1       a system of its own elsewhere
  UORB_LOG=debug uorbd --foreground      says more

SIGTERM and SIGINT end the system, as `uorb stop` does.";

/// The broker of uORB between processes: it makes nodes and says who publishes
/// on them. `uorb start` starts it; a service manager runs it with --foreground.
#[derive(Parser, Debug)]
#[command(name = "uorbd", version, after_help = EXAMPLES)]
struct Args {
    /// The directory of all systems [default: $UORB_DIR, else /dev/shm/uorb-UID]
    #[arg(long, value_name = "DIR")]
    dir: Option<PathBuf>,

    /// The number of the system [default: $UORB_SYSTEM, else 0]
    #[arg(long, value_name = "N")]
    system: Option<u32>,

    /// Take the place of the broker that runs, for an upgrade: nobody loses anything
    #[arg(long)]
    replace: bool,

    /// Log to stderr instead of broker.log
    #[arg(long)]
    foreground: bool,

    /// Write "ready", "running" or "error: ..." to this descriptor, then close it
    #[arg(long, value_name = "FD", hide = true)]
    ready_fd: Option<RawFd>,
}

fn main() -> ExitCode {
    let args = Args::parse();
    let mut ready = args.ready_fd.map(take_descriptor);
    let mut tell = |word: &str| {
        if let Some(ready) = &mut ready {
            let _ = writeln!(ready, "{word}");
        }
        // Closed: whoever waits for it goes on.
        ready = None;
    };
    match run(&args, &mut tell) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            tell(&format!("error: {failure:#}"));
            error!("{failure:#}");
            eprintln!("uorbd: {failure:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(args: &Args, tell: &mut dyn FnMut(&str)) -> anyhow::Result<()> {
    let system = match (&args.dir, args.system) {
        (Some(dir), Some(number)) => System::new(dir, number),
        (dir, number) => {
            let named = System::from_env()?;
            let base = dir.clone().unwrap_or_else(|| named.base().to_path_buf());
            System::new(base, number.unwrap_or(named.number()))
        }
    };
    let had_base = system.base().exists();
    let begun = begin(args, &system);
    if begun.is_err() && !had_base {
        // Only if nobody else has made something in it meanwhile.
        let _ = std::fs::remove_dir(system.base());
    }
    let Some(mut broker) = begun? else {
        tell("running");
        eprintln!("uorbd: already running at {system}");
        return Ok(());
    };
    tell("ready");
    broker.run()
}

/// Makes the system ours, and a broker in it. None if another one runs it.
fn begin(args: &Args, system: &System) -> anyhow::Result<Option<Broker>> {
    if args.replace {
        directory::end_the_running(system)?;
    }
    let Some((lock, system_id, living)) = take_system(system)? else { return Ok(None) };
    // Held while we clean up after a failure, too.
    let lock = Arc::new(lock);
    let is_new = living.is_empty();
    let broker = equip(args, system)
        .and_then(|()| Broker::new(system.clone(), lock.clone(), system_id, living));
    if broker.is_err() && is_new {
        // A system that never was leaves nothing behind.
        directory::remove(system);
    }
    broker.map(Some)
}

/// What a broker needs besides its directory.
fn equip(args: &Args, system: &System) -> anyhow::Result<()> {
    let log = system.log();
    log::start((!args.foreground).then_some(&log))
        .with_context(|| format!("cannot write the log {}", log.display()))?;
    if !kernel_rings_bells()? {
        bail!(
            "this kernel does not wake an edge-triggered epoll on a pipe that is not empty \
             (Linux 5.5 to 5.10.55 and 5.11 to 5.13.7): update it"
        );
    }
    raise_descriptor_limit();
    Ok(())
}

/// Makes the system ours. None if another broker runs it: one that has the lock
/// and answers. One that has the lock and does not is starting or stopping.
fn take_system(system: &System) -> anyhow::Result<Option<(File, u64, Vec<Survivor>)>> {
    let deadline = Instant::now() + RUNNING_TIMEOUT;
    loop {
        if let Found::Ours { lock, system_id, living } = directory::open(system)? {
            return Ok(Some((lock, system_id, living)));
        }
        match Session::connect_to(system) {
            Ok(_) => return Ok(None),
            Err(failure) if Instant::now() >= deadline => {
                return Err(failure).context("another broker has the lock and does not answer");
            }
            // That takes it microseconds; there is nothing to wait on.
            Err(_) => std::thread::sleep(Duration::from_millis(10)),
        }
    }
}

/// Two descriptors a process, and one a node that is only subscribed: the soft
/// limit of 1,024 would be the first to be reached.
fn raise_descriptor_limit() {
    if let Ok((_, hard)) = getrlimit(Resource::RLIMIT_NOFILE) {
        let _ = setrlimit(Resource::RLIMIT_NOFILE, hard, hard);
    }
}

#[allow(unsafe_code)]
fn take_descriptor(number: RawFd) -> File {
    // SAFETY: whoever names a descriptor on the command line hands it over; a
    // number that is not open fails at the first write.
    unsafe { File::from_raw_fd(number) }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_help_has_examples() {
        let after = Args::command().get_after_help().map(ToString::to_string);
        assert!(after.is_some_and(|after| after.contains("Examples:\n")));
    }
}
