//! Following a stream: every message, in order, without a copy.
//!
//! Beside what the node keeps, a stream subscription has a queue of its own. It
//! begins with the node's newest message and has every one from there on, in the
//! order of generations, whoever published it; what was overwritten before it
//! was received counts as lost.
//!
//! A streamed topic is not hard real time for its publishers: the first message
//! to a new follower maps its queue, which takes some tens of microseconds.

#![allow(unsafe_code)]

use std::fmt;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, RawFd};

use crate::error::Error;
use crate::protocol::Subject;
use crate::session::Session;
use crate::subscription::RawSubscription;
use crate::topic::{Instance, Topic};

/// How to follow a stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamOptions {
    /// How many messages the queue holds, at most [`crate::depth_max`]. None: as
    /// many as that. A full queue loses its oldest message.
    pub depth: Option<u32>,
    /// Whether a publisher's `try_publish` is to fail while the queue is full.
    /// `publish` overwrites all the same.
    pub back_pressure: bool,
}

/// A subscription to every message of topic `T`.
///
/// It is also a [`RawSubscription`], for whatever does not depend on the type:
/// `updated`, `lost`, its descriptor, [`crate::poll`].
pub struct StreamSubscription<T: Topic> {
    raw: RawSubscription,
    topic: PhantomData<fn() -> T>,
}

impl<T: Topic> StreamSubscription<T> {
    /// Follows instance 0, with the deepest queue that the topic's messages
    /// allow.
    ///
    /// # Errors
    ///
    /// As [`crate::Subscription::subscribe`]; [`Error::Stream`] where the stream
    /// cannot be followed: it has as many followers as it takes, or is another
    /// user's.
    pub fn subscribe(session: &Session) -> Result<Self, Error> {
        Self::subscribe_with(session, Instance::FIRST, StreamOptions::default())
    }

    /// Follows an instance in a way of one's own.
    ///
    /// # Errors
    ///
    /// As [`StreamSubscription::subscribe`].
    pub fn subscribe_with(
        session: &Session,
        instance: Instance,
        options: StreamOptions,
    ) -> Result<Self, Error> {
        let subject = Subject::Described(T::METADATA.clone());
        let raw = RawSubscription::follow(session, subject, instance, Some(options))?;
        Ok(Self { raw, topic: PhantomData })
    }

    /// The next message, borrowed where it lies, until the next call. None if
    /// nothing is new.
    #[allow(clippy::should_implement_trait)]
    pub fn update(&mut self) -> Option<&T::Message> {
        if !self.raw.updated() || !self.raw.advance() {
            return None;
        }
        let bytes = self.raw.current()?;
        let is_message = bytes.len() == size_of::<T::Message>()
            && bytes.as_ptr().cast::<T::Message>().is_aligned();
        assert!(is_message, "a message has the size and alignment of its type");
        // SAFETY: size and alignment are checked, any bytes are a message by
        // `FromBytes`, and they stay while they are borrowed: a message that
        // somebody has borrowed is not overwritten.
        Some(unsafe { &*bytes.as_ptr().cast() })
    }
}

impl RawSubscription {
    /// As [`StreamSubscription`], to a topic whose layout is known at run time
    /// only. `copy` copies every message.
    ///
    /// # Errors
    ///
    /// As [`StreamSubscription::subscribe`].
    pub fn subscribe_stream(
        session: &Session,
        topic: &str,
        instance: Instance,
        options: StreamOptions,
    ) -> Result<Self, Error> {
        Self::follow(session, Subject::Named(topic.to_string()), instance, Some(options))
    }

    /// The next message of a stream, borrowed where it lies, until the next call.
    /// None if nothing is new, or if it follows no stream.
    pub fn borrow_update(&mut self) -> Option<&[u8]> {
        if self.updated() && self.advance() { self.current() } else { None }
    }
}

impl<T: Topic> Deref for StreamSubscription<T> {
    type Target = RawSubscription;
    fn deref(&self) -> &RawSubscription {
        &self.raw
    }
}

impl<T: Topic> DerefMut for StreamSubscription<T> {
    fn deref_mut(&mut self) -> &mut RawSubscription {
        &mut self.raw
    }
}

impl<T: Topic> AsFd for StreamSubscription<T> {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.raw.as_fd()
    }
}

impl<T: Topic> AsRawFd for StreamSubscription<T> {
    fn as_raw_fd(&self) -> RawFd {
        self.raw.as_raw_fd()
    }
}

impl<T: Topic> fmt::Debug for StreamSubscription<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.raw.fmt(f)
    }
}
