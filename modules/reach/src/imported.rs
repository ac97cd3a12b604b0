//! One topic of another machine, as it is published here.
//!
//! Messages come on threads of zenoh's and are published at once, which waits for
//! nobody. Whatever comes is checked before it touches a node: it is of our format,
//! of the size and the revision that were announced, and newer than the one before.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};

use uorb_core::{RawPublication, now_us};

use crate::clock::Clock;
use crate::communicator::lock;
use crate::counts::Counts;
use crate::ledger::Mark;
use crate::translate::Timestamps;
use crate::wire::{Count, Header};

/// The end of a topic at which messages come in.
#[derive(Debug)]
pub(crate) struct Incoming {
    /// None: the other machine does not have it now.
    publication: Option<RawPublication>,
    revision: u32,
    /// The message before. None: what comes next begins the count.
    before: Option<Count>,
    /// Messages that came before this process did, and are no part of what is missing.
    came_earlier: u32,
    /// From where the next reach is to count, should this one be killed.
    mark: Option<Mark>,
    translation: Option<Translation>,
    message: Vec<u8>,
    counts: Arc<Counts>,
}

/// Timestamps, and the clock that they are of.
#[derive(Debug)]
pub(crate) struct Translation {
    pub(crate) timestamps: Timestamps,
    pub(crate) clock: Arc<Mutex<Clock>>,
}

impl Incoming {
    pub(crate) fn new(counts: Arc<Counts>) -> Self {
        Self {
            publication: None,
            revision: 0,
            before: None,
            came_earlier: 0,
            mark: None,
            translation: None,
            message: Vec::new(),
            counts,
        }
    }

    /// Publishes from now on what comes.
    pub(crate) fn open(
        &mut self,
        publication: RawPublication,
        revision: u32,
        translation: Option<Translation>,
    ) {
        if self.revision != revision {
            // Its generations are others.
            self.rest();
        }
        (self.publication, self.revision) = (Some(publication), revision);
        self.translation = translation;
    }

    /// The other machine does not have it any more, or is out of reach. What is
    /// published there meanwhile is missing when it comes back, and counted then.
    pub(crate) fn close(&mut self) -> Option<RawPublication> {
        self.publication.take()
    }

    /// Nobody here wants it now: what is published there meanwhile is not missing.
    pub(crate) fn rest(&mut self) {
        (self.before, self.mark, self.came_earlier) = (None, None, 0);
    }

    /// Counts on from where a reach before us has begun, of whose messages so many
    /// have come.
    pub(crate) fn count_from(&mut self, mark: Mark, came_earlier: u32) {
        self.revision = mark.revision;
        (self.before, self.mark, self.came_earlier) = (Some(mark.there), Some(mark), came_earlier);
        self.counts.count_lost(mark.lost);
    }

    pub(crate) fn mark(&self) -> Option<Mark> {
        self.mark
    }

    /// uORBCommunicator's `process_received_message`.
    pub(crate) fn process_received_message(&mut self, bytes: &[u8]) {
        let Some(publication) = &mut self.publication else { return };
        let decoded = Header::decode(bytes).filter(|(header, message)| {
            let size_bytes = publication.metadata().layout.size_bytes as usize;
            header.revision == self.revision && message.len() == size_bytes
        });
        let Some((header, message)) = decoded else {
            self.counts.count_refused();
            return;
        };
        let lost = match self.before.map(|before| header.count.lost_since(&before)) {
            None => 0,
            Some(Some(lost)) => lost.saturating_sub(self.came_earlier),
            // The newest message again, which was sent for somebody else.
            Some(None) => return,
        };
        let published = match &self.translation {
            None => publication.publish(message),
            Some(Translation { timestamps, clock }) => {
                let known = lock(clock).difference(now_us());
                // It is not asked for before the clock is known.
                let Some(known) = known else { return };
                self.message.clear();
                self.message.extend_from_slice(message);
                timestamps.translate(&mut self.message, known.offset_us);
                publication.publish(&self.message)
            }
        };
        let Ok(here) = published else { return };
        self.counts.count_lost(lost.into());
        self.counts.count_message(bytes.len());
        let begins = self.before.is_none_or(|before| before.run != header.count.run);
        if begins {
            let (revision, there, here) = (self.revision, header.count, here.get());
            let lost = self.counts.lost.load(Ordering::Relaxed);
            self.mark = Some(Mark { revision, there, here, lost });
        }
        (self.before, self.came_earlier) = (Some(header.count), 0);
    }
}
