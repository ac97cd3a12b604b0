//! What the modules share: how they end, and how they keep time.
//!
//! | to see how to | read |
//! |---|---|
//! | subscribe, wait, copy and publish | `px4_simple_app.rs` |
//! | wait for several topics at once | `color_counter.rs` |
//! | define a topic in code, and look without waiting | `random_integer.rs` |
//! | publish one topic from several processes, and tell them apart | `position.rs` |
//! | follow all instances and choose by priority | `sensors/` |
//! | publish many topics at rates of their own | `sensor_sim/` |
//! | answer commands | `commander/` |
//! | record a bus | `logger/` |
//!
//! A module is an ordinary program. It runs until Ctrl-C, SIGTERM or
//! `uorb stop`, and then leaves its `main` loop, so that its publications are
//! unadvertised on the way out. What it has to tell goes to stdout, and what went
//! wrong to stderr.

pub mod background;
pub mod color;
pub mod random;
pub mod rotation;
pub mod search;

use std::error::Error;
use std::fmt;
use std::io::{self, ErrorKind, StdoutLock, Write};
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use nix::sys::time::TimeSpec;
use nix::time::{ClockId, ClockNanosleepFlags, clock_nanosleep};
use signal_hook::consts::{SIGINT, SIGTERM};
use uorb_core::now_us;

/// How a module's work ends, if it does not go well.
pub type Outcome = Result<(), Box<dyn Error>>;

/// The longest sleep without a look at [`Stop`]: a signal that arrives between
/// the look and the sleep is noticed after this.
const SLEEP_MAX_US: u64 = 200_000;

/// Runs a module until it ends, and says how it went.
pub fn run(module: impl FnOnce(&Stop, &mut StdoutLock<'static>) -> Outcome) -> ExitCode {
    let result = Stop::on_signals()
        .map_err(Box::from)
        .and_then(|stop| module(&stop, &mut io::stdout().lock()));
    let Err(error) = result else { return ExitCode::SUCCESS };

    if let Some(ended @ uorb_core::Error::Ended { .. }) = error.downcast_ref() {
        say(ended);
        return ExitCode::SUCCESS;
    }
    // `color_counter | head` closed the pipe: the reader has seen enough.
    if error.downcast_ref().is_some_and(|error: &io::Error| error.kind() == ErrorKind::BrokenPipe) {
        return ExitCode::SUCCESS;
    }
    say(&error);
    ExitCode::FAILURE
}

/// Says something on stderr. That nobody listens any more changes nothing: whoever
/// started a module in the background has read its first words, and is gone.
pub fn say(words: &dyn fmt::Display) {
    let path = std::env::args_os().next().unwrap_or_default();
    let name = Path::new(&path).file_name().unwrap_or_default().to_string_lossy();
    let _ = writeln!(io::stderr(), "{name}: {words}");
}

/// Whether somebody has asked the module to end.
#[derive(Clone, Debug)]
pub struct Stop {
    requested: Arc<AtomicBool>,
}

impl Stop {
    /// Asked for by Ctrl-C (SIGINT) and by SIGTERM. A second one ends the
    /// process on the spot.
    ///
    /// # Errors
    ///
    /// As sigaction(2), which knows both signals.
    pub fn on_signals() -> io::Result<Self> {
        let requested = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            // In this order: the first signal finds the flag not set yet.
            let exit_code = 128 + signal;
            signal_hook::flag::register_conditional_shutdown(signal, exit_code, requested.clone())?;
            signal_hook::flag::register(signal, requested.clone())?;
        }
        Ok(Self { requested })
    }

    /// True from the signal on. `uorb_core::poll` returns 0 when it arrives.
    pub fn requested(&self) -> bool {
        self.requested.load(Ordering::Relaxed)
    }

    /// Sleeps until a time of CLOCK_MONOTONIC, not at all if it is over. False:
    /// the module is to end.
    pub fn sleep_until(&self, due_us: u64) -> bool {
        loop {
            let now_us = now_us();
            if self.requested() || now_us >= due_us {
                return !self.requested();
            }
            let wake = Duration::from_micros(due_us.min(now_us + SLEEP_MAX_US));
            // Ends early when a signal arrives, and then the flag says why.
            let _ = clock_nanosleep(
                ClockId::CLOCK_MONOTONIC,
                ClockNanosleepFlags::TIMER_ABSTIME,
                &TimeSpec::from_duration(wake),
            );
        }
    }
}

