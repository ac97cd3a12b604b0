//! What a reach that is killed leaves to the next one: from where it counts.
//!
//! Generations are dense, there and here. So of a topic that comes in one pair is
//! enough, a message's generation there and the one under which it was published
//! here: whatever has come since, so many are missing as there were more there than
//! here. The pair is noted when counting begins, which is seldom.

use std::fs;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use uorb_core::broker_side::Node;
use uorb_core::{Instance, Session, System};

use crate::keys::Remote;
use crate::wire::Count;

/// From where a topic is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Mark {
    /// Which description the generations are of.
    pub(crate) revision: u32,
    /// A message there.
    pub(crate) there: Count,
    /// The same message here: the low half of its generation.
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
    pub(crate) instance: Instance,
    pub(crate) mark: Mark,
}

/// The file in which it is noted, in the directory of the system.
#[derive(Debug)]
pub(crate) struct Ledger {
    path: PathBuf,
    unfinished: PathBuf,
    entries: Vec<Entry>,
}

impl Ledger {
    /// What the one before has left. That it is not there, or not whole, is as if it
    /// had left nothing.
    pub(crate) fn open(session: &Session) -> Self {
        let system: &System = session.system();
        let (path, unfinished) = (system.reach(), system.unfinished().join("reach"));
        let text = fs::read_to_string(&path).unwrap_or_default();
        Self { path, unfinished, entries: serde_json::from_str(&text).unwrap_or_default() }
    }

    pub(crate) fn entry(&self, remote: &Remote) -> Option<&Entry> {
        let key = remote.key();
        self.entries.iter().find(|entry| entry.key == key)
    }

    /// Notes what there is now, if it is not what there was. What the reach before us
    /// has left stays for topics that have not come back yet.
    pub(crate) fn note(&mut self, mut entries: Vec<Entry>, is_known: impl Fn(&str) -> bool) {
        entries.extend(self.entries.iter().filter(|entry| !is_known(&entry.key)).cloned());
        if entries == self.entries {
            return;
        }
        let text = serde_json::to_string(&entries).expect("numbers and names");
        self.entries = entries;
        // Where it cannot be written, the next one counts from its own beginning.
        let _ = fs::write(&self.unfinished, text)
            .and_then(|()| fs::rename(&self.unfinished, &self.path));
    }
}
