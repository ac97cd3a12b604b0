use std::collections::BTreeSet;
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use nix::poll::{PollFd, PollFlags, PollTimeout};
use nix::sys::signal::Signal;
use uorb_core::broker_side::{Refusal, open_stream};
use uorb_core::{
    Error, Instance, Publication, RawSubscription, Session, StreamOptions, StreamSubscription,
    Topic, World, depth_max, poll,
};
use uorb_tests::{Actor, Bus, Image, PATIENCE, Plain, Stamped, eventually, program};

pub(crate) fn streamer(bus: &Bus, arguments: &[&str]) -> Actor {
    bus.spawn_program(&program("streamer"), arguments)
}

/// The numbers in a follower's last line: received, lost, pending, torn, out of
/// order.
pub(crate) fn followed(mut follower: Actor) -> [u64; 5] {
    follower.say("all is published");
    let line = follower.finish().pop().expect("it says what it saw");
    let numbers: Vec<u64> = line.split(' ').filter_map(|word| word.parse().ok()).collect();
    numbers.try_into().unwrap_or_else(|_| panic!("{line}"))
}

/// What a world has in shared memory.
pub(crate) fn shared_files(world: &World) -> BTreeSet<String> {
    let entries = std::fs::read_dir("/dev/shm").unwrap().flatten();
    let names = entries.map(|entry| entry.file_name().into_string().unwrap());
    names.filter(|name| name.starts_with(&world.prefix)).collect()
}

fn with_back_pressure(session: &Session, depth: u32) -> StreamSubscription<Plain> {
    let options = StreamOptions { depth: Some(depth), back_pressure: true };
    StreamSubscription::subscribe_with(session, Instance::FIRST, options).unwrap()
}

#[test]
fn a_stream_begins_with_the_newest_message_and_has_every_one_from_there() {
    let mut bus = Bus::start();
    let mut plain = bus.advertise::<Plain>();
    for value in 1..=3 {
        plain.publish(&Plain { value }).unwrap();
    }
    let mut stream = bus.stream::<Plain>();
    for value in 4..=1_000 {
        plain.publish(&Plain { value }).unwrap();
    }
    for value in 3..=1_000 {
        assert_eq!(stream.update(), Some(&Plain { value }));
    }
    assert_eq!(stream.update(), None);
    assert_eq!(stream.lost(), 0);
}

#[test]
fn a_stream_waits_for_its_first_publisher_and_for_the_topic() {
    let mut bus = Bus::start();
    let session = bus.session();
    let options = StreamOptions::default();
    let mut by_name =
        RawSubscription::subscribe_stream(&session, "plain", Instance::FIRST, options).unwrap();
    let mut message = Vec::new();
    assert!(!by_name.updated() && !by_name.copy(&mut message));

    let mut plain = bus.advertise::<Plain>();
    plain.publish(&Plain { value: 1 }).unwrap();
    plain.publish(&Plain { value: 2 }).unwrap();

    assert_eq!(poll(&mut [&mut by_name], Some(PATIENCE)).unwrap(), 1);
    // It joined when it first looked, and begins with what is newest then.
    assert!(by_name.copy(&mut message));
    plain.publish(&Plain { value: 3 }).unwrap();
    plain.publish(&Plain { value: 4 }).unwrap();
    for value in [3_u32, 4] {
        assert!(by_name.updated() && by_name.copy(&mut message));
        assert_eq!(message, value.to_ne_bytes());
    }
}

#[test]
fn a_stream_is_a_descriptor_and_is_polled_beside_ordinary_subscriptions() {
    let mut bus = Bus::start();
    let mut plain = bus.advertise::<Plain>();
    let mut stream = bus.stream::<Plain>();
    let mut stamped = bus.subscribe::<Stamped>();
    assert_eq!(poll(&mut [&mut stream, &mut stamped], Some(Duration::ZERO)).unwrap(), 0);
    let readable = |stream: &StreamSubscription<Plain>| {
        let mut ready = [PollFd::new(stream.as_fd(), PollFlags::POLLIN)];
        nix::poll::poll(&mut ready, PollTimeout::ZERO).unwrap() == 1
    };
    assert!(!readable(&stream));

    plain.publish(&Plain { value: 1 }).unwrap();
    plain.publish(&Plain { value: 2 }).unwrap();

    assert_eq!(poll(&mut [&mut stream, &mut stamped], None).unwrap(), 1);
    assert!(readable(&stream));
    assert_eq!(stream.update(), Some(&Plain { value: 1 }));
    assert!(readable(&stream), "there is one more");
    assert_eq!(stream.update(), Some(&Plain { value: 2 }));
    assert!(!readable(&stream));
}