/// The longest delay that a beat makes up for, tick by tick: a busy machine
/// takes its time now and then, and readings should not be missing for it.
const DELAY_MAX_US: u64 = 100_000;

/// A beat that does not drift: every tick is counted from the first one.
#[derive(Clone, Debug)]
pub struct Ticks {
    start_us: u64,
    rate_hz: f64,
    next: u64,
}

impl Ticks {
    /// So many a second, the first one at `start_us`.
    ///
    /// # Panics
    ///
    /// If the rate is not positive; see [`parse_rate`].
    pub fn new(start_us: u64, rate_hz: f64) -> Self {
        assert!(rate_hz > 0.0, "a rate of {rate_hz} Hz never ticks");
        Self { start_us, rate_hz, next: 0 }
    }

    /// When the next tick is due, in microseconds of CLOCK_MONOTONIC.
    pub fn due_us(&self) -> u64 {
        self.start_us.saturating_add((self.next as f64 * 1e6 / self.rate_hz) as u64)
    }

    /// Goes on to the next tick. Returns how many are left out because their
    /// time is long over: a process that was stopped for a minute makes up for
    /// one tick and not for thousands.
    pub fn advance(&mut self, now_us: u64) -> u64 {
        self.next += 1;
        if now_us.saturating_sub(self.due_us()) <= DELAY_MAX_US {
            return 0;
        }
        let newest = ((now_us - self.start_us) as f64 * self.rate_hz / 1e6) as u64;
        let left_out = newest.saturating_sub(self.next);
        self.next += left_out;
        left_out
    }

    /// Sleeps until the next tick and goes on behind it. False: the module is
    /// to end.
    pub fn wait(&mut self, stop: &Stop) -> bool {
        let in_time = stop.sleep_until(self.due_us());
        self.advance(now_us());
        in_time
    }
}

/// The most vehicles that MAVLink can number; 255 are ground stations.
const VEHICLES_MAX: u32 = 250;

/// A vehicle's number in MAVLink: one more.
///
/// # Errors
///
/// In words, for whoever has numbered it.
pub fn system_id(vehicle: u32) -> Result<u8, String> {
    match vehicle {
        0..VEHICLES_MAX => Ok(vehicle as u8 + 1),
        _ => Err(format!("vehicle {vehicle}: MAVLink numbers 0 to 249; say another with -i")),
    }
}

/// A rate on the command line: a positive number of hertz.
///
/// # Errors
///
/// In words, for clap.
pub fn parse_rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        // A tick a microsecond is more than anybody waits for.
        Ok(rate_hz) if rate_hz > 0.0 && rate_hz <= 1e6 => Ok(rate_hz),
        _ => Err("not a number above 0, and up to 1000000".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vehicles_are_numbered_from_1_in_mavlink() {
        assert_eq!((system_id(0), system_id(249)), (Ok(1), Ok(250)));
        for vehicle in [250, u32::MAX] {
            assert!(system_id(vehicle).unwrap_err().contains("-i"));
        }
    }

    #[test]
    fn a_third_of_a_second_does_not_add_up_to_a_drift() {
        let mut ticks = Ticks::new(5_000_000, 3.0);
        for _ in 0..3 * 86_400 {
            let due_us = ticks.due_us();
            assert_eq!(ticks.advance(due_us), 0);
        }
        assert_eq!(ticks.due_us(), 5_000_000 + 86_400 * 1_000_000);
    }

    #[test]
    fn what_is_late_is_made_up_for() {
        let mut ticks = Ticks::new(0, 250.0);
        for next_due_us in [4_000, 8_000, 12_000] {
            assert_eq!(ticks.advance(50_000), 0);
            assert_eq!(ticks.due_us(), next_due_us);
        }
    }

    #[test]
    fn after_a_stop_one_tick_is_made_up_for() {
        let mut ticks = Ticks::new(0, 250.0);
        assert_eq!(ticks.advance(10_001_000), 2_499);
        assert_eq!(ticks.due_us(), 10_000_000);
        assert_eq!(ticks.advance(10_001_000), 0);
        assert_eq!(ticks.due_us(), 10_004_000);
    }

    #[test]
    fn rates_are_positive_and_finite() {
        assert_eq!(parse_rate("2.5"), Ok(2.5));
        for wrong in ["0", "-1", "inf", "NaN", "2Hz", ""] {
            assert!(parse_rate(wrong).is_err(), "{wrong:?}");
        }
    }
}
