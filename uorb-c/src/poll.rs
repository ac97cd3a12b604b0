//! `px4_poll`: poll(2) that knows what a subscription has.
//!
//! The descriptors are real ones, so poll(2) works on them, too; but readable is
//! a hint there, and here it is what `orb_check` says. Descriptors of other
//! kinds may stand among them; closed ones are passed over, as in PX4.

use std::ffi::{c_int, c_uint};
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::libc::{self, POLLIN, POLLNVAL, pollfd, timespec};

use crate::failure::{errno_of, fail};
use crate::handles::subscription;

/// # Safety
///
/// `fds` points to `nfds` of them.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn px4_poll(fds: *mut pollfd, nfds: c_uint, timeout: c_int) -> c_int {
    if fds.is_null() || nfds == 0 {
        return fail(Errno::EINVAL);
    }
    // SAFETY: the caller's word.
    let fds = unsafe { std::slice::from_raw_parts_mut(fds, nfds as usize) };
    let timeout = u64::try_from(timeout).ok().map(Duration::from_millis);
    let deadline = timeout.map(|timeout| Instant::now() + timeout);
    loop {
        let found = look(fds);
        if found.updated == fds.len() || found.updated > 0 && found.others == 0 {
            return found.updated as c_int;
        }
        if let (0, Some(errno)) = (found.updated, found.hindrance) {
            return fail(errno);
        }
        let rest = match (found.updated, deadline) {
            // What else is ready is reported together with them.
            (1.., _) => Some(Duration::ZERO),
            (0, Some(deadline)) => Some(deadline.saturating_duration_since(Instant::now())),
            (0, None) => None,
        };
        match sleep(fds, rest) {
            Ok(ready) if found.updated + ready > 0 => return (found.updated + ready) as c_int,
            Ok(_) if rest == Some(Duration::ZERO) => return 0,
            Ok(_) => {}
            Err(Errno::EINTR) => return 0,
            Err(errno) => return fail(errno),
        }
    }
}

/// What there is to know without a system call.
#[derive(Default)]
struct Found {
    /// Subscriptions that can be copied from.
    updated: usize,
    /// Descriptors that are no subscriptions.
    others: usize,
    /// What hinders a subscription from ever being updated.
    hindrance: Option<Errno>,
}

fn look(fds: &mut [pollfd]) -> Found {
    let mut found = Found::default();
    for fd in fds {
        fd.revents = 0;
        match subscription(fd.fd) {
            None => found.others += 1,
            Some(mut place) => {
                let raw = &mut place.get().raw;
                if raw.updated() && fd.events & POLLIN != 0 {
                    fd.revents = POLLIN;
                    found.updated += 1;
                } else if let Err(error) = raw.check() {
                    found.hindrance = Some(errno_of(&error));
                }
            }
        }
    }
    found
}

/// Sleeps until something is readable, or the rest of the time is over. Returns
/// how many descriptors are ready that are no subscriptions; whether a
/// subscription is, `look` has to say.
fn sleep(fds: &mut [pollfd], rest: Option<Duration>) -> Result<usize, Errno> {
    let mut waiting: Vec<pollfd> = fds.iter().map(|fd| pollfd { revents: 0, ..*fd }).collect();
    for fd in &mut waiting {
        // SAFETY: asks about a number, which may be none.
        if fd.fd >= 0 && unsafe { libc::fcntl(fd.fd, libc::F_GETFD) } < 0 {
            fd.fd = -1;
        }
    }
    if waiting.iter().all(|fd| fd.fd < 0) {
        return Err(Errno::EBADF);
    }
    let rest = rest.map(|rest| timespec {
        tv_sec: rest.as_secs() as libc::time_t,
        tv_nsec: libc::c_long::from(rest.subsec_nanos() as i32),
    });
    let rest = rest.as_ref().map_or(std::ptr::null(), std::ptr::from_ref);
    // SAFETY: so many descriptors are there, and the time is NULL or a timespec
    // that outlives the call.
    let slept = unsafe {
        libc::ppoll(waiting.as_mut_ptr(), waiting.len() as libc::nfds_t, rest, std::ptr::null())
    };
    Errno::result(slept)?;
    let mut ready = 0;
    for (fd, woken) in fds.iter_mut().zip(&waiting) {
        let events = woken.revents & !POLLNVAL;
        if events != 0 && subscription(fd.fd).is_none() {
            fd.revents = events;
            ready += 1;
        }
    }
    Ok(ready)
}
