//! A publisher's port to the stream of its node.
//!
//! It is opened off the road of any publish: by the session's thread when
//! somebody begins to follow the stream, or in `advertise` when somebody already
//! does. A publish then loans a message's memory, commits to the node, and
//! sends.

use std::mem::ManuallyDrop;
use std::ptr::NonNull;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::CallbackProgression;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::port_factory::PortFactory;

use super::room::{check_room, mapping_of, no_room, populate};
use super::unconnected::Unconnected;
use super::{Events, Ipc, LOANED_MAX, Member, Stream, UorbHeader, port_bytes, slots, stride_bytes};
use crate::error::Error;
use crate::node::Node;
use crate::ring::Stamp;
use crate::system::System;

/// Where a publication finds its port, once the session has opened it.
#[derive(Debug, Default)]
pub(crate) struct PortCell {
    port: OnceLock<Port>,
    /// Held while it is opened, by whichever thread does it.
    opening: Mutex<()>,
}

impl PortCell {
    /// The port, if there is one yet: one load.
    #[inline]
    pub(crate) fn get(&self) -> Option<&Port> {
        self.port.get()
    }

    /// Opens the port, if it is not open. Then tells subscriptions of it, and
    /// newcomers of the newest large message.
    pub(crate) fn open(
        &self,
        member: &Member,
        system: &System,
        node: &Node,
        publisher: (u16, u32),
    ) -> Result<(), Error> {
        let _opening = self.opening.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(port) = self.port.get() {
            // A newcomer is connected here and not in the middle of a publish:
            // this takes system calls, which a signal may interrupt there. And it
            // is to have the newest large message.
            port.update_connections();
        } else {
            let port = Port::open(member, system, node)?;
            fail_point!("port.opened");
            let (peer, handle) = publisher;
            if !node.enter_port(peer, handle, port.id) {
                return Err(Error::stream(node.name(), "all its ports are taken"));
            }
            let _ = self.port.set(port);
            fail_point!("port.entered");
        }
        // Whoever waits for the port looks again.
        node.ring_for_publisher();
        Ok(())
    }
}

#[derive(Debug)]
pub(crate) struct Port {
    ends: Mutex<Ends>,
    events: Events,
    size_bytes: usize,
    is_large: bool,
    name: String,
    id: u128,
}

/// What iceoryx2 wants used by one thread at a time.
#[derive(Debug)]
struct Ends {
    publisher: Publisher<Ipc, [u8], UorbHeader>,
    /// The subscribers that it has missed, and where they are looked for.
    unconnected: Unconnected,
    stream: Stream,
    notifier: Notifier<Ipc>,
    /// Of a large topic: where its messages begin, and which of them have their
    /// pages.
    first: usize,
    populated: Vec<bool>,
}

// SAFETY: the two ports and the messages loaned from them share counters that
// are not atomic, and nothing that belongs to a thread. All of them are reached
// under the mutex around this only: loaned messages are sent and given back
// there, too (see `Loaned`).
unsafe impl Send for Ends {}

impl Port {
    fn open(member: &Member, system: &System, node: &Node) -> Result<Self, Error> {
        let (metadata, name) = (&node.identity.metadata, node.name());
        let layout = &metadata.layout;
        check_room(&name, port_bytes(layout))?;
        let (stream, events) = super::open(member, system, metadata, node.identity.instance, false)
            .map_err(|what| Error::stream(&name, what))?;
        let slots = slots(layout.size_bytes);
        let unconnected = Unconnected::default();
        let publisher = stream
            .publisher_builder()
            .initial_max_slice_len(layout.size_bytes as usize)
            .max_loaned_samples(LOANED_MAX)
            .override_sample_preallocation(move |_| slots)
            .set_degradation_handler(unconnected.handler(|missed| missed.receiver_port_id))
            .create()
            .map_err(|why| Error::stream(&name, format!("no port: iceoryx2 says {why:?}")))?;
        let notifier = events
            .notifier_builder()
            .create()
            .map_err(|why| Error::stream(&name, format!("no notifier: iceoryx2 says {why:?}")))?;
        let port = Self {
            id: publisher.id().value(),
            ends: Mutex::new(Ends {
                publisher,
                unconnected,
                stream,
                notifier,
                first: 0,
                populated: Vec::new(),
            }),
            events,
            size_bytes: layout.size_bytes as usize,
            is_large: layout.is_large(),
            name,
        };
        port.populate_beginning(slots)?;
        Ok(port)
    }

