//! What chaos has found in us, each as a story of its own.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use uorb_core::broker_side::{Node, Reply, Request, Role};
use uorb_core::{Instance, PeerInfo, Session, Subscription};
use uorb_tests::{Bus, Stamped, eventually, program};

/// A broker of this build, ready; it may have a place to die at.
fn start_broker(bus: &mut Bus, fate: Option<&str>) {
    let mut command = Command::new(program("uorbd-with-fail-points"));
    command.args(["--ready-fd", "1", "--dir"]).arg(bus.system.base());
    command.envs(fate.map(|place| ("UORB_DIE_AT", place))).stdout(Stdio::piped());
    let mut broker = command.spawn().unwrap();
    let mut line = String::new();
    BufReader::new(broker.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
    assert_eq!(line, "ready\n");
    bus.adopt_broker(broker);
}

/// A publisher of `stamped` that is to die at a place.
fn fated_publisher(bus: &Bus, place: &str) -> Child {
    let mut command = bus.command(&program("chaos"));
    command.args(["publish", "stamped"]).env("UORB_DIE_AT", place);
    command.stdin(Stdio::null()).spawn().unwrap()
}

#[test]
fn a_broker_that_dies_in_a_burial_leaves_no_slot_to_the_dead() {
    let places = ["bury.counted", "bury.rung", "bury.forgotten", "stream.executed"];
    for place in places {
        let mut bus = Bus::without_broker();
        start_broker(&mut bus, Some(place));
        // It keeps the system when all others are dead.
        let _keeper: Subscription<Stamped> = bus.subscribe();
        // The stream is there: its thread gives slots back.
        drop(bus.stream::<Stamped>());
        let mut victim = fated_publisher(&bus, "publish.claimed:3");
        victim.wait().unwrap();
        eventually("the broker has died", || bus.running_broker().is_none());
        bus.kill_broker();

        start_broker(&mut bus, None);

        let node = Node::open(&bus.system, "stamped", Instance::FIRST, Role::Observer).unwrap();
        assert_eq!(node.slot_holders(), Vec::<u16>::new(), "{place}");
    }
}

#[test]
fn a_process_whose_broker_dies_between_its_welcome_and_its_lock_joins_the_next_one() {
    let mut bus = Bus::without_broker();
    start_broker(&mut bus, None);
    let _keeper: Subscription<Stamped> = bus.subscribe();
    let session = bus.session();
    let publisher = |variable: &str| {
        let mut command = bus.command(&program("chaos"));
        command.args(["publish", "stamped"]).env(variable, "join.welcome");
        command.stdin(Stdio::null()).spawn().unwrap()
    };
    let mut late = publisher("UORB_STOP_AT");
    let stat = || std::fs::read_to_string(format!("/proc/{}/stat", late.id())).unwrap();
    eventually("it has its number, and no lock", || stat().contains(") T "));
    bus.kill_broker();
    start_broker(&mut bus, None);
    // Somebody who may get the number.
    let other = Session::connect_to(&bus.system).unwrap();

    kill(Pid::from_raw(late.id() as i32), Signal::SIGCONT).unwrap();

    let peers = || match session.ask(Request::Peers) {
        Ok(Reply::Peers(peers)) => peers,
        answer => panic!("{answer:?}"),
    };
    let is_late = |peer: &PeerInfo| peer.connected && peer.pid == late.id();
    eventually("it publishes", || {
        peers().iter().any(|peer| is_late(peer) && peer.publications == 1)
    });
    assert!(peers().iter().all(|peer| !is_late(peer) || peer.peer != other.peer()));
    late.kill().unwrap();
    late.wait().unwrap();
}
