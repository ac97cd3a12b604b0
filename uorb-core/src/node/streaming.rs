//! What a node knows of its stream: who follows it, whose ports it has, and what
//! became of messages on their way there.

use std::mem::MaybeUninit;

use super::{MappedRing, Node, Role};
use crate::clock::now_us;
use crate::mapping::Mapping;
use crate::node_file::{counts, doorbell, last_section, ring_section};
use crate::ring::{Busy, Corrupt, Stamp, Unsent, Writer, load_words, store_words};
use crate::stream::STREAMS_MAX;
use crate::stream::port::{Loaned, Port};
use crate::sync::{AtomicU64, Ordering, fence};

/// One stream subscription, as the broker has written it into the counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamEntry {
    /// The process.
    pub peer: u16,
    /// Which of the process's handles.
    pub handle: u32,
    /// How many messages its queue holds.
    pub depth: u32,
    /// Whether a publisher that asks is to wait for it.
    pub back_pressure: bool,
}

/// How long a publish that is under way is waited for, in microseconds.
const UNDER_WAY_TIMEOUT_US: u64 = 10_000;

const DEPTH_MASK: u64 = (1 << 15) - 1;

impl StreamEntry {
    fn to_word(self) -> u64 {
        let depth = u64::from(self.depth) & DEPTH_MASK;
        u64::from(self.handle) << 32
            | u64::from(self.back_pressure) << 31
            | depth << 16
            | u64::from(self.peer)
    }

    fn from_word(word: u64) -> Option<Self> {
        (word as u16 != 0).then_some(Self {
            peer: word as u16,
            handle: (word >> 32) as u32,
            depth: (word >> 16 & DEPTH_MASK) as u32,
            back_pressure: word >> 31 & 1 == 1,
        })
    }
}

/// A stream subscription, and how far it has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamStatus {
    /// Whose it is.
    pub entry: StreamEntry,
    /// Messages that it has still to receive.
    pub pending: u64,
    /// Messages that it has lost.
    pub lost: u64,
    /// Whether it has begun: what is published from now on is pending, and else
    /// counted. Before that, the broker alone knows of it.
    pub has_begun: bool,
}

/// What of a stream is not a subscription of ours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Foreigners {
    /// Foreign programs that follow the stream.
    pub subscribers: u64,
    /// Foreign programs that publish on it. Their messages are dropped.
    pub publishers: u64,
    /// Messages of theirs that were dropped, by all subscriptions together.
    pub dropped: u64,
}

impl Node {
    /// Whether somebody follows the stream: one load.
    #[inline]
    pub(crate) fn is_streamed(&self) -> bool {
        self.counts.words()[counts::STREAMED].load(Ordering::Relaxed) != 0
    }

    /// Publishes a message, which is in the stream's memory if there is a port:
    /// commits it to the node, sends it, and rings.
    #[inline]
    pub(crate) fn publish_and_send(
        &self,
        writer: &mut Writer,
        message: Option<&[u8]>,
        loaned: Option<(&Port, Loaned)>,
    ) -> Result<u64, Busy> {
        let Some(mapped) = self.ring.get() else { return Err(Busy) };
        let publish_time_us = now_us();
        let stamp = Stamp { publish_time_us, publisher: writer.stamp() };
        let in_node = match (&loaned, message) {
            // A large message is nowhere but on the stream.
            _ if self.identity.metadata.layout.is_large() => &[],
            (_, Some(message)) => message,
            (Some((_, loaned)), None) => loaned.bytes(),
            (None, None) => return Err(Busy),
        };
        let held = mapped.ring.publish_unsent(writer, publish_time_us, in_node);
        let generation = match (held, loaned) {
            (Ok(held), loaned) => {
                let generation = held.generation;
                if let Some((port, loaned)) = loaned {
                    port.send(loaned, generation, stamp);
                    fail_point!("publish.sent");
                }
                held.sent();
                generation
            }
            (Err(busy), Some((port, loaned))) => {
                port.give_back(loaned);
                return Err(busy);
            }
            (Err(busy), None) => return Err(busy),
        };
        self.ring_if_asked(mapped);
        Ok(generation)
    }

