//! When lost messages are worth a word.
//!
//! Whoever loses messages is too slow already: a word for each gap would make it
//! slower, and nobody could read them. So the first loss is told at once, and
//! what follows is summed up, a line a second at most.

use std::time::{Duration, Instant};

const INTERVAL: Duration = Duration::from_secs(1);

/// What was said of lost messages.
#[derive(Debug, Default)]
pub(super) struct Losses {
    told: u64,
    told_at: Option<Instant>,
}

impl Losses {
    /// Of `lost` messages that are lost by now, how many to speak of; None for
    /// the moment.
    pub(super) fn worth_saying(&mut self, lost: u64, now: Instant) -> Option<u64> {
        let more = lost.saturating_sub(self.told);
        let is_early = self.told_at.is_some_and(|at| now < at + INTERVAL);
        if more == 0 || is_early {
            return None;
        }
        (self.told, self.told_at) = (lost, Some(now));
        Some(more)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_loss_is_told_at_once_and_the_rest_once_a_second() {
        let mut losses = Losses::default();
        let start = Instant::now();
        let mut after_ms = |ms, lost| losses.worth_saying(lost, start + Duration::from_millis(ms));
        assert_eq!(after_ms(0, 0), None);
        assert_eq!(after_ms(1, 7), Some(7));
        assert_eq!(after_ms(2, 9), None);
        assert_eq!(after_ms(1_000, 10), None);
        assert_eq!(after_ms(1_001, 10), Some(3));
        assert_eq!(after_ms(3_000, 10), None);
    }
}
