//! The newest messages of a node, for any number of publishers and readers,
//! without a lock.
//!
//! A ring is two tables in shared memory. **Slots** hold messages. The **order
//! ring** says which slot holds which generation: generation `g` is named by
//! word `g % N`, as `g << 16 | slot`. A message exists from the instant its
//! word is written, which is its *commit*; before that nobody can see it, so
//! generations are dense and there is never anything to skip.
//!
//! To publish: claim a slot that no order word names any more, write it, and
//! commit it by compare-exchange as the next generation; whoever comes second
//! commits behind. To read generation `g`: load its word, copy the slot, load
//! the word again; if it is unchanged the copy is whole.
//!
//! There are N = max(4, 2Q) order words for a queue of Q messages, and N + P
//! slots for P publishers, so that a slot being written is never one that a
//! reader may still ask for, and a publisher that was stopped or killed in
//! mid-publish holds one slot and blocks nobody. A reader asks for the newest Q
//! only: a publisher would have to come round half the ring under its hands to
//! make it try again.
//!
//! Generations have 48 bits here. Whatever other processes write, nothing in
//! this file indexes outside its tables or loops without an end: bounds come
//! from a [`Geometry`] in private memory.
//!
//! What copies a message is always inlined: with the message's size known, a
//! copy of 64 bytes takes two thirds of the time.

mod unsent;

use crate::sync::{AtomicU64, Ordering, fence};
use std::mem::MaybeUninit;

#[cfg(not(loom))]
pub(crate) use unsent::Unsent;

/// How many publishers a node admits: each may hold one slot at any time.
pub const PUBLISHERS_MAX: u32 = 16;

/// The bits of a slot number in an order word, and of a peer in an owner word.
const LOW_BITS: u32 = 16;
const LOW_MASK: u64 = (1 << LOW_BITS) - 1;

/// The largest number of a peer. The bit above it says in an owner word that the
/// message is committed, and its publisher about to send it elsewhere.
pub const PEER_MAX: u16 = SENDING - 1;
const SENDING: u16 = 1 << 15;

/// 64-bit words in a cache line, the unit in which the tables are aligned.
const LINE_WORDS: usize = 8;

// A slot: who may write it, when and by whom it was published, the message.
const OWNER: usize = 0;
const PUBLISH_TIME: usize = 1;
const PUBLISHER: usize = 2;
const PAYLOAD: usize = 3;

/// Rounds of the slot table that a publish makes before it says busy. With at
/// most [`PUBLISHERS_MAX`] handles one round finds a slot; more are needed only
/// when threads outnumber the handles that they share.
const CLAIM_ROUNDS: usize = 64;

/// The sizes of a ring, all that is needed to find one's way in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Geometry {
    queue_length: usize,
    order_words: usize,
    slots: usize,
    slot_words: usize,
    message_bytes: usize,
}

impl Geometry {
    pub(crate) fn new(queue_length: u32, publishers: u32, message_bytes: u32) -> Self {
        let order_words = (2 * queue_length as usize).max(4);
        let payload_words = (message_bytes as usize).div_ceil(8);
        Self {
            queue_length: queue_length as usize,
            order_words,
            slots: order_words + publishers as usize,
            slot_words: (PAYLOAD + payload_words).next_multiple_of(LINE_WORDS),
            message_bytes: message_bytes as usize,
        }
    }

    /// The 64-bit words that both tables take together.
    pub(crate) fn words(&self) -> usize {
        self.order_line_words() + self.slots * self.slot_words
    }

    fn order_line_words(&self) -> usize {
        self.order_words.next_multiple_of(LINE_WORDS)
    }
}

/// What stands beside a message in its slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stamp {
    pub(crate) publish_time_us: u64,
    /// The publisher as [`Writer::publisher`] gave it.
    pub(crate) publisher: u64,
}

/// A message that was read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Taken {
    pub(crate) generation: u64,
    /// Messages between the cursor and this one that were overwritten before
    /// they were read.
    pub(crate) lost: u64,
    pub(crate) stamp: Stamp,
}

