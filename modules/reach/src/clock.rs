//! What another machine's clock says, as PX4's timesync finds out.
//!
//! We ask what time it is. The answer was written at some moment between the
//! question and its arrival: so the middle of both is wrong by half the round trip
//! at most, whatever the link does. Of the answers of the last minutes those of the
//! shortest round trips say the most; the line through two of them is the drift.

use std::collections::VecDeque;

/// The answers that are kept, one a second.
const ANSWERS_MAX: usize = 300;

/// By how much two crystals differ at most.
const DRIFT_MAX_PPM: f64 = 100.0;

#[derive(Clone, Copy, Debug)]
struct Answer {
    /// The middle between question and answer, by our clock.
    at_us: u64,
    /// Their clock minus ours.
    offset_us: i64,
    round_trip_us: u64,
}

/// What is known of another machine's clock.
#[derive(Clone, Debug, Default)]
pub(crate) struct Clock {
    answers: VecDeque<Answer>,
}

/// How two clocks differ at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Difference {
    /// Their clock minus ours.
    pub(crate) offset_us: i64,
    /// By how much it may be wrong.
    pub(crate) uncertainty_us: u64,
    /// By how much theirs runs fast, in millionths.
    pub(crate) drift_ppm: f64,
    pub(crate) round_trip_us: u64,
}

impl Clock {
    /// Takes an answer: their time, and ours when it was asked for and was here.
    pub(crate) fn learn(&mut self, asked_us: u64, theirs_us: u64, answered_us: u64) {
        let Some(round_trip_us) = answered_us.checked_sub(asked_us) else { return };
        let at_us = asked_us + round_trip_us / 2;
        // An answer that was overtaken by a later one says nothing new.
        if self.answers.back().is_some_and(|last| at_us <= last.at_us) {
            return;
        }
        let offset_us = theirs_us.wrapping_sub(at_us) as i64;
        let jumped = self.answers.back().is_some_and(|last| {
            let apart_us = last.offset_us.abs_diff(offset_us);
            apart_us > last.round_trip_us.saturating_add(round_trip_us) / 2 + 1_000_000
        });
        if jumped {
            // The other machine was started anew.
            self.answers.clear();
        }
        if self.answers.len() == ANSWERS_MAX {
            self.answers.pop_front();
        }
        self.answers.push_back(Answer { at_us, offset_us, round_trip_us });
    }

    /// How the clocks differ at this moment of ours. None: nobody has answered.
    pub(crate) fn difference(&self, at_us: u64) -> Option<Difference> {
        let (drift_ppm, doubt_ppm) = self.drift_ppm();
        let uncertainty_us = |answer: &Answer| {
            let age_us = at_us.abs_diff(answer.at_us) as f64;
            answer.round_trip_us.div_ceil(2) + (age_us * doubt_ppm * 1e-6).ceil() as u64
        };
        let best = self.answers.iter().min_by_key(|answer| uncertainty_us(answer))?;
        let since_us = at_us as f64 - best.at_us as f64;
        Some(Difference {
            offset_us: best.offset_us.saturating_add((since_us * drift_ppm * 1e-6).round() as i64),
            uncertainty_us: uncertainty_us(best),
            drift_ppm,
            round_trip_us: best.round_trip_us,
        })
    }

    /// The line through the best answer of the older half and that of the newer, and by
    /// how much it may be wrong: each end by half its round trip.
    fn drift_ppm(&self) -> (f64, f64) {
        let (older, newer) = self.answers.as_slices();
        let all: Vec<&Answer> = older.iter().chain(newer).collect();
        let (older, newer) = all.split_at(all.len() / 2);
        let best = |half: &[&Answer]| half.iter().min_by_key(|it| it.round_trip_us).map(|it| **it);
        let (Some(from), Some(to)) = (best(older), best(newer)) else {
            return (0.0, DRIFT_MAX_PPM);
        };
        let time_us = to.at_us.saturating_sub(from.at_us) as f64;
        let doubt_ppm = (from.round_trip_us + to.round_trip_us) as f64 / 2.0 / time_us * 1e6;
        if doubt_ppm >= DRIFT_MAX_PPM {
            return (0.0, DRIFT_MAX_PPM);
        }
        let moved_us = to.offset_us.saturating_sub(from.offset_us) as f64;
        let drift_ppm = (moved_us / time_us * 1e6).clamp(-DRIFT_MAX_PPM, DRIFT_MAX_PPM);
        (drift_ppm, doubt_ppm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A clock that is ahead by a second and gains 20 us a second, asked once a second
    /// over a link that takes 1 ms there, and back anything up to 50 ms.
    fn asked(seconds: u64) -> Clock {
        let mut clock = Clock::default();
        for second in 0..seconds {
            let asked_us = second * 1_000_000;
            let there_us = asked_us + 1_000;
            let back_us = 1_000 + (second * 7_919) % 49_000;
            clock.learn(asked_us, there_us + 1_000_000 + second * 20, there_us + back_us);
        }
        clock
    }

    #[test]
    fn the_offset_is_within_the_uncertainty_and_the_drift_is_found() {
        for seconds in [1, 2, 5, 20, 200, 1_000] {
            let at_us = (seconds - 1) * 1_000_000;
            let known = asked(seconds).difference(at_us).unwrap();
            let truly_us = 1_000_000 + (seconds as i64 - 1) * 20;
            let wrong_us = known.offset_us.abs_diff(truly_us);
            assert!(wrong_us <= known.uncertainty_us, "{seconds} s: {known:?}");
        }
        // A link that is no better one way than the other.
        let mut even = Clock::default();
        for second in 0..60 {
            let asked_us = second * 1_000_000;
            even.learn(asked_us, asked_us + 500 + second * 20, asked_us + 1_000);
        }
        let drift_ppm = even.difference(60_000_000).unwrap().drift_ppm;
        assert!((drift_ppm - 20.0).abs() < 1.0, "{drift_ppm}");
    }

    #[test]
    fn a_machine_that_was_started_anew_has_another_clock() {
        let mut clock = asked(30);
        clock.learn(30_000_000, 5_000_000, 30_000_400);
        let known = clock.difference(30_000_200).unwrap();
        assert_eq!(known.offset_us, 5_000_000 - 30_000_200);
        assert_eq!(Clock::default().difference(0), None);
    }

    #[test]
    fn answers_that_come_out_of_order_or_are_absurd_do_no_harm() {
        let mut clock = Clock::default();
        clock.learn(1_000_000, 1_500_000, 1_000_400);
        clock.learn(2_000_000, 2_500_000, 2_000_400);
        let known = clock.difference(2_000_200);
        clock.learn(0, 500_000, 1_500_000);
        clock.learn(2_000_000, 9_500_000, 2_000_400);
        assert_eq!(clock.difference(2_000_200), known, "not later than what is known");
        // Whatever another machine says, within a jump of both ends of time.
        for theirs_us in [u64::MAX / 2 + 3_000_000, u64::MAX / 2 + 4_900_000, 0, u64::MAX] {
            let asked_us = clock.answers.back().unwrap().at_us + 1_000_000;
            clock.learn(asked_us, theirs_us, asked_us + 400);
            clock.difference(u64::MAX).unwrap();
        }
    }
}
