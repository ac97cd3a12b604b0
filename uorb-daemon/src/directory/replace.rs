//! Taking the place of a broker that runs: for an upgrade.
//!
//! It is killed, as any broker may be at any instant: publishers and
//! subscriptions go on without one, and what it leaves is adopted. Only a broker
//! that could not adopt it must not kill it.

use std::fs::File;
use std::io;

use anyhow::{Context as _, bail};
use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use uorb_core::System;
use uorb_core::broker_side::NODE_FILE_VERSION;

use super::{Inscription, write_lock};

/// Ends the broker of a system, if one runs, and waits until it is gone.
pub(crate) fn end_the_running(system: &System) -> anyhow::Result<()> {
    let path = system.lock();
    let lock = match File::options().read(true).write(true).open(&path) {
        Ok(lock) => lock,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error).with_context(|| format!("cannot open {}", path.display())),
    };
    let about = || format!("cannot ask who has locked {}", path.display());
    let mut holder = write_lock();
    fcntl(&lock, FcntlArg::F_GETLK(&mut holder)).with_context(about)?;
    if holder.l_type == libc::F_UNLCK as libc::c_short {
        return Ok(());
    }
    // One that is just starting has not written it yet, and will run beside nobody.
    let version = Inscription::read(&lock).map_or(NODE_FILE_VERSION, |before| before.version);
    if version != NODE_FILE_VERSION {
        bail!(
            "the broker of {system} makes nodes of version {version}, this one would make \
             {NODE_FILE_VERSION}: it goes on; end the system first (`uorb stop`)"
        );
    }
    // In another pid namespace it has no number here; to signal 0 is to signal us.
    if holder.l_pid <= 0 {
        bail!("the broker of {system} runs in another pid namespace: replace it from there");
    }
    match kill(Pid::from_raw(holder.l_pid), Signal::SIGKILL) {
        Ok(()) | Err(Errno::ESRCH) => {}
        Err(errno) => {
            return Err(errno)
                .with_context(|| format!("cannot end the broker, pid {}", holder.l_pid));
        }
    }
    loop {
        match fcntl(&lock, FcntlArg::F_SETLKW(&write_lock())) {
            // The file is closed here, and whoever is first has the lock.
            Ok(_) => return Ok(()),
            Err(Errno::EINTR) => {}
            Err(errno) => {
                return Err(errno).with_context(|| format!("cannot wait for {}", path.display()));
            }
        }
    }
}
