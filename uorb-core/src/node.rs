//! One topic instance in shared memory.
//!
//! A node is a file (see `node_file.rs`) that processes map: publishers the
//! ring writable, subscribers the doorbell, the broker all of it. Whoever maps
//! a part read-only cannot harm it: a stray write hits the memory protection,
//! not the bus.
//!
//! Publish is commit, then ring the bell; copy is one look at the ring. Neither
//! allocates, logs, waits, or speaks to the broker.

#![allow(unsafe_code)]

mod making;
mod streaming;

use std::fs::{File, OpenOptions};
use std::io;
use std::mem::MaybeUninit;
use std::ops::Range;
use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use crate::bell::{self, Bell};
use crate::clock::now_us;
use crate::error::Error;
use crate::mapping::{Access, Mapping, page_bytes};
use crate::node_file::{Identity, Sections, counts, doorbell, ring_section};
use crate::ring::{Busy, Corrupt, PEER_MAX, PUBLISHERS_MAX, Ring, Stamp, Taken, Writer};
use crate::sync::{AtomicU64, Ordering};
use crate::system::System;
use crate::topic::{Instance, Priority, QueueLength};

pub use making::base_of;
pub use streaming::{Foreigners, StreamEntry, StreamStatus};

/// What a process does with a node, and so what it may write.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Role {
    /// Looks, as `uorb top` does: writes nothing.
    Observer,
    /// Follows: writes the doorbell.
    Subscriber,
    /// Publishes: writes the ring.
    Publisher,
    /// The broker: writes everything.
    Broker,
}

impl Role {
    fn access(self, writers: &[Self]) -> Access {
        if writers.contains(&self) { Access::ReadWrite } else { Access::ReadOnly }
    }

    fn may_copy(self) -> bool {
        matches!(self, Self::Subscriber | Self::Broker)
    }
}

/// How many subscriptions share one open bell. The kernel lets one open file
/// reach 500 epoll instances that are nested in others, as tokio nests them;
/// opening the path again makes room for as many more.
const DESCRIPTORS_PER_BELL: usize = 400;

/// A node as this process has it mapped.
#[derive(Debug)]
pub struct Node {
    /// Who it is.
    pub identity: Identity,
    role: Role,
    sections: Sections,
    counts: Mapping,
    doorbell: Mapping,
    /// Only of a large topic, and only for those who copy or keep its messages.
    last: Option<Mapping>,
    ring: OnceLock<MappedRing>,
    /// Kept until the ring is mapped, which is when there is one.
    file: Mutex<Option<File>>,
    bell_path: PathBuf,
    bells: Mutex<Vec<Arc<Bell>>>,
}

/// The ring section, once it is there.
#[derive(Debug)]
struct MappedRing {
    ring: Ring<'static>,
    rung: &'static AtomicU64,
    ports: &'static [AtomicU64],
    next_port: &'static AtomicU64,
    /// What rings for this publisher. Subscribers and observers have none.
    bell: Option<Arc<Bell>>,
    /// What all these point into.
    _mapping: Mapping,
}

/// One publisher of a node, as the broker has written it into the counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PublisherEntry {
    /// The process.
    pub peer: u16,
    /// Which of the process's handles.
    pub handle: u32,
    /// What it was advertised with.
    pub priority: Priority,
}

impl PublisherEntry {
    fn to_word(self) -> u64 {
        u64::from(self.handle) << 32 | u64::from(self.priority.0) << 16 | u64::from(self.peer)
    }

    fn from_word(word: u64) -> Option<Self> {
        let (peer, handle) = (word as u16, (word >> 32) as u32);
        (peer != 0).then_some(Self { peer, handle, priority: Priority((word >> 16) as u8) })
    }
}

/// Why a node is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// Its system has ended.
    System = 1,
    /// A node of another layout has taken its place.
    GaveWay = 2,
}

/// What everybody may know of a node at one moment.
#[derive(Clone, Debug)]
pub struct NodeStatus {
    /// Messages published so far.
    pub published: u64,
    /// Messages that subscriptions have lost. A killed reader's last addition
    /// may be missing.
    pub lost: u64,
    /// The publishers.
    pub publishers: Vec<PublisherEntry>,
    /// The number of subscriptions.
    pub subscribers: u64,
    /// The messages that the node keeps; None before its first publisher.
    pub queue_length: Option<QueueLength>,
    /// When the newest message was published, and by which peer and handle.
    pub newest: Option<(u64, u16, u32)>,
}