    #[inline]
    fn ends(&self) -> MutexGuard<'_, Ends> {
        self.ends.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes the pages that iceoryx2 writes by itself, which are the headers,
    /// and for ordinary topics those of all messages.
    fn populate_beginning(&self, slots: usize) -> Result<(), Error> {
        let mut ends = self.ends();
        // Not populated yet, and touched for its address: the room was checked.
        let address = {
            let mut first = ends
                .publisher
                .loan_slice_uninit(self.size_bytes)
                .map_err(|why| Error::stream(&self.name, format!("no message: {why:?}")))?;
            first.payload_mut().as_mut_ptr() as usize
        };
        let Some((start, end)) = mapping_of(address) else {
            return Err(Error::stream(&self.name, "its memory is not mapped"));
        };
        if !self.is_large {
            return self.take_pages(start, end);
        }
        (ends.first, ends.populated) = (address, vec![false; slots]);
        self.take_pages(start, address)?;
        let headers = (address..end).step_by(stride_bytes(self.size_bytes as u32));
        headers
            .skip(1)
            .take(slots - 1)
            .try_for_each(|message| self.take_pages(message - super::HEADERS_BYTES, message))
    }

    fn take_pages(&self, start: usize, end: usize) -> Result<(), Error> {
        match populate(start, end) {
            Ok(true) => Ok(()),
            Ok(false) => Err(no_room(&self.name, (end - start) as u64)),
            Err(errno) => Err(Error::io("take memory for", self.name.as_ref(), errno.into())),
        }
    }

    /// The memory of the next message, with whatever was in it before.
    #[inline]
    pub(crate) fn loan(&self) -> Result<Loaned, Error> {
        let mut ends = self.ends();
        let mut sample = ends.publisher.loan_slice_uninit(self.size_bytes).map_err(|why| {
            Error::stream(&self.name, format!("no memory for a message: iceoryx2 says {why:?}"))
        })?;
        if self.is_large {
            let address = sample.payload_mut().as_mut_ptr() as usize;
            let slot = (address - ends.first) / stride_bytes(self.size_bytes as u32);
            if ends.populated.get(slot) != Some(&true) {
                self.take_pages(address, address + self.size_bytes)?;
                if let Some(populated) = ends.populated.get_mut(slot) {
                    *populated = true;
                }
            }
        }
        // SAFETY: the memory is a file's, which the kernel has filled with zeros
        // before anybody wrote there. Bytes have no invalid values.
        let mut sample = unsafe { sample.assume_init() };
        let bytes = NonNull::from(sample.payload_mut());
        Ok(Loaned { sample: ManuallyDrop::new(sample), bytes })
    }

    /// Hands a message, which is committed to the node, to everybody who follows
    /// the stream. Whoever it does not reach finds it missing.
    #[inline]
    pub(crate) fn send(&self, loaned: Loaned, generation: u64, stamp: Stamp) {
        let mut ends = self.ends();
        // Sending does this, too; but then the message has passed whom it missed.
        ends.connect();
        let mut sample = ManuallyDrop::into_inner(loaned.sample);
        *sample.user_header_mut() = UorbHeader {
            generation: generation as u32,
            publisher: u32::from(stamp.publisher as u16),
            publish_time_us: stamp.publish_time_us,
        };
        let _ = sample.send();
    }

    /// Takes a message back that is not to be sent.
    pub(crate) fn give_back(&self, loaned: Loaned) {
        let _ends = self.ends();
        drop(ManuallyDrop::into_inner(loaned.sample));
    }

    /// Wakes foreign programs that wait for the stream, if there are any.
    #[inline]
    pub(crate) fn notify(&self) {
        if self.events.dynamic_config().number_of_listeners() > 0 {
            let _ = self.ends().notifier.notify();
        }
    }

    fn update_connections(&self) {
        self.ends().connect();
    }
}

