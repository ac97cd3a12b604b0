//! The floors: what the kernel and the machine take by themselves.
//!
//! They are measured again before each row's contestants; here they stand by
//! themselves.

use std::hint::black_box;

use uorb_core::now_us;
use uorb_tests::Bus;

use super::Run;
use crate::doors::{Meeting, eventfd, one_way};
use crate::place::Place;
use crate::times::{Times, per_call};

pub const CLOCK: &str = "clock read";

/// One clock read, the unit of the hot path.
pub fn clock_read(batches: u32) -> Times {
    per_call(batches, || {
        black_box(now_us());
    })
}

/// One copy of a message of this size.
pub fn memcpy(batches: u32, bytes: usize) -> Times {
    let from = vec![1_u8; bytes];
    let mut to = vec![0_u8; bytes];
    per_call(batches, || black_box(&mut to).copy_from_slice(black_box(&from)))
}

/// What a wake takes at least, on this place.
pub fn eventfd_wake(bus: &Bus, place: &Place, counters: &eventfd::Counters, wakes: u32) -> Times {
    let meeting = Meeting { extra: counters.arguments(), ..Meeting::by("eventfd") };
    one_way(bus, place, meeting, wakes)
}

pub fn measure(run: &mut Run, bus: &mut Bus) {
    let effort = run.figures.effort;
    run.alone(|figures| {
        figures.note_times((CLOCK, ""), "floor", clock_read(effort.batches));
        for bytes in [64, 1 << 10, 64 << 10, 4 << 20] {
            let setting = format!("{bytes} B");
            let batches = effort.batches.min((64 << 20) / bytes as u32).max(20);
            figures.note_times(("memcpy", &setting), "floor", memcpy(batches, bytes));
        }
    });
    let counters = eventfd::Counters::new();
    for place in Place::all(run.cores) {
        let eventfd = eventfd_wake(bus, &place, &counters, effort.wakes);
        run.figures.note_times(("eventfd and poll", place.name), "floor", eventfd);
        let futex = one_way(bus, &place, Meeting::by("futex"), effort.wakes);
        run.figures.note_times(("futex", place.name), "floor", futex);
    }
}