impl Node {
    /// Opens a node for what `role` does with it.
    ///
    /// # Errors
    ///
    /// [`Error::NoNode`] where there is none, [`Error::CorruptNode`] and
    /// [`Error::NodeVersion`] where the file is not one of ours.
    pub fn open(
        system: &System,
        topic: &str,
        instance: Instance,
        role: Role,
    ) -> Result<Self, Error> {
        let path = system.node(topic, instance);
        let file = OpenOptions::new()
            .read(true)
            .write(role != Role::Observer)
            .custom_flags(libc::O_CLOEXEC | libc::O_NOFOLLOW)
            .open(&path)
            .map_err(|error| match error.kind() {
                io::ErrorKind::NotFound => Error::NoNode { topic: topic.into(), instance },
                _ => Error::io("open", &path, error),
            })?;
        let (identity, sections) = Identity::read(&file, &path)?;
        if identity.metadata.name != topic || identity.instance != instance {
            let what = "it says that it is another node".into();
            return Err(Error::CorruptNode { path, what });
        }
        let node = Self::map(system, identity, sections, file, role)?;
        if role == Role::Publisher && node.mapped_ring()?.is_none() {
            let what = "it has no ring, though the broker has admitted a publisher".into();
            return Err(Error::CorruptNode { path, what });
        }
        Ok(node)
    }

    /// Maps what is there before the first publisher: counts and doorbell.
    fn map(
        system: &System,
        identity: Identity,
        sections: Sections,
        file: File,
        role: Role,
    ) -> Result<Self, Error> {
        let path = system.node(&identity.metadata.name, identity.instance);
        let length = file.metadata().map_err(|error| Error::io("look at", &path, error))?.len();
        if length < sections.ring as u64 {
            return Err(Error::CorruptNode { path, what: "it is cut off".into() });
        }
        let map = |section: Range<usize>, access| {
            Mapping::new(&file, section, access)
                .map_err(|errno| Error::io("map", &path, errno.into()))
        };
        let page = |start| start..start + page_bytes();
        let has_last = sections.last < sections.ring && role.may_copy();
        let last = has_last
            .then(|| map(sections.last..sections.ring, role.access(&[Role::Broker])))
            .transpose()?;
        let doorbell_access = role.access(&[Role::Subscriber, Role::Broker]);
        Ok(Self {
            counts: map(page(sections.counts), role.access(&[Role::Broker]))?,
            doorbell: map(page(sections.doorbell), doorbell_access)?,
            last,
            ring: OnceLock::new(),
            bell_path: system.bell(&identity.metadata.name, identity.instance),
            bells: Mutex::new(Vec::new()),
            file: Mutex::new(Some(file)),
            identity,
            role,
            sections,
        })
    }

    /// The ring, if the node has one yet. That it cannot be mapped is what
    /// `check` tells.
    #[inline]
    fn ring(&self) -> Option<&MappedRing> {
        self.ring.get().or_else(|| self.mapped_ring().ok()?)
    }

    /// The ring, mapped on first sight: once in the life of a handle.
    #[cold]
    fn mapped_ring(&self) -> Result<Option<&MappedRing>, Error> {
        if let Some(ring) = self.ring.get() {
            return Ok(Some(ring));
        }
        // Pairs with the broker's store in `admit`: whoever sees a length also
        // sees the ring that was formatted for it.
        let length = self.counts.words()[counts::QUEUE_LENGTH].load(Ordering::SeqCst);
        if length == 0 {
            return Ok(None);
        }
        let path = || PathBuf::from(self.name());
        let corrupt = |what: &str| Error::CorruptNode { path: path(), what: what.into() };
        let queue_length = u32::try_from(length).ok().and_then(QueueLength::new);
        let queue_length = queue_length.ok_or_else(|| corrupt("its queue length is none"))?;

        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(open) = &*file {
            let bytes = self.identity.file_bytes(self.sections, queue_length);
            let found = open.metadata().map_err(|error| Error::io("look at", &path(), error))?;
            if found.len() < bytes as u64 {
                return Err(corrupt("its ring is cut off"));
            }
            let ring = self.ring_in(open, queue_length, bytes)?;
            // Two threads may come here; the lock lets one map, and the other
            // finds the ring there.
            let _ = self.ring.set(ring);
            *file = None;
        }
        Ok(self.ring.get())
    }

