//! Which of several sensors of a kind to believe.
//!
//! The best is the one with the highest priority among those that are usable:
//! advertised, and heard of lately. A sensor that is lost is replaced at once.
//! One that is better than the chosen one has to be usable for a while first,
//! so that a loose contact does not make the vehicle change its mind twice a
//! second. Between equals the chosen one stays.

use uorb_core::{Instance, Priority};

/// How long a better sensor must have been usable before it is chosen.
pub(crate) const SETTLING_US: u64 = 1_000_000;

/// A sensor, as far as it matters for the choice.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    pub(crate) instance: Instance,
    pub(crate) priority: Priority,
    /// Since when it is usable; None while it is not.
    pub(crate) usable_since_us: Option<u64>,
}

/// The sensor to use now; None if none is usable.
pub(crate) fn choose(
    candidates: &[Candidate],
    chosen: Option<Instance>,
    now_us: u64,
) -> Option<Instance> {
    let chosen = candidates.iter().find(|candidate| {
        Some(candidate.instance) == chosen && candidate.usable_since_us.is_some()
    });
    let is_eligible = |candidate: &&Candidate| match (candidate.usable_since_us, chosen) {
        (None, _) => false,
        (Some(_), None) => true,
        (Some(since_us), Some(chosen)) => {
            candidate.priority > chosen.priority && now_us.saturating_sub(since_us) >= SETTLING_US
        }
    };
    candidates
        .iter()
        .filter(is_eligible)
        // Of equals the lowest instance, which `max` finds last.
        .max_by_key(|candidate| (candidate.priority, std::cmp::Reverse(candidate.instance)))
        .or(chosen)
        .map(|candidate| candidate.instance)
}

/// Follows whether a sensor is usable. Call it at every look.
pub(crate) fn usable_since_us(
    before: Option<u64>,
    advertised: bool,
    last_publish_us: Option<u64>,
    now_us: u64,
    timeout_us: u64,
) -> Option<u64> {
    let last_us = last_publish_us?;
    let usable = advertised && now_us.saturating_sub(last_us) <= timeout_us;
    usable.then(|| before.unwrap_or(now_us))
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: u64 = 100_000_000;
    const LONG: Option<u64> = Some(NOW - SETTLING_US);
    const JUST: Option<u64> = Some(NOW - SETTLING_US + 1);
    const LOST: Option<u64> = None;

    fn chosen(sensors: [(u8, Option<u64>); 3], chosen: Option<u8>) -> Option<u8> {
        let candidates: Vec<_> = (0..)
            .zip(sensors)
            .map(|(number, (priority, usable_since_us))| Candidate {
                instance: Instance::new(number).unwrap(),
                priority: Priority(priority),
                usable_since_us,
            })
            .collect();
        choose(&candidates, chosen.and_then(Instance::new), NOW).map(Instance::number)
    }

    #[test]
    fn the_choice() {
        for (story, sensors, before, expected) in [
            ("at first the best", [(50, JUST), (100, JUST), (75, JUST)], None, Some(1)),
            ("of equals the first", [(75, LONG), (75, LONG), (50, LONG)], None, Some(0)),
            ("all is well", [(100, LONG), (75, LONG), (50, LONG)], Some(0), Some(0)),
            ("the best is lost", [(100, LOST), (75, LONG), (50, LONG)], Some(0), Some(1)),
            ("the next best is new", [(100, LOST), (75, JUST), (50, LONG)], Some(0), Some(1)),
            ("the second is lost, too", [(100, LOST), (75, LOST), (50, LONG)], Some(1), Some(2)),
            ("all are lost", [(100, LOST), (75, LOST), (50, LOST)], Some(2), None),
            ("the best is back just now", [(100, JUST), (75, LONG), (50, LONG)], Some(1), Some(1)),
            ("the best is back to stay", [(100, LONG), (75, LONG), (50, LONG)], Some(1), Some(0)),
            ("the worst is back first", [(100, LOST), (75, LOST), (50, JUST)], None, Some(2)),
            ("an equal is no better", [(75, LONG), (75, LONG), (50, LONG)], Some(1), Some(1)),
            ("two are better", [(50, LONG), (75, LONG), (100, LONG)], Some(0), Some(2)),
            (
                "the better is lost, the good is back",
                [(100, LOST), (75, LONG), (50, LONG)],
                Some(2),
                Some(1),
            ),
        ] {
            assert_eq!(chosen(sensors, before), expected, "{story}");
        }
        assert_eq!(choose(&[], None, NOW), None, "no sensors");
    }

    #[test]
    fn a_sensor_is_usable_while_it_is_advertised_and_speaks() {
        let look = |before, advertised, last_publish_us| {
            usable_since_us(before, advertised, last_publish_us, NOW, 100_000)
        };
        assert_eq!(look(None, true, None), None, "advertised, has never spoken");
        assert_eq!(look(None, true, Some(NOW - 4_000)), Some(NOW), "speaks for the first time");
        assert_eq!(look(Some(7), true, Some(NOW - 100_000)), Some(7), "goes on");
        assert_eq!(look(Some(7), true, Some(NOW - 100_001)), None, "is silent");
        assert_eq!(look(Some(7), false, Some(NOW - 4_000)), None, "was killed just now");
        assert_eq!(look(None, true, Some(NOW + 5)), Some(NOW), "has spoken since we looked");
    }
}
