//! A stream subscription's end of the stream, merged with its node.
//!
//! The reader is asked for the message after a given generation. It looks for it
//! on the stream; then in the node, where every message is committed before it
//! is sent: an ordinary topic's node keeps the newest, and the slot of one that
//! is still being sent. What is in none of these places is lost, and is counted.
//!
//! Each publisher sends its messages in order, but one publisher's may overtake
//! another's. A message that came too early is put aside until its turn.

use std::collections::BTreeMap;
use std::fmt;
use std::mem::MaybeUninit;
use std::ptr::NonNull;

use iceoryx2::sample::Sample;

use super::inbox::Inbox;
use super::room::check_room;
use super::{Events, Ipc, Member, OVERRUN_MAX, Stream, UorbHeader, depth_max};
use crate::clock::now_us;
use crate::error::Error;
use crate::node::Node;
use crate::protocol::Wish;
use crate::ring::{Corrupt, Stamp, Unsent};
use crate::system::System;

/// How long a message may be on its way before it is given up for lost, in
/// microseconds: a large one whose publisher was stopped before it had sent it,
/// or one that cannot be told from one that is about to be committed.
const PATIENCE_US: u64 = 10_000;

/// A message on the stream, borrowed.
type Message = Sample<Ipc, [u8], UorbHeader>;

/// iceoryx2's and our own state of following a stream.
pub(crate) struct Reader {
    inbox: Inbox,
    stream: Stream,
    /// Kept so that a publisher finds them, who comes when the broker has died and
    /// the next one has not made them yet.
    _events: Events,
    /// Which of the node's stream entries is ours.
    index: usize,
    size_bytes: usize,
    is_large: bool,
    /// Messages that came before their turn, by generation.
    early: BTreeMap<u64, Message>,
    current: Current,
    /// The next message, where it was found and not yet taken: it is the current
    /// one already.
    ahead: Option<Found>,
    /// The memory of a copy, so that copying allocates twice and no more.
    spare: Vec<u8>,
    /// Ids of ports that were found in the node's table.
    known_ports: Vec<u128>,
    /// The generation that is waited for, and since when.
    awaited: (u64, u64),
    lost: u64,
}

// SAFETY: the inbox and the messages borrowed from it share counters that
// are not atomic, and nothing that belongs to a thread. All of them are in here,
// and reached by an exclusive reference only, so by one thread at a time.
unsafe impl Send for Reader {}
// SAFETY: a shared reference gives nothing but numbers and a message's bytes.
unsafe impl Sync for Reader {}

impl fmt::Debug for Reader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Reader").field("index", &self.index).finish_non_exhaustive()
    }
}

/// The message that was found last.
enum Current {
    None,
    /// With the bytes in it: to ask it for them would count references to the
    /// subscriber, which one thread at a time may do.
    Borrowed {
        _sample: Message,
        bytes: NonNull<[u8]>,
    },
    Copied(Vec<u8>),
}

/// A message that was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Found {
    pub(crate) generation: u64,
    pub(crate) stamp: Stamp,
}

/// What a look for the next message came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Next {
    /// It is there: `Reader::current`.
    Found(Found),
    /// Nothing newer was published, or it is on its way.
    NotYet,
    /// All up to this generation is lost.
    AllLost(u64),
}

impl Reader {
    pub(crate) fn open(
        member: &Member,
        system: &System,
        node: &Node,
        wish: Wish,
        index: usize,
    ) -> Result<Self, Error> {
        let (metadata, name) = (&node.identity.metadata, node.name());
        check_room(&name, 0)?;
        let (stream, events) = super::open(member, system, metadata, node.identity.instance, false)
            .map_err(|what| Error::stream(&name, what))?;
        let depth = (wish.depth as usize).clamp(1, depth_max(metadata.layout.size_bytes) as usize);
        let overrun = if wish.back_pressure { OVERRUN_MAX } else { 0 };
        let inbox = Inbox::open(&stream, depth + overrun)
            .map_err(|why| Error::stream(&name, format!("no queue: iceoryx2 says {why:?}")))?;
        Ok(Self {
            inbox,
            stream,
            _events: events,
            index,
            size_bytes: metadata.layout.size_bytes as usize,
            is_large: metadata.layout.is_large(),
            early: BTreeMap::new(),
            current: Current::None,
            ahead: None,
            spare: Vec::new(),
            known_ports: Vec::new(),
            awaited: (0, 0),
            lost: 0,
        })
    }

    /// Messages that were in neither the stream nor the node any more.
    pub(crate) fn lost(&self) -> u64 {
        self.lost
    }

    /// Which of the node's stream entries is this subscription's.
    pub(crate) fn index(&self) -> usize {
        self.index
    }