#[test]
fn back_pressure_lets_a_publisher_lose_nothing() {
    const MESSAGES: u64 = 50_000;
    let bus = Bus::start();
    let mut publisher = streamer(&bus, &["try-publish", &MESSAGES.to_string()]);
    publisher.expect("advertised");
    let mut follower = streamer(&bus, &["follow-and-press", "1024"]);
    follower.expect("subscribed");
    publisher.say("go");
    publisher.until(&["published"]);
    assert_eq!(followed(follower), [MESSAGES, 0, 0, 0, 0]);
}

#[test]
fn several_publishers_under_back_pressure_are_one_order_without_a_hole() {
    const MESSAGES: u64 = 10_000;
    let bus = Bus::start();
    let count = MESSAGES.to_string();
    let mut publishers: Vec<_> = (0..4).map(|_| streamer(&bus, &["try-publish", &count])).collect();
    publishers.iter_mut().for_each(|publisher| publisher.expect("advertised"));
    let mut follower = streamer(&bus, &["follow-and-press", "1024"]);
    follower.expect("subscribed");
    publishers.iter_mut().for_each(|publisher| publisher.say("go"));
    publishers.iter_mut().for_each(|publisher| _ = publisher.until(&["published"]));
    assert_eq!(followed(follower), [4 * MESSAGES, 0, 0, 0, 0]);
}

#[test]
fn a_follower_that_was_stopped_counts_what_it_lost_and_others_lose_nothing() {
    const MESSAGES: u64 = 20_000;
    let bus = Bus::start();
    let mut publisher = streamer(&bus, &["try-publish", &MESSAGES.to_string()]);
    publisher.expect("advertised");
    let mut stopped = streamer(&bus, &["follow", "64"]);
    let mut other = streamer(&bus, &["follow-and-press", "1024"]);
    stopped.expect("subscribed");
    other.expect("subscribed");
    stopped.stop();
    publisher.say("go");
    publisher.until(&["published"]);
    stopped.signal(Signal::SIGCONT);
    let [received, lost, pending, torn, disorder] = followed(stopped);
    assert_eq!((received + lost, pending, torn, disorder), (MESSAGES, 0, 0, 0));
    assert!(lost >= MESSAGES - 100, "its queue holds 64: {received} received");
    assert!(received >= 64, "{received}");
    assert_eq!(followed(other), [MESSAGES, 0, 0, 0, 0]);
}

#[test]
fn a_full_queue_fails_try_publish_with_the_slow_process_and_changes_nothing() {
    let mut bus = Bus::start();
    let session = bus.session();
    let mut plain = bus.advertise::<Plain>();
    let mut pressing = with_back_pressure(&session, 8);
    let mut other = bus.stream::<Plain>();
    let mut node = bus.subscribe::<Plain>();
    for value in 0..8 {
        plain.try_publish(&Plain { value }).unwrap();
    }
    let full = plain.try_publish(&Plain { value: 8 }).unwrap_err();
    assert!(matches!(full, Error::QueueFull { depth: 8, .. }), "{full:?}");
    let ours = format!("(pid {})", std::process::id());
    assert!(full.to_string().contains(&ours), "{full}");
    let full = plain.loan().unwrap().try_publish().unwrap_err();
    assert!(matches!(full, Error::QueueFull { .. }), "{full:?}");

    assert_eq!(node.copy(), Some(Plain { value: 7 }), "neither face has changed");
    let all: Vec<u32> = std::iter::from_fn(|| other.update().map(|plain| plain.value)).collect();
    assert_eq!(all, [0, 1, 2, 3, 4, 5, 6, 7]);

    assert_eq!(pressing.update(), Some(&Plain { value: 0 }));
    plain.try_publish(&Plain { value: 8 }).unwrap();
    // Who does not ask is not told, and overwrites.
    for value in 9..100 {
        plain.publish(&Plain { value }).unwrap();
    }
    let rest: Vec<u32> =
        std::iter::from_fn(|| pressing.update().map(|plain| plain.value)).collect();
    assert_eq!(rest.len() as u64 + pressing.lost(), 99);
    assert_eq!(rest.last(), Some(&99));
    drop(pressing);
    for value in 100..200 {
        plain.try_publish(&Plain { value }).unwrap();
    }
}