/// How an attempt to copy one generation ended.
enum Read {
    /// The message is copied, whole.
    Whole(Stamp),
    /// This later generation has taken its place.
    OverwrittenBy(u64),
}

/// All slots are taken by publishes that other threads have under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Busy;

/// The order words contradict each other: something wrote into the ring that is
/// not a publisher.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Corrupt;

/// A publisher's private memory between two publishes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Writer {
    /// Peer number, 1 to [`PEER_MAX`]: it owns the slots that this writer claims.
    peer: u16,
    /// Peer and handle: who published, in every slot.
    publisher: u64,
    /// The newest generation this writer knows of.
    newest: u64,
    /// The slot to try first: the one that its last commit displaced.
    candidate: usize,
}

impl Writer {
    pub(crate) fn new(peer: u16, handle: u32) -> Self {
        debug_assert!((1..=PEER_MAX).contains(&peer), "peer 0 marks a free slot");
        Self { peer, publisher: Self::publisher(peer, handle), newest: 0, candidate: 0 }
    }

    /// The same publisher, which knows what another copy of it has learnt.
    pub(crate) fn with_hints(self, newest: u64, candidate: usize) -> Self {
        Self { newest, candidate, ..self }
    }

    /// What it has learnt.
    pub(crate) fn hints(&self) -> (u64, usize) {
        (self.newest, self.candidate)
    }

    /// Who publishes, as [`Stamp`] carries it.
    pub(crate) fn stamp(&self) -> u64 {
        self.publisher
    }

    /// The newest generation that it knows of.
    pub(crate) fn newest(&self) -> u64 {
        self.newest
    }

    /// Peer and handle in one word, as [`Stamp`] carries it.
    pub(crate) fn publisher(peer: u16, handle: u32) -> u64 {
        u64::from(handle) << LOW_BITS | u64::from(peer)
    }
}

/// The two tables, wherever they are mapped.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ring<'m> {
    order: &'m [AtomicU64],
    slots: &'m [AtomicU64],
    geometry: Geometry,
    /// The generation before the first publish.
    base: u64,
}

fn generation_of(word: u64) -> u64 {
    word >> LOW_BITS
}

fn word(generation: u64, low: u64) -> u64 {
    generation << LOW_BITS | low
}

impl<'m> Ring<'m> {
    /// The ring in `words`, which are `geometry.words()` many.
    pub(crate) fn new(words: &'m [AtomicU64], geometry: Geometry, base: u64) -> Self {
        let (order, slots) = words.split_at(geometry.order_line_words());
        let order = &order[..geometry.order_words];
        assert_eq!(slots.len(), geometry.slots * geometry.slot_words);
        Self { order, slots, geometry, base }
    }

    /// Makes an empty ring of zeroed words. The broker does it before anybody
    /// else can see the node.
    pub(crate) fn format(&self) {
        for back in 0..self.geometry.order_words as u64 {
            let generation = self.base - back;
            self.order_word(generation).store(word(generation, LOW_MASK), Ordering::Relaxed);
        }
    }

