//! Following a node.
//!
//! A subscription is a cursor: the generation that it last copied. Whether
//! there is anything new is one load; copying is one look at the ring. It knows
//! nothing of other subscriptions, and publishers know nothing of it, unless it
//! sleeps.
//!
//! It is a real file descriptor too (`AsFd`), for poll(2), epoll, tokio and
//! mio: readable while there is something to copy. One that never asks for its
//! descriptor pays nothing for it. `subscription/readable.rs` says what holds of
//! the descriptor.

#![allow(unsafe_code)]

mod readable;
mod streaming;

use std::fmt;
use std::marker::PhantomData;
use std::mem::MaybeUninit;
use std::ops::{Deref, DerefMut};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use zerocopy::IntoBytes;

use crate::clock::now_us;
use crate::descriptor::Descriptor;
use crate::error::Error;
use crate::generation::Generation;
use crate::interval::Pace;
use crate::link::Waiting;
use crate::node::{Node, Role};
use crate::protocol::Subject;
use crate::ring::Taken;
use crate::session::{Followed, Session};
use crate::stream::reader::Reader;
use crate::stream_subscription::StreamOptions;
use crate::topic::{Instance, Metadata, Priority, Topic};

/// A subscription to a topic whose layout is known at run time only. What it
/// copies is bytes.
#[derive(Debug)]
pub struct RawSubscription {
    /// None until the topic is described.
    node: Option<Arc<Node>>,
    /// The generation that was copied last.
    cursor: u64,
    pace: Option<Pace>,
    descriptor: OnceLock<Descriptor>,
    lost: u64,
    last: Option<Copied>,
    /// The ring contradicts itself: nothing can be copied from it.
    is_corrupt: bool,
    waiting: Option<Arc<Waiting>>,
    /// How it asked to follow the stream, if it did.
    stream: Option<StreamOptions>,
    /// Its end of the stream: of every large topic's subscription, too. Before
    /// the session: it goes before the process's membership.
    reader: Option<Box<Reader>>,
    topic: String,
    instance: Instance,
    session: Session,
    handle: u32,
}

/// What is known of a message besides its bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Copied {
    /// How many messages were published up to it.
    pub generation: Generation,
    /// When it was published, in microseconds of CLOCK_MONOTONIC.
    pub publish_time_us: u64,
    /// The process that published it, as the broker numbers them.
    pub peer: u16,
}

impl RawSubscription {
    /// Follows a topic by its name, whatever its layout is. Where nobody has
    /// described the topic yet, nothing is new until somebody has.
    ///
    /// # Errors
    ///
    /// [`Error::Refused`] for a name that is none; [`Error::NoBroker`].
    pub fn subscribe(session: &Session, topic: &str, instance: Instance) -> Result<Self, Error> {
        Self::follow(session, Subject::Named(topic.to_string()), instance, None)
    }

    /// Follows a topic that is described at run time, as the C door's are.
    ///
    /// # Errors
    ///
    /// As [`Subscription::subscribe`].
    pub fn subscribe_described(
        session: &Session,
        metadata: &Metadata,
        instance: Instance,
    ) -> Result<Self, Error> {
        Self::follow(session, Subject::Described(metadata.clone()), instance, None)
    }

