//! Something that a process has once, and the child of a fork once more.
//!
//! A fork may happen while another thread of the parent holds a lock or runs in
//! a thread that the child does not have. So the child does not touch what the
//! parent has: it makes its own, and leaks the parent's.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicPtr, AtomicU32, Ordering};

use nix::libc;

/// How many forks lie between this process and the one that first looked.
static FORKS: AtomicU32 = AtomicU32::new(0);

/// Whether this process is a child of one that used the library before.
pub(crate) fn is_child() -> bool {
    FORKS.load(Ordering::Relaxed) > 0
}

/// A value of each process's own.
pub(crate) struct PerProcess<T: 'static> {
    made: AtomicPtr<Made<T>>,
}

struct Made<T> {
    forks: u32,
    value: T,
}

impl<T: Default + Sync> PerProcess<T> {
    pub(crate) const fn new() -> Self {
        Self { made: AtomicPtr::new(std::ptr::null_mut()) }
    }

    /// This process's value.
    pub(crate) fn get(&'static self) -> &'static T {
        static WATCHED: OnceLock<()> = OnceLock::new();
        WATCHED.get_or_init(|| {
            // SAFETY: the handler adds to a counter. Registering fails only
            // without memory; a child is then refused by the session itself.
            unsafe { libc::pthread_atfork(None, None, Some(count)) };
        });
        let forks = FORKS.load(Ordering::Acquire);
        let found = self.made.load(Ordering::Acquire);
        // SAFETY: what is stored comes from a box that nobody frees; NULL is
        // none.
        match unsafe { found.as_ref() } {
            Some(made) if made.forks == forks => return &made.value,
            _ => {}
        }
        let made = Box::into_raw(Box::new(Made { forks, value: T::default() }));
        let stored = self.made.compare_exchange(found, made, Ordering::AcqRel, Ordering::Acquire);
        let kept = match stored {
            Ok(_) => made,
            Err(others) => {
                // SAFETY: it comes from `Box::into_raw`, and nobody has seen it.
                drop(unsafe { Box::from_raw(made) });
                others
            }
        };
        // SAFETY: as above, and another thread of this process made it.
        unsafe { &(*kept).value }
    }
}

/// In the child of a fork.
extern "C" fn count() {
    FORKS.fetch_add(1, Ordering::Release);
}
