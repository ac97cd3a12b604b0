//! A subscription as a file descriptor: when it is readable, and why.
//!
//! What holds of the descriptor:
//!
//! * Readable is a hint, [`RawSubscription::updated`] decides.
//! * Copy until nothing is new before you wait again: edge-triggered epoll,
//!   tokio's among them, reports a descriptor that stays readable only once.
//! * One handle, one waiter: of two threads that wait on it, or on a duplicate
//!   of the descriptor, either may take the other's wake.

use std::os::fd::{AsFd, AsRawFd, BorrowedFd, RawFd};
use std::sync::atomic::Ordering;

use super::{RawSubscription, Subscription};
use crate::clock::now_us;
use crate::descriptor::Descriptor;
use crate::error::Error;
use crate::node::Node;
use crate::topic::Topic;

impl RawSubscription {
    /// Makes a descriptor that somebody holds readable exactly if there is
    /// something to copy. Called whenever that may have changed by our doing.
    pub(super) fn settle(&self) {
        let (Some(descriptor), Some(node)) = (self.descriptor.get(), &self.node) else { return };
        // In the child of a fork the epoll instance is the parent's too.
        if !descriptor.is_public.load(Ordering::Relaxed) || self.session.is_forked() {
            return;
        }
        if let Some(pace) = self.pace
            && now_us() < pace.due_us()
        {
            // The timer says when to look again, whatever is published.
            descriptor.make_unreadable(node);
            if descriptor.mute_until(pace.due_us()).is_ok() {
                return;
            }
        }
        if descriptor.is_muted() {
            descriptor.stop_timer();
            descriptor.hear_bell();
        }
        if node.has_newer(self.cursor) && !self.is_corrupt {
            return;
        }
        descriptor.make_unreadable(node);
        if descriptor.ask(node, self.cursor) && !self.is_corrupt {
            // It came in between, and its ring may have been consumed.
            descriptor.hear_bell();
        }
    }

    /// As `settle`, where nothing was copied: a program that looks again and again
    /// makes no system call each time.
    pub(super) fn settle_if_need_be(&self) {
        let (Some(descriptor), Some(node)) = (self.descriptor.get(), &self.node) else { return };
        if self.is_corrupt || !descriptor.is_settled(node, self.hold_off_until_us()) {
            self.settle();
        }
    }

    /// Makes the descriptor, so that `as_fd` cannot fail later.
    ///
    /// # Errors
    ///
    /// [`Error::NoDescriptors`] where the process has none left.
    pub fn open_descriptor(&self) -> Result<(), Error> {
        let descriptor = self.descriptor()?;
        if !descriptor.is_public.swap(true, Ordering::Relaxed) {
            // What `poll` has consumed until now is readable again.
            descriptor.hear_bell();
            self.settle();
        }
        Ok(())
    }

    pub(crate) fn descriptor(&self) -> Result<&Descriptor, Error> {
        self.descriptor_of(self.node.as_deref())
    }

    /// The descriptor, with the bell of a node that is about to be followed.
    pub(super) fn descriptor_for(&self, node: &Node) -> Result<&Descriptor, Error> {
        self.descriptor_of(Some(node))
    }

    fn descriptor_of(&self, node: Option<&Node>) -> Result<&Descriptor, Error> {
        if let Some(descriptor) = self.descriptor.get() {
            return Ok(descriptor);
        }
        let made = Descriptor::new(node, self.waiting.as_deref());
        // The bell goes with its system: then that is what there is to say.
        let made = made.or_else(|error| self.check().and(Err(error)))?;
        Ok(self.descriptor.get_or_init(|| made))
    }

    /// Asks to be woken. True: there is something new already.
    pub(crate) fn ask(&self) -> Result<bool, Error> {
        let descriptor = self.descriptor()?;
        if self.is_corrupt {
            // There is always something new, and it cannot be copied.
            return self.check().map(|()| false);
        }
        Ok(self.node.as_ref().is_some_and(|node| descriptor.ask(node, self.cursor)))
    }
}

impl AsFd for RawSubscription {
    /// The descriptor that is readable while there is something to copy.
    ///
    /// # Panics
    ///
    /// If the process has no descriptors left. Call
    /// [`RawSubscription::open_descriptor`] first to have that as an error.
    fn as_fd(&self) -> BorrowedFd<'_> {
        match self.open_descriptor().and_then(|()| self.descriptor()) {
            Ok(descriptor) => descriptor.as_fd(),
            Err(error) => panic!("{error}"),
        }
    }
}

impl AsRawFd for RawSubscription {
    fn as_raw_fd(&self) -> RawFd {
        self.as_fd().as_raw_fd()
    }
}

impl<T: Topic> AsFd for Subscription<T> {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.raw.as_fd()
    }
}

impl<T: Topic> AsRawFd for Subscription<T> {
    fn as_raw_fd(&self) -> RawFd {
        self.raw.as_raw_fd()
    }
}
