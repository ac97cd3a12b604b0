//! Writing a message where it will be read.
//!
//! A loan is the memory of the next message. Where somebody follows the node's
//! stream, and always for a large topic, it is memory of the stream, which is
//! handed on without a copy. Else it is private memory of the publication. An
//! ordinary topic's node gets its copy, of at most 64 KiB, in either case.

#![allow(unsafe_code)]

use std::fmt;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};

use zerocopy::IntoBytes;

use crate::error::Error;
use crate::generation::Generation;
use crate::publication::RawPublication;
use crate::stream::port::Loaned;
use crate::topic::Topic;

/// The memory of the next message, as bytes. They are those of some earlier
/// message, or zeros. Dropping it publishes nothing.
pub struct RawLoan<'p> {
    publication: &'p mut RawPublication,
    memory: Memory,
}

enum Memory {
    Stream(Loaned),
    /// Words, so that a message is aligned in it.
    Private(Vec<u64>),
    /// It was published.
    Gone,
}

impl<'p> RawLoan<'p> {
    pub(crate) fn new(
        publication: &'p mut RawPublication,
        loaned: Option<Loaned>,
        private: Vec<u64>,
    ) -> Self {
        let memory = loaned.map_or(Memory::Private(private), Memory::Stream);
        Self { publication, memory }
    }

    /// Makes the message the newest.
    ///
    /// # Errors
    ///
    /// As [`RawPublication::publish`].
    pub fn publish(mut self) -> Result<Generation, Error> {
        match std::mem::replace(&mut self.memory, Memory::Gone) {
            Memory::Stream(loaned) => self.publication.publish_loaned(loaned),
            Memory::Private(words) => {
                let published = self.publication.publish_private(words.as_bytes());
                self.publication.keep_private(words);
                published
            }
            Memory::Gone => unreachable!("publishing takes the loan"),
        }
    }

    /// Makes the message the newest, unless the queue of a stream with
    /// back-pressure is full. Then it is gone: loan again.
    ///
    /// # Errors
    ///
    /// As [`RawPublication::try_publish`].
    pub fn try_publish(self) -> Result<Generation, Error> {
        self.publication.check_queues()?;
        self.publish()
    }
}

impl Deref for RawLoan<'_> {
    type Target = [u8];
    fn deref(&self) -> &[u8] {
        let size_bytes = self.publication.size_bytes();
        match &self.memory {
            Memory::Stream(loaned) => loaned.bytes(),
            Memory::Private(words) => &words.as_bytes()[..size_bytes],
            Memory::Gone => &[],
        }
    }
}

impl DerefMut for RawLoan<'_> {
    fn deref_mut(&mut self) -> &mut [u8] {
        let size_bytes = self.publication.size_bytes();
        match &mut self.memory {
            Memory::Stream(loaned) => loaned.bytes_mut(),
            Memory::Private(words) => &mut words.as_mut_bytes()[..size_bytes],
            Memory::Gone => &mut [],
        }
    }
}

impl Drop for RawLoan<'_> {
    fn drop(&mut self) {
        match std::mem::replace(&mut self.memory, Memory::Gone) {
            Memory::Stream(loaned) => self.publication.give_back(loaned),
            Memory::Private(words) => self.publication.keep_private(words),
            Memory::Gone => {}
        }
    }
}

impl fmt::Debug for RawLoan<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RawLoan").field("bytes", &self.len()).finish_non_exhaustive()
    }
}

/// The memory of the next message of topic `T`.
///
/// ```no_run
/// # use uorb_core::{Publication, Session, topic};
/// topic! { pub struct Image = "image" { pub pixels: [u8; 640 * 480] } }
/// # fn main() -> Result<(), uorb_core::Error> {
/// let mut image = Publication::<Image>::advertise(&Session::connect()?)?;
/// let mut next = image.loan()?;
/// next.pixels[0] = 255; // in shared memory
/// next.publish()?;
/// # Ok(())
/// # }
/// ```
pub struct Loan<'p, T: Topic> {
    raw: RawLoan<'p>,
    topic: PhantomData<fn(T)>,
}

impl<'p, T: Topic> Loan<'p, T> {
    pub(crate) fn new(raw: RawLoan<'p>) -> Self {
        let is_message =
            raw.len() == size_of::<T::Message>() && raw.as_ptr().cast::<T::Message>().is_aligned();
        assert!(is_message, "a loan has the size and alignment of its message");
        Self { raw, topic: PhantomData }
    }

    /// Makes the message the newest.
    ///
    /// # Errors
    ///
    /// As [`RawPublication::publish`].
    pub fn publish(self) -> Result<Generation, Error> {
        self.raw.publish()
    }

    /// Makes the message the newest, unless the queue of a stream with
    /// back-pressure is full. Then it is gone: loan again.
    ///
    /// # Errors
    ///
    /// As [`RawPublication::try_publish`].
    pub fn try_publish(self) -> Result<Generation, Error> {
        self.raw.try_publish()
    }
}

impl<T: Topic> Deref for Loan<'_, T> {
    type Target = T::Message;
    fn deref(&self) -> &T::Message {
        // SAFETY: `new` has checked size and alignment, which do not change;
        // `FromBytes` says that any bytes are a message.
        unsafe { &*self.raw.as_ptr().cast() }
    }
}

impl<T: Topic> DerefMut for Loan<'_, T> {
    fn deref_mut(&mut self) -> &mut T::Message {
        // SAFETY: as in `deref`; `IntoBytes` says that any message is bytes.
        unsafe { &mut *self.raw.as_mut_ptr().cast() }
    }
}

impl<T: Topic> fmt::Debug for Loan<'_, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.raw.fmt(f)
    }
}
