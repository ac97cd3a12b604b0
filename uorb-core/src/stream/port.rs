//! A publisher's port to the stream of its node.
//!
//! It is opened off the road of any publish: by the session's thread when
//! somebody begins to follow the stream, or in `advertise` when somebody already
//! does. A publish then loans a message's memory, commits to the node, and
//! sends.

use std::collections::HashSet;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::port_factory::PortFactory;

use super::room::{check_room, mapping_of, no_room, populate};
use super::{Events, Ipc, LOANED_MAX, Member, UorbHeader, port_bytes, slots, stride_bytes};
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
            port.update_connections();
        } else {
            let port = Port::open(member, system, node)?;
            let (peer, handle) = publisher;
            if !node.enter_port(peer, handle, port.publisher.id().value()) {
                return Err(Error::stream(node.name(), "all its ports are taken"));
            }
            let _ = self.port.set(port);
        }
        // Whoever waits for the port looks again.
        node.ring_for_publisher();
        Ok(())
    }
}

#[derive(Debug)]
pub(crate) struct Port {
    publisher: Publisher<Ipc, [u8], UorbHeader>,
    notifier: Notifier<Ipc>,
    events: Events,
    size_bytes: usize,
    name: String,
    /// Where the messages are whose pages are taken. None: of all of them.
    populated: Option<Mutex<HashSet<usize>>>,
}

impl Port {
    fn open(member: &Member, system: &System, node: &Node) -> Result<Self, Error> {
        let (metadata, name) = (&node.identity.metadata, node.name());
        let layout = &metadata.layout;
        check_room(&name, port_bytes(layout))?;
        let (stream, events) = super::open(member, system, metadata, node.identity.instance, false)
            .map_err(|what| Error::stream(&name, what))?;
        let slots = slots(layout.size_bytes);
        let publisher = stream
            .publisher_builder()
            .initial_max_slice_len(layout.size_bytes as usize)
            .max_loaned_samples(LOANED_MAX)
            .override_sample_preallocation(move |_| slots)
            .create()
            .map_err(|why| Error::stream(&name, format!("no port: iceoryx2 says {why:?}")))?;
        let notifier = events
            .notifier_builder()
            .create()
            .map_err(|why| Error::stream(&name, format!("no notifier: iceoryx2 says {why:?}")))?;
        let port = Self {
            publisher,
            notifier,
            events,
            size_bytes: layout.size_bytes as usize,
            populated: layout.is_large().then(Mutex::default),
            name,
        };
        port.populate_beginning()?;
        Ok(port)
    }

    /// Takes the pages that iceoryx2 writes by itself, which are the headers,
    /// and for ordinary topics those of all messages.
    fn populate_beginning(&self) -> Result<(), Error> {
        // Not populated yet, and touched for its address: the room was checked.
        let mut first = self
            .publisher
            .loan_slice_uninit(self.size_bytes)
            .map_err(|why| Error::stream(&self.name, format!("no message: {why:?}")))?;
        let address = first.payload_mut().as_mut_ptr() as usize;
        let Some((start, end)) = mapping_of(address) else { return Ok(()) };
        if self.populated.is_none() {
            return self.take_pages(start, end);
        }
        let stride = stride_bytes(self.size_bytes as u32);
        let header = address - super::HEADERS_BYTES;
        self.take_pages(start, header)?;
        (header..end - super::HEADERS_BYTES)
            .step_by(stride)
            .try_for_each(|header| self.take_pages(header, header + super::HEADERS_BYTES))
    }

    fn take_pages(&self, start: usize, end: usize) -> Result<(), Error> {
        match populate(start, end) {
            Ok(true) => Ok(()),
            Ok(false) => Err(no_room(&self.name, (end - start) as u64)),
            Err(errno) => Err(Error::io("take memory for", self.name.as_ref(), errno.into())),
        }
    }

    /// The memory of the next message, with whatever was in it before.
    pub(crate) fn loan(&self) -> Result<Loaned, Error> {
        let mut sample = self.publisher.loan_slice_uninit(self.size_bytes).map_err(|why| {
            Error::stream(&self.name, format!("no memory for a message: iceoryx2 says {why:?}"))
        })?;
        if let Some(populated) = &self.populated {
            let address = sample.payload_mut().as_mut_ptr() as usize;
            let mut populated = populated.lock().unwrap_or_else(PoisonError::into_inner);
            if !populated.contains(&address) {
                self.take_pages(address, address + self.size_bytes)?;
                populated.insert(address);
            }
        }
        // SAFETY: the memory is a file's, which the kernel has filled with zeros
        // before anybody wrote there. Bytes have no invalid values.
        let sample = unsafe { sample.assume_init() };
        Ok(Loaned { sample })
    }

    /// Wakes foreign programs that wait for the stream, if there are any.
    pub(crate) fn notify(&self) {
        if self.events.dynamic_config().number_of_listeners() > 0 {
            let _ = self.notifier.notify();
        }
    }

    fn update_connections(&self) {
        // What cannot be told now is told at the next send.
        let _ = self.publisher.update_connections();
    }
}

/// The memory of a message that is being written.
#[derive(Debug)]
pub(crate) struct Loaned {
    sample: SampleMut<Ipc, [u8], UorbHeader>,
}

impl Loaned {
    pub(crate) fn bytes(&self) -> &[u8] {
        self.sample.payload()
    }

    pub(crate) fn bytes_mut(&mut self) -> &mut [u8] {
        self.sample.payload_mut()
    }

    /// Hands the message, which is committed to the node, to everybody who
    /// follows the stream. Whoever it does not reach finds it missing.
    pub(crate) fn send(mut self, generation: u64, stamp: Stamp) {
        *self.sample.user_header_mut() = UorbHeader {
            generation: generation as u32,
            publisher: u32::from(stamp.publisher as u16),
            publish_time_us: stamp.publish_time_us,
        };
        let _ = self.sample.send();
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
            loaned.send(generation, stamp);
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
        if !node.enter_port(BROKER, 0, port.publisher.id().value()) {
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
