//! `reach`: topics of one machine on another. Each bus here is a machine; they all
//! meet at a port of this one.

use std::net::TcpListener;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use nix::sys::signal::Signal;
use serde_json::Value;
use uorb_core::broker_side::{Node, NodeStatus, Role};
use uorb_core::{
    AdvertiseOptions, Claim, Error, Instance, Layout, Metadata, Priority, Publication, QueueLength,
    RawPublication, StreamSubscription, Topic, now_us, poll,
};
use uorb_tests::{Actor, Bus, PATIENCE, Plain, Stamped, eventually, instance, program};

/// A place to meet.
fn endpoint() -> String {
    let free = TcpListener::bind("127.0.0.1:0").expect("a free port");
    format!("tcp/{}", free.local_addr().expect("it has one"))
}

/// A reach of this name.
fn reach(bus: &Bus, name: &str, arguments: &[&str]) -> Actor {
    let mut arguments = arguments.to_vec();
    arguments.extend(["--name", name]);
    let mut reach = bus.spawn_heard("reach", &arguments);
    reach.expect(&format!("[reach] this is {name}/0"));
    reach
}

/// What `reach status` says of the imports or exports of a topic.
pub(crate) fn links(bus: &Bus, kind: &str, topic: &str) -> Vec<Value> {
    let mut status = bus.spawn_program(&program("reach"), &["status", "--json"]);
    let out = status.end().out;
    let Ok(status) = serde_json::from_str::<Value>(&out) else { return Vec::new() };
    let links = status["links"].as_array().expect("a list").clone();
    links.into_iter().filter(|link| link["kind"] == kind && link["topic"] == topic).collect()
}

/// Waits until it says so of the first of them.
#[track_caller]
pub(crate) fn says(bus: &Bus, kind: &str, topic: &str, what: &str, value: impl Into<Value>) {
    let value = value.into();
    let words = format!("{kind} of {topic}: {what} is {value}");
    eventually(&words, || links(bus, kind, topic).first().is_some_and(|link| link[what] == value));
}

/// What the node of a topic is now, if there is one.
pub(crate) fn look(bus: &Bus, topic: &str, number: u8) -> Option<NodeStatus> {
    let node = Node::open(&bus.system, topic, instance(number), Role::Observer).ok()?;
    Some(node.status())
}

/// Whether it has a publisher: a node is there before its ring and its publisher are.
fn is_published(bus: &Bus, topic: &str, number: u8) -> bool {
    look(bus, topic, number).is_some_and(|node| !node.publishers.is_empty())
}

fn subscribers(bus: &Bus, topic: &str) -> u64 {
    look(bus, topic, 0).map_or(0, |node| node.subscribers)
}

/// Waits until so many streams of an instance have begun: what is published from now
/// on is on them.
fn followed(bus: &Bus, topic: &str, number: u8, streams: usize) {
    eventually("it is followed", || {
        let node = Node::open(&bus.system, topic, instance(number), Role::Observer);
        node.is_ok_and(|node| {
            node.streams().iter().filter(|stream| stream.has_begun).count() == streams
        })
    });
}

/// Two machines, of which the second has the topics of the first.
fn two(export: &str, import: &str) -> ([Bus; 2], [Actor; 2]) {
    let (a, b) = (Bus::start(), Bus::start());
    let at = endpoint();
    let exporting = reach(&a, "a", &["--listen", &at, "--export", export]);
    let importing = reach(&b, "b", &["--connect", &at, "--import", import]);
    ([a, b], [exporting, importing])
}

/// Publishes when reach has room for it.
fn publish(stamped: &mut Publication<Stamped>, count: u64) {
    let message = Stamped::new(count, 7);
    while let Err(error) = stamped.try_publish(&message) {
        assert!(matches!(error, Error::QueueFull { .. }), "{error}");
        std::thread::yield_now();
    }
}

