//! Where something runs, and whether its core sleeps in between.
//!
//! On a virtual machine a wake that finds its core asleep takes tens of
//! microseconds, whoever wakes. So wakes are measured in three places: both
//! sides on one core; on two cores that are kept awake by a process of idle
//! priority, which anybody else displaces at once; and wherever the kernel puts
//! them, as in daily life.

use std::fmt;
use std::hint::spin_loop;
use std::time::{Duration, Instant};

use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity, sched_yield};
use nix::unistd::Pid;
use uorb_tests::Actor;

use crate::role::play;

/// How long a spinner spins before it asks whether anybody else wants the core.
const YIELD_EVERY: Duration = Duration::from_micros(40);

/// The cores that this process may use. Asked before anything is pinned.
#[derive(Clone, Copy, Debug)]
pub struct Cores(CpuSet);

impl Cores {
    pub fn of_this_process() -> Self {
        Self(sched_getaffinity(Pid::from_raw(0)).expect("Linux says where we may run"))
    }

    fn numbers(self) -> Vec<usize> {
        (0..CpuSet::count()).filter(|core| self.0.is_set(*core) == Ok(true)).collect()
    }

    pub fn count(self) -> usize {
        self.numbers().len()
    }

    /// The core for what is measured alone: the last, since interrupts tend to
    /// go to the first.
    pub fn alone(self) -> Core {
        Core(self.numbers().last().copied())
    }

    /// Another one, if there is one.
    pub fn other(self) -> Core {
        Core(self.numbers().first().copied())
    }

    /// Takes back what `Core::pin` did to this thread.
    pub fn unpin(self) {
        sched_setaffinity(Pid::from_raw(0), &self.0).expect("we were there before");
    }
}

/// A core to be pinned to; None: any.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Core(pub Option<usize>);

impl Core {
    pub const ANY: Self = Self(None);

    pub fn pin(self) {
        let Some(core) = self.0 else { return };
        let mut only = CpuSet::new();
        only.set(core).expect("the kernel has named it");
        sched_setaffinity(Pid::from_raw(0), &only).expect("we may run there");
    }

    /// As an argument of a role.
    pub fn parse(word: &str) -> Self {
        Self(word.parse().ok())
    }
}

impl fmt::Display for Core {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.map_or(write!(f, "any"), |core| write!(f, "{core}"))
    }
}

/// Where two processes that wake each other run.
#[derive(Debug)]
pub struct Place {
    pub name: &'static str,
    pub cores: [Core; 2],
    _awake: Vec<Actor>,
}

impl Place {
    pub fn one_core(cores: Cores) -> Self {
        Self { name: "one core", cores: [cores.alone(); 2], _awake: Vec::new() }
    }

    /// None on a machine of one core.
    pub fn two_awake(cores: Cores) -> Option<Self> {
        (cores.count() >= 2).then(|| {
            let cores = [cores.other(), cores.alone()];
            let awake = cores.map(|core| play(None, &["keep-awake", &core.to_string()]));
            Self { name: "two cores awake", cores, _awake: awake.into() }
        })
    }

    /// All of them, one after the other: what keeps cores awake in one must not
    /// run in another.
    pub fn all(cores: Cores) -> impl Iterator<Item = Self> {
        (0..3).filter_map(move |place| match place {
            0 => Some(Self::one_core(cores)),
            1 => Self::two_awake(cores),
            _ => Some(Self::unpinned()),
        })
    }

    pub fn unpinned() -> Self {
        Self { name: "unpinned", cores: [Core::ANY; 2], _awake: Vec::new() }
    }
}

/// The role that keeps a core awake, until it is killed.
#[allow(unsafe_code)]
pub fn keep_awake() -> anyhow::Result<()> {
    let idle = libc::sched_param { sched_priority: 0 };
    // SAFETY: the kernel reads a `sched_param`, which is one.
    let done = unsafe { libc::sched_setscheduler(0, libc::SCHED_IDLE, &raw const idle) };
    nix::errno::Errno::result(done)?;
    loop {
        let until = Instant::now() + YIELD_EVERY;
        while Instant::now() < until {
            spin_loop();
        }
        sched_yield()?;
    }
}
