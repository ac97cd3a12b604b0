//! Making a message the newest of its node.
//!
//! Advertising asks the broker for a place among the node's publishers;
//! publishing is a matter between this process and the node. Dropping a
//! publication unadvertises it; the node and its last message stay.

mod shared;

use std::fmt;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};
use std::sync::Arc;

pub use shared::SharedPublication;
use zerocopy::IntoBytes;

use crate::error::Error;
use crate::generation::Generation;
use crate::loan::{Loan, RawLoan};
use crate::node::Node;
use crate::protocol::{Advertise, Claim};
use crate::ring::Writer;
use crate::session::Session;
use crate::stream::port::{Loaned, Port, PortCell, Streamable};
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
    /// Before the session: a port goes before the process's membership.
    port: Arc<PortCell>,
    /// What a loan is written into where nobody follows the stream.
    private: Vec<u64>,
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
        let publication = Self {
            writer: Writer::new(session.peer(), handle),
            port: session.port(handle, &node).inspect_err(|_| session.unadvertise(handle))?,
            node,
            private: Vec::new(),
            session: session.clone(),
            handle,
        };
        Ok(publication)
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
        if message.len() != self.size_bytes() {
            return Err(self.wrong_size(message.len()));
        }
        self.check()?;
        if self.is_streamed() {
            return self.with_writer(|raw, writer| raw.publish_and_send(writer, message));
        }
        let published = self.node.publish(&mut self.writer, message);
        published.map(Generation::from_wide).map_err(|_| self.busy())
    }

    /// As [`RawPublication::publish`], unless the queue of a stream subscription
    /// that asked for back-pressure is full: then nothing is published, neither
    /// in the node nor on the stream.
    ///
    /// # Errors
    ///
    /// [`Error::QueueFull`], which names the slow process; else as
    /// [`RawPublication::publish`].
    pub fn try_publish(&mut self, message: &[u8]) -> Result<Generation, Error> {
        self.check_queues()?;
        self.publish(message)
    }

    /// The memory of the next message, to be written in place.
    ///
    /// # Errors
    ///
    /// As [`RawPublication::publish`]; [`Error::NoSpace`] where shared memory has
    /// no room for one more large message.
    #[inline]
    pub fn loan(&mut self) -> Result<RawLoan<'_>, Error> {
        self.check()?;
        let loaned = if self.is_streamed() { self.loan_from_stream()? } else { None };
        let mut private = std::mem::take(&mut self.private);
        if loaned.is_none() {
            private.resize(self.size_bytes().div_ceil(size_of::<u64>()), 0);
        }
        Ok(RawLoan::new(self, loaned, private))
    }

    #[inline]
    fn check(&self) -> Result<(), Error> {
        self.session.check()?;
        if self.node.has_ended() { Err(self.session.ended()) } else { Ok(()) }
    }

    #[inline]
    fn is_streamed(&self) -> bool {
        self.node.is_streamed() || self.is_large()
    }

    fn is_large(&self) -> bool {
        self.node.identity.metadata.layout.is_large()
    }

    pub(crate) fn size_bytes(&self) -> usize {
        self.node.identity.metadata.layout.size_bytes as usize
    }

    pub(crate) fn check_queues(&self) -> Result<(), Error> {
        let Some(full) = self.node.full_stream(self.writer.newest()) else { return Ok(()) };
        let process = self.session.describe_process(full.peer);
        Err(Error::QueueFull { node: self.node.name(), process, depth: full.depth })
    }

    fn with_writer<R>(&mut self, publish: impl FnOnce(&Self, &mut Writer) -> R) -> R {
        let mut writer = self.writer;
        let published = publish(self, &mut writer);
        self.writer = writer;
        published
    }

    /// Somebody follows the stream: the message goes there too.
    #[inline(never)]
    fn publish_and_send(&self, writer: &mut Writer, message: &[u8]) -> Result<Generation, Error> {
        let mut loaned = self.loan_from_stream()?;
        if let Some(loaned) = &mut loaned {
            loaned.bytes_mut().copy_from_slice(message);
        }
        self.commit_and_send(writer, Some(message), loaned)
    }

    #[inline]
    pub(crate) fn publish_loaned(&mut self, loaned: Loaned) -> Result<Generation, Error> {
        match self.check() {
            Ok(()) => {
                self.with_writer(|raw, writer| raw.commit_and_send(writer, None, Some(loaned)))
            }
            Err(error) => {
                self.give_back(loaned);
                Err(error)
            }
        }
    }

    /// Gives memory of the stream back that is not to be published.
    pub(crate) fn give_back(&self, loaned: Loaned) {
        if let Some(port) = self.port.get() {
            port.give_back(loaned);
        }
    }

    pub(crate) fn publish_private(&mut self, padded: &[u8]) -> Result<Generation, Error> {
        self.publish(&padded[..self.size_bytes()])
    }

    /// Keeps the memory of a loan for the next one.
    pub(crate) fn keep_private(&mut self, words: Vec<u64>) {
        self.private = words;
    }

    /// Memory of the stream. None where its port is not open yet: the node has
    /// the message then, and whoever follows the stream looks there, too.
    #[inline]
    fn loan_from_stream(&self) -> Result<Option<Loaned>, Error> {
        match (self.port.get().map(Port::loan), self.is_large()) {
            (Some(Ok(loaned)), _) => Ok(Some(loaned)),
            // An ordinary message can do without: publishing does not fail
            // because somebody streams.
            (_, false) => Ok(None),
            (Some(Err(error)), true) => Err(error),
            (None, true) => Err(Error::stream(self.node.name(), "its port is not open")),
        }
    }

    #[inline]
    fn commit_and_send(
        &self,
        writer: &mut Writer,
        message: Option<&[u8]>,
        loaned: Option<Loaned>,
    ) -> Result<Generation, Error> {
        let port = self.port.get();
        let loaned = port.zip(loaned);
        let published = self.node.publish_and_send(writer, message, loaned);
        if let Some(port) = port {
            port.notify();
        }
        published.map(Generation::from_wide).map_err(|_| self.busy())
    }

    #[cold]
    fn busy(&self) -> Error {
        Error::Busy { node: self.node.name() }
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
        if self.session.is_forked() {
            // It is the parent's port.
            std::mem::forget(self.port.clone());
            return;
        }
        // Before the broker answers: the session's thread looks after it then.
        let (cell, node) = (self.port.clone(), self.node.clone());
        let port = Streamable { cell, node, publisher: (self.session.peer(), self.handle) };
        self.session.linger(port, self.writer.newest());
        self.session.unadvertise(self.handle);
        fail_point!("unadvertise.done");
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

    /// See [`RawPublication::try_publish`].
    ///
    /// # Errors
    ///
    /// As [`RawPublication::try_publish`].
    pub fn try_publish(&mut self, message: &T::Message) -> Result<Generation, Error> {
        self.raw.try_publish(message.as_bytes())
    }

    /// The memory of the next message, to be written in place: without a copy
    /// where somebody follows the stream, and always for a large topic.
    ///
    /// # Errors
    ///
    /// As [`RawPublication::loan`].
    pub fn loan(&mut self) -> Result<Loan<'_, T>, Error> {
        self.raw.loan().map(Loan::new)
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