/// Waits for the next message.
fn next<T: Topic>(subscription: &mut StreamSubscription<T>) -> T::Message {
    assert_eq!(poll(&mut [subscription], Some(PATIENCE)).unwrap(), 1, "nothing comes");
    *subscription.update().expect("it was updated")
}

#[test]
fn a_topic_crosses_while_somebody_over_there_subscribes_and_not_a_message_longer() {
    let ([mut a, mut b], _reaches) = two("*,reliable", "a/*");
    let mut stamped = a.advertise::<Stamped>();
    stamped.publish(&Stamped::new(1, 7)).unwrap();
    eventually("it is advertised there", || b.is_advertised("stamped"));
    assert_eq!(subscribers(&a, "stamped"), 0, "nobody has asked for it");
    assert_eq!(look(&b, "stamped", 0).unwrap().published, 0);

    let mut there = b.stream::<Stamped>();

    // The newest first, and then every one.
    assert_eq!(next(&mut there), Stamped::new(1, 7));
    let publishing = std::thread::spawn(move || {
        (2..2_000).for_each(|count| publish(&mut stamped, count));
        stamped
    });
    for count in 2..2_000 {
        let message = next(&mut there);
        assert!(message.is_whole());
        assert_eq!((message.count, message.sender), (count, 7));
    }
    let mut stamped = publishing.join().unwrap();
    assert_eq!(subscribers(&a, "stamped"), 1);
    drop(there);
    eventually("nobody there, nobody here", || subscribers(&a, "stamped") == 0);
    stamped.publish(&Stamped::new(2_000, 7)).unwrap();
    drop(stamped);
    eventually("it has no publisher there either", || !b.is_advertised("stamped"));
    assert_eq!(look(&b, "stamped", 0).unwrap().published, 1_999);
}

#[test]
fn publishers_that_come_and_go_with_other_priorities_cost_no_message() {
    let ([mut a, mut b], _reaches) = two("*,reliable", "a/*");
    let mut stamped = a.advertise::<Stamped>();
    stamped.publish(&Stamped::new(1, 7)).unwrap();
    eventually("it is advertised there", || b.is_advertised("stamped"));
    let mut there = b.stream::<Stamped>();
    assert_eq!(next(&mut there).count, 1);
    let has_ended = Arc::new(AtomicBool::new(false));
    let its_end = has_ended.clone();
    let publishing = std::thread::spawn(move || {
        let mut count = 1;
        while !its_end.load(Ordering::Relaxed) {
            count += 1;
            publish(&mut stamped, count);
        }
        (stamped, count)
    });
    let has_priority = |expected| {
        eventually("it has this priority there", || {
            let node = look(&b, "stamped", 0).expect("it is there");
            node.publishers.last().is_some_and(|entry| entry.priority == expected)
        });
    };

    for _ in 0..5 {
        let options = AdvertiseOptions { priority: Priority::VERY_HIGH, ..Default::default() };
        let second = Publication::<Stamped>::advertise_with(&a.session(), options).unwrap();
        has_priority(Priority::VERY_HIGH);
        drop(second);
        has_priority(Priority::DEFAULT);
    }
    has_ended.store(true, Ordering::Relaxed);
    let (_stamped, published) = publishing.join().unwrap();

    says(&b, "import", "stamped", "messages", published);
    assert_eq!(look(&b, "stamped", 0).unwrap().published, published);
    says(&b, "import", "stamped", "lost", 0);
}