    /// The peer of a stream with back-pressure whose queue is full.
    pub(crate) fn full_stream(&self, known: u64) -> Option<StreamEntry> {
        let words = self.counts.words();
        if words[counts::BACK_PRESSURE].load(Ordering::Acquire) == 0 {
            return None;
        }
        let newest = self.newest(known);
        let entries = self.stream_entries().into_iter().enumerate();
        let pressing = entries.filter_map(|(index, entry)| Some((index, entry?)));
        pressing.filter(|(_, entry)| entry.back_pressure).find_map(|(index, entry)| {
            let received = self.received(index).load(Ordering::Acquire);
            (newest.saturating_sub(received) >= u64::from(entry.depth)).then_some(entry)
        })
    }

    fn stream_entries(&self) -> [Option<StreamEntry>; STREAMS_MAX] {
        let words = &self.counts.words()[counts::STREAMS..];
        std::array::from_fn(|index| StreamEntry::from_word(words[index].load(Ordering::Acquire)))
    }

    fn stream_word(&self, index: usize, word: usize) -> &AtomicU64 {
        let index = index.min(STREAMS_MAX - 1);
        &self.doorbell.words()[doorbell::STREAMS + index * doorbell::STREAM_WORDS + word]
    }

    fn received(&self, index: usize) -> &AtomicU64 {
        self.stream_word(index, 0)
    }

    /// Tells publishers how far a stream subscription has come.
    pub(crate) fn set_received(&self, index: usize, generation: u64) {
        self.received(index).store(generation, Ordering::Release);
    }

    /// Whether all who follow the stream have received this message.
    pub fn has_received(&self, generation: u64) -> bool {
        let mut entries = self.stream_entries().into_iter().enumerate();
        !entries.any(|(index, entry)| {
            entry.is_some() && self.received(index).load(Ordering::Acquire) < generation
        })
    }

    /// Begins to tell how far a stream subscription has come.
    pub(crate) fn begin_stream(&self, index: usize, generation: u64) {
        self.stream_word(index, 1).store(0, Ordering::Relaxed);
        self.set_received(index, generation);
        // Pairs with the load in `streams`: who sees it publishes behind `generation`.
        self.stream_word(index, 2).store(1, Ordering::Release);
    }

    pub(crate) fn count_stream_lost(&self, index: usize, lost: u64) {
        self.stream_word(index, 1).fetch_add(lost, Ordering::Relaxed);
    }

    /// Whether the broker has seen a foreign publisher: one load.
    pub(crate) fn has_foreign_publishers(&self) -> bool {
        self.counts.words()[counts::FOREIGN_PUBLISHERS].load(Ordering::Relaxed) != 0
    }

    /// Counts a message of a foreign publisher, which was dropped.
    #[cold]
    pub(crate) fn count_foreign(&self) {
        self.doorbell.words()[doorbell::FOREIGN].fetch_add(1, Ordering::Relaxed);
    }

    /// The stream subscriptions, and how far they have come.
    pub fn streams(&self) -> Vec<StreamStatus> {
        let newest = self.newest(self.identity.base);
        let entries = self.stream_entries().into_iter().enumerate();
        let status = |(index, entry): (usize, Option<StreamEntry>)| {
            Some(StreamStatus {
                entry: entry?,
                has_begun: self.stream_word(index, 2).load(Ordering::Acquire) != 0,
                pending: newest.saturating_sub(self.received(index).load(Ordering::Acquire)),
                lost: self.stream_word(index, 1).load(Ordering::Relaxed),
            })
        };
        entries.filter_map(status).collect()
    }

    /// What of the stream is not ours.
    pub fn foreigners(&self) -> Foreigners {
        let words = self.counts.words();
        Foreigners {
            subscribers: words[counts::FOREIGN_SUBSCRIBERS].load(Ordering::Relaxed),
            publishers: words[counts::FOREIGN_PUBLISHERS].load(Ordering::Relaxed),
            dropped: self.doorbell.words()[doorbell::FOREIGN].load(Ordering::Relaxed),
        }
    }

    // Where a message is.

    pub(crate) fn read_exactly(
        &self,
        generation: u64,
        into: &mut [MaybeUninit<u8>],
    ) -> Result<Option<Stamp>, Corrupt> {
        let Some(mapped) = self.ring() else { return Ok(None) };
        mapped.ring.read_exactly(generation, into)
    }

    pub(crate) fn unsent(&self, generation: u64, into: &mut [MaybeUninit<u8>]) -> Unsent {
        self.ring().map_or(Unsent::Over, |mapped| mapped.ring.unsent(generation, into))
    }

