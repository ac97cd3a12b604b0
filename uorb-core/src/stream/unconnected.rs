//! The ports that another one could not connect to, so that it tries again.
//!
//! iceoryx2 looks at a new port once. Where connecting fails, because the other is
//! just being made, or taken down by somebody else, or there is no descriptor
//! left, it looks again only when some port comes or goes, and what is sent
//! meanwhile is lost. So each port of ours notes whom it missed, and a little
//! later, if they are still there, lets a port come and go.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use iceoryx2::port::{DegradationAction, DegradationCause, DegradationInfo};

use crate::clock::now_us;

/// How long after a failure the next try is: twice as long after each that
/// failed, too. Most obstacles last some microseconds.
const FIRST_PAUSE_US: u64 = 1_000;
const LONGEST_PAUSE_US: u64 = 1_000_000;

/// Those whom one port has missed.
#[derive(Debug, Default)]
pub(super) struct Unconnected {
    noted: Arc<Noted>,
    pause_us: u64,
    /// When to try next; 0: nobody is missed.
    due_us: u64,
}

#[derive(Debug, Default)]
struct Noted {
    any: AtomicBool,
    /// Their ids; and some that are gone.
    ports: Mutex<Vec<u128>>,
}

impl Unconnected {
    /// What notes a failure, for iceoryx2 to call. `port` says who was missed.
    pub(super) fn handler(
        &self,
        port: fn(&DegradationInfo) -> u128,
    ) -> impl Fn(DegradationCause, &DegradationInfo) -> DegradationAction + Send + 'static {
        let noted = self.noted.clone();
        move |cause, info| match cause {
            DegradationCause::FailedToEstablishConnection => {
                noted.ports.lock().unwrap_or_else(PoisonError::into_inner).push(port(info));
                noted.any.store(true, Ordering::Relaxed);
                DegradationAction::Ignore
            }
            DegradationCause::ConnectionCorrupted => DegradationAction::Warn,
        }
    }

    /// Whether anybody was missed: one load.
    #[inline]
    pub(super) fn any(&self) -> bool {
        self.noted.any.load(Ordering::Relaxed)
    }

    /// Whether it is time to try again, for one that `is_there` still.
    #[cold]
    pub(super) fn is_due(&mut self, is_there: impl Fn(u128) -> bool) -> bool {
        self.is_due_at(now_us(), is_there)
    }

    fn is_due_at(&mut self, now_us: u64, is_there: impl Fn(u128) -> bool) -> bool {
        if self.due_us == 0 {
            self.pause_us = FIRST_PAUSE_US;
            self.due_us = now_us + self.pause_us;
        }
        if now_us < self.due_us {
            return false;
        }
        let mut ports = self.noted.ports.lock().unwrap_or_else(PoisonError::into_inner);
        ports.retain(|port| is_there(*port));
        if ports.is_empty() {
            self.noted.any.store(false, Ordering::Relaxed);
            self.due_us = 0;
            return false;
        }
        // Whoever is missed again is noted again, and for longer.
        ports.clear();
        self.pause_us = (2 * self.pause_us).min(LONGEST_PAUSE_US);
        self.due_us = now_us + self.pause_us;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MISSED: u128 = 7;

    fn missed() -> Unconnected {
        let unconnected = Unconnected::default();
        let info = DegradationInfo { service_id: 0, sender_port_id: MISSED, receiver_port_id: 8 };
        let handler = unconnected.handler(|info| info.sender_port_id);
        assert_eq!(
            handler(DegradationCause::FailedToEstablishConnection, &info),
            DegradationAction::Ignore
        );
        unconnected
    }

    #[test]
    fn who_is_still_there_is_tried_after_a_pause_that_grows() {
        let mut unconnected = missed();
        let mut now_us = 1;
        assert!(unconnected.any() && !unconnected.is_due_at(now_us, |port| port == MISSED));
        let mut pauses = Vec::new();
        for _ in 0..12 {
            let begin_us = now_us;
            while !unconnected.is_due_at(now_us, |port| port == MISSED) {
                now_us += 500;
            }
            pauses.push((now_us - begin_us) / 1_000);
            // It fails again.
            unconnected.noted.ports.lock().unwrap().push(MISSED);
        }
        assert_eq!(pauses, [1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1_000, 1_000]);
    }

    #[test]
    fn who_is_gone_is_forgotten_and_the_next_failure_is_tried_soon() {
        let mut unconnected = missed();
        assert!(!unconnected.is_due_at(1, |_| false));
        assert!(!unconnected.is_due_at(1 + FIRST_PAUSE_US, |_| false));
        assert!(!unconnected.any());

        let again = missed();
        unconnected.noted = again.noted;
        assert!(!unconnected.is_due_at(10_000, |_| true));
        assert!(unconnected.is_due_at(10_000 + FIRST_PAUSE_US, |_| true));
    }

    #[test]
    fn who_was_connected_at_the_second_try_is_forgotten() {
        let mut unconnected = missed();
        assert!(!unconnected.is_due_at(1, |_| true));
        assert!(unconnected.is_due_at(1 + FIRST_PAUSE_US, |_| true));
        assert!(!unconnected.is_due_at(1 + 3 * FIRST_PAUSE_US, |_| true));
        assert!(!unconnected.any());
    }
}