#[test]
fn a_late_joiner_has_the_newest_message_on_whichever_machine_it_is() {
    let ([mut a, mut b], _reaches) = two("*", "a/*");
    let mut plain = a.advertise::<Plain>();
    plain.publish(&Plain { value: 5 }).unwrap();
    eventually("it is advertised there", || b.is_advertised("plain"));
    let mut early = b.subscribe::<Plain>();
    assert_eq!(poll(&mut [&mut early], Some(PATIENCE)).unwrap(), 1);
    assert_eq!(early.copy(), Some(Plain { value: 5 }));

    // Beside the first one; and on a machine that comes only now.
    assert_eq!(b.subscribe::<Plain>().copy(), Some(Plain { value: 5 }));
    let mut c = Bus::start();
    let at = endpoint();
    let _listening = reach(&c, "c", &["--listen", &at, "--import", "*/*"]);
    let mut a_again = Bus::start();
    let mut again = a_again.advertise::<Plain>();
    again.publish(&Plain { value: 6 }).unwrap();
    let _exporting = reach(&a_again, "d", &["--connect", &at, "--export", "plain"]);
    eventually("it is advertised there", || c.is_advertised("plain"));
    let mut late = c.subscribe::<Plain>();
    assert_eq!(poll(&mut [&mut late], Some(PATIENCE)).unwrap(), 1);
    assert_eq!(late.copy(), Some(Plain { value: 6 }));
}

#[test]
fn a_second_machine_that_joins_late_has_the_newest_message_and_the_first_has_it_once() {
    let (mut a, mut b, mut c) = (Bus::start(), Bus::start(), Bus::start());
    let at = endpoint();
    let _a = reach(&a, "a", &["--listen", &at, "--export", "*,reliable"]);
    let _b = reach(&b, "b", &["--connect", &at, "--import", "a/*"]);
    let mut plain = a.advertise::<Plain>();
    plain.publish(&Plain { value: 5 }).unwrap();
    eventually("it is advertised there", || b.is_advertised("plain"));
    let mut first = b.stream::<Plain>();
    assert_eq!(next(&mut first), Plain { value: 5 });

    let _c = reach(&c, "c", &["--connect", &at, "--import", "a/*"]);
    eventually("it is advertised there", || c.is_advertised("plain"));
    assert_eq!(next(&mut c.stream::<Plain>()), Plain { value: 5 });

    plain.publish(&Plain { value: 6 }).unwrap();
    assert_eq!(next(&mut first), Plain { value: 6 }, "and not the 5 again");
}

#[test]
fn what_there_is_to_know_of_a_topic_crosses_with_it() {
    let ([mut a, mut b], _reaches) = two("stamped", "a/*");
    // They have one of their own of the number that it has here, and of the first.
    let _own = b.advertise::<Stamped>();
    let _third = Publication::<Stamped>::advertise_instance(&b.session(), instance(3)).unwrap();
    let options = AdvertiseOptions {
        claim: Claim::Shared(instance(3)),
        priority: Priority::VERY_HIGH,
        queue_length: QueueLength::new(16),
    };
    let mut third = Publication::<Stamped>::advertise_with(&a.session(), options).unwrap();
    third.publish(&Stamped::new(1, 1)).unwrap();

    eventually("it has the next instance", || is_published(&b, "stamped", 1));
    let there = look(&b, "stamped", 1).unwrap();
    assert_eq!(there.queue_length, QueueLength::new(16));
    assert_eq!(there.publishers[0].priority, Priority::VERY_HIGH);
    let metadata = b.session().describe("stamped").unwrap();
    assert_eq!(metadata.layout, Stamped::METADATA.layout);
    let mut there = b.subscribe_instance::<Stamped>(1);
    assert_eq!(poll(&mut [&mut there], Some(PATIENCE)).unwrap(), 1);
    assert_eq!(there.copy(), Some(Stamped::new(1, 1)));
    assert_eq!(look(&b, "stamped", 0).unwrap().published, 0, "their own is their own");
    says(&b, "import", "stamped", "instance", 1);
    says(&b, "import", "stamped", "far_instance", 3);
    let info = b.uorb(&["info", "stamped"]).fine();
    assert!(info.contains("  reach      from a/0, instance 3: "), "{info}");
    let info = a.uorb(&["info", "stamped"]).fine();
    assert!(info.contains("  reach      to 1 other machines: "), "{info}");
}

