//! The least time between two updates of a subscription.
//!
//! A subscription with an interval sees the first update at once, and then one
//! an interval at most; what was published meanwhile is pending when the
//! interval ends. The pacing is PX4's (SubscriptionInterval.cpp): the next
//! interval counts from when this update was due, not from when it was copied,
//! so that a late copy costs no rate. After a pause two updates may follow each
//! other closely; the very first one begins the count.

/// An interval, and the update it counts from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    pub(crate) interval_us: u64,
    /// None before the first update.
    last_us: Option<u64>,
}

impl Pace {
    /// The first update is due at once.
    pub(crate) fn new(interval_us: u64) -> Self {
        Self { interval_us, last_us: None }
    }

    /// When the next update is due.
    pub(crate) fn due_us(&self) -> u64 {
        self.last_us.map_or(0, |last_us| last_us.saturating_add(self.interval_us))
    }

    /// Counts on from an update that was copied now.
    pub(crate) fn copied(&mut self, now_us: u64) {
        let earliest = now_us.saturating_sub(self.interval_us);
        let counted = self.last_us.map_or(now_us, |_| self.due_us().clamp(earliest, now_us));
        self.last_us = Some(counted);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_copies_lose_no_rate() {
        let mut pace = Pace::new(100);
        assert!(pace.due_us() <= 1_000, "the first update is due at once");
        pace.copied(1_000);
        assert_eq!(pace.due_us(), 1_100, "and begins the count");
        let mut copies = 0;
        // A reader that looks every 30 us is late by up to 29 us each time.
        for now_us in (1_000..11_000).step_by(30) {
            if now_us >= pace.due_us() {
                pace.copied(now_us);
                copies += 1;
            }
        }
        assert_eq!(copies, 99, "one for each hundred from 1,100 to 10,900");
    }

    #[test]
    fn after_a_pause_there_is_no_burst() {
        let mut pace = Pace::new(100);
        pace.copied(1_000);
        pace.copied(5_000);
        assert_eq!(pace.due_us(), 5_000, "one update may follow at once");
        pace.copied(5_000);
        assert_eq!(pace.due_us(), 5_100, "the next may not");
    }
}
