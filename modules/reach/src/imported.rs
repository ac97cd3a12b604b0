//! One topic of another machine, as it is published here.
//!
//! Messages come on threads of zenoh's and are published at once, which waits for
//! nobody. Whatever comes is checked before it touches a node: it is of our format,
//! of the size and the revision that were announced, and newer than the one before.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};

use uorb_core::{Priority, RawPublication, now_us};

use crate::clock::Clock;
use crate::communicator::lock;
use crate::counts::Counts;
use crate::ledger::Mark;
use crate::translate::Timestamps;
use crate::wire::{Count, Header};

/// How long the last messages of a topic may be on their way: word that it has gone
/// overtakes what waits for room on the link.
const LAST_MESSAGES_US: u64 = 2_000_000;

/// The end of a topic at which messages come in.
#[derive(Debug)]
pub(crate) struct Incoming {
    /// None: the other machine does not have it now.
    publication: Option<RawPublication>,
    revision: u32,
    /// That of its publisher over there, as the newest message says.
    priority: Priority,
    /// The message before. None: what comes next begins the count.
    before: Option<Count>,
    /// What a reach before us has left here, until a message comes.
    inheritance: Option<Inheritance>,
    /// From where the next reach is to count, should this one be killed.
    mark: Option<Mark>,
    /// Whether that is of what is published now, not of what was before an interruption.
    is_marked: bool,
    /// When the newest message came.
    heard_us: u64,
    /// Whether the other machine has said that it was the last.
    has_ended: bool,
    translation: Option<Translation>,
    message: Vec<u8>,
    counts: Arc<Counts>,
}

/// What a reach that was killed has published since its mark.
#[derive(Debug)]
pub(crate) struct Inheritance {
    /// How many messages.
    pub(crate) published: u32,
    /// The last of them: whoever sends begins with the newest, and that may be it.
    pub(crate) newest: Vec<u8>,
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
            priority: Priority::DEFAULT,
            before: None,
            inheritance: None,
            mark: None,
            is_marked: false,
            heard_us: 0,
            has_ended: false,
            translation: None,
            message: Vec::new(),
            counts,
        }
    }

    /// Publishes from now on what comes.
    pub(crate) fn open(
        &mut self,
        publication: RawPublication,
        (revision, priority): (u32, Priority),
        translation: Option<Translation>,
    ) {
        if self.revision != revision {
            // Its generations are others.
            self.rest();
        }
        (self.publication, self.revision) = (Some(publication), revision);
        (self.priority, self.translation, self.is_marked) = (priority, translation, false);
    }

    /// The priority with which it is to be published here.
    pub(crate) fn priority(&self) -> Priority {
        self.priority
    }

    /// Publishes from the next message on with another publication. Returns the old one.
    pub(crate) fn publish_with(&mut self, publication: RawPublication) -> Option<RawPublication> {
        self.publication.replace(publication)
    }

    /// The other machine does not have it any more, or is out of reach. What is
    /// published there meanwhile is missing when it comes back, and counted then.
    pub(crate) fn close(&mut self) -> Option<RawPublication> {
        self.publication.take()
    }

    /// Nobody here wants it now: what is published there meanwhile is not missing.
    pub(crate) fn rest(&mut self) {
        (self.before, self.mark, self.inheritance) = (None, None, None);
    }

    /// Counts on from where a reach before us has begun.
    pub(crate) fn count_from(&mut self, mark: Mark, inheritance: Inheritance) {
        self.revision = mark.revision;
        (self.before, self.mark) = (Some(mark.there), Some(mark));
        self.inheritance = Some(inheritance);
        self.counts.count_lost(mark.lost);
    }

    pub(crate) fn mark(&self) -> Option<Mark> {
        self.mark
    }

    /// It was the last message for now.
    pub(crate) fn end(&mut self) {
        self.has_ended = true;
    }

    /// Whether the last messages of a topic that has gone there are here: the other
    /// machine says so behind them, or else, if it cannot, nothing comes any more.
    pub(crate) fn is_over(&self, gone_us: u64) -> bool {
        self.has_ended || now_us() > self.heard_us.max(gone_us) + LAST_MESSAGES_US
    }

    /// uORBCommunicator's `process_received_message`.
    pub(crate) fn process_received_message(&mut self, bytes: &[u8]) {
        let Some(publication) = &mut self.publication else { return };
        (self.heard_us, self.has_ended) = (now_us(), false);
        let decoded = Header::decode(bytes).filter(|(header, message)| {
            let size_bytes = publication.metadata().layout.size_bytes as usize;
            header.revision == self.revision && message.len() == size_bytes
        });
        let Some((header, message)) = decoded else {
            self.counts.count_refused();
            return;
        };
        // None: the newest message again, which was sent for somebody else.
        let Some(missing) = missing_since(self.before, header.count) else { return };
        self.priority = header.priority;
        let instance = publication.instance();
        let mut lost = missing;
        if let Some(Inheritance { published, newest }) = self.inheritance.take() {
            let none = Timestamps::default();
            let translated = self.translation.as_ref().map_or(&none, |it| &it.timestamps);
            if translated.is_same(&newest, message) {
                // It is one of those that were published.
                self.before = Some(header.count);
                self.counts.count_lost((missing + 1).saturating_sub(published).into());
                return;
            }
            lost = missing.saturating_sub(published);
        }
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
        if begins || !self.is_marked {
            let (revision, there, here) = (self.revision, header.count, here.get());
            let lost = self.counts.lost.load(Ordering::Relaxed);
            self.mark = Some(Mark { revision, there, instance, here, lost });
            self.is_marked = true;
        }
        self.before = Some(header.count);
    }
}

/// How many messages are missing before this one. None: it is not newer.
fn missing_since(before: Option<Count>, now: Count) -> Option<u32> {
    before.map_or(Some(0), |before| now.lost_since(&before))
}
