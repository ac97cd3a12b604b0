//! Waiting for several subscriptions at once.

use std::env;
use std::hint::spin_loop;
use std::os::fd::AsFd;
use std::sync::OnceLock;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::time::TimeSpec;

use crate::clock::now_us;
use crate::error::Error;
use crate::subscription::RawSubscription;

/// The environment variable that names how long a wait spins before it sleeps.
pub const SPIN_VARIABLE: &str = "UORB_SPIN_US";

/// How often a spinning wait looks between two readings of the clock.
const SPIN_LOOKS: u32 = 16;

/// Waits until something can be copied from one of the subscriptions, whose
/// intervals are over, or until `timeout` is over (None: for ever). Returns how
/// many can be copied from; `updated` says which.
///
/// It returns 0 when the time is over and when a signal arrives, so that a
/// handler's flag can be looked at. With something to copy it returns at once,
/// without a system call. Without subscriptions it sleeps, as poll(2) does.
///
/// ```no_run
/// # use std::time::Duration;
/// # fn example(
/// #     accel: &mut uorb_core::RawSubscription,
/// #     gyro: &mut uorb_core::RawSubscription,
/// # ) -> Result<(), uorb_core::Error> {
/// while uorb_core::poll(&mut [accel, gyro], Some(Duration::from_secs(1)))? > 0 {
///     if accel.updated() { /* copy it */ }
///     if gyro.updated() { /* copy it */ }
/// }
/// # Ok(())
/// # }
/// ```
///
/// # Errors
///
/// [`Error::Ended`] once the system has ended and all is copied;
/// [`Error::Forked`] in the child of a fork; [`Error::NoDescriptors`] where
/// there are none left to sleep on.
#[doc(alias = "px4_poll")]
pub fn poll(
    subscriptions: &mut [&mut RawSubscription],
    timeout: Option<Duration>,
) -> Result<usize, Error> {
    // With something to copy the time does not matter, and reading the clock
    // would be the dearest part.
    let updated = look(subscriptions)?;
    if updated > 0 {
        return Ok(updated);
    }
    // A time too far away to be counted is none.
    let deadline = timeout.and_then(|timeout| Instant::now().checked_add(timeout));
    let updated = spin(subscriptions, deadline)?;
    if updated > 0 {
        return Ok(updated);
    }
    loop {
        let rest = deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()));
        if rest == Some(Duration::ZERO) {
            return check(subscriptions).map(|()| 0);
        }
        if matches!(sleep(subscriptions, rest)?, Wake::Signal) {
            return Ok(0);
        }
        let updated = look(subscriptions)?;
        if updated > 0 {
            return Ok(updated);
        }
    }
}

/// Looks again and again for `spin_time`, though not beyond the deadline.
fn spin(
    subscriptions: &mut [&mut RawSubscription],
    deadline: Option<Instant>,
) -> Result<usize, Error> {
    let spin_time = spin_time();
    if spin_time.is_zero() {
        return Ok(0);
    }
    let until = Instant::now() + spin_time;
    let until = deadline.map_or(until, |deadline| deadline.min(until));
    while Instant::now() < until {
        // Several looks take what one reading of the clock does.
        for _ in 0..SPIN_LOOKS {
            let updated = look(subscriptions)?;
            if updated > 0 {
                return Ok(updated);
            }
            spin_loop();
        }
    }
    Ok(0)
}

/// How long a wait looks again and again before it sleeps: what `UORB_SPIN_US`
/// says, in microseconds; zero where it is not set. A message that comes
/// meanwhile is seen at once, and its publisher need not wake anybody; the core
/// is not free for anything else.
pub fn spin_time() -> Duration {
    static SPIN: OnceLock<Duration> = OnceLock::new();
    *SPIN.get_or_init(|| spin_time_from_env().unwrap_or_default())
}

/// What the environment says. Joining a system checks it.
pub(crate) fn spin_time_from_env() -> Result<Duration, Error> {
    match env::var(SPIN_VARIABLE) {
        Err(_) => Ok(Duration::ZERO),
        Ok(text) => text.trim().parse().map(Duration::from_micros).map_err(|_| {
            let expected = "a time in microseconds, 0 and up";
            Error::BadEnvironment { variable: SPIN_VARIABLE, value: text, expected }
        }),
    }
}

/// How many subscriptions can be copied from.
fn look(subscriptions: &mut [&mut RawSubscription]) -> Result<usize, Error> {
    let mut updated = 0;
    for subscription in subscriptions.iter_mut() {
        // That it cannot follow a topic that is there now is an error, not a
        // reason to wait.
        subscription.attach()?;
        updated += usize::from(subscription.updated());
    }
    Ok(updated)
}

fn check(subscriptions: &[&mut RawSubscription]) -> Result<(), Error> {
    subscriptions.iter().try_for_each(|subscription| subscription.check())
}

enum Wake {
    LookAgain,
    Signal,
}

/// Sleeps until a bell rings, an interval ends, or the rest of the time is
/// over.
fn sleep(
    subscriptions: &mut [&mut RawSubscription],
    rest: Option<Duration>,
) -> Result<Wake, Error> {
    let mut rest = rest;
    // Subscriptions whose interval is running are left out: no bell may wake
    // them before it ends.
    let mut listening = Vec::new();
    for subscription in subscriptions.iter() {
        match subscription.hold_off_until_us() {
            Some(due_us) => {
                let hold_off = Duration::from_micros(due_us.saturating_sub(now_us()));
                rest = Some(rest.map_or(hold_off, |rest| rest.min(hold_off)));
            }
            None if subscription.ask()? => return Ok(Wake::LookAgain),
            None => listening.push(subscription.descriptor()?),
        }
    }
    // Whoever ends the system marks the nodes and then rings: after asking, so
    // that either the mark is seen here, or the ring is heard below.
    check(subscriptions)?;

    let slept = match &listening[..] {
        // Waits and consumes in one call, unless somebody outside expects the
        // descriptor to stay readable.
        [alone] if !alone.is_public.load(Ordering::Relaxed) => alone.wait(rest).map(|_| ()),
        _ => {
            let mut ready: Vec<PollFd> = listening
                .iter()
                .map(|descriptor| PollFd::new(descriptor.as_fd(), PollFlags::POLLIN))
                .collect();
            let slept = ppoll(&mut ready, rest.map(TimeSpec::from_duration), None);
            let woken = ready.iter().map(|ready| ready.any() == Some(true));
            for (descriptor, woken) in listening.iter().zip(woken) {
                if woken && !descriptor.is_public.load(Ordering::Relaxed) {
                    descriptor.consume();
                }
            }
            slept.map(|_| ())
        }
    };
    match slept {
        Ok(()) => Ok(Wake::LookAgain),
        Err(Errno::EINTR) => Ok(Wake::Signal),
        Err(errno) => Err(Error::io("wait on", "subscriptions".as_ref(), errno.into())),
    }
}
