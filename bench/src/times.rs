//! How long something took, many times over.
//!
//! A time is kept in picoseconds: a look at whether there is anything new takes
//! one nanosecond and a bit. What is shorter than a clock read is timed in
//! batches and each batch counts as one time, the mean of its calls; what is
//! longer is timed by itself.

use std::hint::black_box;
use std::time::{Duration, Instant};

use hdrhistogram::Histogram;

/// A batch takes about this long, two hundred clock reads, so that reading the
/// clock around it adds half a percent.
const BATCH: Duration = Duration::from_micros(5);

/// The most calls in a batch: what is compiled to nothing must end, too.
const BATCH_MAX: u32 = 65_536;

/// A distribution of times.
#[derive(Clone, Debug)]
pub struct Times {
    pub(crate) picoseconds: Histogram<u64>,
}

impl Times {
    pub fn none() -> Self {
        // Three digits, from a picosecond to a thousand seconds.
        let picoseconds = Histogram::new_with_bounds(1, 10_u64.pow(15), 3);
        Self { picoseconds: picoseconds.expect("these bounds are in order") }
    }

    pub fn of_ns(times_ns: impl IntoIterator<Item = f64>) -> Self {
        let mut times = Self::none();
        times_ns.into_iter().for_each(|time_ns| times.add_ns(time_ns));
        times
    }

    pub fn add_ns(&mut self, time_ns: f64) {
        self.picoseconds.saturating_record(((time_ns * 1e3) as u64).max(1));
    }

    pub fn add(&mut self, other: &Self) {
        self.picoseconds.add(&other.picoseconds).expect("all have the same bounds");
    }

    pub fn count(&self) -> u64 {
        self.picoseconds.len()
    }

    pub fn median_ns(&self) -> f64 {
        self.at_ns(0.5)
    }

    pub fn at_ns(&self, quantile: f64) -> f64 {
        self.picoseconds.value_at_quantile(quantile) as f64 / 1e3
    }

    pub fn max_ns(&self) -> f64 {
        self.picoseconds.max() as f64 / 1e3
    }
}

/// What one call takes, in so many batches.
pub fn per_call<R>(batches: u32, mut call: impl FnMut() -> R) -> Times {
    per_call_in(batches, BATCH_MAX, &mut call, || {})
}

/// The same, with so many calls in a batch at most, and something to be done
/// after each batch that does not count.
pub fn per_call_in<R>(
    batches: u32,
    batch_max: u32,
    mut call: impl FnMut() -> R,
    mut after: impl FnMut(),
) -> Times {
    let mut batch = 1;
    // The first calls find caches and branch predictors cold.
    while time_of(batch, &mut call) < BATCH && batch < batch_max {
        after();
        batch = (2 * batch).min(batch_max);
    }
    after();
    let mut times = Times::none();
    for _ in 0..batches {
        let took = time_of(batch, &mut call);
        times.add_ns(took.as_nanos() as f64 / f64::from(batch));
        after();
    }
    times
}

fn time_of<R>(calls: u32, call: &mut impl FnMut() -> R) -> Duration {
    let began = Instant::now();
    for _ in 0..calls {
        // By reference: a large message is not moved once more.
        black_box(&call());
    }
    began.elapsed()
}
