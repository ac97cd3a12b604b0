//! What a message looks like on the way: a header of 32 bytes, and its own bytes.
//!
//! | byte | | |
//! |---|---|---|
//! | 0 | `u8` | the version of this format |
//! | 1 | `u8` | the priority of the publisher |
//! | 2 | `u16` | how many messages a node of the topic keeps |
//! | 4 | `u32` | the revision of the topic: a hash of its layout, and of where its generations began |
//! | 8 | `u32` | how many bytes the message has |
//! | 12 | `u32` | which run of which reach has sent it |
//! | 16 | `u32` | the message's generation |
//! | 20 | `u32` | how many messages this run has left out because nobody wanted them |
//! | 24 | `u64` | when it was published, in microseconds of the sender's CLOCK_MONOTONIC |
//!
//! Numbers are little-endian. Where generations are missing that were not left out,
//! messages were lost: [`Count::lost_since`].

use serde::{Deserialize, Serialize};
use uorb_core::{Layout, LayoutFault, Metadata, Priority, QueueLength};

pub(crate) const VERSION: u8 = 1;
pub(crate) const HEADER_BYTES: usize = 32;

/// What there is to know of a topic before its messages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct About {
    pub(crate) metadata: Metadata,
    pub(crate) priority: Priority,
    /// The system it is on, and where the node began to count: generations of
    /// another system, or another node, are others.
    pub(crate) counts_from: (u64, u64),
}

/// Why a description that came over the network is not believed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum NotSound {
    /// Another one is announced by now: ask again.
    #[error("its description is not the one that was announced")]
    Revision,
    #[error("its description is none")]
    Description,
    #[error("its description names another topic")]
    Name,
    #[error(transparent)]
    Layout(#[from] LayoutFault),
}

impl About {
    pub(crate) fn encode(&self) -> Vec<u8> {
        postcard::to_stdvec(self).expect("a vector takes any description")
    }

    /// Reads what another machine says of a topic.
    pub(crate) fn decode(bytes: &[u8], topic: &str, revision: u32) -> Result<Self, NotSound> {
        let about: Self = postcard::from_bytes(bytes).map_err(|_| NotSound::Description)?;
        if about.revision() != revision {
            return Err(NotSound::Revision);
        }
        if about.metadata.name != topic {
            return Err(NotSound::Name);
        }
        about.metadata.layout.check()?;
        Ok(about)
    }

    /// What tells its messages from those that the topic had, or will have. The priority
    /// is none of it, which changes as publishers come and go: what is on its way then is
    /// as good as before.
    pub(crate) fn revision(&self) -> u32 {
        let what = (&self.metadata.layout, self.counts_from);
        fnv(&postcard::to_stdvec(&what).expect("a vector takes any description"))
    }

    pub(crate) fn layout(&self) -> &Layout {
        &self.metadata.layout
    }
}

/// FNV-1a, 32 bits.
fn fnv(bytes: &[u8]) -> u32 {
    let step = |hash: u32, byte: &u8| (hash ^ u32::from(*byte)).wrapping_mul(0x0100_0193);
    bytes.iter().fold(0x811c_9dc5, step)
}

/// Where a message stands among those of its topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Count {
    pub(crate) run: u32,
    pub(crate) generation: u32,
    pub(crate) left_out: u32,
}

/// What stands before a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Header {
    pub(crate) priority: Priority,
    pub(crate) queue_length: QueueLength,
    pub(crate) revision: u32,
    pub(crate) size_bytes: u32,
    pub(crate) count: Count,
    pub(crate) publish_time_us: u64,
}

impl Header {
    pub(crate) fn encode(&self, message: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER_BYTES + message.len());
        bytes.push(VERSION);
        bytes.push(self.priority.0);
        bytes.extend_from_slice(&(self.queue_length.get() as u16).to_le_bytes());
        let Count { run, generation, left_out } = self.count;
        for word in [self.revision, self.size_bytes, run, generation, left_out] {
            bytes.extend_from_slice(&word.to_le_bytes());
        }
        bytes.extend_from_slice(&self.publish_time_us.to_le_bytes());
        bytes.extend_from_slice(message);
        bytes
    }

    /// Reads a header and the message behind it. None: it is not of this format,
    /// or has another size than it says.
    pub(crate) fn decode(bytes: &[u8]) -> Option<(Self, &[u8])> {
        let (header, message) = bytes.split_first_chunk::<HEADER_BYTES>()?;
        let word = |at: usize| u32::from_le_bytes(*header[at..].first_chunk().expect("within 32"));
        let queue_length = u16::from_le_bytes([header[2], header[3]]);
        let header = Self {
            priority: Priority(header[1]),
            queue_length: QueueLength::new(queue_length.into())?,
            revision: word(4),
            size_bytes: word(8),
            count: Count { run: word(12), generation: word(16), left_out: word(20) },
            publish_time_us: u64::from(word(24)) | u64::from(word(28)) << 32,
        };
        (bytes[0] == VERSION && header.size_bytes as usize == message.len())
            .then_some((header, message))
    }
}

