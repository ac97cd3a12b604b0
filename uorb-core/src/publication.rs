//! Making a message the newest of its node.
//!
//! Advertising asks the broker for a place among the node's publishers;
//! publishing is a matter between this process and the node. Dropping a
//! publication unadvertises it; the node and its last message stay.

use std::fmt;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};
use std::sync::Arc;

use zerocopy::IntoBytes;

use crate::error::Error;
use crate::generation::Generation;
use crate::node::Node;
use crate::protocol::{Advertise, Claim};
use crate::ring::Writer;
use crate::session::Session;
use crate::topic::{Instance, Metadata, Priority, QueueLength, Topic};

/// How to advertise, where the usual way does not do.
#[derive(Clone, Copy, Debug)]
pub struct AdvertiseOptions {
    /// Which instance. The usual way is to share instance 0.
    pub claim: Claim,
    /// What subscribers choose by.
    pub priority: Priority,
    /// A longer queue than the .msg text asks for. Only the first publisher of
    /// a node has a say.
    pub queue_length: Option<QueueLength>,
}

impl Default for AdvertiseOptions {
    fn default() -> Self {
        Self {
            claim: Claim::Shared(Instance::FIRST),
            priority: Priority::DEFAULT,
            queue_length: None,
        }
    }
}

/// A place among the publishers of a topic whose layout is known at run time
/// only. What it publishes is bytes.
#[derive(Debug)]
pub struct RawPublication {
    node: Arc<Node>,
    writer: Writer,
    session: Session,
    handle: u32,
}

impl RawPublication {
    /// Becomes a publisher of the topic that `metadata` describes.
    ///
    /// # Errors
    ///
    /// [`Error::LayoutMismatch`] while a live process uses the topic with
    /// another layout; [`Error::Refused`] where all instances or publishers are
    /// taken; [`Error::NoSpace`] where shared memory is full.
    pub fn advertise(
        session: &Session,
        metadata: &Metadata,
        options: AdvertiseOptions,
    ) -> Result<Self, Error> {
        let AdvertiseOptions { claim, priority, queue_length } = options;
        let metadata = metadata.clone();
        let advertise = Advertise { handle: 0, metadata, claim, priority, queue_length };
        let (handle, node) = session.advertise(advertise)?;
        let writer = Writer::new(session.peer(), handle);
        Ok(Self { node, writer, session: session.clone(), handle })
    }

    /// Makes `message` the newest. It has exactly the bytes of the layout.
    ///
    /// Returns the message's generation. Never waits for anybody, never
    /// allocates, and makes no system call unless a subscription sleeps.
    ///
    /// # Errors
    ///
    /// [`Error::Ended`] after `uorb stop`, [`Error::Forked`] in the child of a
    /// fork, [`Error::WrongSize`].
    #[doc(alias = "orb_publish")]
    #[inline]
    pub fn publish(&mut self, message: &[u8]) -> Result<Generation, Error> {
        if message.len() != self.node.identity.metadata.layout.size_bytes as usize {
            return Err(self.wrong_size(message.len()));
        }
        self.session.check()?;
        if self.node.has_ended() {
            return Err(self.session.ended());
        }
        match self.node.publish(&mut self.writer, message) {
            Ok(generation) => Ok(Generation::from_wide(generation)),
            Err(_) => Err(Error::Busy { node: self.node.name() }),
        }
    }

    #[cold]
    fn wrong_size(&self, given_bytes: usize) -> Error {
        let metadata = &self.node.identity.metadata;
        Error::WrongSize {
            topic: metadata.name.to_string(),
            expected_bytes: metadata.layout.size_bytes as usize,
            given_bytes,
        }
    }

    /// The instance that it publishes on.
    pub fn instance(&self) -> Instance {
        self.node.identity.instance
    }

    /// The topic, as the node describes it.
    pub fn metadata(&self) -> &Metadata {
        &self.node.identity.metadata
    }

    /// How many messages the node keeps.
    #[doc(alias = "orb_get_queue_size")]
    pub fn queue_length(&self) -> QueueLength {
        self.node.queue_length().unwrap_or(QueueLength::ONE)
    }
}

impl Drop for RawPublication {
    fn drop(&mut self) {
        self.session.unadvertise(self.handle);
    }
}

/// A place among the publishers of topic `T`.
///
/// It is also a [`RawPublication`], for whatever does not depend on the type.
pub struct Publication<T: Topic> {
    raw: RawPublication,
    topic: PhantomData<fn(T)>,
}

impl<T: Topic> Publication<T> {
    /// Becomes a publisher of instance 0, beside any others.
    ///
    /// # Errors
    ///
    /// As [`RawPublication::advertise`].
    #[doc(alias = "orb_advertise")]
    pub fn advertise(session: &Session) -> Result<Self, Error> {
        Self::advertise_with(session, AdvertiseOptions::default())
    }

    /// Claims the lowest instance that nobody has advertised.
    ///
    /// # Errors
    ///
    /// As [`RawPublication::advertise`].
    #[doc(alias = "orb_advertise_multi")]
    pub fn advertise_multi(session: &Session, priority: Priority) -> Result<Self, Error> {
        let options = AdvertiseOptions { claim: Claim::Lowest, priority, ..Default::default() };
        Self::advertise_with(session, options)
    }

    /// Becomes a publisher of this instance, beside any others: what a replay
    /// needs.
    ///
    /// # Errors
    ///
    /// As [`RawPublication::advertise`].
    pub fn advertise_instance(session: &Session, instance: Instance) -> Result<Self, Error> {
        let options = AdvertiseOptions { claim: Claim::Shared(instance), ..Default::default() };
        Self::advertise_with(session, options)
    }

    /// Becomes a publisher in a way of one's own.
    ///
    /// # Errors
    ///
    /// As [`RawPublication::advertise`].
    pub fn advertise_with(session: &Session, options: AdvertiseOptions) -> Result<Self, Error> {
        let raw = RawPublication::advertise(session, T::METADATA, options)?;
        Ok(Self { raw, topic: PhantomData })
    }

    /// Makes `message` the newest. See [`RawPublication::publish`].
    ///
    /// # Errors
    ///
    /// As [`RawPublication::publish`].
    #[inline]
    pub fn publish(&mut self, message: &T::Message) -> Result<Generation, Error> {
        self.raw.publish(message.as_bytes())
    }
}

impl<T: Topic> Deref for Publication<T> {
    type Target = RawPublication;
    fn deref(&self) -> &RawPublication {
        &self.raw
    }
}

impl<T: Topic> DerefMut for Publication<T> {
    fn deref_mut(&mut self) -> &mut RawPublication {
        &mut self.raw
    }
}

impl<T: Topic> fmt::Debug for Publication<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.raw.fmt(f)
    }
}