impl Ends {
    /// Connects the port to the subscribers that are new.
    #[inline]
    fn connect(&mut self) {
        // What fails is noted, or else is fatal to the message's sending, too.
        let _ = self.publisher.update_connections();
        if self.unconnected.any() {
            self.connect_again();
        }
    }

    #[cold]
    fn connect_again(&mut self) {
        let Self { publisher, unconnected, stream, .. } = self;
        let is_there = |port| {
            let mut is_there = false;
            stream.dynamic_config().list_subscribers(|subscriber| {
                is_there |= subscriber.subscriber_id.value() == port;
                CallbackProgression::Continue
            });
            is_there
        };
        while unconnected.any() {
            if unconnected.is_due(is_there) {
                // It comes and goes, and the publisher looks again.
                let subscriber = stream
                    .subscriber_builder()
                    .buffer_size(1)
                    .set_degradation_handler(Unconnected::default().handler(|_| 0))
                    .create();
                if subscriber.is_ok() {
                    unconnected.forget();
                }
                drop(subscriber);
                let _ = publisher.update_connections();
            } else if !unconnected.is_hopeful() {
                return;
            }
            std::hint::spin_loop();
        }
    }
}

/// The memory of a message that is being written. It goes back to its port by
/// `send` or `give_back`, under the port's lock.
#[derive(Debug)]
pub(crate) struct Loaned {
    sample: ManuallyDrop<SampleMut<Ipc, [u8], UorbHeader>>,
    /// The message in it. To ask the sample would count references to the port,
    /// and nobody holds its lock here.
    bytes: NonNull<[u8]>,
}

// SAFETY: what it shares with its port is touched by `send` and `give_back` only,
// which hold the port's lock; its bytes are its own.
unsafe impl Send for Loaned {}
// SAFETY: a shared reference gives nothing but the bytes.
unsafe impl Sync for Loaned {}

impl Loaned {
    pub(crate) fn bytes(&self) -> &[u8] {
        // SAFETY: the sample keeps the memory mapped, and nobody else has it: it is
        // given to another only when this one was sent or given back.
        unsafe { self.bytes.as_ref() }
    }

    pub(crate) fn bytes_mut(&mut self) -> &mut [u8] {
        // SAFETY: as above, and this reference is exclusive.
        unsafe { self.bytes.as_mut() }
    }
}

/// The broker's port: it sends what a publisher has committed and did not live
/// to send.
#[derive(Debug)]
pub struct Executor {
    port: Port,
}

/// In the table of ports, the broker: no process has this number.
const BROKER: u16 = u16::MAX;

impl Executor {
    /// Sends what a dead process has left unsent on a node, as long as it still
    /// has its slots there. `executor` is made when it is needed first.
    ///
    /// # Errors
    ///
    /// What hinders it from having a port.
    pub fn send_for(
        executor: &mut Option<Self>,
        member: &Member,
        system: &System,
        node: &Node,
        dead: u16,
    ) -> Result<(), Error> {
        // A large message was nowhere but in memory of the dead.
        if node.identity.metadata.layout.is_large() || !node.is_streamed() {
            return Ok(());
        }
        for (generation, stamp, message) in node.unsent_of(dead) {
            let Self { port } = match executor {
                Some(executor) => executor,
                None => executor.insert(Self::new(member, system, node)?),
            };
            let mut loaned = port.loan()?;
            loaned.bytes_mut().copy_from_slice(&message);
            port.send(loaned, generation, stamp);
        }
        Ok(())
    }

    /// Lets go of followers that are gone.
    pub fn tidy(&self) {
        self.port.update_connections();
    }

    fn new(member: &Member, system: &System, node: &Node) -> Result<Self, Error> {
        let port = Port::open(member, system, node)?;
        // One of a broker before us.
        node.leave_ports_of(BROKER);
        if !node.enter_port(BROKER, 0, port.id) {
            return Err(Error::stream(node.name(), "all its ports are taken"));
        }
        Ok(Self { port })
    }
}

/// A publication's port, as the session keeps track of it.
#[derive(Clone, Debug)]
pub(crate) struct Streamable {
    pub(crate) cell: Arc<PortCell>,
    pub(crate) node: Arc<Node>,
    pub(crate) publisher: (u16, u32),
}