#[test]
fn the_slow_process_is_named_also_when_it_is_another_and_forgotten_when_it_dies() {
    let mut bus = Bus::start();
    let mut stamped = bus.advertise::<Stamped>();
    let mut follower = streamer(&bus, &["follow-and-press", "4"]);
    follower.expect("subscribed");
    follower.stop();
    let message = Stamped::new(0, 0);
    let full = std::iter::from_fn(|| Some(stamped.try_publish(&message)))
        .take(100)
        .find_map(Result::err)
        .expect("its queue holds 4");
    assert!(full.to_string().contains(&format!("streamer (pid {})", follower.pid())), "{full}");

    follower.kill();

    eventually("nobody waits for the dead", || stamped.try_publish(&message).is_ok());
    (0..100).for_each(|_| _ = stamped.try_publish(&message).unwrap());
}

#[test]
fn a_large_message_is_borrowed_and_copied() {
    let mut bus = Bus::start();
    let mut image = bus.advertise::<Image>();
    let mut stream = bus.stream::<Image>();
    let mut newest = bus.subscribe::<Image>();
    let mut copied = Vec::new();
    for count in 1..=5 {
        let mut loan = image.loan().unwrap();
        loan.count = count;
        loan.pixels[77_777] = count as u8;
        loan.publish().unwrap();
        let seen = stream.update().unwrap();
        assert_eq!((seen.count, seen.pixels[77_777]), (count, count as u8));
        assert!(newest.updated() && (*newest).copy(&mut copied));
        assert_eq!(copied[..8], count.to_ne_bytes());
        assert!(!newest.updated());
        assert!((*newest).copy(&mut copied), "the last one again");
        assert_eq!(copied[..8], count.to_ne_bytes());
    }
    assert_eq!((stream.lost(), newest.lost()), (0, 0));
}

#[test]
fn what_an_interval_skips_of_a_large_topic_is_not_lost() {
    let mut bus = Bus::start();
    let mut image = bus.advertise::<Image>();
    let mut paced = bus.subscribe::<Image>();
    let mut hasty = bus.subscribe::<Image>();
    paced.set_interval(Duration::from_micros(1));
    for _ in 0..10 {
        image.loan().unwrap().publish().unwrap();
    }
    let mut copied = Vec::new();
    assert!((*paced).copy(&mut copied) && (*hasty).copy(&mut copied));
    assert!(!hasty.updated());
    assert_eq!((paced.lost(), hasty.lost()), (0, 9));
}

fn newest_image(bus: &mut Bus) -> Option<u64> {
    let mut late = bus.subscribe_by_name("image");
    let mut copied = Vec::new();
    let has_copied = late.updated() && late.copy(&mut copied);
    has_copied.then(|| u64::from_ne_bytes(copied[..8].try_into().unwrap()))
}

#[test]
fn the_newest_large_message_is_there_for_latecomers() {
    let mut bus = Bus::start();
    let mut publisher = streamer(&bus, &["hold-image"]);
    publisher.expect("published");
    assert_eq!(newest_image(&mut bus), Some(7), "while its publisher lives");
    bus.kill_broker();
    bus.start_broker();
    eventually("the broker's next has it too", || newest_image(&mut bus) == Some(7));

    publisher.kill();

    eventually("it is buried", || !bus.is_advertised("image"));
    assert_eq!(newest_image(&mut bus), Some(7), "while the broker lives");
    bus.kill_broker();
    bus.start_broker();
    assert_eq!(newest_image(&mut bus), Some(7), "the node has it now");
    let mut publisher = streamer(&bus, &["hold-image"]);
    publisher.expect("published");
    assert_eq!(newest_image(&mut bus), Some(7), "it is another one");
    publisher.finish();
    assert_eq!(newest_image(&mut bus), Some(7), "also where it has left in peace");
}