    pub(crate) fn least_unsent(&self, from: u64) -> Option<u64> {
        self.ring()?.ring.least_unsent(from)
    }

    pub(crate) fn oldest_named(&self, newest: u64) -> u64 {
        self.ring().map_or(newest, |mapped| mapped.ring.oldest_named(newest))
    }

    // Ports: a table that publishers write.

    fn port_entries(&self) -> impl Iterator<Item = &[AtomicU64]> {
        let ports: &[AtomicU64] = self.ring().map_or(&[], |mapped| mapped.ports);
        ports.chunks_exact(ring_section::PORT_WORDS)
    }

    /// Notes the id of a port, so that its messages are known for ours. False:
    /// all places are taken.
    pub(crate) fn enter_port(&self, peer: u16, handle: u32, id: u128) -> bool {
        let Some(mapped) = self.ring() else { return false };
        // Each in turn, so that the ids of ports that are gone stay for a while.
        let first = mapped.next_port.fetch_add(1, Ordering::Relaxed) as usize;
        let ours = port_key(peer, handle);
        let entries: Vec<_> = self.port_entries().collect();
        (first..first + entries.len()).any(|turn| {
            let entry = entries[turn % entries.len()];
            let claimed =
                entry[0].compare_exchange(0, ours, Ordering::Acquire, Ordering::Relaxed).is_ok();
            if claimed {
                entry[1].store(id as u64, Ordering::Release);
                entry[2].store((id >> 64) as u64, Ordering::Release);
            }
            claimed
        })
    }

    /// Whether a publisher has its port.
    pub(crate) fn has_port(&self, peer: u16, handle: u32) -> bool {
        let key = port_key(peer, handle);
        self.port_entries().any(|entry| entry[0].load(Ordering::Acquire) == key)
    }

    /// Whether every publisher has its port.
    pub(crate) fn has_all_ports(&self) -> bool {
        self.publisher_entries().iter().all(|entry| self.has_port(entry.peer, entry.handle))
    }

    /// Waits for publishes that began before their publisher had seen its port,
    /// and so do not send. They take microseconds, unless somebody is stopped.
    pub(crate) fn wait_for_publishes_under_way(&self) {
        let Some(mapped) = self.ring() else { return };
        let begun = mapped.ring.claimed();
        let deadline_us = now_us() + UNDER_WAY_TIMEOUT_US;
        while begun.iter().any(|claimed| mapped.ring.is_claimed(*claimed)) && now_us() < deadline_us
        {
            std::thread::yield_now();
        }
    }

    /// Whether a port is, or was, one of ours.
    pub fn has_port_id(&self, id: u128) -> bool {
        self.port_entries().any(|entry| {
            let halves = [1, 2].map(|half| entry[half].load(Ordering::Acquire));
            halves == [id as u64, (id >> 64) as u64]
        })
    }

    /// Gives the place of a port back. Its id stays known until another takes
    /// the place.
    pub(crate) fn leave_port(&self, peer: u16, handle: u32) {
        let key = port_key(peer, handle);
        for entry in self.port_entries() {
            let _ = entry[0].compare_exchange(key, 0, Ordering::Release, Ordering::Relaxed);
        }
    }

    /// Gives back the places of a peer that is proven dead.
    pub(crate) fn leave_ports_of(&self, peer: u16) {
        for entry in self.port_entries() {
            let key = entry[0].load(Ordering::Acquire);
            if key as u16 == peer {
                let _ = entry[0].compare_exchange(key, 0, Ordering::Release, Ordering::Relaxed);
            }
        }
    }

    /// The newest generation, where a peer has a port and not all who follow the
    /// stream have received that.
    pub fn unreceived_of(&self, peer: u16) -> Option<u64> {
        if !self.is_streamed() || !self.port_holders().contains(&peer) {
            return None;
        }
        let newest = self.ring()?.ring.newest_of_all();
        (!self.has_received(newest)).then_some(newest)
    }

    /// The peers that have ports.
    pub(crate) fn port_holders(&self) -> Vec<u16> {
        let keys = self.port_entries().map(|entry| entry[0].load(Ordering::Acquire) as u16);
        keys.filter(|peer| *peer != 0).collect()
    }

    /// Wakes subscriptions, for a publisher that has opened its port.
    pub(crate) fn ring_for_publisher(&self) {
        if let Some(MappedRing { bell: Some(bell), .. }) = self.ring() {
            bell.ring();
        }
    }