    fn ring_in(
        &self,
        file: &File,
        queue_length: QueueLength,
        file_bytes: usize,
    ) -> Result<MappedRing, Error> {
        let access = self.role.access(&[Role::Publisher, Role::Broker]);
        let mapping = Mapping::new(file, self.sections.ring..file_bytes, access)
            .map_err(|errno| Error::io("map", self.name().as_ref(), errno.into()))?;
        // SAFETY: the words live as long as the mapping, which `MappedRing`
        // keeps beside them and drops together with them; nothing hands them
        // out for longer than a borrow of the node.
        let words: &'static [AtomicU64] = unsafe { &*std::ptr::from_ref(mapping.words()) };
        let geometry = self.identity.geometry(queue_length);
        let tables = &words[ring_section::TABLES..][..geometry.words()];
        Ok(MappedRing {
            ring: Ring::new(tables, geometry, self.identity.base),
            rung: &words[ring_section::RUNG],
            ports: &words[ring_section::PORTS..ring_section::TABLES],
            next_port: &words[ring_section::NEXT_PORT],
            bell: (self.role == Role::Publisher).then(|| self.open_bell()).transpose()?,
            _mapping: mapping,
        })
    }

    /// The node's name as the file system has it: `sensor_accel0`.
    pub fn name(&self) -> String {
        format!("{}{}", self.identity.metadata.name, self.identity.instance)
    }

    /// Publishes a message, as many bytes as the layout says: commits it to the
    /// ring, then rings the bell if anybody sleeps.
    #[inline]
    pub(crate) fn publish(&self, writer: &mut Writer, message: &[u8]) -> Result<u64, Busy> {
        let Some(mapped) = self.ring.get() else { return Err(Busy) };
        let generation = mapped.ring.publish(writer, now_us(), message)?;
        self.ring_if_asked(mapped);
        Ok(generation)
    }

    #[inline]
    fn ring_if_asked(&self, mapped: &MappedRing) {
        let asked = &self.doorbell.words()[doorbell::ASKED];
        bell::ring_if_asked(asked, mapped.rung, || {
            mapped.bell.as_ref().is_some_and(|bell| bell.ring())
        });
    }

    /// Whether anything newer than `cursor` was published.
    #[inline]
    pub(crate) fn has_newer(&self, cursor: u64) -> bool {
        self.ring().is_some_and(|mapped| mapped.ring.has_newer(cursor))
    }

    /// Copies what a subscription at `cursor` is to see next.
    #[inline(always)]
    pub(crate) fn take(
        &self,
        cursor: u64,
        into: &mut [MaybeUninit<u8>],
    ) -> Result<Option<Taken>, Corrupt> {
        let Some(mapped) = self.ring() else { return Ok(None) };
        mapped.ring.take(cursor, into)
    }

    /// Adds to the node's total of lost messages.
    #[cold]
    pub(crate) fn count_lost(&self, lost: u64) {
        self.doorbell.words()[doorbell::LOST].fetch_add(lost, Ordering::Relaxed);
    }

    /// Asks for the bell. Look at the ring once more before you sleep.
    pub(crate) fn ask(&self) {
        bell::ask(&self.doorbell.words()[doorbell::ASKED]);
    }

    /// What tells that a publisher has rung the bell since.
    pub(crate) fn rung(&self) -> u64 {
        self.ring().map_or(0, |mapped| mapped.rung.load(Ordering::Relaxed))
    }

    /// Where a new subscription begins: before the newest message, so that it
    /// is pending, if there is one.
    pub(crate) fn cursor_of_newcomer(&self) -> u64 {
        let base = self.identity.base;
        match self.ring() {
            Some(mapped) if !mapped.ring.is_empty() => mapped.ring.newest_of_all() - 1,
            _ => base,
        }
    }

    /// The newest generation; the base where nothing was ever published.
    pub(crate) fn newest(&self, known: u64) -> u64 {
        self.ring().map_or(self.identity.base, |mapped| mapped.ring.newest(known))
    }

