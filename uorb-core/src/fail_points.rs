//! Places where a process of a `fail-points` build can be told to die.
//!
//! `fail_point!("publish.committed")` stands between two steps that a death may
//! part. It is nothing at all without the feature; with it, a process whose
//! environment says `UORB_DIE_AT=publish.committed:17` sends itself SIGKILL at
//! its 17th passing, and one with `UORB_STOP_AT` SIGSTOP. `:1` may be left out.
//!
//! The list below is what `tests/chaos` draws from; a test compares it with the
//! places.

/// Every fail point there is, by whose steps it parts.
pub const FAIL_POINTS: &[&str] = &[
    // A process that joins, and one that re-joins.
    "join.connected",
    "join.welcome",
    "join.locked",
    "rejoin.connected",
    "rejoin.welcome",
    "rejoin.named",
    "rejoin.confirmed",
    "rejoin.asked_again",
    // A publisher.
    "advertise.begun",
    "advertise.granted",
    "advertise.mapped",
    "publish.begun",
    "publish.claimed",
    "publish.half_written",
    "publish.written",
    "publish.owned",
    "publish.committed",
    "publish.marked",
    "publish.sent",
    "publish.freed",
    "publish.asked",
    "publish.rung",
    "publish.noted",
    "port.opened",
    "port.entered",
    "port.told",
    "unadvertise.begun",
    "unadvertise.answered",
    "unadvertise.done",
    // A subscriber.
    "subscribe.begun",
    "subscribe.granted",
    "subscribe.mapped",
    "follow.granted",
    "follow.queued",
    "follow.told",
    "follow.begun",
    "copy.begun",
    "copy.copied",
    "copy.asked",
    "receive.found",
    "unsubscribe.begun",
    "unsubscribe.answered",
    // The broker: its start, its answers, nodes, deaths, streams, its end.
    "start.locked",
    "start.emptied",
    "start.inscribed",
    "start.listening",
    "adopt.peers",
    "adopt.node",
    "adopt.rung",
    "adopt.buried",
    "broker.accepted",
    "broker.peer_made",
    "broker.welcoming",
    "broker.granted",
    "broker.answered",
    "node.allocated",
    "node.bell_named",
    "node.named",
    "ring.allocated",
    "ring.formatted",
    "ring.there",
    "admit.noted",
    "admit.counted",
    "give_way.made",
    "give_way.discarded",
    "bury.proven",
    "bury.freed",
    "bury.counted",
    "bury.rung",
    "bury.forgotten",
    "stream.making",
    "stream.made",
    "stream.executed",
    "stream.freed",
    "stream.cleaning",
    "stream.cleaned",
    "end.socket_removed",
    "end.said",
    "end.emptied",
];

/// Where a process may be parted from its next step. With something behind the
/// name, that is done first: half a step, which no other build has.
#[cfg(feature = "fail-points")]
#[doc(hidden)]
#[macro_export]
macro_rules! fail_point {
    ($name:literal) => {
        $crate::fail_points::pass($name)
    };
    ($name:literal, $half:expr) => {
        $half;
        $crate::fail_points::pass($name)
    };
}

/// Nothing, in a build without the feature.
#[cfg(not(feature = "fail-points"))]
#[doc(hidden)]
#[macro_export]
macro_rules! fail_point {
    ($name:literal $(, $half:expr)?) => {};
}

#[cfg(feature = "fail-points")]
pub use passing::pass;

#[cfg(feature = "fail-points")]
mod passing {
    use std::env;
    use std::sync::OnceLock;
    use std::sync::atomic::{AtomicU32, Ordering};

    use nix::sys::signal::{Signal, raise};

    use super::FAIL_POINTS;

    /// The one place where this process is to die or to stop.
    struct Fate {
        name: &'static str,
        left: AtomicU32,
        signal: Signal,
    }

    /// Passes a place: the process may end here.
    pub fn pass(name: &'static str) {
        static FATES: OnceLock<Vec<Fate>> = OnceLock::new();
        for fate in FATES.get_or_init(fates) {
            if fate.name == name && fate.left.fetch_sub(1, Ordering::Relaxed) == 1 {
                let _ = raise(fate.signal);
            }
        }
    }

    fn fates() -> Vec<Fate> {
        let variables = [("UORB_DIE_AT", Signal::SIGKILL), ("UORB_STOP_AT", Signal::SIGSTOP)];
        let fate = |(variable, signal)| {
            let value = env::var(variable).ok()?;
            let (named, count) = value.split_once(':').unwrap_or((&value, "1"));
            let name = FAIL_POINTS.iter().find(|name| **name == named);
            let name = name.unwrap_or_else(|| panic!("{variable}={value}: no such fail point"));
            let left = count.parse().expect("a number of passings");
            Some(Fate { name, left: AtomicU32::new(left), signal })
        };
        variables.into_iter().filter_map(fate).collect()
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    use std::collections::BTreeSet;
    use std::path::Path;

    use super::FAIL_POINTS;

    fn places_in(dir: &Path, places: &mut Vec<String>) {
        for entry in std::fs::read_dir(dir).expect("a folder of sources") {
            let path = entry.expect("its entry").path();
            if path.is_dir() {
                places_in(&path, places);
            } else if path.extension().is_some_and(|extension| extension == "rs")
                && !path.ends_with("fail_points.rs")
            {
                let text = std::fs::read_to_string(&path).expect("a source file");
                let after = text.split("fail_point!(").skip(1);
                places.extend(after.filter_map(|rest| Some(rest.split('"').nth(1)?.to_string())));
            }
        }
    }

    #[test]
    fn the_list_of_fail_points_is_that_of_the_places() {
        let mut places = Vec::new();
        for folder in ["../uorb-core/src", "../uorb-daemon/src"] {
            places_in(&Path::new(env!("CARGO_MANIFEST_DIR")).join(folder), &mut places);
        }
        let placed: BTreeSet<&str> = places.iter().map(String::as_str).collect();
        let listed: BTreeSet<&str> = FAIL_POINTS.iter().copied().collect();
        assert_eq!(placed, listed);
        assert_eq!(placed.len(), places.len(), "each name stands at one place");
    }
}
