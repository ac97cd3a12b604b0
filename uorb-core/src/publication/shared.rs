//! A publication that many may use at once: the C door's.
//!
//! C programs share a publication between threads and publish from signal
//! handlers, also into the topic that the signal has interrupted. The ring
//! admits that as it is: each publish under way holds a slot of its own. So
//! nothing is locked here; what a publication remembers between two publishes
//! are hints, and each publish works on a copy of them.
//!
//! The stream's port is one for all. Whoever finds it taken for longer than a
//! send lasts publishes to the node alone, and those who follow the stream look
//! there for what is missing.

use std::hint::spin_loop;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

use super::RawPublication;
use crate::error::Error;
use crate::generation::Generation;
use crate::ring::Writer;

/// How often a taken port is looked at before the message goes to the node
/// alone: some tens of microseconds.
const PORT_LOOKS: u32 = 2_000;

/// A [`RawPublication`] that any number of threads, and signal handlers, may
/// publish on at once.
#[derive(Debug)]
pub struct SharedPublication {
    raw: RawPublication,
    newest: AtomicU64,
    candidate: AtomicUsize,
    sending: AtomicBool,
}

impl SharedPublication {
    /// Shares a publication.
    pub fn new(raw: RawPublication) -> Self {
        let (newest, candidate, sending) = Default::default();
        Self { raw, newest, candidate, sending }
    }

    /// As [`RawPublication::publish`]. If somebody follows the stream, `may_send`
    /// is asked whether this is a place to send from, and what it answers is
    /// held meanwhile: in a signal handler it is not one, and then the message is
    /// in the node alone.
    ///
    /// # Errors
    ///
    /// As [`RawPublication::publish`]; [`Error::Busy`] where more threads publish
    /// on the node at once than it has slots for.
    #[inline]
    pub fn publish<Held>(
        &self,
        message: &[u8],
        may_send: impl FnOnce() -> Option<Held>,
    ) -> Result<Generation, Error> {
        let raw = &self.raw;
        if message.len() != raw.size_bytes() {
            return Err(raw.wrong_size(message.len()));
        }
        raw.check()?;
        let mut writer = raw.writer.with_hints(
            self.newest.load(Ordering::Relaxed),
            self.candidate.load(Ordering::Relaxed),
        );
        let published = match raw.is_streamed().then(may_send) {
            Some(Some(_held)) => self.publish_and_send(&mut writer, message),
            _ => {
                let published = raw.node.publish(&mut writer, message);
                published.map(Generation::from_wide).map_err(|_| raw.busy())
            }
        };
        let (newest, candidate) = writer.hints();
        self.newest.store(newest, Ordering::Relaxed);
        self.candidate.store(candidate, Ordering::Relaxed);
        published
    }

    #[inline(never)]
    fn publish_and_send(&self, writer: &mut Writer, message: &[u8]) -> Result<Generation, Error> {
        let mut looks = 0;
        while self.sending.swap(true, Ordering::Acquire) {
            looks += 1;
            if looks == PORT_LOOKS {
                let published = self.raw.node.publish(writer, message);
                return published.map(Generation::from_wide).map_err(|_| self.raw.busy());
            }
            spin_loop();
        }
        let published = self.raw.publish_and_send(writer, message);
        self.sending.store(false, Ordering::Release);
        published
    }

    /// What does not depend on sharing.
    pub fn raw(&self) -> &RawPublication {
        &self.raw
    }
}