#[test]
fn three_machines_in_a_ring_that_all_give_and_take_everything_have_no_echo() {
    let mut buses = [Bus::start(), Bus::start(), Bus::start()];
    let places: Vec<String> = (0..3).map(|_| endpoint()).collect();
    let _reaches: Vec<Actor> = (0..3)
        .map(|index| {
            let (listen, connect) = (&*places[index], &*places[(index + 1) % 3]);
            let all = ["--export", "*,reliable", "--import", "*/*"];
            let mut arguments = vec!["--listen", listen, "--connect", connect];
            arguments.extend(all);
            reach(&buses[index], &format!("m{index}"), &arguments)
        })
        .collect();
    let mut publications: Vec<_> = buses.iter_mut().map(|bus| bus.advertise::<Stamped>()).collect();
    for bus in &buses {
        eventually("each has its own and two others", || {
            (0..3).all(|number| look(bus, "stamped", number).is_some())
        });
    }
    // Somebody wants everything everywhere, what comes in from others included.
    let mut streams: Vec<Vec<_>> = (0..3)
        .map(|index| {
            let session = buses[index].session();
            let options = uorb_core::StreamOptions::default();
            let follow = |number| {
                StreamSubscription::<Stamped>::subscribe_with(&session, instance(number), options)
            };
            (0..3).map(|number| follow(number).unwrap()).collect()
        })
        .collect();
    for bus in &buses {
        // The subscription here, and the reach that sends it to the two others.
        followed(bus, "stamped", 0, 2);
        says(bus, "export", "stamped", "machines", 2);
    }

    for count in 1..=100 {
        for (sender, publication) in (0..).zip(&mut publications) {
            publication.publish(&Stamped::new(count, sender)).unwrap();
        }
    }

    for streams in &mut streams {
        let mut senders: Vec<u64> = streams
            .iter_mut()
            .map(|stream| {
                let messages: Vec<_> = (0..100).map(|_| next(stream)).collect();
                let sender = messages[0].sender;
                let expected = (1..=100).map(|count| Stamped::new(count, sender));
                assert!(messages.into_iter().eq(expected), "each once, in order");
                sender
            })
            .collect();
        senders.sort_unstable();
        assert_eq!(senders, [0, 1, 2]);
    }
    for bus in &buses {
        let published = |number| look(bus, "stamped", number).map(|node| node.published);
        assert_eq!([0, 1, 2].map(published), [Some(100); 3]);
        assert_eq!(published(3), None);
    }
}

#[test]
fn a_topic_that_a_local_publisher_has_joined_is_sent_on_without_what_came_in() {
    let (mut a, mut b) = (Bus::start(), Bus::start());
    let at = endpoint();
    let all = ["--export", "*,reliable", "--import", "*/*"];
    let _a = reach(&a, "a", &[&["--listen", &at], &all[..]].concat());
    let mut ours = a.advertise::<Plain>();
    let _b = reach(&b, "b", &[&["--connect", &at], &all[..]].concat());
    eventually("it is advertised there", || b.is_advertised("plain"));
    // Theirs joins the instance on which ours comes in.
    let mut theirs = b.advertise::<Plain>();
    let mut back = Vec::new();
    eventually("theirs is advertised here", || is_published(&a, "plain", 1));
    let session = a.session();
    let mut follow = StreamSubscription::<Plain>::subscribe_with(
        &session,
        instance(1),
        uorb_core::StreamOptions::default(),
    )
    .unwrap();
    let mut both = b.stream::<Plain>();
    followed(&a, "plain", 0, 1);
    followed(&b, "plain", 0, 2);
    for value in 0..10 {
        ours.publish(&Plain { value }).unwrap();
        assert_eq!(next(&mut both), Plain { value });
        theirs.publish(&Plain { value: 100 + value }).unwrap();
        assert_eq!(next(&mut both), Plain { value: 100 + value });
        back.push(next(&mut follow).value);
    }
    assert_eq!(back, (100..110).collect::<Vec<_>>());
    says(&a, "import", "plain", "messages", 10);
    // What was ours is not missing.
    says(&a, "import", "plain", "lost", 0);
}