    /// The message that was found last.
    pub(crate) fn current(&self) -> Option<&[u8]> {
        match &self.current {
            Current::None => None,
            // SAFETY: the sample keeps the memory mapped, and its publisher writes there
            // again only after it is given back.
            Current::Borrowed { bytes, .. } => Some(unsafe { bytes.as_ref() }),
            Current::Copied(bytes) => Some(bytes),
        }
    }

    /// Keeps the message that the subscription begins with: by the time that it
    /// is asked for, the node may have forgotten it.
    pub(crate) fn begin(&mut self, node: &Node, generation: u64) -> Next {
        match self.find(node, generation) {
            Ok(Place::Here(stamp)) => {
                let found = Found { generation, stamp };
                self.ahead = Some(found);
                Next::Found(found)
            }
            Ok(Place::Nowhere) => Next::AllLost(generation),
            Ok(Place::OnItsWay) | Err(_) => Next::NotYet,
        }
    }

    /// Looks for the message after `cursor`, or, where that is lost, the next
    /// one that is not. What is found stays so until it is taken.
    #[inline]
    pub(crate) fn look(&mut self, node: &Node, cursor: u64, skips: Skips) -> Result<Next, Corrupt> {
        if let Some(ahead) = self.ahead {
            return Ok(Next::Found(ahead));
        }
        let next = self.search(node, cursor, skips)?;
        if let Next::Found(found) = next {
            self.ahead = Some(found);
        }
        Ok(next)
    }

    /// Takes the message that the last look has found.
    #[inline]
    pub(crate) fn take(&mut self, node: &Node) -> Option<Found> {
        let found = self.ahead.take()?;
        node.set_received(self.index, found.generation);
        Some(found)
    }

    /// All up to this message is taken for received.
    pub(crate) fn pass_over(&self, node: &Node, generation: u64) {
        node.set_received(self.index, generation);
    }

    #[inline]
    fn search(&mut self, node: &Node, cursor: u64, skips: Skips) -> Result<Next, Corrupt> {
        // Whatever was committed before this look was sent, is on its way, or
        // will never come.
        let newest = node.newest(cursor);
        let mut wanted = cursor + 1;
        while wanted <= newest {
            match self.find(node, wanted)? {
                Place::Here(stamp) => {
                    self.count_lost(node, wanted - cursor - 1, skips);
                    if wanted == newest && node.has_foreign_publishers() {
                        self.drop_foreign(node, newest);
                    }
                    return Ok(Next::Found(Found { generation: wanted, stamp }));
                }
                // What is lost before it need not be looked for again.
                Place::OnItsWay => break,
                Place::Nowhere => wanted = self.first_after(node, wanted),
            }
        }
        let lost_up_to = (wanted - 1).min(newest);
        if lost_up_to == cursor {
            return Ok(Next::NotYet);
        }
        self.count_lost(node, lost_up_to - cursor, skips);
        node.set_received(self.index, lost_up_to);
        Ok(Next::AllLost(lost_up_to))
    }

    /// Looks for one message everywhere, and makes it the current one.
    #[inline]
    fn find(&mut self, node: &Node, wanted: u64) -> Result<Place, Corrupt> {
        if let Some(stamp) = self.take_from_stream(node, wanted) {
            return Ok(Place::Here(stamp));
        }
        let mut bytes = std::mem::take(&mut self.spare);
        match self.find_in_node(node, wanted, &mut bytes) {
            Ok(Place::Here(stamp)) => {
                // SAFETY: what has found the message there has written all of it.
                unsafe { bytes.set_len(self.size_bytes) };
                let before = std::mem::replace(&mut self.current, Current::Copied(bytes));
                if let Current::Copied(spare) = before {
                    self.spare = spare;
                }
                return Ok(Place::Here(stamp));
            }
            place => {
                self.spare = bytes;
                if !matches!(place?, Place::Nowhere) {
                    return Ok(Place::OnItsWay);
                }
            }
        }
        // It may have been sent since we looked there.
        Ok(match self.take_from_stream(node, wanted) {
            Some(stamp) => Place::Here(stamp),
            None if self.inbox.is_connecting() => Place::OnItsWay,
            None => Place::Nowhere,
        })
    }

    fn find_in_node(
        &mut self,
        node: &Node,
        wanted: u64,
        bytes: &mut Vec<u8>,
    ) -> Result<Place, Corrupt> {
        if self.is_large {
            return Ok(match node.unsent(wanted, &mut []) {
                Unsent::Read(_) | Unsent::Unknown if self.is_patient(wanted) => Place::OnItsWay,
                _ if node.last_generation() == wanted => node
                    .read_last(wanted, room(bytes, self.size_bytes))
                    .map_or(Place::Nowhere, Place::Here),
                _ => Place::Nowhere,
            });
        }
        if let Some(stamp) = node.read_exactly(wanted, room(bytes, self.size_bytes))? {
            return Ok(Place::Here(stamp));
        }
        Ok(match node.unsent(wanted, room(bytes, self.size_bytes)) {
            Unsent::Read(stamp) => Place::Here(stamp),
            Unsent::Unknown if self.is_patient(wanted) => Place::OnItsWay,
            _ => Place::Nowhere,
        })
    }

