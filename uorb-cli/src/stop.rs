//! `uorb stop`: ends the system, and returns when it is gone.

use std::fs::File;
use std::io::ErrorKind;

use anyhow::{Context as _, bail};
use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;
use uorb_core::Error;
use uorb_core::broker_side::{Reply, Request};

use crate::context::Context;
use crate::exit::say;

/// Stop the broker and remove the system's directory.
///
/// Modules find their handles ended; what was published can still be copied by
/// whoever has a subscription.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {}

const EXAMPLES: &str = "\
Examples:
  uorb stop
  uorb --system 1 stop

That none runs is no error, as in PX4: what was wanted is so.";

pub(crate) fn run(_args: &Args, context: &Context) -> anyhow::Result<()> {
    let system = &context.system;
    let session = match context.session() {
        Ok(session) => session,
        Err(Error::NoBroker { .. }) => {
            say(format_args!("not running at {system}"));
            if system.nodes().exists() {
                say(format_args!(
                    "a broker was killed there; `uorb start` takes over what it left"
                ));
            }
            return Ok(());
        }
        // Somebody else stops it, and we came too late to wait for its end.
        Err(Error::Ended { .. }) => {
            say(format_args!("stopped at {system}"));
            return Ok(());
        }
        Err(error) => return Err(error.into()),
    };
    let lock_path = system.lock();
    let open = File::options().read(true).write(true).open(&lock_path);
    let lock = match open {
        Err(error) if error.kind() == ErrorKind::NotFound => None,
        open => Some(open.with_context(|| format!("cannot open {}", lock_path.display()))?),
    };
    match session.ask(Request::Stop) {
        // It ends us with all others, and that may be heard first.
        Ok(Reply::Done) | Err(Error::Ended { .. }) => {}
        Ok(reply) => bail!("the broker answered {reply:?} to a stop"),
        Err(error) => return Err(error.into()),
    }
    if let Some(lock) = lock {
        wait_for(&lock).with_context(|| format!("cannot wait for {}", lock_path.display()))?;
    }
    say(format_args!("stopped at {system}"));
    Ok(())
}

/// Waits until the broker lets go of its lock, which it does when it exits: its
/// directory is gone by then.
fn wait_for(lock: &File) -> Result<(), Errno> {
    let whole_file = libc::flock {
        l_type: libc::F_WRLCK as libc::c_short,
        l_whence: libc::SEEK_SET as libc::c_short,
        l_start: 0,
        l_len: 0,
        l_pid: 0,
    };
    loop {
        match fcntl(lock, FcntlArg::F_SETLKW(&whole_file)) {
            Err(Errno::EINTR) => {}
            done => return done.map(|_| ()),
        }
    }
}
