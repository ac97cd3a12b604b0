//! Publishers and followers of streams that are killed: what was sent is received, and
//! what they had is given back.

use uorb_core::{Publication, StreamSubscription, World, topic};
use uorb_tests::{Bus, Plain, Stamped, eventually};

use super::streams::{followed, shared_files, streamer};

/// A publisher that has sent a hundred messages and was killed.
fn kill_a_publisher(bus: &Bus) {
    let mut publisher = streamer(bus, &["publish", "100"]);
    publisher.expect("advertised");
    publisher.say("go");
    publisher.expect("published, refused 0");
    publisher.kill();
}

/// Whether all that it sent is received by one who has not looked since, when the
/// broker has done all that it has to do for the dead.
fn is_received(bus: &mut Bus, stream: &mut StreamSubscription<Stamped>) {
    eventually("the broker knows that it is dead", || !bus.is_advertised("stamped"));
    // To make a stream is done after that.
    let _another = bus.stream::<Plain>();

    for count in 0..100 {
        assert_eq!(stream.update().map(|stamped| stamped.count), Some(count));
    }
    assert!(stream.update().is_none());
    assert_eq!(stream.lost(), 0);
}

#[test]
fn what_a_publisher_sent_before_it_was_killed_is_received_by_one_who_looks_later() {
    let mut bus = Bus::start();
    let mut stream = bus.stream::<Stamped>();

    kill_a_publisher(&bus);

    is_received(&mut bus, &mut stream);
}

#[test]
fn what_a_killed_publisher_sent_is_received_though_the_broker_dies_too() {
    let mut bus = Bus::start();
    let mut stream = bus.stream::<Stamped>();

    kill_a_publisher(&bus);
    bus.kill_broker();
    bus.start_broker();

    is_received(&mut bus, &mut stream);
}

#[test]
fn what_a_killed_publisher_sent_is_received_though_the_broker_is_replaced() {
    let mut bus = Bus::without_broker();
    bus.start_by_command();
    let mut stream = bus.stream::<Stamped>();

    kill_a_publisher(&bus);
    eventually("the broker knows that it is dead", || !bus.is_advertised("stamped"));
    assert_eq!(bus.uorb(&["start", "--replace"]).code, 0);

    is_received(&mut bus, &mut stream);
}

topic! {
    /// Topic `image` with other fields, as large.
    struct OtherImage = "image" { pub pixels: [u8; 6 << 20] }
}

#[test]
fn a_topic_gets_another_layout_while_a_dead_publisher_of_it_is_needed_for_another_topic() {
    let mut bus = Bus::start();
    let _stream = bus.stream::<Stamped>();
    let mut publisher = streamer(&bus, &["hold-image-and-stamped"]);
    publisher.expect("published");
    publisher.kill();
    eventually("the broker knows that it is dead", || !bus.is_advertised("image"));

    let advertised = Publication::<OtherImage>::advertise(&bus.session());

    assert!(advertised.is_ok(), "{advertised:?}");
}

#[test]
fn the_memory_of_a_killed_publisher_is_given_back_though_a_follower_never_looks() {
    let mut bus = Bus::start();
    let world = World::of(&bus.system);
    let _stream = bus.stream::<Stamped>();
    let before = shared_files(&world);

    kill_a_publisher(&bus);

    eventually("its memory is given back", || shared_files(&world) == before);
}

/// How often a process is killed: more by hand, with UORB_KILLS=1000.
fn kills() -> u64 {
    std::env::var("UORB_KILLS").ok().and_then(|kills| kills.parse().ok()).unwrap_or(100)
}

#[test]
fn killed_publishers_and_followers_cost_nobody_a_message_and_leave_nothing() {
    let mut bus = Bus::start();
    let world = uorb_core::World::of(&bus.system);
    let node = bus.subscribe::<Stamped>();
    let mut witness = streamer(&bus, &["follow-and-press", "512"]);
    witness.expect("subscribed");
    let spawn = |bus: &Bus, kind: u64| match kind {
        0 | 1 => (streamer(bus, &["try-publish-for-ever"]), "advertised"),
        2 => (streamer(bus, &["follow", "16"]), "subscribed"),
        _ => (streamer(bus, &["follow-and-press", "256"]), "subscribed"),
    };
    let mut others: Vec<_> = (0..4).map(|kind| spawn(&bus, kind)).collect();
    others.iter_mut().for_each(|(other, line)| other.expect(line));
    let files = || shared_files(&world);

    let mut random = 0x9e37_79b9_7f4a_7c15_u64;
    let mut most_files = 0;
    for kill in 0..kills() {
        // Somewhere within the next hundred publishes, the two of them together.
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(kill | 1);
        let (kind, after) = ((random >> 33) % 4, node.pending() + (random >> 40) % 100);
        eventually("publishing goes on", || node.pending() >= after);
        let (victim, _) = &mut others[kind as usize];
        victim.kill();
        let (mut next, line) = spawn(&bus, kind);
        next.expect(line);
        others[kind as usize] = (next, line);
        most_files = most_files.max(files().len());
    }
    let publishers = others.drain(..2).collect::<Vec<_>>();
    publishers.into_iter().for_each(|(mut publisher, _)| publisher.kill());
    let [received, lost, pending, torn, disorder] = followed(witness);
    assert_eq!((pending, torn, disorder), (0, 0, 0));
    assert_eq!(received + lost, node.pending(), "and nothing else was published");
    assert_eq!(lost, 0, "of {received}");

    others.into_iter().for_each(|(mut follower, _)| follower.kill());
    // What is left: two services, the broker's membership, and its port.
    eventually("all is cleaned up", || files().len() <= 4);
    eprintln!("{received} messages, {} kills, at most {most_files} files", kills());
    drop(node);
}