    // The last section of a large topic's node.

    /// The generation of the message that outlived its publisher; 0 if none did.
    pub fn last_generation(&self) -> u64 {
        let generation =
            |last: &Mapping| last.words()[last_section::GENERATION].load(Ordering::Acquire);
        self.last.as_ref().map_or(0, generation)
    }

    /// Copies the message that outlived its publisher, if it is this one.
    pub(crate) fn read_last(&self, generation: u64, into: &mut [MaybeUninit<u8>]) -> Option<Stamp> {
        let words = self.last.as_ref()?.words();
        if words[last_section::GENERATION].load(Ordering::Acquire) != generation {
            return None;
        }
        let stamp = Stamp {
            publish_time_us: words[last_section::PUBLISH_TIME].load(Ordering::Relaxed),
            publisher: words[last_section::PUBLISHER].load(Ordering::Relaxed),
        };
        load_words(&words[last_section::PAYLOAD..], into);
        // Pairs with the fence in `save_last`: a word of a later message comes
        // with its generation, or with 0.
        fence(Ordering::Acquire);
        let after = words[last_section::GENERATION].load(Ordering::Relaxed);
        (after == generation).then_some(stamp)
    }

    // What the broker does.

    /// Keeps a large message whose publisher has died, if none that is newer is
    /// kept.
    pub fn save_last(&self, generation_low: u32, stamp: (u64, u32), message: &[u8]) {
        let Some(last) = self.last.as_ref().filter(|_| self.role == Role::Broker) else { return };
        if message.len() != self.identity.metadata.layout.size_bytes as usize {
            return;
        }
        let newest = self.newest(self.identity.base);
        let behind = (newest as u32).wrapping_sub(generation_low);
        let generation = newest.saturating_sub(behind.into());
        if generation <= self.last_generation() {
            return;
        }
        let words = last.words();
        words[last_section::GENERATION].store(0, Ordering::Relaxed);
        fence(Ordering::Release);
        words[last_section::PUBLISH_TIME].store(stamp.0, Ordering::Relaxed);
        words[last_section::PUBLISHER].store(stamp.1.into(), Ordering::Relaxed);
        store_words(&words[last_section::PAYLOAD..], message);
        words[last_section::GENERATION].store(generation, Ordering::Release);
    }

    /// A stream subscription gets a place: until it begins by itself, it counts
    /// from now.
    pub fn admit_stream(&self, place: u8) {
        self.begin_stream(place.into(), self.newest(self.identity.base));
        self.stream_word(place.into(), 2).store(0, Ordering::Release);
    }

    /// Messages of a dead peer that are committed and may not have been sent.
    pub(crate) fn unsent_of(&self, peer: u16) -> Vec<(u64, Stamp, Vec<u8>)> {
        self.ring().map(|mapped| mapped.ring.unsent_of(peer)).unwrap_or_default()
    }

    /// Writes who follows the stream.
    pub fn set_streams(&self, entries: &[Option<StreamEntry>], foreign: (u64, u64)) {
        let words = self.counts.words();
        for (word, index) in words[counts::STREAMS..].iter().zip(0..STREAMS_MAX) {
            let entry = entries.get(index).copied().flatten();
            word.store(entry.map_or(0, StreamEntry::to_word), Ordering::Release);
        }
        let entries = entries.iter().flatten();
        let pressing = entries.clone().filter(|entry| entry.back_pressure).count();
        words[counts::BACK_PRESSURE].store(pressing as u64, Ordering::Release);
        let (subscribers, publishers) = foreign;
        words[counts::FOREIGN_SUBSCRIBERS].store(subscribers, Ordering::Relaxed);
        words[counts::FOREIGN_PUBLISHERS].store(publishers, Ordering::Relaxed);
        let streamed = entries.count() as u64 + subscribers;
        words[counts::STREAMED].store(streamed, Ordering::Release);
    }

    /// The stream subscriptions, each at its place: what an adopting broker
    /// finds.
    pub fn stream_places(&self) -> Vec<Option<StreamEntry>> {
        self.stream_entries().to_vec()
    }
}

/// A port's place in the table: whose it is. Not 0, as no peer is.
fn port_key(peer: u16, handle: u32) -> u64 {
    u64::from(handle) << 16 | u64::from(peer)
}
