//! What a reach that is killed leaves to the next one: from where it counts, and which
//! messages on the bus it has brought in.
//!
//! Generations are dense, there and here. So of a topic that comes in one pair is
//! enough, a message's generation there and the one under which it was published
//! here: whatever has come since, so many are missing as there were more there than
//! here. The pair is noted when counting begins, which is seldom.

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use uorb_core::broker_side::Node;
use uorb_core::{Copied, Instance, Session, System, now_us};

use crate::keys::Remote;
use crate::wire::Count;

/// So many numbers of those before us are kept.
const PEERS_MAX: usize = 64;

/// So many topics are noted, those included that have been gone for a while.
const ENTRIES_MAX: usize = 8_192;

/// From where a topic is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Mark {
    /// Which description the generations are of.
    pub(crate) revision: u32,
    /// A message there.
    pub(crate) there: Count,
    /// The same message here: on which instance, and the low half of its generation.
    pub(crate) instance: Instance,
    pub(crate) here: u32,
    /// What was lost before it.
    pub(crate) lost: u64,
}

impl Mark {
    /// How many messages have been published here since.
    pub(crate) fn published_since(&self, node: &Node) -> u32 {
        let newest = node.identity.base.wrapping_add(node.status().published) as u32;
        newest.wrapping_sub(self.here)
    }
}

/// What is noted of a topic.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Entry {
    /// The topic, as its key has it.
    pub(crate) key: String,
    pub(crate) mark: Mark,
}

/// All that is noted.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Notes {
    /// The numbers that we, and those before us, have with the broker.
    peers: Vec<u16>,
    entries: Vec<Entry>,
}

/// The file in which it is noted, in the directory of the system.
#[derive(Debug)]
pub(crate) struct Ledger {
    path: PathBuf,
    unfinished: PathBuf,
    notes: Notes,
}

/// Which messages a reach has published here: they are from another machine, and are
/// not sent to any.
#[derive(Clone, Debug)]
pub(crate) struct BroughtIn {
    ours: u16,
    before_us: Vec<u16>,
    since_us: u64,
}

impl BroughtIn {
    /// The newest message of a topic may well be one of a reach that has gone. Its number
    /// can be somebody else's by now, so it counts only for what is older than we are.
    pub(crate) fn has(&self, message: &Copied) -> bool {
        let is_older = message.publish_time_us < self.since_us;
        message.peer == self.ours || (is_older && self.before_us.contains(&message.peer))
    }
}

impl Ledger {
    /// What the one before has left, and from now on our number. That it is not there, or
    /// not whole, is as if it had left nothing.
    pub(crate) fn open(session: &Session) -> (Self, BroughtIn) {
        let system: &System = session.system();
        let (path, unfinished) = (system.reach(), system.unfinished().join("reach"));
        let text = fs::read_to_string(&path).unwrap_or_default();
        let mut notes: Notes = serde_json::from_str(&text).unwrap_or_default();
        let before_us = notes.peers.clone();
        let brought_in = BroughtIn { ours: session.peer(), before_us, since_us: now_us() };
        notes.peers.push(session.peer());
        let too_many = notes.peers.len().saturating_sub(PEERS_MAX);
        notes.peers.drain(..too_many);
        let ledger = Self { path, unfinished, notes };
        ledger.write();
        (ledger, brought_in)
    }

    pub(crate) fn entry(&self, remote: &Remote) -> Option<&Entry> {
        let key = remote.key();
        self.notes.entries.iter().find(|entry| entry.key == key)
    }

    /// Notes what there is now of the topics that are known, if it is not what there was.
    pub(crate) fn note(&mut self, entries: Vec<Entry>, known: &BTreeSet<String>) {
        let entries = with_gone(entries, &self.notes.entries, known);
        if entries != self.notes.entries {
            self.notes.entries = entries;
            self.write();
        }
    }

    fn write(&self) {
        let text = serde_json::to_string(&self.notes).expect("numbers and names");
        // Where it cannot be written, the next one counts from its own beginning.
        let _ = fs::write(&self.unfinished, text)
            .and_then(|()| fs::rename(&self.unfinished, &self.path));
    }
}

/// What was noted before stays for topics that are gone. Behind those that are there are
/// those that went last, so that the oldest find no room.
fn with_gone(mut entries: Vec<Entry>, before: &[Entry], known: &BTreeSet<String>) -> Vec<Entry> {
    entries.extend(before.iter().filter(|entry| !known.contains(&entry.key)).cloned());
    entries.truncate(ENTRIES_MAX);
    entries
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(key: usize) -> Entry {
        let there = Count { run: 1, generation: 2, left_out: 0 };
        let mark = Mark { revision: 3, there, instance: Instance::FIRST, here: 4, lost: 0 };
        Entry { key: key.to_string(), mark }
    }

    #[test]
    fn topics_that_are_gone_stay_noted_until_newer_ones_need_the_room() {
        let mut entries = Vec::new();
        for key in 0..ENTRIES_MAX + 2 {
            let known = BTreeSet::from([key.to_string()]);
            entries = with_gone(vec![entry(key)], &entries, &known);
        }
        assert_eq!(entries.len(), ENTRIES_MAX);
        assert_eq!(entries[0], entry(ENTRIES_MAX + 1));
        assert_eq!(entries[ENTRIES_MAX - 1], entry(2), "0 and 1 are the oldest");
    }
}