#[test]
fn what_a_reach_that_was_killed_had_brought_in_is_not_sent_back_by_the_next_one() {
    let (mut a, mut b) = (Bus::start(), Bus::start());
    let at = endpoint();
    let all = ["--export", "*,reliable", "--import", "*/*"];
    let _a = reach(&a, "a", &[&["--listen", &at], &all[..]].concat());
    let mut ours = a.advertise::<Plain>();
    let connecting = [&["--connect", &at], &all[..]].concat();
    let mut first = reach(&b, "b", &connecting);
    eventually("it is advertised there", || b.is_advertised("plain"));
    let mut both = b.stream::<Plain>();
    ours.publish(&Plain { value: 1 }).unwrap();
    assert_eq!(next(&mut both), Plain { value: 1 });
    first.kill();
    // Somebody there joins the instance, whose newest message is the one from here.
    let mut theirs = b.advertise::<Plain>();

    let _next = reach(&b, "b", &connecting);

    eventually("theirs is advertised here", || is_published(&a, "plain", 1));
    let session = a.session();
    let options = uorb_core::StreamOptions::default();
    let mut back =
        StreamSubscription::<Plain>::subscribe_with(&session, instance(1), options).unwrap();
    followed(&b, "plain", 0, 2);
    theirs.publish(&Plain { value: 100 }).unwrap();
    assert_eq!(next(&mut back), Plain { value: 100 });
}

#[test]
fn a_layout_that_does_not_match_is_refused_with_both_field_lists() {
    let ([mut a, mut b], [_a, mut importing]) = two("plain", "a/*");
    let other = Metadata {
        name: "plain".into(),
        layout: std::borrow::Cow::Owned(Layout {
            name: "plain".into(),
            ..<uorb_tests::Image as uorb_core::Message>::LAYOUT.clone()
        }),
        queue_length: QueueLength::ONE,
    };
    let other =
        RawPublication::advertise(&b.session(), &other, AdvertiseOptions::default()).unwrap();

    let _plain = a.advertise::<Plain>();

    let first = importing.word().expect("it says why");
    assert!(first.starts_with("reach: a/0/plain/0 is refused: "), "{first}");
    let words: String = std::iter::once(first)
        .chain(std::iter::from_fn(|| importing.word()))
        .take(3)
        .collect::<Vec<_>>()
        .join("\n");
    assert!(words.contains("uint32_t value;"), "{words}");
    assert!(words.contains("uint64_t count;uint8_t[6291448] pixels;"), "{words}");
    says(&b, "import", "plain", "state", "refused");
    // When nobody uses the other layout any more, it is welcome.
    drop(other);
    let mut there = b.stream::<Plain>();
    let mut plain = a.advertise::<Plain>();
    eventually("it is advertised there", || b.is_advertised("plain"));
    plain.publish(&Plain { value: 3 }).unwrap();
    assert_eq!(next(&mut there), Plain { value: 3 });
}