    #[inline]
    fn order_word(&self, generation: u64) -> &'m AtomicU64 {
        // A power of two: the remainder is a mask.
        &self.order[generation as usize & (self.geometry.order_words - 1)]
    }

    fn slot(&self, slot: usize) -> Option<&'m [AtomicU64]> {
        let words = self.geometry.slot_words;
        if slot < self.geometry.slots {
            self.slots.get(slot * words..(slot + 1) * words)
        } else {
            None
        }
    }

    /// Whether anything newer than `cursor` was committed: one load.
    ///
    /// Sequentially consistent, because a subscription that goes to sleep looks
    /// once more after it has asked for the bell (see `bell.rs`). On x86-64 and
    /// aarch64 that costs a load what acquire costs.
    #[inline]
    pub(crate) fn has_newer(&self, cursor: u64) -> bool {
        generation_of(self.order_word(cursor + 1).load(Ordering::SeqCst)) > cursor
    }

    /// The newest committed generation, found from any committed one.
    ///
    /// Commits are dense, so "generation k is committed" is true up to the
    /// newest and false beyond; steps double while it is true and halve when it
    /// is not. A word may hold a later lap of the ring, and then we jump there.
    #[inline]
    pub(crate) fn newest(&self, known: u64) -> u64 {
        let mut newest = known;
        let mut step = 1;
        loop {
            // Pairs with the commit: who sees a generation sees all before it.
            let seen = generation_of(self.order_word(newest + step).load(Ordering::Acquire));
            if seen >= newest + step {
                newest = seen;
                step = (step * 2).min(self.geometry.order_words as u64);
            } else if step > 1 {
                step /= 2;
            } else {
                return newest;
            }
        }
    }

    /// The newest generation, for whoever knows none.
    pub(crate) fn newest_of_all(&self) -> u64 {
        let words = self.order.iter().map(|word| word.load(Ordering::Acquire));
        self.newest(words.map(generation_of).max().unwrap_or(self.base).max(self.base))
    }

    /// Whether nothing was ever published.
    pub(crate) fn is_empty(&self) -> bool {
        !self.has_newer(self.base)
    }

    /// Publishes `message`, `message_bytes` long, and returns its generation.
    /// Never waits for anybody.
    #[inline]
    pub(crate) fn publish(
        &self,
        writer: &mut Writer,
        publish_time_us: u64,
        message: &[u8],
    ) -> Result<u64, Busy> {
        let (generation, owner) = self.write_and_commit(writer, publish_time_us, message)?;
        // The slot is free for whoever finds it displaced, N commits from now.
        owner.store(word(generation, 0), Ordering::Release);
        fail_point!("publish.freed");
        Ok(generation)
    }

    #[inline(always)]
    fn write_and_commit(
        &self,
        writer: &mut Writer,
        publish_time_us: u64,
        message: &[u8],
    ) -> Result<(u64, &'m AtomicU64), Busy> {
        debug_assert_eq!(message.len(), self.geometry.message_bytes);
        fail_point!("publish.begun");
        let (index, slot) = self.claim(writer)?;
        fail_point!("publish.claimed");
        // Pairs with the acquire fence in `read`: a reader that sees one word of
        // what follows also sees that the order ring no longer names this slot.
        fence(Ordering::Release);
        slot[PUBLISH_TIME].store(publish_time_us, Ordering::Relaxed);
        slot[PUBLISHER].store(writer.publisher, Ordering::Relaxed);
        fail_point!(
            "publish.half_written",
            store_words(&slot[PAYLOAD..], &message[..message.len() / 2])
        );
        store_words(&slot[PAYLOAD..], message);
        fail_point!("publish.written");

        let (generation, displaced) = self.commit(writer, index, slot);
        fail_point!("publish.committed");
        writer.newest = generation;
        writer.candidate = displaced;
        Ok((generation, &slot[OWNER]))
    }

    /// Takes a slot that nobody owns and no order word names: its generation is
    /// N or more behind the newest. There is one, because N are named, each
    /// other publisher holds one at most, and there are N + P.
    #[inline]
    pub(crate) fn claim(&self, writer: &mut Writer) -> Result<(usize, &'m [AtomicU64]), Busy> {
        writer.newest = self.newest(writer.newest.max(self.base));
        if let Some(slot) = self.try_claim(writer, writer.candidate) {
            return Ok((writer.candidate, slot));
        }
        self.claim_any(writer)
    }

    #[cold]
    fn claim_any(&self, writer: &mut Writer) -> Result<(usize, &'m [AtomicU64]), Busy> {
        for _ in 0..CLAIM_ROUNDS {
            writer.newest = self.newest(writer.newest);
            for index in 0..self.geometry.slots {
                if let Some(slot) = self.try_claim(writer, index) {
                    return Ok((index, slot));
                }
            }
        }
        Err(Busy)
    }

    #[inline]
    fn try_claim(&self, writer: &Writer, index: usize) -> Option<&'m [AtomicU64]> {
        let slot = self.slot(index)?;
        let owner = slot[OWNER].load(Ordering::Relaxed);
        let generation = generation_of(owner);
        let displaced = generation + self.geometry.order_words as u64 <= writer.newest;
        if owner & LOW_MASK != 0 || !displaced {
            return None;
        }
        // Of no generation yet: `unsent` must not take it for the old one's.
        let ours = word(0, u64::from(writer.peer));
        // Acquire pairs with the release that freed the slot: its last owner has
        // finished writing.
        slot[OWNER]
            .compare_exchange(owner, ours, Ordering::Acquire, Ordering::Relaxed)
            .is_ok()
            .then_some(slot)
    }

    /// Makes the slot the next generation. Returns that and the slot that its
    /// order word named before.
    #[inline]
    fn commit(&self, writer: &Writer, index: usize, slot: &[AtomicU64]) -> (u64, usize) {
        let mut newest = writer.newest;
        loop {
            let next = newest + 1;
            // Before the commit, so that nobody takes the slot for an old one
            // when we are killed right after it.
            slot[OWNER].store(word(next, u64::from(writer.peer)), Ordering::Relaxed);
            fail_point!("publish.owned");
            let entry = self.order_word(next);
            let old = entry.load(Ordering::Acquire);
            if generation_of(old) < next {
                // The success is sequentially consistent for the bell: a
                // subscription that asked before it, we see asking after it.
                let new = word(next, index as u64);
                let committed =
                    entry.compare_exchange(old, new, Ordering::SeqCst, Ordering::Acquire);
                if committed.is_ok() {
                    return (next, (old & LOW_MASK) as usize);
                }
            }
            // Somebody was first: commit behind whoever is newest now.
            newest = self.newest(newest);
        }
    }

    /// Copies what a reader at `cursor` is to see next into `into`: the next generation; if that is no longer among
    /// the newest Q, the oldest of those; if there is nothing newer, the newest
    /// again. None if nothing was ever published.
    #[inline(always)]
    pub(crate) fn take(
        &self,
        cursor: u64,
        into: &mut [MaybeUninit<u8>],
    ) -> Result<Option<Taken>, Corrupt> {
        // What is not written here stays as it was, and the caller takes it for
        // a message.
        if into.len() != self.geometry.message_bytes {
            return Err(Corrupt);
        }
        fail_point!("copy.begun");
        let mut newest = self.newest(cursor);
        if newest == self.base {
            return Ok(None);
        }
        loop {
            let oldest = newest.saturating_sub(self.geometry.queue_length as u64 - 1);
            let generation = if newest == cursor { cursor } else { oldest.max(cursor + 1) };
            match self.read(generation, into)? {
                Read::Whole(stamp) => {
                    fail_point!("copy.copied");
                    let lost = generation.saturating_sub(cursor + 1);
                    return Ok(Some(Taken { generation, lost, stamp }));
                }
                Read::OverwrittenBy(later) => newest = self.advance(newest, later)?,
            }
        }
    }

    /// The newest generation, after one that `later` has overwritten: publishers
    /// came round half the ring while we copied one message, so it is newer
    /// than the newest we knew. If not, nobody overwrote anything.
    #[cold]
    fn advance(&self, known: u64, later: u64) -> Result<u64, Corrupt> {
        if later > known { Ok(self.newest(later)) } else { Err(Corrupt) }
    }

    /// Copies one generation, if it is still there.
    #[inline(always)]
    fn read(&self, generation: u64, into: &mut [MaybeUninit<u8>]) -> Result<Read, Corrupt> {
        let entry = self.order_word(generation);
        // Pairs with the commit: who sees the word sees the message.
        let before = entry.load(Ordering::Acquire);
        if generation_of(before) > generation {
            return Ok(Read::OverwrittenBy(generation_of(before)));
        }
        let slot = self.slot((before & LOW_MASK) as usize).ok_or(Corrupt)?;
        if generation_of(before) < generation {
            return Err(Corrupt);
        }
        let stamp = read_stamp(slot);
        load_words(&slot[PAYLOAD..], into);
        // Pairs with the release fence in `publish`: if any word came from a
        // later message in this slot, the order word has changed.
        fence(Ordering::Acquire);
        let after = entry.load(Ordering::Relaxed);
        if after == before {
            return Ok(Read::Whole(stamp));
        }
        // Pairs with the commit that overwrote it: we go on from there, and
        // must see what came before it.
        fence(Ordering::Acquire);
        Ok(Read::OverwrittenBy(generation_of(after)))
    }

    /// Copies one generation, if the order ring still names it: also one that is
    /// older than the newest Q.
    pub(crate) fn read_exactly(
        &self,
        generation: u64,
        into: &mut [MaybeUninit<u8>],
    ) -> Result<Option<Stamp>, Corrupt> {
        if into.len() != self.geometry.message_bytes {
            return Err(Corrupt);
        }
        match self.read(generation, into)? {
            Read::Whole(stamp) => Ok(Some(stamp)),
            Read::OverwrittenBy(_) => Ok(None),
        }
    }

    /// The oldest generation that the order ring names, when `newest` is the
    /// newest.
    pub(crate) fn oldest_named(&self, newest: u64) -> u64 {
        newest.saturating_sub(self.geometry.order_words as u64 - 1).max(self.base + 1)
    }

    /// The stamp of the newest message, without the message.
    pub(crate) fn newest_stamp(&self, known: u64) -> Result<Option<Stamp>, Corrupt> {
        let mut newest = self.newest(known.max(self.base));
        if newest == self.base {
            return Ok(None);
        }
        loop {
            match self.read(newest, &mut [])? {
                Read::Whole(stamp) => return Ok(Some(stamp)),
                Read::OverwrittenBy(later) => newest = self.advance(newest, later)?,
            }
        }
    }

    fn names(&self, generation: u64, index: usize) -> bool {
        self.order_word(generation).load(Ordering::SeqCst) == word(generation, index as u64)
    }

    /// Gives back the slots of a peer that is proven dead. Only the broker may,
    /// and a stopped peer is not dead: its slot would be written by two.
    pub(crate) fn free_slots_of(&self, peer: u16) {
        for index in 0..self.geometry.slots {
            let Some(slot) = self.slot(index) else { return };
            let owner = slot[OWNER].load(Ordering::Acquire);
            if owner & u64::from(PEER_MAX) != u64::from(peer) {
                continue;
            }
            // It died before its commit, and then the slot is not named and may
            // be taken at once; or after, and then its generation says until
            // when it is named.
            let generation = generation_of(owner);
            let named = self.names(generation, index);
            slot[OWNER].store(word(if named { generation } else { 0 }, 0), Ordering::Release);
        }
    }
}

