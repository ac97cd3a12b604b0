//! How C hears of what went wrong: errno, and a sentence on stderr.

use std::ffi::c_int;
use std::fmt;
use std::io::{self, Write};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use nix::errno::Errno;
use uorb_core::Error;

/// What the functions return where something went wrong (PX4's `PX4_ERROR`).
pub(crate) const ERROR: c_int = -1;
/// What they return where nothing did (PX4's `PX4_OK`).
pub(crate) const OK: c_int = 0;

/// A module that tries again a thousand times a second is told once.
const SAID_AGAIN_AFTER: Duration = Duration::from_secs(1);

/// Sets errno. Nothing is said: the functions of the hot path fail like this.
pub(crate) fn fail(errno: Errno) -> c_int {
    errno.set();
    ERROR
}

/// Sets errno and says on stderr what `function` could not do with what, and
/// what helps.
#[cold]
pub(crate) fn fail_aloud(
    function: &str,
    topic: &str,
    errno: Errno,
    why: &dyn fmt::Display,
) -> c_int {
    static SAID: Mutex<Option<(Instant, String)>> = Mutex::new(None);
    let words = format!("ERROR [uorb] {function} {topic}: {why}\n");
    // After a fork its holder may not exist; then it is said twice.
    if let Ok(mut said) = SAID.try_lock().or_else(|lock| match lock {
        std::sync::TryLockError::Poisoned(poisoned) => Ok(PoisonError::into_inner(poisoned)),
        std::sync::TryLockError::WouldBlock => Err(()),
    }) {
        if let Some((when, what)) = &*said
            && *what == words
            && when.elapsed() < SAID_AGAIN_AFTER
        {
            return fail(errno);
        }
        *said = Some((Instant::now(), words.clone()));
    }
    let _ = io::stderr().write_all(words.as_bytes());
    fail(errno)
}

/// What errno is for an error of the library.
pub(crate) fn errno_of(error: &Error) -> Errno {
    match error {
        Error::NoBroker { .. } => Errno::ECONNREFUSED,
        Error::NoAnswer { .. } => Errno::ETIMEDOUT,
        Error::Ended { .. } => Errno::ESHUTDOWN,
        Error::Forked => Errno::EPERM,
        Error::OtherUser { .. } => Errno::EACCES,
        Error::Busy { .. } => Errno::EAGAIN,
        Error::NoSpace { .. } => Errno::ENOSPC,
        Error::NoDescriptors { .. } => Errno::EMFILE,
        Error::LayoutMismatch(_) | Error::WrongSize { .. } => Errno::EINVAL,
        Error::NoNode { .. } => Errno::ENOENT,
        Error::Io { source, .. } => source.raw_os_error().map_or(Errno::EIO, Errno::from_raw),
        _ => Errno::EIO,
    }
}
