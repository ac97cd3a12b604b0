//! Ctrl-C, noticed instead of suffered.
//!
//! The first one lets the command end in its own way; a second one, should that
//! not come to an end, kills it.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::time::TimeSpec;
use signal_hook::consts::SIGINT;

use crate::exit;

/// The longest time to wait for anything that Ctrl-C does not wake for certain.
///
/// A signal makes `uorb_core::poll` return, but not one that arrives between
/// the look at [`Interrupt::has_come`] and the system call. So nobody waits for
/// ever: after this time one looks again.
pub(crate) const LOOK_AGAIN: Duration = Duration::from_secs(1);

/// Whether Ctrl-C was pressed since [`Interrupt::catch`].
#[derive(Debug)]
pub(crate) struct Interrupt {
    has_come: Arc<AtomicBool>,
    /// Becomes readable when it comes.
    pipe: UnixStream,
}

impl Interrupt {
    /// From now on, Ctrl-C does not kill.
    pub(crate) fn catch() -> anyhow::Result<Self> {
        Self::catch_signal().context("cannot catch Ctrl-C")
    }

    fn catch_signal() -> io::Result<Self> {
        let has_come = Arc::new(AtomicBool::new(false));
        let (pipe, write_end) = UnixStream::pair()?;
        // In this order, so that the first Ctrl-C only sets the flag.
        let code = exit::INTERRUPTED.into();
        signal_hook::flag::register_conditional_shutdown(SIGINT, code, has_come.clone())?;
        signal_hook::flag::register(SIGINT, has_come.clone())?;
        signal_hook::low_level::pipe::register(SIGINT, write_end)?;
        Ok(Self { has_come, pipe })
    }

    pub(crate) fn has_come(&self) -> bool {
        self.has_come.load(Ordering::Relaxed)
    }

    /// Waits until this moment (None: for ever) or for Ctrl-C, whichever comes
    /// first. True: it was Ctrl-C.
    pub(crate) fn wait_until(&self, moment: Option<Instant>) -> anyhow::Result<bool> {
        loop {
            let rest = moment.map(|moment| moment.saturating_duration_since(Instant::now()));
            if self.has_come() || rest == Some(Duration::ZERO) {
                return Ok(self.has_come());
            }
            let mut ready = [PollFd::new(self.pipe.as_fd(), PollFlags::POLLIN)];
            match ppoll(&mut ready, rest.map(TimeSpec::from_duration), None) {
                Ok(_) | Err(Errno::EINTR) => {}
                Err(errno) => return Err(errno).context("cannot wait"),
            }
        }
    }
}

/// Becomes readable when it comes.
impl AsFd for Interrupt {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.pipe.as_fd()
    }
}
