//! What happens in a round, drawn from its dice before it begins.

use uorb_core::fail_points::FAIL_POINTS;

use crate::bus::Fate;
use crate::random::Random;

/// What actors may be.
pub(crate) const KINDS: [&str; 6] =
    ["publisher", "claimer", "changer", "subscriber", "descriptor", "follower"];

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Deed {
    Kill,
    Stop,
}

/// Something that is done at a moment.
#[derive(Clone, Debug)]
pub(crate) struct Moment {
    pub(crate) at_us: u64,
    pub(crate) deed: Deed,
    /// Whom: None is the broker, a number chooses among the processes.
    pub(crate) whom: Option<u64>,
}

#[derive(Debug)]
pub(crate) struct Plan {
    /// Who joins, how often its calls are interrupted, and where it is to die.
    pub(crate) newcomers: Vec<(&'static str, u64, Option<Fate>)>,
    pub(crate) moments: Vec<Moment>,
    pub(crate) lasts_us: u64,
    /// The round begins with a new broker that is to die while it buries
    /// somebody, who dies in mid-publish.
    pub(crate) burial: Option<Fate>,
    /// Where the next broker is to die, if one has to be started.
    pub(crate) next_broker: Option<Fate>,
    /// Whether newcomers that were to die and did not are kept.
    pub(crate) keeps_survivors: bool,
    pub(crate) kills_the_stopped: bool,
    /// Everybody is killed at once.
    pub(crate) kills_all: bool,
}

impl Plan {
    pub(crate) fn draw(random: &mut Random) -> Self {
        let lasts_us = 4_000 + random.below(30_000);
        let mut newcomers = Vec::new();
        for _ in 0..1 + random.below(3) {
            let kind = *random.of(&KINDS);
            let storm_us = if random.once_in(4) { 100 + random.below(900) } else { 0 };
            let fate = (!random.once_in(3)).then(|| fate_of(kind, random));
            newcomers.push((kind, storm_us, fate));
        }
        let burial = random.once_in(5).then(|| {
            let mid_publish = ["claimed", "half_written", "owned", "committed", "marked", "sent"];
            let step = random.of(&mid_publish);
            let place = format!("publish.{step}:{}", 1 + random.below(20));
            newcomers.push(("publisher", 0, Some(Fate { variable: "UORB_DIE_AT", place })));
            let family = *random.of(&["bury.", "bury.", "stream.executed", "stream.freed"]);
            place_of(&[family], 1, random)
        });
        let mut moments = Vec::new();
        let mut dice = Random::new(random.next());
        let mut add = |odds, deed, any: bool| {
            if dice.once_in(odds) {
                let whom = any.then(|| dice.next());
                moments.push(Moment { at_us: dice.below(lasts_us), deed, whom });
            }
        };
        add(2, Deed::Kill, true);
        add(4, Deed::Kill, true);
        add(4, Deed::Stop, true);
        add(5, Deed::Kill, false);
        add(12, Deed::Stop, false);
        moments.sort_by_key(|moment| moment.at_us);
        Self {
            newcomers,
            moments,
            lasts_us,
            burial,
            next_broker: random.once_in(2).then(|| broker_s_fate(random)),
            keeps_survivors: random.once_in(2),
            kills_the_stopped: random.once_in(2),
            kills_all: random.once_in(20),
        }
    }
}

fn fate_of(kind: &str, random: &mut Random) -> Fate {
    let families: &[&str] = match kind {
        "publisher" | "claimer" | "changer" => {
            &["join.", "rejoin.", "advertise.", "publish.", "publish.", "port.", "unadvertise."]
        }
        "follower" => {
            &["join.", "rejoin.", "subscribe.", "follow.", "receive.", "unsubscribe.", "copy."]
        }
        _ => &["join.", "rejoin.", "subscribe.", "copy.", "copy.", "unsubscribe."],
    };
    let family = *random.of(families);
    let places: Vec<_> = FAIL_POINTS.iter().filter(|name| name.starts_with(family)).collect();
    let often = ["publish.", "copy.", "receive."].contains(&family);
    let passing = if often { 1 + random.below(60) } else { 1 + random.below(2) };
    let variable = if random.once_in(5) { "UORB_STOP_AT" } else { "UORB_DIE_AT" };
    Fate { variable, place: format!("{}:{passing}", random.of(&places)) }
}

/// Where a broker may die that ends its system.
pub(crate) fn end_of_a_system(random: &mut Random) -> Option<Fate> {
    random.once_in(2).then(|| place_of(&["end."], 1, random))
}

fn broker_s_fate(random: &mut Random) -> Fate {
    const FAMILIES: [&str; 11] = [
        "start.",
        "adopt.",
        "broker.",
        "broker.",
        "node.",
        "ring.",
        "admit.",
        "give_way.",
        "bury.",
        "bury.",
        "stream.",
    ];
    let passings = if random.once_in(2) { 30 } else { 3 };
    place_of(&FAMILIES, passings, random)
}

/// Death at a place of one of these families, at one of the first passings.
fn place_of(families: &[&str], passings: u64, random: &mut Random) -> Fate {
    let family = *random.of(families);
    let places: Vec<_> = FAIL_POINTS.iter().filter(|name| name.starts_with(family)).collect();
    let place = format!("{}:{}", random.of(&places), 1 + random.below(passings));
    Fate { variable: "UORB_DIE_AT", place }
}
