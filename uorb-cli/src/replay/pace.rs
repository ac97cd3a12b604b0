//! When to publish what was recorded when.
//!
//! A log is written in rounds over all topics, so its messages stand in it in
//! nearly the order of their timestamps, and they are published in that order:
//! each when its timestamp has come, or at once if it has passed. Two kinds of
//! message need care. Those from long before the log began (the last value of a
//! topic that rarely speaks) do not move the time. And a timestamp far in the
//! future, which real logs have where a module stamped wrongly, would hold up
//! all messages behind it: such a message is published where it stands.

use std::collections::VecDeque;
use std::fmt;
use std::str::FromStr;
use std::time::{Duration, Instant};

/// How far a timestamp may be ahead of those behind it. They lag by the length
/// of a round, some milliseconds, and by the age of what rarely speaks.
const AHEAD_MAX_US: u64 = 1_000_000;

/// How many messages behind it are asked whether a message is ahead of its time.
const FOLLOWERS: usize = 32;

/// How fast to replay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Speed {
    /// So many times as fast as it was recorded.
    Times(f64),
    /// As fast as it goes.
    Max,
}

impl FromStr for Speed {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text.strip_suffix(['x', 'X']).unwrap_or(text).parse::<f64>() {
            _ if text == "max" => Ok(Self::Max),
            Ok(times) if times.is_finite() && times > 0.0 => Ok(Self::Times(times)),
            _ => Err("neither a number above 0 nor `max`"),
        }
    }
}

impl Speed {
    /// When a message is due that stands `position_us` behind the beginning.
    /// None: now; `Some(None)`: never.
    fn due(self, start: Instant, position_us: u64) -> Option<Option<Instant>> {
        let Self::Times(times) = self else { return None };
        let after = match times {
            // Exact, however long the log is.
            1.0 => Ok(Duration::from_micros(position_us)),
            _ => Duration::try_from_secs_f64(position_us as f64 / 1e6 / times),
        };
        Some(after.ok().and_then(|after| start.checked_add(after)))
    }
}

impl fmt::Display for Speed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Times(times) => write!(f, "{times}x"),
            Self::Max => f.write_str("max"),
        }
    }
}

/// The most and the least that the keys make of a speed.
const TIMES_MAX: f64 = 1_024.0;

/// When messages are due, at a speed that may change on the way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    speed: Speed,
    is_paused: bool,
    /// From this moment on the speed holds,
    since: Instant,
    /// and this is where in the log we were then.
    from_us: u64,
    /// Where the newest message stands that went out.
    reached_us: u64,
}

/// When a message is to go out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Due {
    Now,
    /// None: after more time than there is.
    At(Option<Instant>),
    /// When somebody says so.
    Paused,
}

impl Pace {
    pub(super) fn begin(speed: Speed, is_paused: bool, from_us: u64) -> Self {
        Self { speed, is_paused, since: Instant::now(), from_us, reached_us: from_us }
    }

    /// When a message is due that stands here.
    pub(super) fn due(&self, position_us: u64) -> Due {
        if self.is_paused {
            return Due::Paused;
        }
        match self.speed.due(self.since, position_us.saturating_sub(self.from_us)) {
            None => Due::Now,
            Some(due) => Due::At(due),
        }
    }

    /// A message went out that stands here.
    pub(super) fn reach(&mut self, position_us: u64) {
        self.reached_us = position_us;
    }

    /// Goes on from here, as if nothing had been before.
    pub(super) fn restart(&mut self, from_us: u64) {
        *self = Self::begin(self.speed, self.is_paused, from_us);
    }

    /// Where in the log it is now, and from where on another speed will hold.
    fn settle(&mut self, now: Instant) {
        if let (Speed::Times(times), false) = (self.speed, self.is_paused) {
            let passed_us = now.saturating_duration_since(self.since).as_micros() as f64 * times;
            self.from_us = self.from_us.saturating_add(passed_us as u64);
        }
        self.from_us = self.from_us.max(self.reached_us);
        self.since = now;
    }

