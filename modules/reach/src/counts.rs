//! What has crossed of one topic, counted by whoever moves it and read by whoever
//! tells.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

#[derive(Debug, Default)]
pub(crate) struct Counts {
    pub(crate) messages: AtomicU64,
    pub(crate) bytes: AtomicU64,
    pub(crate) lost: AtomicU64,
    pub(crate) refused: AtomicU64,
    /// Of an export: messages that nobody wanted. It outlives interruptions, as the
    /// receivers compare it.
    pub(crate) left_out: AtomicU32,
}

impl Counts {
    pub(crate) fn count_message(&self, bytes: usize) {
        self.messages.fetch_add(1, Ordering::Relaxed);
        self.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    pub(crate) fn count_lost(&self, lost: u64) {
        self.lost.fetch_add(lost, Ordering::Relaxed);
    }

    pub(crate) fn count_refused(&self) {
        self.refused.fetch_add(1, Ordering::Relaxed);
    }

    /// Adds, and says how many they are now.
    pub(crate) fn leave_out(&self, messages: u32) -> u32 {
        self.left_out.fetch_add(messages, Ordering::Relaxed).wrapping_add(messages)
    }
}
