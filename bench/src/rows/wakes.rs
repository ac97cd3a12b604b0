//! One-way wakes between two processes, in three places; and without sleeping.

use uorb_tests::Bus;

use super::Run;
use super::kernel::eventfd_wake;
use crate::doors::{Meeting, eventfd, mutex_ring, one_way};
use crate::figures::Contestant;
use crate::place::Place;

/// Who wakes by which door.
const BY_NAME: [(&str, &str); 6] = [
    ("uorb, poll", "poll"),
    ("uorb, epoll", "epoll"),
    ("uorb, tokio", "tokio"),
    ("iceoryx2 with event", "iceoryx2"),
    ("Unix datagram", "datagram"),
    ("mutex ring in one process", mutex_ring::NAME),
];

/// Longer than any way: `poll` never sleeps.
const SPIN_US: &str = "1000000";

pub const SPINNING: &str = "one way, spinning";

pub fn measure(run: &mut Run, bus: &mut Bus) {
    let wakes = run.figures.effort.wakes;
    let counters = eventfd::Counters::new();
    let bus = &*bus;
    for place in Place::all(run.cores) {
        let mut by_name = BY_NAME.to_vec();
        if cfg!(feature = "zenoh") {
            by_name.push(("zenoh", "zenoh"));
        }
        let place = &place;
        let contestants = by_name
            .into_iter()
            .map(|(who, door)| {
                Contestant::new(who, move || one_way(bus, place, Meeting::by(door), wakes))
            })
            .collect();
        let floor = &mut || eventfd_wake(bus, place, &counters, wakes);
        run.figures.measure(("one-way wake", place.name), ("eventfd and poll", floor), contestants);
    }
    match Place::two_awake(run.cores) {
        Some(place) => spinning(run, bus, &place),
        None => eprintln!("  {SPINNING}: left out, there is one core"),
    }
}

fn spinning(run: &mut Run, bus: &Bus, place: &Place) {
    let wakes = run.figures.effort.wakes;
    let spins = |door| Meeting { spins: true, ..Meeting::by(door) };
    let contestants = vec![
        Contestant::new("uorb, poll", || {
            let meeting = Meeting { spin_us: Some(SPIN_US), ..spins("poll") };
            one_way(bus, place, meeting, wakes)
        }),
        Contestant::new("iceoryx2, receive in a loop", || {
            one_way(bus, place, spins("iceoryx2-spinning"), wakes)
        }),
    ];
    let floor = &mut || one_way(bus, place, spins("line"), wakes);
    run.figures.measure((SPINNING, place.name), ("a cache line", floor), contestants);
}