#[test]
fn a_large_message_is_gone_when_its_publisher_and_the_broker_die() {
    let mut bus = Bus::start();
    // Whose living process keeps the directory.
    let _other = bus.advertise::<Plain>();
    let mut publisher = streamer(&bus, &["hold-image"]);
    publisher.expect("published");
    bus.kill_broker();
    publisher.kill();
    bus.start_broker();
    assert_eq!(newest_image(&mut bus), None);
    let mut publisher = streamer(&bus, &["hold-image"]);
    publisher.expect("published");
    assert_eq!(newest_image(&mut bus), Some(7));
}

#[test]
fn streams_go_on_while_the_broker_is_killed_and_started_again() {
    let mut bus = Bus::start();
    let mut plain = bus.advertise::<Plain>();
    let mut stream = bus.stream::<Plain>();
    let session = bus.session();
    let pressing = with_back_pressure(&session, 16);
    bus.kill_broker();
    for value in 0..10 {
        plain.publish(&Plain { value }).unwrap();
        assert_eq!(stream.update(), Some(&Plain { value }));
    }
    bus.start_broker();
    // Once there is an answer, it has re-joined.
    let mut newcomer = bus.stream::<Plain>();
    assert_eq!(newcomer.update(), Some(&Plain { value: 9 }));
    let full = (10..20).find_map(|value| plain.try_publish(&Plain { value }).err());
    assert!(matches!(full, Some(Error::QueueFull { depth: 16, .. })), "{full:?}");
    drop(pressing);
    for value in 16..1_000 {
        plain.try_publish(&Plain { value }).unwrap();
    }
    for value in 10..1_000 {
        assert_eq!(stream.update(), Some(&Plain { value }));
        assert_eq!(newcomer.update(), Some(&Plain { value }));
    }
    assert_eq!((stream.lost(), newcomer.lost()), (0, 0));
    // A publisher that comes now sends too.
    let mut second = Publication::<Plain>::advertise(&session).unwrap();
    second.publish(&Plain { value: 5_000 }).unwrap();
    assert_eq!(stream.update(), Some(&Plain { value: 5_000 }));
}

#[test]
fn the_limits_of_streams_are_errors_that_name_them() {
    let mut bus = Bus::start();
    let session = bus.session();
    let mut streams: Vec<_> = (0..16).map(|_| bus.stream::<Plain>()).collect();
    let seventeenth = StreamSubscription::<Plain>::subscribe(&session).unwrap_err();
    let Error::Refused(Refusal::Limit { what, limit: 16 }) = &seventeenth else {
        panic!("{seventeenth:?}");
    };
    assert!(what.contains("stream of plain0"), "{what}");
    streams.pop();
    streams.push(bus.stream::<Plain>());

    for depth in [0, depth_max(4) + 1] {
        let options = StreamOptions { depth: Some(depth), back_pressure: false };
        let refused =
            StreamSubscription::<Stamped>::subscribe_with(&session, Instance::FIRST, options);
        let text = refused.unwrap_err().to_string();
        assert!(text.contains(&depth.to_string()) && text.contains("1 to 1024"), "{text}");
    }
}

#[test]
fn in_a_small_dev_shm_large_messages_stream_or_are_refused_and_nothing_dies() {
    let mut bus = Bus::without_broker();
    let mut streamer = streamer(&bus, &["small-memory"]);
    let line = streamer.line().expect("it says how it goes");
    if line.starts_with("skipped") {
        eprintln!("{line}");
        return;
    }
    assert_eq!(line, "streamed");
    assert!(streamer.until(&["filled"]).contains("No space"));
    streamer.expect("still streamed");
    let refused = streamer.until(&["refused"]);
    assert!(refused.contains("image0") && refused.contains("bytes"), "{refused}");
    streamer.expect("published again");
    streamer.finish();
    bus = bus.without_session();
    drop(bus);
}

#[test]
fn a_stopped_system_leaves_nothing_of_its_streams() {
    let mut bus = Bus::start();
    let world = uorb_core::World::of(&bus.system);
    let mut image = bus.advertise::<Image>();
    let stream = bus.stream::<Image>();
    image.loan().unwrap().publish().unwrap();
    let of_world = || shared_files(&world);
    assert!(!of_world().is_empty() && world.root.exists());
    bus.stop();
    assert_eq!(of_world(), BTreeSet::new());
    assert!(!world.root.exists() && !bus.system.dir().exists());
    assert!(matches!(image.loan(), Err(Error::Ended { .. })));
    drop((image, stream));
    bus = bus.without_session();
    assert_eq!(of_world(), BTreeSet::new());
    drop(bus);
}

