//! `px4_poll`: poll(2) that knows what a subscription has.
//!
//! The descriptors are real ones, so poll(2) works on them, too; but readable is
//! a hint there, and here it is what `orb_check` says. Descriptors of other
//! kinds may stand among them; closed ones are passed over, as in PX4.

use std::ffi::{c_int, c_uint};
use std::hint::spin_loop;
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::libc::{self, POLLIN, POLLNVAL, pollfd, timespec};
use uorb_core::spin_time;

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
    let found = look(fds);
    if found.updated > 0 && found.others == 0 {
        return found.updated as c_int;
    }
    let timeout = u64::try_from(timeout).ok().map(Duration::from_millis);
    match wait(fds, found, timeout) {
        Ok(ready) => ready as c_int,
        Err(Errno::EINTR) => 0,
        Err(errno) => fail(errno),
    }
}

/// Waits until something is ready, or the time is over. Returns how many are.
fn wait(fds: &mut [pollfd], mut found: Found, timeout: Option<Duration>) -> Result<usize, Errno> {
    let begun = Instant::now();
    let spins_to = spin_time().min(timeout.unwrap_or(Duration::MAX));
    while found.updated == 0 && begun.elapsed() < spins_to {
        if fds.iter().any(is_pending) {
            found = look(fds);
        }
        spin_loop();
    }
    loop {
        if let (0, Some(errno)) = (found.updated, found.hindrance) {
            return Err(errno);
        }
        // What else is ready is reported together with those that are updated.
        let rest = match found.updated {
            0 => timeout.map(|timeout| timeout.saturating_sub(begun.elapsed())),
            _ => Some(Duration::ZERO),
        };
        let ready = found.updated + sleep(fds, rest)?;
        if ready > 0 || rest == Some(Duration::ZERO) {
            return Ok(ready);
        }
        found = look(fds);
        if found.updated > 0 && found.others == 0 {
            return Ok(found.updated);
        }
    }
}

/// Whether there is something to look at: cheaper than looking.
fn is_pending(fd: &pollfd) -> bool {
    subscription(fd.fd).is_some_and(|mut place| place.get().raw.pending() > 0)
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