#[inline(always)]
fn read_stamp(slot: &[AtomicU64]) -> Stamp {
    Stamp {
        publish_time_us: slot[PUBLISH_TIME].load(Ordering::Relaxed),
        publisher: slot[PUBLISHER].load(Ordering::Relaxed),
    }
}

/// Writes a message into words that others may be reading: each word whole.
#[inline(always)]
pub(crate) fn store_words(words: &[AtomicU64], message: &[u8]) {
    let (whole, rest) = message.as_chunks::<8>();
    for (word, bytes) in words.iter().zip(whole) {
        word.store(u64::from_ne_bytes(*bytes), Ordering::Relaxed);
    }
    if let (Some(word), false) = (words.get(whole.len()), rest.is_empty()) {
        let mut bytes = [0; 8];
        bytes[..rest.len()].copy_from_slice(rest);
        word.store(u64::from_ne_bytes(bytes), Ordering::Relaxed);
    }
}

/// Reads a message from words that others may be writing: each word whole.
#[inline(always)]
pub(crate) fn load_words(words: &[AtomicU64], into: &mut [MaybeUninit<u8>]) {
    let (whole, rest) = into.as_chunks_mut::<8>();
    let whole_words = whole.len();
    for (word, bytes) in words.iter().zip(whole) {
        bytes.write_copy_of_slice(&word.load(Ordering::Relaxed).to_ne_bytes());
    }
    if let (Some(word), false) = (words.get(whole_words), rest.is_empty()) {
        let bytes = word.load(Ordering::Relaxed).to_ne_bytes();
        rest.write_copy_of_slice(&bytes[..rest.len()]);
    }
}

#[cfg(all(test, not(loom)))]
#[allow(unsafe_code)]
mod tests;