    /// When the newest message was published, and by whom.
    pub(crate) fn newest_stamp(&self) -> Option<Stamp> {
        let mapped = self.ring()?;
        mapped.ring.newest_stamp(mapped.ring.newest_of_all()).ok()?
    }

    /// What can be wrong with a node that is open: its ring cannot be mapped.
    pub(crate) fn check(&self) -> Result<(), Error> {
        self.mapped_ring().map(|_| ())
    }

    /// Whether the system has ended, or the node gave way to another.
    #[inline]
    pub(crate) fn has_ended(&self) -> bool {
        self.counts.words()[counts::ENDED].load(Ordering::Relaxed) != 0
    }

    /// Why it has ended, if it has.
    pub fn ending(&self) -> Option<Ending> {
        match self.counts.words()[counts::ENDED].load(Ordering::SeqCst) {
            0 => None,
            word if word == Ending::GaveWay as u64 => Some(Ending::GaveWay),
            _ => Some(Ending::System),
        }
    }

    /// The number of publishers.
    pub fn publishers(&self) -> u64 {
        self.counts.words()[counts::PUBLISHERS].load(Ordering::Acquire)
    }

    /// The priority of the instance: that of its newest publisher.
    pub(crate) fn priority(&self) -> Priority {
        self.publisher_entries().last().map(|entry| entry.priority).unwrap_or_default()
    }

    fn publisher_entries(&self) -> Vec<PublisherEntry> {
        let words = &self.counts.words()[counts::ENTRIES..][..PUBLISHERS_MAX as usize];
        words
            .iter()
            .filter_map(|word| PublisherEntry::from_word(word.load(Ordering::Acquire)))
            .collect()
    }

    /// The messages that the node keeps; None before its first publisher.
    pub fn queue_length(&self) -> Option<QueueLength> {
        let length = self.counts.words()[counts::QUEUE_LENGTH].load(Ordering::Acquire);
        u32::try_from(length).ok().and_then(QueueLength::new)
    }

    /// What everybody may know of the node now.
    pub fn status(&self) -> NodeStatus {
        let base = self.identity.base;
        let newest = self.ring().map_or(base, |mapped| mapped.ring.newest_of_all());
        NodeStatus {
            published: newest - base,
            lost: self.doorbell.words()[doorbell::LOST].load(Ordering::Relaxed),
            publishers: self.publisher_entries(),
            subscribers: self.counts.words()[counts::SUBSCRIBERS].load(Ordering::Acquire),
            queue_length: self.queue_length(),
            newest: self.newest_stamp().map(|stamp| {
                let (peer, handle) = (stamp.publisher as u16, (stamp.publisher >> 16) as u32);
                (stamp.publish_time_us, peer, handle)
            }),
        }
    }

    /// The peers that hold slots now: who is in the middle of a publish, or died
    /// there and was not buried yet.
    pub fn slot_holders(&self) -> Vec<u16> {
        let claimed = self.ring().map(|mapped| mapped.ring.claimed()).unwrap_or_default();
        claimed.into_iter().map(|(_, owner)| owner as u16 & PEER_MAX).collect()
    }

    fn open_bell(&self) -> Result<Arc<Bell>, Error> {
        Bell::open(&self.bell_path)
            .map(Arc::new)
            .map_err(|error| Error::io("open the bell", &self.bell_path, error))
    }

    /// Wakes the subscriptions of this process, also where the bell has lost its
    /// path.
    pub(crate) fn ring_own_bells(&self) {
        for bell in self.bells.lock().unwrap_or_else(PoisonError::into_inner).iter() {
            bell.ring();
        }
    }

    /// A bell for one more epoll instance to register.
    pub(crate) fn bell_for_descriptor(&self) -> Result<Arc<Bell>, Error> {
        let mut bells = self.bells.lock().unwrap_or_else(PoisonError::into_inner);
        // One reference is ours, each other a registration.
        let with_room = bells.iter().find(|bell| Arc::strong_count(bell) <= DESCRIPTORS_PER_BELL);
        if let Some(bell) = with_room {
            return Ok(bell.clone());
        }
        let bell = self.open_bell()?;
        bells.push(bell.clone());
        Ok(bell)
    }
}