#[test]
fn the_highest_rate_that_anybody_wants_crosses_and_not_more() {
    const PUBLISHED_HZ: u64 = 400;
    let (mut a, mut b, mut c) = (Bus::start(), Bus::start(), Bus::start());
    let at = endpoint();
    let _a = reach(&a, "a", &["--listen", &at, "--export", "stamped:100"]);
    let _b = reach(&b, "b", &["--connect", &at, "--import", "a/*:20"]);
    let _c = reach(&c, "c", &["--connect", &at, "--import", "a/*:50"]);
    let mut stamped = a.advertise::<Stamped>();
    // Publishes until so many messages in a row have come at this rate, by the stamps that
    // the sender wrote: whoever is held up only takes longer.
    let mut crosses_at = |stream: &mut StreamSubscription<Stamped>, hz: f64| {
        const IN_A_ROW: usize = 40;
        while stream.update().is_some() {}
        let (begun_us, mut sent_us) = (now_us(), Vec::new());
        for tick in 0.. {
            let due_us = begun_us + tick * 1_000_000 / PUBLISHED_HZ;
            std::thread::sleep(Duration::from_micros(due_us.saturating_sub(now_us())));
            stamped.publish(&Stamped::new(tick, now_us())).unwrap();
            while let Some(message) = stream.update() {
                sent_us.push(message.sender);
            }
            let took_s = (now_us() - begun_us) as f64 / 1e6;
            // One of before, the first one, and one on its way.
            assert!(sent_us.len() as f64 <= hz * took_s + 3.0, "{sent_us:?}");
            assert!(took_s < PATIENCE.as_secs_f64(), "never at {hz} Hz: {sent_us:?}");
            if let [.., last] = sent_us[..]
                && let Some(before) = sent_us.iter().rev().nth(IN_A_ROW)
            {
                let its_hz = IN_A_ROW as f64 * 1e6 / (last - before) as f64;
                if (its_hz - hz).abs() <= hz / 20.0 {
                    break;
                }
            }
        }
    };
    for bus in [&mut b, &mut c] {
        eventually("it is advertised there", || bus.is_advertised("stamped"));
    }
    let mut slow = b.stream::<Stamped>();
    eventually("it is asked for", || subscribers(&a, "stamped") == 1);
    crosses_at(&mut slow, 20.0);

    let _fast = c.stream::<Stamped>();
    says(&a, "export", "stamped", "machines", 2);
    crosses_at(&mut slow, 50.0);
    // Nobody wanted the others.
    says(&b, "import", "stamped", "lost", 0);
}

#[test]
fn nothing_is_lost_where_one_wants_a_rate_and_others_who_come_and_go_want_everything() {
    let (mut a, mut b, mut c) = (Bus::start(), Bus::start(), Bus::start());
    let at = endpoint();
    let _a = reach(&a, "a", &["--listen", &at, "--export", "*,reliable"]);
    let _b = reach(&b, "b", &["--connect", &at, "--import", "a/*:50"]);
    let _c = reach(&c, "c", &["--connect", &at, "--import", "a/*"]);
    let mut stamped = a.advertise::<Stamped>();
    stamped.publish(&Stamped::new(0, 7)).unwrap();
    for bus in [&mut b, &mut c] {
        eventually("it is advertised there", || bus.is_advertised("stamped"));
    }
    let mut slow = b.stream::<Stamped>();
    next(&mut slow);

    let mut count = 0;
    for _ in 0..5 {
        let mut all = c.stream::<Stamped>();
        followed(&a, "stamped", 0, 1);
        // The newest of all, behind the newest that it had.
        while next(&mut all).count < count {}
        for _ in 0..100 {
            count += 1;
            publish(&mut stamped, count);
            assert_eq!(next(&mut all).count, count);
        }
        drop(all);
        followed(&a, "stamped", 0, 0);
        // While there is only the rate.
        for _ in 0..100 {
            count += 1;
            publish(&mut stamped, count);
        }
        while next(&mut slow).count < count {}
    }
    says(&b, "import", "stamped", "lost", 0);
    says(&c, "import", "stamped", "lost", 0);
}