    pub(super) fn pause_or_go_on(&mut self, now: Instant) {
        self.settle(now);
        self.is_paused = !self.is_paused;
    }

    pub(super) fn faster(&mut self, now: Instant) {
        self.settle(now);
        if let Speed::Times(times) = self.speed {
            self.speed = Speed::Times((times * 2.0).min(TIMES_MAX.max(times)));
        }
    }

    /// Half as fast; what was as fast as it goes, as it was recorded.
    pub(super) fn slower(&mut self, now: Instant) {
        self.settle(now);
        self.speed = Speed::Times(match self.speed {
            Speed::Max => 1.0,
            Speed::Times(times) => (times / 2.0).max(times.min(1.0 / TIMES_MAX)),
        });
    }
}

/// `2x`, `2x, paused`
impl fmt::Display for Pace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.speed, if self.is_paused { ", paused" } else { "" })
    }
}

/// Where in the log's own time we are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clock {
    origin_us: u64,
    position_us: u64,
}

impl Clock {
    /// `origin_us` is the timestamp with which the log begins.
    pub(super) fn new(origin_us: u64) -> Self {
        Self { origin_us, position_us: 0 }
    }

    /// Where the next message stands, in microseconds from the beginning. Never
    /// goes back.
    pub(super) fn advance(&mut self, timestamp_us: Option<u64>, is_ahead: bool) -> u64 {
        if let (Some(timestamp_us), false) = (timestamp_us, is_ahead) {
            let position_us = timestamp_us.saturating_sub(self.origin_us);
            self.position_us = self.position_us.max(position_us);
        }
        self.position_us
    }
}

/// Finds the messages that are ahead of their time: most of those behind them
/// are earlier, and by far.
#[derive(Debug, Default)]
pub(crate) struct Judge {
    /// Number and timestamp of messages that are not judged yet.
    waiting: VecDeque<(u64, u64)>,
}

/// What the judge says of one message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Judged {
    pub(super) number: u64,
    pub(super) timestamp_us: u64,
    pub(super) is_ahead: bool,
}

impl Judge {
    /// Takes a message, and judges the one that by now has enough behind it.
    pub(crate) fn push(&mut self, number: u64, timestamp_us: u64) -> Option<Judged> {
        self.waiting.push_back((number, timestamp_us));
        (self.waiting.len() > FOLLOWERS).then(|| self.pop()).flatten()
    }

