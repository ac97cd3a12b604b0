//! How a publisher wakes subscribers that sleep.
//!
//! A bell is a FIFO, one a node, that everybody opens by its path and nobody
//! reads as a rule. Each sleeping subscription has registered it in an epoll
//! instance of its own, edge-triggered, so one `write` of one byte wakes them
//! all, however many, and each stays woken until it has consumed the event
//! itself. The path is the bell's identity: there is nothing to hand over, and
//! the broker's death changes nothing.
//!
//! Two words say whether a write is due. A subscription that has copied all
//! there is adds 1 to `asked`, looks at the ring once more, and sleeps. A
//! publisher, after its commit, reads `asked`; if it is not `rung`, it writes
//! the FIFO and *then* stores what it read in `rung`. Killed before the write,
//! the next publish rings; killed after it, somebody rings once too often;
//! never once too rarely. While nobody has asked, a publish makes no system
//! call.
//!
//! Why no wake is lost: the commit and the look at `asked` on one side, the
//! addition and the look at the ring on the other, are all sequentially
//! consistent, so at least one of the two sees the other.

use crate::sync::{AtomicU64, Ordering};

/// Asks for the bell. The caller looks at the ring once more before it sleeps.
#[inline]
pub(crate) fn ask(asked: &AtomicU64) {
    asked.fetch_add(1, Ordering::SeqCst);
    fail_point!("copy.asked");
    loom_fence();
}

/// After a commit: rings if somebody has asked since the bell was last rung.
/// `ring` says whether it has.
#[inline]
pub(crate) fn ring_if_asked(asked: &AtomicU64, rung: &AtomicU64, ring: impl FnOnce() -> bool) {
    loom_fence();
    let asked = asked.load(Ordering::SeqCst);
    let is_due = asked != rung.load(Ordering::Relaxed);
    if is_due {
        fail_point!("publish.asked");
    }
    if is_due && ring() {
        fail_point!("publish.rung");
        // Two publishers may store in either order. The older number makes the
        // next publish ring once too often.
        rung.store(asked, Ordering::SeqCst);
        fail_point!("publish.noted");
    }
}

/// loom takes sequentially consistent loads and stores for acquire and release
/// only, and would report a lost wake that cannot happen. Its fences are real.
#[inline]
fn loom_fence() {
    #[cfg(loom)]
    loom::sync::atomic::fence(Ordering::SeqCst);
}

#[cfg(not(loom))]
pub(crate) use fifo::Bell;

#[cfg(not(loom))]
mod fifo {
    use std::fs::{File, OpenOptions};
    use std::io::{self, Read, Write};
    use std::os::fd::{AsFd, BorrowedFd};
    use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
    use std::path::Path;

    use nix::fcntl::{FcntlArg, fcntl};
    use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

    /// What a FIFO is to hold: rings are drained only when it is full, and a
    /// page is allocated for each that it takes. The kernel rounds up to pages.
    const CAPACITY_BYTES: libc::c_int = 8_192;

    /// How much is read from a full FIFO at a time.
    const DRAIN_BYTES: usize = 4_096;

    /// How often. The kernel makes room by whole pages, of up to 64 KiB; the
    /// rest is for other publishers that fill it meanwhile.
    const DRAINS_MAX: usize = 64;

    /// A process's open end of a node's bell.
    #[derive(Debug)]
    pub(crate) struct Bell {
        fifo: File,
    }

    impl Bell {
        /// Opens the FIFO and leaves a byte in it: epoll reports the next
        /// change of interest at once only if something can be read.
        pub(crate) fn open(path: &Path) -> io::Result<Self> {
            let fifo = OpenOptions::new()
                .read(true)
                .write(true)
                .custom_flags(libc::O_NONBLOCK | libc::O_CLOEXEC | libc::O_NOFOLLOW)
                .open(path)?;
            if !fifo.metadata()?.file_type().is_fifo() {
                let message = format!("{} is not a FIFO", path.display());
                return Err(io::Error::new(io::ErrorKind::InvalidData, message));
            }
            let bell = Self { fifo };
            // A FIFO that has its byte is left in peace: to write it, or only to
            // set its size, would wake all sleepers.
            if !bell.is_readable() {
                // A smaller buffer saves memory, a larger one works as well.
                let _ = fcntl(&bell.fifo, FcntlArg::F_SETPIPE_SZ(CAPACITY_BYTES));
                bell.ring();
            }
            Ok(bell)
        }

        fn is_readable(&self) -> bool {
            let mut ready = [PollFd::new(self.fifo.as_fd(), PollFlags::POLLIN)];
            poll(&mut ready, PollTimeout::ZERO).is_ok_and(|ready| ready > 0)
        }

        /// Wakes every subscription that sleeps on the node. Whether it did.
        ///
        /// A FIFO that is full, after some 8,000 rings, is drained and written
        /// again: the byte written last is what wakes.
        pub(crate) fn ring(&self) -> bool {
            for _ in 0..DRAINS_MAX {
                match (&self.fifo).write(&[0]) {
                    Ok(_) => return true,
                    Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                        let _ = (&self.fifo).read(&mut [0; DRAIN_BYTES]);
                    }
                    Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                    Err(_) => return false,
                }
            }
            false
        }
    }

    impl AsFd for Bell {
        fn as_fd(&self) -> BorrowedFd<'_> {
            self.fifo.as_fd()
        }
    }
}
