//! What another machine's clock says, as PX4's timesync finds out.
//!
//! We ask what time it is. The answer was written at some moment between the
//! question and its arrival: so the middle of both is wrong by half the round trip
//! at most, whatever the link does. Of the answers of the last minute those of the
//! shortest round trips say the most; the line through them is the drift.

use std::collections::VecDeque;

/// The answers that are kept, one a second.
const ANSWERS_MAX: usize = 60;

/// How long answers have to be apart before they say anything about the drift.
const DRIFT_AFTER_US: u64 = 10_000_000;

/// By how much two crystals may differ at most, while no drift is known.
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
        let offset_us = theirs_us.wrapping_sub(at_us) as i64;
        let jumped = self.answers.back().is_some_and(|last| {
            let apart_us = last.offset_us.abs_diff(offset_us);
            apart_us > (last.round_trip_us + round_trip_us) / 2 + 1_000_000
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
        let best = self.answers.iter().min_by_key(|answer| answer.round_trip_us)?;
        let drift = self.drift_ppm();
        let age_us = at_us.abs_diff(best.at_us) as f64;
        let since_us = at_us as f64 - best.at_us as f64;
        let moved_us = since_us * drift.unwrap_or(0.0) * 1e-6;
        let doubt_ppm = if drift.is_some() { DRIFT_MAX_PPM / 10.0 } else { DRIFT_MAX_PPM };
        let uncertainty_us = best.round_trip_us.div_ceil(2) + (age_us * doubt_ppm * 1e-6) as u64;
        Some(Difference {
            offset_us: best.offset_us + moved_us as i64,
            uncertainty_us,
            drift_ppm: drift.unwrap_or(0.0),
            round_trip_us: best.round_trip_us,
        })
    }

    /// The slope of the line through the better half of the answers.
    fn drift_ppm(&self) -> Option<f64> {
        let (first, last) = (self.answers.front()?, self.answers.back()?);
        if last.at_us - first.at_us < DRIFT_AFTER_US {
            return None;
        }
        let mut better: Vec<Answer> = self.answers.iter().copied().collect();
        better.sort_by_key(|answer| answer.round_trip_us);
        better.truncate(better.len().div_ceil(2));
        let count = better.len() as f64;
        let at = |answer: &Answer| (answer.at_us - first.at_us) as f64;
        let offset = |answer: &Answer| (answer.offset_us - first.offset_us) as f64;
        let mean_at = better.iter().map(at).sum::<f64>() / count;
        let mean_offset = better.iter().map(offset).sum::<f64>() / count;
        let spread: f64 = better.iter().map(|it| (at(it) - mean_at).powi(2)).sum();
        let together: f64 =
            better.iter().map(|it| (at(it) - mean_at) * (offset(it) - mean_offset)).sum();
        (spread > 0.0).then(|| (together / spread * 1e6).clamp(-DRIFT_MAX_PPM, DRIFT_MAX_PPM))
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
        for seconds in [1, 5, 20, 200] {
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
        assert!((drift_ppm - 20.0).abs() < 0.1, "{drift_ppm}");
    }

    #[test]
    fn a_machine_that_was_started_anew_has_another_clock() {
        let mut clock = asked(30);
        clock.learn(30_000_000, 5_000_000, 30_000_400);
        let known = clock.difference(30_000_200).unwrap();
        assert_eq!(known.offset_us, 5_000_000 - 30_000_200);
        assert_eq!(Clock::default().difference(0), None);
    }
}