#[test]
fn a_loan_is_read_and_written_while_newcomers_are_connected_to_its_port() {
    let mut bus = Bus::start();
    let mut image = bus.advertise::<Image>();
    let mut first = bus.stream::<Image>();
    let mut loan = image.loan().unwrap();
    let done = AtomicBool::new(false);

    // The session's thread uses the port for each of them.
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for _ in 0..1_000 {
                drop(bus.stream::<Image>());
            }
            done.store(true, Ordering::Relaxed);
        });
        while !done.load(Ordering::Relaxed) {
            loan.pixels[0] = std::hint::black_box(loan.pixels[0].wrapping_add(1));
        }
    });

    loan.pixels[0] = 7;
    loan.publish().unwrap();
    assert_eq!(first.update().map(|image| image.pixels[0]), Some(7));
    // Nobody counts a port that is gone: its memory is given back.
    drop((first, image));
    bus.stop();
}

#[test]
fn what_a_publisher_sent_before_it_went_is_received_by_one_who_looks_later() {
    let mut bus = Bus::start();
    let mut keeper = bus.advertise::<Plain>();
    let mut stream = bus.stream::<Plain>();
    keeper.publish(&Plain { value: 0 }).unwrap();
    assert!(stream.update().is_some());

    // More than the node keeps, and the follower has not seen their port.
    let mut short = bus.advertise::<Plain>();
    for value in 1..=100 {
        short.publish(&Plain { value }).unwrap();
    }
    drop(short);

    for value in 1..=100 {
        assert_eq!(stream.update(), Some(&Plain { value }));
    }
    assert_eq!(stream.lost(), 0);
}

#[test]
fn a_follower_that_could_not_connect_to_a_publisher_tries_again() {
    let mut bus = Bus::start();
    let mut keeper = bus.advertise::<Plain>();
    keeper.publish(&Plain { value: 0 }).unwrap();
    let mut follower = streamer(&bus, &["follow-blindly"]);
    follower.expect("follows from 0");

    let mut newcomer = bus.advertise::<Plain>();
    follower.say("somebody new is there");
    keeper.publish(&Plain { value: 1 }).unwrap();
    follower.expect("was blind at 1");
    // More than the node keeps.
    for value in 2..=100 {
        newcomer.publish(&Plain { value }).unwrap();
    }

    assert_eq!(follower.finish(), ["98 before 100, 0 lost"]);
}

#[test]
fn a_publisher_that_could_not_connect_to_a_follower_tries_again() {
    let mut bus = Bus::start();
    // So that the publisher has its port before it is blind.
    let _first = bus.stream::<Plain>();
    let mut publisher = streamer(&bus, &["publish-blindly"]);
    publisher.expect("is blind");
    let mut second = bus.stream::<Plain>();
    let mut received = Vec::new();
    let mut receive_up_to = |value| {
        while received.last() != Some(&value) {
            match second.update() {
                Some(plain) => received.push(plain.value),
                None => _ = poll(&mut [&mut second], Some(PATIENCE)).unwrap(),
            }
        }
    };
    publisher.say("somebody follows");
    publisher.expect("is blind no more");
    // What the node forgets at the next message.
    receive_up_to(1);
    publisher.say("it was received");
    receive_up_to(100);
    publisher.finish();

    assert_eq!(received, (0..=100).collect::<Vec<_>>());
    assert_eq!(second.lost(), 0);
}

#[test]
fn a_stream_that_is_followed_is_there_for_publishers_when_no_broker_is() {
    let mut bus = Bus::start();
    let _follower = bus.stream::<Plain>();
    bus.kill_broker();
    let newcomer = World::of(&bus.system).join("newcomer").unwrap();
    // What the next broker does first.
    newcomer.clean_up(|_, _| false);

    let opened =
        open_stream(&newcomer, &bus.system, Plain::METADATA, Instance::FIRST, false).map(|_| ());

    assert_eq!(opened, Ok(()));
}