    /// The least generation after a lost one that may be somewhere.
    fn first_after(&mut self, node: &Node, lost: u64) -> u64 {
        // In this order: what is committed now is on its way at the next look, or
        // else it was sent, and comes with what is received after that.
        let committed = node.newest(lost);
        let unsent = node.least_unsent(lost + 1);
        while let Some((generation, sample)) = self.receive(node, lost) {
            if generation > lost {
                self.early.insert(generation, sample);
            }
        }
        let early = self.early.keys().next().copied();
        // A large message is never in the node, but the newest may be in its last
        // section.
        let newest = node.newest(committed);
        let named = if self.is_large { newest } else { node.oldest_named(newest) };
        let places = [early, unsent].into_iter().flatten();
        places.fold(named.min(committed + 1), u64::min).max(lost + 1)
    }

    /// Receives until the wanted message has come, or nothing more comes.
    #[inline]
    fn take_from_stream(&mut self, node: &Node, wanted: u64) -> Option<Stamp> {
        while let Some(entry) = self.early.first_entry() {
            match *entry.key() {
                late if late < wanted => _ = entry.remove(),
                early if early > wanted => break,
                _ => {
                    let sample = entry.remove();
                    return Some(self.borrowed(sample));
                }
            }
        }
        while let Some((generation, sample)) = self.receive(node, wanted - 1) {
            if generation == wanted {
                return Some(self.borrowed(sample));
            }
            // What is late was copied from the node.
            if generation > wanted {
                self.early.insert(generation, sample);
            }
        }
        None
    }

    /// The next message that the stream has, and its generation.
    #[inline]
    fn receive(&mut self, node: &Node, known: u64) -> Option<(u64, Message)> {
        loop {
            // None, too, where every publisher that has sent anything has sent
            // something later than what is wanted, and that is put aside.
            let sample = self.inbox.receive(&self.stream)?;
            // Widened from the low 32 bits: it is at most the newest.
            let newest = node.newest(known);
            let behind = (newest as u32).wrapping_sub(sample.user_header().generation);
            let is_ours = self.is_registered(node, sample.origin().value())
                && sample.payload().len() == self.size_bytes;
            if is_ours {
                return Some((newest.saturating_sub(behind.into()), sample));
            }
            node.count_foreign();
        }
    }

    /// Receives what foreign publishers have sent, so that it is counted: while
    /// there are messages of ours, those are all that is received. What of ours
    /// has come since is put aside for its turn.
    #[cold]
    fn drop_foreign(&mut self, node: &Node, newest: u64) {
        while let Some((generation, sample)) = self.receive(node, newest) {
            if generation > newest {
                self.early.insert(generation, sample);
            }
        }
    }

    /// Whether a port is a publisher's of ours. Foreign ones may write what they
    /// like into the header.
    #[inline]
    fn is_registered(&mut self, node: &Node, id: u128) -> bool {
        if self.known_ports.contains(&id) {
            return true;
        }
        let is_registered = node.has_port_id(id);
        if is_registered {
            self.known_ports.push(id);
        }
        is_registered
    }

    /// Whether a message that is on its way may still come.
    fn is_patient(&mut self, wanted: u64) -> bool {
        let now_us = now_us();
        if self.awaited.0 != wanted {
            self.awaited = (wanted, now_us);
        }
        now_us < self.awaited.1 + PATIENCE_US
    }

    #[inline]
    fn borrowed(&mut self, sample: Message) -> Stamp {
        let header = *sample.user_header();
        let bytes = NonNull::from(sample.payload());
        self.current = Current::Borrowed { _sample: sample, bytes };
        Stamp { publish_time_us: header.publish_time_us, publisher: header.publisher.into() }
    }

    fn count_lost(&mut self, node: &Node, lost: u64, skips: Skips) {
        if lost > 0 && skips == Skips::AreLost {
            self.lost += lost;
            node.count_lost(lost);
            node.count_stream_lost(self.index, lost);
        }
    }
}

/// What it means that messages are not there any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Skips {
    AreLost,
    /// The subscription has an interval, and wanted none of them.
    AreWanted,
}

/// Where a message was found.
#[derive(Clone, Copy)]
enum Place {
    Here(Stamp),
    OnItsWay,
    Nowhere,
}

fn room(bytes: &mut Vec<u8>, size_bytes: usize) -> &mut [MaybeUninit<u8>] {
    bytes.clear();
    bytes.reserve(size_bytes);
    &mut bytes.spare_capacity_mut()[..size_bytes]
}
