//! All that one run has measured.
//!
//! A figure stands beside its floor: what the kernel, or the machine, takes for
//! the least that could do the same. The floor is measured again just before
//! each figure, in every round, and the ratio is the median of the rounds'
//! ratios: a machine that is slower for a second is slower for both.

use crate::times::Times;

/// One measured thing.
#[derive(Debug)]
pub struct Figure {
    /// What was done: `publish`.
    pub row: String,
    /// With what: `64 B, 16 subscriptions`.
    pub setting: String,
    /// By whom: `uorb`.
    pub who: String,
    pub unit: &'static str,
    pub measured: Measured,
    pub floor: Option<Floor>,
}

#[derive(Debug)]
pub enum Measured {
    Times(Times),
    Value(f64),
}

/// The least that could do the same, in the same rounds.
#[derive(Debug)]
pub struct Floor {
    pub name: String,
    pub median_ns: f64,
    pub ratio: f64,
}

impl Figure {
    /// The median of times, or the value.
    pub fn middle(&self) -> f64 {
        match &self.measured {
            Measured::Times(times) => times.median_ns(),
            Measured::Value(value) => *value,
        }
    }
}

/// One of those who are measured beside each other.
pub struct Contestant<'a> {
    who: String,
    measure: Box<dyn FnMut() -> Times + 'a>,
}

impl<'a> Contestant<'a> {
    pub fn new(who: &str, measure: impl FnMut() -> Times + 'a) -> Self {
        Self { who: who.into(), measure: Box::new(measure) }
    }
}

/// How much is done for a figure.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// How often everybody has a turn.
    pub rounds: u32,
    /// Batches of short calls in a turn.
    pub batches: u32,
    /// Wakes in a turn.
    pub wakes: u32,
    /// How long something that goes on by itself is watched.
    pub watch_ms: u64,
    /// Whether it is only to be seen that all can be measured.
    pub is_quick: bool,
}

impl Effort {
    pub const FULL: Self =
        Self { rounds: 7, batches: 1_000, wakes: 1_500, watch_ms: 5_000, is_quick: false };
    pub const QUICK: Self =
        Self { rounds: 1, batches: 20, wakes: 50, watch_ms: 300, is_quick: true };
}

/// The figures of a run, in the order in which they were measured.
#[derive(Debug)]
pub struct Figures {
    pub effort: Effort,
    pub all: Vec<Figure>,
}

impl Figures {
    pub fn new(effort: Effort) -> Self {
        Self { effort, all: Vec::new() }
    }

    /// Measures contestants in turns, the floor before each.
    pub fn measure(
        &mut self,
        (row, setting): (&str, &str),
        floor: (&str, &mut dyn FnMut() -> Times),
        contestants: Vec<Contestant<'_>>,
    ) {
        let (name, measure_floor) = floor;
        eprintln!("  {row}, {setting}");
        struct Seen {
            times: Times,
            floor: Times,
            ratios: Vec<f64>,
        }
        let mut seen: Vec<Seen> = contestants
            .iter()
            .map(|_| Seen { times: Times::none(), floor: Times::none(), ratios: Vec::new() })
            .collect();
        let mut contestants = contestants;
        for _ in 0..self.effort.rounds {
            for (contestant, seen) in contestants.iter_mut().zip(&mut seen) {
                let floor = measure_floor();
                let times = (contestant.measure)();
                seen.ratios.push(times.median_ns() / floor.median_ns());
                seen.times.add(&times);
                seen.floor.add(&floor);
            }
        }
        for (contestant, mut seen) in contestants.into_iter().zip(seen) {
            let floor = Floor {
                name: name.into(),
                median_ns: seen.floor.median_ns(),
                ratio: median(&mut seen.ratios),
            };
            self.all.push(Figure {
                row: row.into(),
                setting: setting.into(),
                who: contestant.who,
                unit: "ns",
                measured: Measured::Times(seen.times),
                floor: Some(floor),
            });
        }
    }

    /// Notes times that have no floor, or are one.
    pub fn note_times(&mut self, (row, setting): (&str, &str), who: &str, times: Times) {
        self.note(row, setting, who, "ns", Measured::Times(times));
    }

    /// Notes one value.
    pub fn note_value(
        &mut self,
        (row, setting): (&str, &str),
        who: &str,
        value: f64,
        unit: &'static str,
    ) {
        self.note(row, setting, who, unit, Measured::Value(value));
    }

    fn note(&mut self, row: &str, setting: &str, who: &str, unit: &'static str, seen: Measured) {
        eprintln!("  {row}, {setting}, {who}");
        let (row, setting, who) = (row.into(), setting.into(), who.into());
        self.all.push(Figure { row, setting, who, unit, measured: seen, floor: None });
    }

    /// The figure of this row, setting and name, if it was measured.
    pub fn find(&self, row: &str, setting: &str, who: &str) -> Option<&Figure> {
        self.all.iter().find(|it| it.row == row && it.setting == setting && it.who == who)
    }
}

fn median(ratios: &mut [f64]) -> f64 {
    ratios.sort_by(f64::total_cmp);
    ratios[ratios.len() / 2]
}
