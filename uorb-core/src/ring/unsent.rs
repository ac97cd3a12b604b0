//! Messages that are committed and not sent elsewhere yet.
//!
//! A publisher that also sends its messages on a stream marks the slot of one
//! that it has committed, and keeps it until it has sent it. Nobody else writes
//! there meanwhile. So of a message that the order ring names no more it can be
//! told whether it is on its way, and what is in it.

use std::mem::MaybeUninit;

use super::{
    Busy, LOW_MASK, OWNER, PAYLOAD, PEER_MAX, Ring, SENDING, Stamp, Writer, generation_of,
    load_words, read_stamp, word,
};
use crate::sync::{AtomicU64, Ordering, fence};

/// The slot of a message that is committed and about to be sent elsewhere.
#[derive(Debug)]
pub(crate) struct Held<'m> {
    owner: &'m AtomicU64,
    pub(crate) generation: u64,
}

impl Held<'_> {
    /// The message was sent: gives the slot up.
    pub(crate) fn sent(self) {
        // Pairs with the load in `unsent`: who sees the slot free sees what was
        // sent.
        self.owner.store(word(self.generation, 0), Ordering::Release);
    }
}

/// What became of a message that the order ring names no more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unsent {
    /// Its publisher has not sent it yet. It is copied, whole.
    Read(Stamp),
    /// Somebody was about to commit this generation. It may be the one who did,
    /// if it was interrupted at that instant and so was who overwrote it.
    Unknown,
    /// It was sent, or its publisher died, or it never was to be sent.
    Over,
}

impl<'m> Ring<'m> {
    /// As `publish`, for a message that is also to be sent elsewhere: the slot is
    /// kept, marked, until it was.
    pub(crate) fn publish_unsent(
        &self,
        writer: &mut Writer,
        publish_time_us: u64,
        message: &[u8],
    ) -> Result<Held<'m>, Busy> {
        let (generation, owner) = self.write_and_commit(writer, publish_time_us, message)?;
        let sending = word(generation, u64::from(writer.peer | SENDING));
        owner.store(sending, Ordering::Release);
        self.mark_displaced(generation, writer.candidate);
        fail_point!("publish.marked");
        Ok(Held { owner, generation })
    }

    /// Whoever overwrites an order word knows that the slot which it named was
    /// committed. If that one's publisher was interrupted before it could mark
    /// its slot, this does it: nobody else could tell any more.
    fn mark_displaced(&self, generation: u64, displaced: usize) {
        let Some(slot) = self.slot(displaced) else { return };
        let owner = slot[OWNER].load(Ordering::Relaxed);
        let displaced = generation - self.geometry.order_words as u64;
        let is_unmarked = owner & LOW_MASK != 0 && owner & u64::from(SENDING) == 0;
        if generation_of(owner) == displaced && is_unmarked {
            let marked = owner | u64::from(SENDING);
            // It fails where its owner has gone on by itself. Acquire and release
            // hand on what the owner has written before its commit, which our
            // commit has seen.
            let _ =
                slot[OWNER].compare_exchange(owner, marked, Ordering::AcqRel, Ordering::Relaxed);
        }
    }

    /// What became of a message that the order ring names no more. Its publisher
    /// holds the slot until it has sent it, and nobody else may write there.
    pub(crate) fn unsent(&self, generation: u64, into: &mut [MaybeUninit<u8>]) -> Unsent {
        let mut outcome = Unsent::Over;
        for index in 0..self.geometry.slots {
            let Some(slot) = self.slot(index) else { break };
            // Pairs with the stores that mark and free the slot: who sees it
            // free sees that the message was sent.
            let owner = slot[OWNER].load(Ordering::Acquire);
            if generation_of(owner) != generation || owner & LOW_MASK == 0 {
                continue;
            }
            if owner & u64::from(SENDING) == 0 {
                outcome = Unsent::Unknown;
                continue;
            }
            let stamp = read_stamp(slot);
            load_words(&slot[PAYLOAD..], into);
            // Pairs with the release fence in `publish`, as in `read`.
            fence(Ordering::Acquire);
            if slot[OWNER].load(Ordering::Relaxed) == owner {
                return Unsent::Read(stamp);
            }
            // It was sent meanwhile.
            return Unsent::Over;
        }
        outcome
    }

    /// The least generation from `from` on whose publisher holds a slot, before
    /// or after its commit.
    pub(crate) fn least_unsent(&self, from: u64) -> Option<u64> {
        let slots = (0..self.geometry.slots).filter_map(|index| self.slot(index));
        let owners = slots.map(|slot| slot[OWNER].load(Ordering::Acquire));
        let held = owners.filter(|owner| owner & LOW_MASK != 0).map(generation_of);
        held.filter(|generation| *generation >= from).min()
    }

    /// Slots that publishers have in their hands now: which, and as whose.
    pub(crate) fn claimed(&self) -> Vec<(usize, u64)> {
        let slots = 0..self.geometry.slots;
        let owners = slots.filter_map(|index| Some((index, self.slot(index)?)));
        let owners = owners.map(|(index, slot)| (index, slot[OWNER].load(Ordering::Acquire)));
        owners.filter(|(_, owner)| owner & LOW_MASK != 0).collect()
    }

    /// Whether one of them is still in the same hands, at the same step.
    pub(crate) fn is_claimed(&self, (index, owner): (usize, u64)) -> bool {
        self.slot(index).is_some_and(|slot| slot[OWNER].load(Ordering::Acquire) == owner)
    }

    /// The messages of a dead peer that are committed, and may not have been sent
    /// elsewhere. Only the broker asks, before it gives the slots back: until
    /// then nobody writes there.
    pub(crate) fn unsent_of(&self, peer: u16) -> Vec<(u64, Stamp, Vec<u8>)> {
        let mut unsent = Vec::new();
        for index in 0..self.geometry.slots {
            let Some(slot) = self.slot(index) else { break };
            let owner = slot[OWNER].load(Ordering::Acquire);
            if owner & u64::from(PEER_MAX) != u64::from(peer) {
                continue;
            }
            let generation = generation_of(owner);
            if owner & u64::from(SENDING) == 0 && !self.names(generation, index) {
                continue;
            }
            let words = slot[PAYLOAD..].iter().map(|word| word.load(Ordering::Relaxed));
            let mut bytes: Vec<u8> = words.flat_map(u64::to_ne_bytes).collect();
            bytes.truncate(self.geometry.message_bytes);
            unsent.push((generation, read_stamp(slot), bytes));
        }
        unsent
    }
}