    /// Judges the next of those that are left at the end.
    pub(crate) fn pop(&mut self) -> Option<Judged> {
        let (number, timestamp_us) = self.waiting.pop_front()?;
        let is_far_behind = |(_, follower_us): &&(u64, u64)| {
            follower_us.saturating_add(AHEAD_MAX_US) < timestamp_us
        };
        let far_behind = self.waiting.iter().filter(is_far_behind).count();
        let is_ahead = far_behind * 2 > self.waiting.len();
        Some(Judged { number, timestamp_us, is_ahead })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_speed_is_a_number_above_0_or_max() {
        assert_eq!("max".parse(), Ok(Speed::Max));
        assert_eq!("2".parse(), Ok(Speed::Times(2.0)));
        assert_eq!("0.25x".parse(), Ok(Speed::Times(0.25)));
        for text in ["0", "-1", "inf", "nan", "", "x", "fast", "maxx"] {
            assert!(text.parse::<Speed>().is_err(), "{text}");
        }
    }

    #[test]
    fn the_moment_is_counted_from_the_start_and_so_never_drifts() {
        let start = Instant::now();
        let due = |speed: Speed, position_us| speed.due(start, position_us);
        let after = |duration| Some(Some(start + duration));
        // A log of a hundred days.
        let position_us = 100 * 86_400 * 1_000_000 + 1;
        assert_eq!(due(Speed::Times(1.0), position_us), after(Duration::from_micros(position_us)));
        assert_eq!(due(Speed::Times(4.0), 1_000_000), after(Duration::from_millis(250)));
        assert_eq!(due(Speed::Times(0.5), 1_000_000), after(Duration::from_secs(2)));
        assert_eq!(due(Speed::Times(1e-300), 1_000_000), Some(None));
        assert_eq!(due(Speed::Max, 1_000_000), None);
    }

    #[test]
    fn a_pause_and_another_speed_hold_from_where_one_is() {
        let second = Duration::from_secs(1);
        let mut pace = Pace::begin(Speed::Times(1.0), false, 5_000_000);
        let start = pace.since;
        assert_eq!(pace.due(7_000_000), Due::At(Some(start + 2 * second)));
        pace.faster(start + second);
        assert_eq!(pace.due(7_000_000), Due::At(Some(start + second + second / 2)));
        pace.pause_or_go_on(start + second);
        assert_eq!((pace.due(0), pace.to_string()), (Due::Paused, "2x, paused".into()));
        // One step was made meanwhile.
        pace.reach(6_500_000);
        pace.pause_or_go_on(start + 9 * second);
        assert_eq!(pace.due(7_000_000), Due::At(Some(start + 9 * second + second / 4)));
        pace.slower(start + 9 * second);
        assert_eq!(pace.to_string(), "1x");
    }

    #[test]
    fn from_as_fast_as_it_goes_one_slows_down_to_as_it_was() {
        let mut pace = Pace::begin(Speed::Max, false, 0);
        assert_eq!(pace.due(u64::MAX), Due::Now);
        pace.faster(pace.since);
        assert_eq!(pace.to_string(), "max");
        pace.reach(3_000_000);
        pace.slower(pace.since);
        assert_eq!(pace.due(4_000_000), Due::At(Some(pace.since + Duration::from_secs(1))));
        (0..100).for_each(|_| pace.slower(pace.since));
        assert_eq!(pace.to_string(), format!("{}x", 1.0 / 1_024.0));
        (0..100).for_each(|_| pace.faster(pace.since));
        assert_eq!(pace.to_string(), "1024x");
    }

    #[test]
    fn the_time_never_goes_back_and_old_messages_do_not_move_it() {
        let mut clock = Clock::new(1_000);
        let timestamps = [Some(3), None, Some(1_000), Some(1_500), Some(1_400), None, Some(1_600)];
        let positions = timestamps.map(|timestamp_us| clock.advance(timestamp_us, false));
        assert_eq!(positions, [0, 0, 0, 500, 500, 500, 600]);
        assert_eq!(clock.advance(Some(u64::MAX), true), 600);
    }

    fn ahead(timestamps: &[u64]) -> Vec<u64> {
        let mut judge = Judge::default();
        let mut judged = Vec::new();
        for (number, &timestamp_us) in (0..).zip(timestamps) {
            judged.extend(judge.push(number, timestamp_us));
        }
        judged.extend(std::iter::from_fn(|| judge.pop()));
        assert_eq!(judged.len(), timestamps.len());
        judged.iter().filter(|judged| judged.is_ahead).map(|judged| judged.number).collect()
    }

    #[test]
    fn a_timestamp_from_the_future_is_found() {
        let mut timestamps: Vec<u64> = (0..200).map(|n| 5_000_000 + n * 4_000).collect();
        assert_eq!(ahead(&timestamps), [0; 0]);
        timestamps[0] = 1_000_000_000;
        timestamps[100] = u64::MAX;
        timestamps[180] = 900_000_000;
        assert_eq!(ahead(&timestamps), [0, 100, 180]);
    }

    #[test]
    fn a_gap_in_the_log_is_not_the_future() {
        let before = (0..50).map(|n| n * 1_000);
        let after = (0..50).map(|n| 3_600_000_000 + n * 1_000);
        assert_eq!(ahead(&before.chain(after).collect::<Vec<_>>()), [0; 0]);
    }

    #[test]
    fn old_messages_among_new_ones_do_not_make_the_new_ones_the_future() {
        let timestamps: Vec<u64> =
            (0..200).map(|n| if n % 3 == 0 { 1 } else { 5_000_000 + n * 4_000 }).collect();
        assert_eq!(ahead(&timestamps), [0; 0]);
    }
}
