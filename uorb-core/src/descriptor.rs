//! The descriptor of a subscription: readable while there is something to copy.
//!
//! It is an epoll instance of the subscription's own, in which the node's bell
//! is registered edge-triggered. Nobody reads the bell; what makes the
//! descriptor unreadable again is that the subscription takes the event out of
//! its own epoll instance. So any number of subscriptions share one bell, and
//! each is readable by itself.
//!
//! A subscription with an interval mutes its bell until the interval ends and
//! has a timer wake it instead, so that a paced descriptor is silent in between.

#![allow(unsafe_code)]

use std::os::fd::{AsFd, AsRawFd, BorrowedFd};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use nix::errno::Errno;
use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags, EpollTimeout};
use nix::sys::time::TimeSpec;
use nix::sys::timerfd::{ClockId, Expiration, TimerFd, TimerFlags, TimerSetTimeFlags};

use crate::bell::Bell;
use crate::error::Error;
use crate::link::Waiting;
use crate::node::Node;

/// The epoll instance, and what is registered in it.
#[derive(Debug)]
pub(crate) struct Descriptor {
    epoll: Epoll,
    /// Outlives its registration: a reused number would be another file.
    bell: OnceLock<Arc<Bell>>,
    timer: OnceLock<TimerFd>,
    /// Whether the bell's events are off.
    muted: AtomicBool,
    /// Whether the last asking for the bell has not been answered yet.
    armed: AtomicBool,
    /// What the node's `rung` was when the descriptor was last made unreadable,
    /// and how often it was believed since that nothing has happened to it.
    rung: AtomicU64,
    believed: AtomicU32,
    /// When the timer wakes, while the bell is muted.
    muted_until_us: AtomicU64,
    /// Whether somebody outside holds the descriptor, who expects it to be
    /// readable exactly while there is something to copy.
    pub(crate) is_public: AtomicBool,
}

/// How often it is believed that a descriptor is as it was left.
const BELIEVED_MAX: u32 = 64;

const BELL: u64 = 0;
const TIMER: u64 = 1;
const WAITING: u64 = 2;

/// The most events that one subscription's epoll instance can report.
const EVENTS_MAX: usize = 3;

fn failed(what: &'static str) -> impl FnOnce(Errno) -> Error {
    move |errno| Error::io(what, "a subscription's descriptor".as_ref(), errno.into())
}