impl Count {
    /// How many messages are missing between an earlier one and this one. None:
    /// this one is not the later one.
    pub(crate) fn lost_since(&self, earlier: &Self) -> Option<u32> {
        let steps = self.generation.wrapping_sub(earlier.generation);
        if steps == 0 || steps > u32::MAX / 2 {
            return None;
        }
        // Another run began to count anew what it leaves out.
        let before = if self.run == earlier.run { earlier.left_out } else { 0 };
        let left_out = self.left_out.wrapping_sub(before);
        Some((steps - 1).saturating_sub(left_out))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(generation: u32, left_out: u32) -> Count {
        Count { run: 9, generation, left_out }
    }

    fn header(generation: u32, left_out: u32) -> Header {
        Header {
            priority: Priority::HIGH,
            queue_length: QueueLength::at_least(16),
            revision: 0x0123_4567,
            size_bytes: 3,
            count: count(generation, left_out),
            publish_time_us: 0x0123_4567_89ab_cdef,
        }
    }

    #[test]
    fn a_message_is_read_as_it_was_written_and_not_a_byte_shorter() {
        let written = header(7, 1).encode(b"abc");
        assert_eq!(Header::decode(&written), Some((header(7, 1), &b"abc"[..])));
        assert_eq!(written.len(), HEADER_BYTES + 3);
        (0..written.len()).for_each(|end| assert_eq!(Header::decode(&written[..end]), None));
        for (at, wrong) in [(0, 9), (2, 3), (8, 4)] {
            let mut bytes = written.clone();
            bytes[at] = wrong;
            assert_eq!(Header::decode(&bytes), None, "byte {at}");
        }
    }

    #[test]
    fn what_is_missing_and_was_not_left_out_is_lost() {
        assert_eq!(count(8, 0).lost_since(&count(7, 0)), Some(0));
        assert_eq!(count(10, 0).lost_since(&count(7, 0)), Some(2));
        assert_eq!(count(17, 9).lost_since(&count(7, 0)), Some(0), "a rate was asked for");
        assert_eq!(count(18, 9).lost_since(&count(7, 0)), Some(1));
        assert_eq!(count(2, 0).lost_since(&count(u32::MAX, 0)), Some(2), "across the wrap");
        assert_eq!(count(7, 0).lost_since(&count(7, 0)), None, "the same again");
        assert_eq!(count(6, 0).lost_since(&count(7, 0)), None, "out of order");
        let restarted = Count { run: 10, ..count(20, 2) };
        assert_eq!(restarted.lost_since(&count(7, 100)), Some(10));
    }

    #[test]
    fn a_description_is_believed_if_it_is_the_one_that_was_announced() {
        let metadata = uorb_core::Metadata {
            name: "logger_status".into(),
            layout: std::borrow::Cow::Borrowed(
                <uorb_msg::LoggerStatus as uorb_core::Message>::LAYOUT,
            ),
            queue_length: QueueLength::ONE,
        };
        let about = About { metadata, priority: Priority::DEFAULT, counts_from: (1, 2) };
        let (bytes, revision) = (about.encode(), about.revision());
        assert_eq!(About::decode(&bytes, "logger_status", revision).unwrap(), about);
        assert!(matches!(About::decode(&bytes, "other", revision), Err(NotSound::Name)));
        let stale = About::decode(&bytes, "logger_status", revision + 1);
        assert!(matches!(stale, Err(NotSound::Revision)));
        let joined = About { priority: Priority::HIGH, ..about.clone() };
        assert_eq!(joined.revision(), revision, "another publisher, the same messages");
        let anew = About { counts_from: (1, 3), ..about.clone() };
        assert_ne!(anew.revision(), revision, "another node");
        for end in 0..bytes.len() {
            assert!(About::decode(&bytes[..end], "logger_status", revision).is_err());
        }
        let mut large = about.clone();
        large.metadata.layout.to_mut().size_bytes = 0;
        let decoded = About::decode(&large.encode(), "logger_status", large.revision());
        assert!(matches!(decoded, Err(NotSound::Layout(_))));
    }
}