    /// Follows a topic that somebody has described already; None where nobody
    /// has (PX4's optional topics, `ORB_DEFINE_OPTIONAL`: ENOENT).
    ///
    /// # Errors
    ///
    /// As [`RawSubscription::subscribe`].
    #[doc(alias = "ORB_DEFINE_OPTIONAL")]
    pub fn subscribe_optional(
        session: &Session,
        topic: &str,
        instance: Instance,
    ) -> Result<Option<Self>, Error> {
        match session.describe(topic) {
            Ok(metadata) => {
                Self::follow(session, Subject::Named(metadata.name.into()), instance, None)
                    .map(Some)
            }
            Err(Error::NoNode { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    pub(crate) fn follow(
        session: &Session,
        subject: Subject,
        instance: Instance,
        stream: Option<StreamOptions>,
    ) -> Result<Self, Error> {
        let topic = subject.name().to_string();
        let (handle, followed) = session.subscribe(subject, instance)?;
        fail_point!("subscribe.mapped");
        let (node, waiting) = match followed {
            Followed::Node(node) => (Some(node), None),
            Followed::Waiting(waiting) => (None, Some(waiting)),
        };
        let mut subscription = Self {
            cursor: node.as_ref().map_or(0, |node| node.cursor_of_newcomer()),
            node,
            pace: None,
            descriptor: OnceLock::new(),
            lost: 0,
            last: None,
            is_corrupt: false,
            waiting,
            stream,
            reader: None,
            topic,
            instance,
            session: session.clone(),
            handle,
        };
        if let Some(node) = subscription.node.clone() {
            subscription.open_reader(&node)?;
        }
        Ok(subscription)
    }

    /// Whether there is anything that was not copied yet, and its interval, if
    /// it has one, is over. Stays true until it is copied.
    #[doc(alias = "orb_check")]
    #[inline]
    pub fn updated(&mut self) -> bool {
        let Some(node) = &self.node else { return self.updated_once_described() };
        let has_newer = node.has_newer(self.cursor);
        if has_newer && self.pace.is_none() && self.reader.is_none() && !self.is_corrupt {
            return true;
        }
        if !has_newer && self.descriptor.get().is_none() {
            return false;
        }
        self.updated_with_care(has_newer)
    }

    /// As `updated`, for a subscription with an interval, a descriptor or a stream.
    #[inline(never)]
    fn updated_with_care(&mut self, has_newer: bool) -> bool {
        let is_there = |it: &mut Self| it.reader.is_none() || it.look_ahead(it.skips());
        let updated = has_newer && !self.is_corrupt && self.is_due() && is_there(self);
        if !updated {
            self.settle_if_need_be();
        }
        updated
    }

    #[cold]
    fn updated_once_described(&mut self) -> bool {
        matches!(self.attach(), Ok(true)) && self.updated()
    }

    fn is_due(&self) -> bool {
        self.pace.is_none_or(|pace| now_us() >= pace.due_us())
    }

    /// Goes from waiting for the topic to following its node, if it is there.
    pub(crate) fn attach(&mut self) -> Result<bool, Error> {
        let Some(waiting) = self.waiting.clone().filter(|waiting| waiting.is_over()) else {
            return Ok(self.node.is_some());
        };
        let node = self.session.node(&self.topic, self.instance, Role::Subscriber, None)?;
        if let Some(descriptor) = self.descriptor.get() {
            descriptor.attach(&node)?;
            descriptor.stop_waiting(&waiting);
        }
        // The node was made after the subscription, and so was all that was
        // ever published on it.
        self.cursor = node.identity.base;
        self.open_reader(&node)?;
        self.node = Some(node);
        self.waiting = None;
        Ok(true)
    }

    /// Copies the next message into `message`, which takes its bytes; the last
    /// one again if nothing is new. False if nothing was ever published.
    #[doc(alias = "orb_copy")]
    pub fn copy(&mut self, message: &mut Vec<u8>) -> bool {
        if !matches!(self.attach(), Ok(true)) {
            return false;
        }
        let Some(node) = &self.node else { return false };
        let size_bytes = node.identity.metadata.layout.size_bytes as usize;
        message.clear();
        message.reserve(size_bytes);
        if !self.take_into(&mut message.spare_capacity_mut()[..size_bytes]) {
            return false;
        }
        // SAFETY: `take_into` said that it has written this many bytes.
        unsafe { message.set_len(size_bytes) };
        true
    }

    /// As [`RawSubscription::copy`], into memory of the layout's size that need
    /// not be initialised. True means that all of it was written; false also
    /// that its size is another.
    #[inline]
    pub fn copy_to(&mut self, into: &mut [MaybeUninit<u8>]) -> bool {
        if !matches!(self.attach(), Ok(true)) {
            return false;
        }
        let size_bytes = self.node.as_ref().map(|node| node.identity.metadata.layout.size_bytes);
        size_bytes == Some(into.len() as u32) && self.take_into(into)
    }

    /// Takes all that was published until now as copied, and loses nothing by
    /// it. False if nothing was ever published.
    pub fn skip(&mut self) -> bool {
        if !matches!(self.attach(), Ok(true)) {
            return false;
        }
        if self.reader.is_some() {
            self.skip_on_stream();
            return self.current().is_some();
        }
        let Some(node) = &self.node else { return false };
        self.cursor = node.newest(self.cursor);
        let was_published = self.cursor > node.identity.base;
        self.settle();
        was_published
    }

    /// Copies the next message into a buffer of the layout's size. True means
    /// that all of it was written.
    #[inline(always)]
    fn take_into(&mut self, into: &mut [MaybeUninit<u8>]) -> bool {
        if self.reader.is_some() {
            return self.take_from_stream(into);
        }
        let Some(node) = &self.node else { return false };
        let taken = match node.take(self.cursor, into) {
            Ok(Some(taken)) => taken,
            nothing => {
                self.is_corrupt = nothing.is_err();
                // Somebody else may have rung, and nothing is there to copy.
                self.settle();
                return false;
            }
        };
        let Taken { generation, lost, stamp } = taken;
        self.cursor = generation;
        self.last = Some(Copied {
            generation: Generation::from_wide(generation),
            publish_time_us: stamp.publish_time_us,
            peer: stamp.publisher as u16,
        });
        match &mut self.pace {
            // What an interval skips is not lost: nobody wanted it.
            Some(pace) => pace.copied(now_us()),
            None if lost > 0 => {
                self.lost += lost;
                node.count_lost(lost);
            }
            None => {}
        }
        if self.descriptor.get().is_some() {
            self.settle();
        }
        true
    }

    #[inline(never)]
    fn take_from_stream(&mut self, into: &mut [MaybeUninit<u8>]) -> bool {
        self.advance();
        match self.current() {
            Some(message) if message.len() == into.len() => {
                into.write_copy_of_slice(message);
                true
            }
            _ => false,
        }
    }

    /// What hinders it from ever being updated: the session is not this
    /// process's or has ended, or the node is broken.
    ///
    /// # Errors
    ///
    /// [`Error::Forked`], [`Error::Ended`], [`Error::CorruptNode`].
    pub fn check(&self) -> Result<(), Error> {
        self.session.check()?;
        let Some(node) = &self.node else { return Ok(()) };
        if node.has_ended() {
            return Err(self.session.ended());
        }
        if self.is_corrupt {
            let what = "its ring contradicts itself".into();
            return Err(Error::CorruptNode { path: node.name().into(), what });
        }
        node.check()
    }

    /// When the interval ends, if one is running.
    pub(crate) fn hold_off_until_us(&self) -> Option<u64> {
        self.pace.map(|pace| pace.due_us()).filter(|due_us| now_us() < *due_us)
    }

    /// Shows at most one update in this time; zero: all of them.
    ///
    /// A subscription with an interval loses nothing by it: what was published
    /// meanwhile is pending when the interval ends, and `poll` wakes then.
    #[doc(alias = "orb_set_interval")]
    pub fn set_interval(&mut self, interval: Duration) {
        let interval_us = u64::try_from(interval.as_micros()).unwrap_or(u64::MAX);
        self.pace = (interval_us > 0).then(|| Pace::new(interval_us));
        self.settle();
    }

    /// The least time between two updates; zero where none is set.
    #[doc(alias = "orb_get_interval")]
    pub fn interval(&self) -> Duration {
        Duration::from_micros(self.pace.map_or(0, |pace| pace.interval_us))
    }

    /// Messages that were overwritten before this subscription copied them.
    pub fn lost(&self) -> u64 {
        self.lost + self.reader.as_ref().map_or(0, |reader| reader.lost())
    }

    /// The generation that was copied last; that before the pending one where
    /// nothing was copied yet.
    pub fn generation(&self) -> Generation {
        Generation::from_wide(self.cursor)
    }

    /// What is known of the message that was copied last.
    pub fn last_copied(&self) -> Option<Copied> {
        self.last
    }

    /// Messages that were published and not copied yet, those included that
    /// are overwritten already and will count as lost.
    pub fn pending(&self) -> u64 {
        self.node.as_ref().map_or(0, |node| node.newest(self.cursor).saturating_sub(self.cursor))
    }

    /// When the newest message was published, in microseconds of
    /// CLOCK_MONOTONIC. None if nothing ever was.
    #[doc(alias = "orb_stat")]
    pub fn last_publish_time_us(&self) -> Option<u64> {
        self.node.as_ref()?.newest_stamp().map(|stamp| stamp.publish_time_us)
    }

    /// The instance's priority: that of its newest publisher.
    #[doc(alias = "orb_priority")]
    pub fn priority(&self) -> Priority {
        self.node.as_ref().map(|node| node.priority()).unwrap_or_default()
    }

    /// Whether the instance has a publisher.
    pub fn advertised(&mut self) -> bool {
        matches!(self.attach(), Ok(true))
            && self.node.as_ref().is_some_and(|node| node.publishers() > 0)
    }

    /// Whether the system has ended. What was published can still be copied.
    pub fn has_ended(&self) -> bool {
        self.session.has_ended() || self.node.as_ref().is_some_and(|node| node.has_ended())
    }

    /// The topic's name.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// The instance that it follows.
    pub fn instance(&self) -> Instance {
        self.instance
    }

    /// The topic as its node describes it; None until somebody has described
    /// it.
    pub fn metadata(&mut self) -> Option<&Metadata> {
        let _ = self.attach();
        self.node.as_ref().map(|node| &node.identity.metadata)
    }
}

impl Drop for RawSubscription {
    fn drop(&mut self) {
        if self.session.is_forked() {
            // It is the parent's end of the stream.
            std::mem::forget(self.reader.take());
        }
        self.session.unsubscribe(self.handle);
    }
}

/// A subscription to topic `T`.
///
/// It is also a [`RawSubscription`], for whatever does not depend on the type.
pub struct Subscription<T: Topic> {
    raw: RawSubscription,
    topic: PhantomData<fn() -> T>,
}

impl<T: Topic> Subscription<T> {
    /// Follows instance 0. If anything was ever published there, the newest is
    /// pending.
    ///
    /// # Errors
    ///
    /// [`Error::LayoutMismatch`] while a live process uses the topic with
    /// another layout; [`Error::NoSpace`]; [`Error::NoBroker`].
    #[doc(alias = "orb_subscribe")]
    pub fn subscribe(session: &Session) -> Result<Self, Error> {
        Self::subscribe_instance(session, Instance::FIRST)
    }

    /// Follows one of the topic's instances, whether it was advertised or not.
    ///
    /// # Errors
    ///
    /// As [`Subscription::subscribe`].
    #[doc(alias = "orb_subscribe_multi")]
    pub fn subscribe_instance(session: &Session, instance: Instance) -> Result<Self, Error> {
        let subject = Subject::Described(T::METADATA.clone());
        let raw = RawSubscription::follow(session, subject, instance, None)?;
        Ok(Self { raw, topic: PhantomData })
    }

    /// Copies the next message: the oldest that was not copied and is still
    /// there, or the last one again. None if nothing was ever published.
    #[doc(alias = "orb_copy")]
    #[inline]
    pub fn copy(&mut self) -> Option<T::Message> {
        let mut message = MaybeUninit::<T::Message>::uninit();
        // SAFETY: the slice is the message's memory, as bytes that need not be
        // initialised, and `message` is not used while it lives.
        let into = unsafe {
            std::slice::from_raw_parts_mut(
                message.as_mut_ptr().cast::<MaybeUninit<u8>>(),
                size_of::<T::Message>(),
            )
        };
        if !self.raw.take_into(into) {
            return None;
        }
        // SAFETY: `take_into` said that it has written every byte, and
        // `FromBytes` says that any bytes are a message.
        Some(unsafe { message.assume_init() })
    }

    /// As [`Subscription::copy`], into a message that is there already: for
    /// large ones, which Rust would otherwise move once or twice. False if
    /// nothing was ever published.
    #[inline]
    pub fn copy_into(&mut self, message: &mut T::Message) -> bool {
        let bytes = message.as_mut_bytes();
        // SAFETY: initialised bytes are seen as ones that need not be, and
        // `take_into` writes nothing else but bytes.
        let into = unsafe { &mut *(std::ptr::from_mut(bytes) as *mut [MaybeUninit<u8>]) };
        self.raw.take_into(into)
    }

    /// Copies the next message if there is anything new.
    #[inline]
    pub fn update(&mut self) -> Option<T::Message> {
        if self.raw.updated() { self.copy() } else { None }
    }
}

impl<T: Topic> Deref for Subscription<T> {
    type Target = RawSubscription;
    fn deref(&self) -> &RawSubscription {
        &self.raw
    }
}

impl<T: Topic> DerefMut for Subscription<T> {
    fn deref_mut(&mut self) -> &mut RawSubscription {
        &mut self.raw
    }
}

impl<T: Topic> fmt::Debug for Subscription<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.raw.fmt(f)
    }
}