impl Descriptor {
    /// The descriptor of a subscription to a node, or of one that waits for its
    /// topic to be described.
    pub(crate) fn new(node: Option<&Node>, waiting: Option<&Waiting>) -> Result<Self, Error> {
        let epoll = Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC).map_err(failed("make"))?;
        let descriptor = Self {
            epoll,
            bell: OnceLock::new(),
            timer: OnceLock::new(),
            muted: AtomicBool::new(false),
            armed: AtomicBool::new(false),
            rung: AtomicU64::new(0),
            believed: AtomicU32::new(0),
            muted_until_us: AtomicU64::new(0),
            is_public: AtomicBool::new(false),
        };
        if let Some(node) = node {
            descriptor.attach(node)?;
        }
        if let Some(waiting) = waiting {
            let event = EpollEvent::new(EpollFlags::EPOLLIN, WAITING);
            descriptor.epoll.add(&waiting.event, event).map_err(failed("register"))?;
        }
        Ok(descriptor)
    }

    /// Registers a node's bell.
    pub(crate) fn attach(&self, node: &Node) -> Result<(), Error> {
        let bell = node.bell_for_descriptor()?;
        let event = EpollEvent::new(EpollFlags::EPOLLIN | EpollFlags::EPOLLET, BELL);
        self.epoll.add(&*bell, event).map_err(failed("register a bell in"))?;
        let _ = self.bell.set(bell);
        Ok(())
    }

    /// Takes out the event of a topic that is described now.
    pub(crate) fn stop_waiting(&self, waiting: &Waiting) {
        let _ = self.epoll.delete(&waiting.event);
    }

    /// Whether it need not be looked at again: the bell was asked for, and has not
    /// rung since, as far as its node says; or, in an interval, the timer is set.
    ///
    /// The node does not say all (the broker rings, too), and says it a moment
    /// late. So this is not believed for ever.
    pub(crate) fn is_settled(&self, node: &Node, due_us: Option<u64>) -> bool {
        let is_settled = match due_us {
            Some(due_us) => {
                self.is_muted() && self.muted_until_us.load(Ordering::Relaxed) == due_us
            }
            None => {
                !self.is_muted()
                    && self.armed.load(Ordering::Relaxed)
                    && self.rung.load(Ordering::Relaxed) == node.rung()
            }
        };
        is_settled && self.believed.fetch_add(1, Ordering::Relaxed) < BELIEVED_MAX
    }

    /// Makes the descriptor of a subscription to `node` unreadable.
    pub(crate) fn make_unreadable(&self, node: &Node) {
        // Before: a ring that comes in between is one to look at again.
        self.rung.store(node.rung(), Ordering::Relaxed);
        self.believed.store(0, Ordering::Relaxed);
        self.consume();
    }

    /// Takes the events out. Whether there were any.
    pub(crate) fn consume(&self) -> bool {
        self.wait(Some(Duration::ZERO)).unwrap_or(false)
    }

    /// Sleeps until something makes the descriptor readable, and makes it
    /// unreadable again. Whether it did.
    pub(crate) fn wait(&self, timeout: Option<Duration>) -> Result<bool, Errno> {
        let mut events = [EpollEvent::empty(); EVENTS_MAX];
        // There are no more events than places for them, so one call takes all.
        let count = match timeout {
            Some(Duration::ZERO) => self.epoll.wait(&mut events, EpollTimeout::ZERO)?,
            timeout => epoll_wait_exactly(&self.epoll, &mut events, timeout)?,
        };
        let rang = events[..count].iter().any(|event| event.data() == BELL);
        if rang {
            self.armed.store(false, Ordering::Relaxed);
        }
        Ok(count > 0)
    }

    /// Asks for the bell, unless it was asked for and has not rung since. Then
    /// whether there is something newer than `cursor` already.
    pub(crate) fn ask(&self, node: &Node, cursor: u64) -> bool {
        if !self.armed.swap(true, Ordering::Relaxed) {
            node.ask();
        }
        node.has_newer(cursor)
    }

    /// Lets the bell make the descriptor readable. It does so at once, since
    /// there is always a byte in the FIFO.
    pub(crate) fn hear_bell(&self) {
        self.set_bell(EpollFlags::EPOLLIN | EpollFlags::EPOLLET);
        self.muted.store(false, Ordering::Relaxed);
    }

    /// Whether the bell is muted.
    pub(crate) fn is_muted(&self) -> bool {
        self.muted.load(Ordering::Relaxed)
    }

    /// Mutes the bell and becomes readable at `due_us`.
    pub(crate) fn mute_until(&self, due_us: u64) -> Result<(), Error> {
        if !self.muted.swap(true, Ordering::Relaxed) {
            self.set_bell(EpollFlags::empty());
        }
        self.muted_until_us.store(due_us, Ordering::Relaxed);
        // Setting it takes back an expiration that nobody has read.
        let timer = self.timer()?;
        let due = TimeSpec::from_duration(Duration::from_micros(due_us.max(1)));
        timer
            .set(Expiration::OneShot(due), TimerSetTimeFlags::TFD_TIMER_ABSTIME)
            .map_err(failed("set the timer of"))
    }

    /// Takes back what the timer has reported.
    pub(crate) fn stop_timer(&self) {
        if let Some(timer) = self.timer.get() {
            let _ = timer.unset();
        }
    }

    fn timer(&self) -> Result<&TimerFd, Error> {
        if let Some(timer) = self.timer.get() {
            return Ok(timer);
        }
        let flags = TimerFlags::TFD_CLOEXEC | TimerFlags::TFD_NONBLOCK;
        let timer = TimerFd::new(ClockId::CLOCK_MONOTONIC, flags).map_err(failed("time"))?;
        let event = EpollEvent::new(EpollFlags::EPOLLIN, TIMER);
        self.epoll.add(&timer, event).map_err(failed("register a timer in"))?;
        Ok(self.timer.get_or_init(|| timer))
    }

    fn set_bell(&self, flags: EpollFlags) {
        if let Some(bell) = self.bell.get() {
            let changed = self.epoll.modify(&**bell, &mut EpollEvent::new(flags, BELL));
            debug_assert!(changed.is_ok(), "the bell is registered and open: {changed:?}");
        }
    }
}

impl AsFd for Descriptor {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.epoll.0.as_fd()
    }
}

/// epoll_pwait2(2): as epoll_wait, with a timeout in nanoseconds, where
/// epoll_wait rounds to milliseconds. Linux 5.11 and later; valgrind does not know
/// it, and gets the milliseconds.
fn epoll_wait_exactly(
    epoll: &Epoll,
    events: &mut [EpollEvent; EVENTS_MAX],
    timeout: Option<Duration>,
) -> Result<usize, Errno> {
    let exactly = timeout.map(TimeSpec::from_duration);
    let exactly = exactly.as_ref().map_or(std::ptr::null(), |timeout| timeout.as_ref());
    // SAFETY: `events` has room for EVENTS_MAX events, and nix's event is the
    // kernel's by `repr(transparent)`; `exactly` is null or points to a timespec
    // that lives through the call; a null signal mask needs no size.
    let count = unsafe {
        libc::syscall(
            libc::SYS_epoll_pwait2,
            epoll.0.as_raw_fd(),
            events.as_mut_ptr(),
            EVENTS_MAX,
            exactly,
            std::ptr::null::<libc::sigset_t>(),
            0,
        )
    };
    match Errno::result(count) {
        Err(Errno::ENOSYS) => {
            let up = |timeout: Duration| timeout + Duration::from_nanos(999_999);
            let timeout = timeout.map_or(EpollTimeout::NONE, |timeout| {
                EpollTimeout::try_from(up(timeout)).unwrap_or(EpollTimeout::MAX)
            });
            epoll.wait(events, timeout)
        }
        result => result.map(|count| count as usize),
    }
}
