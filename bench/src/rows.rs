//! What is measured, a file a kind.

pub mod blocked;
pub mod c_functions;
pub mod costs;
pub mod flat_out;
pub mod hot;
pub mod kernel;
pub mod mavlink;
pub mod peers;
pub mod scale;
pub mod sizes;
pub mod streams;
pub mod wakes;

use uorb_tests::Bus;

use crate::figures::Figures;
use crate::place::Cores;

type Row = fn(&mut Run, &mut Bus);

/// What every row needs.
pub struct Run {
    pub figures: Figures,
    pub cores: Cores,
}

impl Run {
    /// Everything, on one bus after the other.
    pub fn all(&mut self, wanted: &dyn Fn(&str) -> bool) {
        let rows: [(&str, Row); 12] = [
            ("kernel", kernel::measure),
            ("hot", hot::measure),
            ("peers", peers::measure),
            ("sizes", sizes::measure),
            ("wakes", wakes::measure),
            ("blocked", blocked::measure),
            ("flat-out", flat_out::measure),
            ("streams", streams::measure),
            ("scale", scale::measure),
            ("costs", costs::measure),
            ("mavlink", mavlink::measure),
            // Last: the library keeps its session until the process ends.
            ("c", c_functions::measure),
        ];
        for (name, measure) in rows.into_iter().filter(|(name, _)| wanted(name)) {
            eprintln!("{name}:");
            let mut bus = Bus::start();
            measure(self, &mut bus);
        }
    }

    /// Does something on a core of its own.
    pub fn alone<R>(&mut self, act: impl FnOnce(&mut Figures) -> R) -> R {
        self.cores.alone().pin();
        let done = act(&mut self.figures);
        self.cores.unpin();
        done
    }
}
