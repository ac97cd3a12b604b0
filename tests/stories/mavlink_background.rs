//! `mavlink start`, `status` and `stop`: a bridge that nobody's shell waits for.

use std::fs;

use nix::sys::stat::Mode;
use nix::unistd::mkfifo;
use uorb_mavlink::dialect::{MavMessage, PARAM_REQUEST_LIST_DATA};
use uorb_tests::{Bus, eventually, is_running};

use super::ground_station::{GroundStation, port_of_next_link};
use super::mavlink::bridge;

#[test]
fn a_bridge_starts_in_the_background_says_how_it_is_and_stops() {
    let bus = Bus::start();
    let mavlink = |arguments: &[&str]| bus.spawn_heard("mavlink", arguments).end();
    mavlink(&["status"]).failed(&["none runs", "mavlink start"]);
    let started = mavlink(&["start", "-u", "0", "-m", "minimal"]).fine();
    assert!(started.contains("[mavlink] started: pid "), "{started}");
    mavlink(&["start", "-u", "0", "-m", "custom", "--", "--tcp-listen", "0"]).fine();

    let status = mavlink(&["status"]).fine();
    for words in
        ["instance #0: udp 127.0.0.1:", "mode minimal", "instance #2: tcp ", "heard: nobody"]
    {
        assert!(status.contains(words), "no {words:?} in {status}");
    }
    let stopped = mavlink(&["stop"]).fine();
    assert_eq!(stopped.matches("[mavlink] ended: pid ").count(), 2, "{stopped}");
    mavlink(&["stop"]).failed(&["none runs"]);
}

#[test]
fn a_bridge_in_the_background_outlives_whoever_started_it() {
    let bus = Bus::start();
    let file = bus.system.base().join("mine.params");
    fs::write(&file, "SYS_AUTOSTART 4001\n").unwrap();
    let mavlink = |arguments: &[&str]| bus.spawn_heard("mavlink", arguments).end().fine();
    mavlink(&["start", "-u", "0", "-m", "custom", "--parameters", file.to_str().unwrap()]);
    let status = mavlink(&["status"]);
    let address = status.split_whitespace().nth(3).and_then(|address| address.rsplit(':').next());
    let mut station = GroundStation::of(address.unwrap().parse().unwrap());

    // It complains where nobody listens any more.
    fs::write(&file, "nonsense\n").unwrap();
    station.send(&MavMessage::PARAM_REQUEST_LIST(PARAM_REQUEST_LIST_DATA {
        target_system: 1,
        target_component: 1,
    }));

    station.said_so_far();
    let stopped = mavlink(&["stop"]);
    assert!(stopped.starts_with("[mavlink] ended: pid "), "{stopped}");
}

#[test]
fn a_bridge_that_could_not_be_shown_is_refused() {
    let bus = Bus::start();
    let links = [&["-u", "0", "--"][..]; 9].concat();
    let mut ten = bridge(&bus, &[&links[..], &["-u", "0"]].concat());
    (0..10).for_each(|_| assert_ne!(port_of_next_link(&mut ten), 0));

    let mut eleventh = bus.spawn_heard("mavlink", &["start", "-u", "0"]);

    eleventh.end().failed(&["ten links", "`mavlink stop`"]);
    eventually("the ten are shown", || {
        let status = bus.spawn_heard("mavlink", &["status"]).end();
        status.out.matches(&format!("pid {}", ten.pid())).count() == 10
    });
}

#[test]
fn a_start_that_is_interrupted_leaves_no_bridge() {
    let bus = Bus::start();
    // Whoever reads this waits until somebody writes.
    let file = bus.system.base().join("parameters");
    mkfifo(&file, Mode::S_IRUSR | Mode::S_IWUSR).unwrap();
    let options = ["start", "-u", "0", "--parameters", file.to_str().unwrap()];
    let mut start = bus.spawn_heard("mavlink", &options);
    let ours = [start.pid(), std::process::id()];
    let joined = || bus.processes().into_iter().find(|pid| !ours.contains(pid));
    eventually("the bridge has joined", || joined().is_some());
    let bridge = joined().unwrap();

    assert_eq!(start.interrupt().fine(), "");

    fs::write(&file, "SYS_AUTOSTART 4001\n").unwrap();
    eventually("the bridge has ended", || !is_running(bridge));
}
