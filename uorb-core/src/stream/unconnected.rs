//! The ports that another one could not connect to, so that it tries again.
//!
//! iceoryx2 looks at a new port once. Where connecting fails, because the other is
//! just being made, or taken down by somebody else, or there is no descriptor
//! left, it looks again only when some port comes or goes, and what is sent
//! meanwhile is lost. So each port of ours notes whom it missed, and, as long as
//! they are there, lets a port come and go.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use iceoryx2::port::{DegradationAction, DegradationCause, DegradationInfo};

use crate::clock::now_us;

/// How long it waits after a try that failed; each time twice as long as before.
/// Most obstacles last some microseconds.
const FIRST_PAUSE_US: u64 = 100;
const LONGEST_PAUSE_US: u64 = 1_000_000;
/// Who is still missed when it would wait longer than this is so for some time: in
/// the list of ports there are also the dead, as long as nobody cleans up.
const HOPEFUL_PAUSE_US: u64 = 2_000;

/// Those whom one port has missed.
#[derive(Debug, Default)]
pub(super) struct Unconnected {
    noted: Arc<Noted>,
    /// How long it waits for the next try; 0: there was none.
    pause_us: u64,
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

    /// Whether it will soon be so, or known to be lasting.
    pub(super) fn is_hopeful(&self) -> bool {
        self.pause_us <= HOPEFUL_PAUSE_US
    }

    /// Whether it is time to try again, for one that `is_there` still.
    pub(super) fn is_due(&mut self, is_there: impl Fn(u128) -> bool) -> bool {
        self.is_due_at(now_us(), is_there)
    }

    /// The port looks again at all of them: whoever is missed then is noted again.
    pub(super) fn forget(&self) {
        self.noted.ports.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    fn is_due_at(&mut self, now_us: u64, is_there: impl Fn(u128) -> bool) -> bool {
        if now_us < self.due_us {
            return false;
        }
        let mut ports = self.noted.ports.lock().unwrap_or_else(PoisonError::into_inner);
        ports.retain(|port| is_there(*port));
        if ports.is_empty() {
            self.noted.any.store(false, Ordering::Relaxed);
            (self.pause_us, self.due_us) = (0, 0);
            return false;
        }
        self.pause_us = (2 * self.pause_us).clamp(FIRST_PAUSE_US, LONGEST_PAUSE_US);
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
    fn who_is_still_there_is_tried_at_once_and_after_pauses_that_grow() {
        let mut unconnected = missed();
        let mut now_us = 1;
        let (mut pauses, mut hopes) = (Vec::new(), 0);
        for _ in 0..16 {
            let begin_us = now_us;
            assert!(unconnected.any());
            while !unconnected.is_due_at(now_us, |port| port == MISSED) {
                now_us += 100;
            }
            pauses.push((now_us - begin_us) / 100);
            hopes += u32::from(unconnected.is_hopeful());
        }
        let expected =
            [0, 1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1_024, 2_048, 4_096, 8_192, 10_000];
        assert_eq!(pauses, expected);
        assert_eq!(hopes, 5);
    }

    #[test]
    fn who_is_gone_is_forgotten() {
        let mut unconnected = missed();
        assert!(!unconnected.is_due_at(1, |_| false));
        assert!(!unconnected.any());
    }

    #[test]
    fn who_was_connected_at_the_second_try_is_forgotten_and_the_next_is_tried_at_once() {
        let mut unconnected = missed();
        assert!(unconnected.is_due_at(1, |_| true));
        unconnected.forget();
        assert!(!unconnected.is_due_at(1 + FIRST_PAUSE_US, |_| true));
        assert!(!unconnected.any());

        unconnected.noted = missed().noted;
        assert!(unconnected.is_due_at(1 + FIRST_PAUSE_US, |_| true));
    }
}