#[test]
fn what_was_published_while_nobody_could_send_it_is_counted_and_the_newest_comes_first() {
    let (mut a, mut b) = (Bus::start(), Bus::start());
    let at = endpoint();
    let export = ["--listen", &at, "--export", "*,reliable"];
    let mut exporting = reach(&a, "a", &export);
    let _importing = reach(&b, "b", &["--connect", &at, "--import", "a/*"]);
    let mut stamped = a.advertise::<Stamped>();
    stamped.publish(&Stamped::new(1, 0)).unwrap();
    eventually("it is advertised there", || b.is_advertised("stamped"));
    let mut there = b.stream::<Stamped>();
    assert_eq!(next(&mut there).count, 1);

    for round in 1..=3 {
        exporting.kill();
        eventually("it has no publisher there", || !b.is_advertised("stamped"));
        for count in 2..=50 {
            stamped.publish(&Stamped::new(round * 100 + count, 0)).unwrap();
        }
        exporting = reach(&a, "a", &export);

        assert_eq!(next(&mut there).count, round * 100 + 50);
        eventually("it is advertised there again", || b.is_advertised("stamped"));
        stamped.publish(&Stamped::new(round * 100 + 51, 0)).unwrap();
        assert_eq!(next(&mut there).count, round * 100 + 51);
        says(&b, "import", "stamped", "lost", 48 * round);
    }
    assert_eq!(there.instance(), Instance::FIRST);
    assert!(look(&b, "stamped", 1).is_none(), "it got its instance back each time");
}

#[test]
fn of_two_that_begin_at_the_same_time_one_runs() {
    let mut bus = Bus::start();
    let listen = ["--listen", "tcp/127.0.0.1:0", "--export", "*"];
    for _ in 0..10 {
        let mut two = [0, 1].map(|_| bus.spawn_heard("reach", &listen));
        // Its first line, or none where it has given way.
        let said = two.each_mut().map(Actor::line);
        assert_eq!(said.iter().flatten().count(), 1, "{said:?}");
        for (reach, said) in two.iter_mut().zip(&said) {
            match said {
                Some(_) => reach.kill(),
                None => reach.end().failed(&["runs on this system already"]),
            }
        }
        eventually("the broker knows of the death", || !bus.is_advertised("reach_status"));
    }
}

#[test]
fn whoever_waits_to_be_let_in_says_so_and_ends_with_the_system() {
    let mut bus = Bus::start();
    let nobody = endpoint();
    let mut waiting = bus.spawn_heard("reach", &["--connect", &nobody, "--export", "*"]);
    let words = waiting.word().expect("it says that it waits");
    assert!(words.contains("nobody lets "), "{words}");
    bus.spawn_heard("reach", &["status"]).end().failed(&["nobody has let it in yet"]);

    bus.stop();

    let ended = waiting.end();
    assert_eq!(ended.code, 0, "{}", ended.words);
    assert!(ended.words.contains("has ended"), "{}", ended.words);
}

#[test]
fn there_is_one_reach_on_a_system_and_it_says_what_it_lacks() {
    let bus = Bus::start();
    let at = endpoint();
    let mut first = reach(&bus, "a", &["--listen", &at, "--export", "*"]);
    let second = |arguments: &[&str]| bus.spawn_heard("reach", arguments).end();
    second(&["--listen", &endpoint(), "--export", "*"]).failed(&["runs on this system already"]);
    second(&["--listen", &at]).failed(&["nothing is to cross"]);
    second(&["--export", "*"]).failed(&["nobody can be reached"]);
    second(&["--export", "*", "--listen", &at, "--name", "a/b"]).failed(&["\"a/b\" is no name"]);
    first.kill();
    let mut next = reach(&bus, "a", &["--listen", &at, "--export", "*"]);
    let status = bus.spawn_heard("reach", &["status"]).end().fine();
    assert!(status.starts_with("WAY ") && status.lines().count() == 1, "{status}");
    let status = bus.uorb(&["info", "reach_status"]).fine();
    assert!(!status.contains("  reach  "), "{status}");
    next.signal(Signal::SIGTERM);
    assert_eq!(next.end().code, 0);
    bus.spawn_heard("reach", &["status"]).end().failed(&["no reach runs here"]);
    let busy = TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = format!("tcp/{}", busy.local_addr().unwrap());
    second(&["--export", "*", "--listen", &taken]).failed(&["127.0.0.1"]);
}
