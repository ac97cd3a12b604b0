//! What chaos has found in us, each as a story of its own.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use uorb_core::broker_side::{Node, Reply, Request, Role};
use uorb_core::zerocopy::IntoBytes;
use uorb_core::{
    AdvertiseOptions, Instance, Metadata, PeerInfo, RawPublication, RawSubscription, Session,
    Subscription,
};
use uorb_tests::{Bus, Plain, Stamped, eventually, program};

/// A broker of this build, ready; it may have a place to die or to stop at.
fn start_broker(bus: &mut Bus, fate: Option<(&str, &str)>) {
    let mut command = Command::new(program("uorbd-with-fail-points"));
    command.args(["--ready-fd", "1", "--dir"]).arg(bus.system.base());
    command.envs(fate).env("UORB_LOG", "debug");
    command.stdout(Stdio::piped());
    let mut broker = command.spawn().unwrap();
    let mut line = String::new();
    BufReader::new(broker.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
    assert_eq!(line, "ready\n");
    bus.adopt_broker(broker);
}

/// A publisher that is to stop, or to die, at a place.
fn publisher(bus: &Bus, topic: &str, fates: &[(&str, &str)]) -> Child {
    let mut command = bus.command(&program("chaos"));
    command.args(["publish", topic]).envs(fates.iter().copied());
    command.stdin(Stdio::null()).spawn().unwrap()
}

fn go_on(pid: u32) {
    kill(Pid::from_raw(pid as i32), Signal::SIGCONT).unwrap();
}

/// A large message, of the topic's size.
fn large(count: u64, metadata: &Metadata) -> Vec<u8> {
    let stamped = Stamped::new(count, 0);
    stamped.as_bytes().repeat(metadata.layout.size_bytes as usize / size_of::<Stamped>())
}

fn is_stopped(pid: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    stat.contains(") T ")
}

#[test]
fn a_broker_that_dies_in_a_burial_leaves_no_slot_to_the_dead() {
    let places = ["bury.counted", "bury.rung", "bury.forgotten", "stream.executed"];
    for place in places {
        let mut bus = Bus::without_broker();
        start_broker(&mut bus, Some(("UORB_DIE_AT", place)));
        // It keeps the system when all others are dead.
        let _keeper: Subscription<Stamped> = bus.subscribe();
        // The stream is there: its thread gives slots back.
        drop(bus.stream::<Stamped>());
        let mut victim = publisher(&bus, "stamped", &[("UORB_DIE_AT", "publish.claimed:3")]);
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
    let mut late = publisher(&bus, "stamped", &[("UORB_STOP_AT", "join.welcome")]);
    eventually("it has its number, and no lock", || is_stopped(late.id()));
    bus.kill_broker();
    start_broker(&mut bus, None);
    // Somebody who may get the number.
    let other = Session::connect_to(&bus.system).unwrap();

    go_on(late.id());

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

#[test]
fn a_large_message_that_is_on_its_way_is_not_new_yet() {
    let mut bus = Bus::without_broker();
    start_broker(&mut bus, None);
    let session = bus.session();
    let mut images = RawSubscription::subscribe(&session, "chaos_large", Instance::FIRST).unwrap();
    let mut process = publisher(&bus, "chaos_large", &[("UORB_STOP_AT", "publish.committed:20")]);
    let mut bytes = Vec::new();
    eventually("it stops between its commit and sending", || {
        while images.updated() {
            assert!(images.copy(&mut bytes));
        }
        is_stopped(process.id())
    });
    let copied = images.last_copied();
    assert!(copied.is_some_and(|copied| copied.generation.get() < 20));

    let is_new = images.updated();

    assert!(!is_new, "there is nothing to copy but what was copied: {copied:?}");
    go_on(process.id());
    eventually("it goes on", || images.updated());
    assert!(images.copy(&mut bytes) && images.last_copied() != copied);
    process.kill().unwrap();
    process.wait().unwrap();
}

#[test]
fn two_large_messages_on_their_way_hold_the_third_up_for_a_moment_only() {
    let mut bus = Bus::without_broker();
    start_broker(&mut bus, None);
    let session = bus.session();
    let mut images = RawSubscription::subscribe(&session, "chaos_large", Instance::FIRST).unwrap();
    let mut stopped = ["first", "second"].map(|_| {
        let stop = ("UORB_STOP_AT", "publish.committed:1");
        let process = publisher(&bus, "chaos_large", &[stop]);
        eventually("it stops between its commit and sending", || is_stopped(process.id()));
        // With the first the topic is there to be followed.
        assert!(images.metadata().is_some());
        process
    });
    let metadata = images.metadata().cloned().unwrap();
    let options = AdvertiseOptions::default();
    let mut ours = RawPublication::advertise(&session, &metadata, options).unwrap();

    ours.publish(&large(3, &metadata)).unwrap();

    eventually("the third comes", || images.updated());
    let mut bytes = Vec::new();
    assert!(images.copy(&mut bytes));
    assert!(bytes == large(3, &metadata));
    assert_eq!(images.lost(), 2);
    for process in &mut stopped {
        process.kill().unwrap();
        process.wait().unwrap();
    }
}

#[test]
fn a_large_message_that_came_late_does_not_replace_the_newest() {
    let mut bus = Bus::without_broker();
    start_broker(&mut bus, None);
    let session = bus.session();
    let mut keeper = RawSubscription::subscribe(&session, "chaos_large", Instance::FIRST).unwrap();
    // The first message of all is sent after the second, by one who dies then.
    let fates = [("UORB_STOP_AT", "publish.committed:1"), ("UORB_DIE_AT", "publish.sent:1")];
    let mut late = publisher(&bus, "chaos_large", &fates);
    eventually("it stops between its commit and sending", || is_stopped(late.id()));
    let metadata = keeper.metadata().cloned().unwrap();
    let options = AdvertiseOptions::default();
    let mut ours = RawPublication::advertise(&session, &metadata, options).unwrap();
    ours.publish(&large(2, &metadata)).unwrap();
    drop(ours);
    let log = || std::fs::read_to_string(bus.system.log()).unwrap();
    let kept = || log().matches("keeps the last message").count();
    eventually("the second is kept", || kept() > 0);
    let before = kept();

    go_on(late.id());
    late.wait().unwrap();
    eventually("what the other sent has been looked at", || kept() > before);

    let mut bytes = Vec::new();
    let mut newcomer =
        RawSubscription::subscribe(&session, "chaos_large", Instance::FIRST).unwrap();
    assert!(newcomer.copy(&mut bytes));
    assert!(bytes == large(2, &metadata));
}

#[test]
fn a_broker_that_starts_after_a_large_publisher_s_death_holds_nothing_of_it() {
    let mut bus = Bus::without_broker();
    start_broker(&mut bus, None);
    let session = bus.session();
    let mut images = RawSubscription::subscribe(&session, "chaos_large", Instance::FIRST).unwrap();
    let mut process = publisher(&bus, "chaos_large", &[]);
    eventually("it publishes", || images.updated());
    bus.kill_broker();
    process.kill().unwrap();
    process.wait().unwrap();

    start_broker(&mut bus, None);

    let pid = bus.running_broker().unwrap();
    let maps = || std::fs::read_to_string(format!("/proc/{pid}/maps")).unwrap();
    eventually("nothing of the dead is mapped", || !maps().contains("(deleted)"));
}

#[test]
fn a_large_message_of_one_who_died_while_others_were_cleaned_up_after_is_kept() {
    let mut bus = Bus::without_broker();
    // The first time is its start.
    start_broker(&mut bus, Some(("UORB_STOP_AT", "stream.cleaning:2")));
    let broker = bus.running_broker().unwrap();
    let session = bus.session();
    let fates = [("UORB_STOP_AT", "port.opened:1"), ("UORB_DIE_AT", "publish.sent:3")];
    let mut late = publisher(&bus, "chaos_large", &fates);
    eventually("it has a port of which nobody knows", || is_stopped(late.id()));
    let mut other = publisher(&bus, "stamped", &[("UORB_DIE_AT", "publish.claimed:3")]);
    other.wait().unwrap();
    eventually("the broker begins to clean up after the other", || is_stopped(broker));
    go_on(late.id());
    late.wait().unwrap();

    go_on(broker);

    let mut newcomer =
        RawSubscription::subscribe(&session, "chaos_large", Instance::FIRST).unwrap();
    let mut bytes = Vec::new();
    eventually("its last message is there", || newcomer.copy(&mut bytes));
    assert_eq!(newcomer.last_copied().map(|copied| copied.generation.get()), Some(3));
}

#[test]
fn what_one_sent_who_died_while_others_were_cleaned_up_after_is_received() {
    let mut bus = Bus::without_broker();
    // The first time is its start.
    start_broker(&mut bus, Some(("UORB_STOP_AT", "stream.cleaning:2")));
    let broker = bus.running_broker().unwrap();
    let mut follower = bus.stream::<Stamped>();
    let fates = [("UORB_STOP_AT", "port.told:1"), ("UORB_DIE_AT", "publish.sent:100")];
    let mut late = publisher(&bus, "stamped", &fates);
    eventually("it has its port", || is_stopped(late.id()));
    let mut other = publisher(&bus, "chaos_large", &[("UORB_DIE_AT", "publish.sent:1")]);
    other.wait().unwrap();
    eventually("the broker begins to clean up after the other", || is_stopped(broker));
    go_on(late.id());
    late.wait().unwrap();

    go_on(broker);
    eventually("the broker knows that it is dead", || !bus.is_advertised("stamped"));
    // To make a stream is done after all that the broker has to do for the dead.
    let _another = bus.stream::<Plain>();

    for count in 0..100 {
        assert_eq!(follower.update().map(|stamped| stamped.count), Some(count));
    }
    assert!(follower.update().is_none());
    assert_eq!(follower.lost(), 0);
}

#[test]
fn a_follower_that_was_held_up_at_its_beginning_loses_nothing() {
    let mut bus = Bus::without_broker();
    start_broker(&mut bus, None);
    let mut stamped = bus.advertise::<Stamped>();
    stamped.publish(&Stamped::new(1, 0)).unwrap();
    let mut command = bus.command(&program("chaos"));
    command.args(["follow", "stamped"]).env("UORB_STOP_AT", "follow.begun:1");
    let mut follower = command.stdout(Stdio::piped()).spawn().unwrap();
    eventually("it has looked what is newest", || is_stopped(follower.id()));

    // More than the node keeps.
    for count in 2..=100 {
        stamped.publish(&Stamped::new(count, 0)).unwrap();
    }
    go_on(follower.id());

    let mut line = String::new();
    BufReader::new(follower.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
    assert_eq!(line, "message 2, lost 0\n");
    follower.kill().unwrap();
    follower.wait().unwrap();
}
