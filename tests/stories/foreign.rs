use std::fs;

use uorb_core::broker_side::{Foreigners, Node, Role};
use uorb_core::{Instance, Topic};
use uorb_msg::SensorAccel;
use uorb_tests::{Actor, Bus, Image, Plain, Python, Stamped, calls_between_marks, eventually};

/// What a node knows of foreign programs.
fn foreigners(bus: &Bus, topic: &str) -> Foreigners {
    Node::open(&bus.system, topic, Instance::FIRST, Role::Observer).unwrap().foreigners()
}

/// An actor that publishes accelerations.
fn publisher(bus: &Bus) -> Actor {
    let mut publisher = bus.spawn(&["publish-accel"]);
    publisher.expect("advertised");
    publisher
}

/// Waits until a foreign program receives what an actor publishes.
fn hears(follower: &mut Actor, bus: &Bus, publisher: &Actor) {
    follower.until(&[&format!("publisher {}", bus.peer_of(publisher.pid()))]);
}

#[test]
fn a_stream_says_what_is_on_it() {
    let Some(python) = Python::with_iceoryx2() else { return };
    let mut bus = Bus::start();
    let _publication = bus.advertise::<SensorAccel>();
    let mut reader = python.spawn(&bus, "describe", "sensor_accel", &[]);
    reader.expect("uorb.depth 1024");
    reader.expect(&format!("uorb.hash {:#010x}", SensorAccel::METADATA.layout.message_hash));
    reader.expect("uorb.size 72");
    reader.expect("uorb.topic sensor_accel");
    reader.finish();
}

#[test]
fn a_foreign_program_receives_every_message_of_a_sensor() {
    let Some(python) = Python::with_iceoryx2() else { return };
    let bus = Bus::start();
    let mut publisher = publisher(&bus);
    let mut follower = python.spawn(&bus, "follow", "sensor_accel", &["10000"]);
    follower.expect("following");
    hears(&mut follower, &bus, &publisher);
    assert_eq!(foreigners(&bus, "sensor_accel").subscribers, 1);

    publisher.say("10000");

    publisher.expect("published 10000");
    follower.expect("received 10000 lost 0 torn 0");
}

#[test]
fn the_program_in_the_documentation_follows_a_sensor() {
    let Some(python) = Python::with_iceoryx2() else { return };
    let document = include_str!("../../docs/joining-from-iceoryx2.md");
    let text = document.split("```python\n").nth(1).and_then(|rest| rest.split("```").next());
    let bus = Bus::start();
    let mut publisher = publisher(&bus);
    let mut follower = python.spawn_text(&bus, text.expect("it has a program"));
    let first = follower.line().expect("a line for each message");
    assert!(first.ends_with(" us: 0.0 7919.0 15838.0"), "{first}");

    publisher.say("100");

    // x, y and z of message 100.
    let is_last = |line: &str| line.ends_with(" us: 3100.0 11019.0 18938.0");
    while let Some(line) = follower.line() {
        assert!(!line.starts_with("lost"), "{line}");
        if is_last(&line) {
            return;
        }
    }
    panic!("it has ended");
}

#[test]
fn a_foreign_program_that_joins_a_large_topic_has_its_newest_message() {
    let Some(python) = Python::with_iceoryx2() else { return };
    let mut bus = Bus::start();
    let mut image = bus.advertise::<Image>();
    image.loan().unwrap().publish().unwrap();
    let mut holder = python.spawn(&bus, "hold", "image", &[]);
    holder.expect("following");
    holder.expect("holds one");
}

#[test]
fn a_foreign_program_sleeps_until_it_is_notified() {
    let Some(python) = Python::with_iceoryx2() else { return };
    let bus = Bus::start();
    let mut publisher = publisher(&bus);
    let mut follower = python.spawn(&bus, "wait", "sensor_accel", &["1000"]);
    follower.expect("following");
    hears(&mut follower, &bus, &publisher);
    publisher.say("1000");
    follower.expect("received 1000 lost 0 torn 0");

    let calls = calls_between_marks(&mut publisher, "marks 100");
    // One for each message, but where the listener has not looked since the last.
    assert!(!calls.is_empty() && calls.len() <= 100, "{calls:?}");
    assert!(calls.iter().all(|call| *call == libc::SYS_sendto), "{calls:?}");
}

#[test]
fn a_publish_for_a_foreign_program_that_does_not_sleep_makes_no_system_call() {
    let Some(python) = Python::with_iceoryx2() else { return };
    let bus = Bus::start();
    let mut publisher = publisher(&bus);
    let mut follower = python.spawn(&bus, "follow", "sensor_accel", &["100"]);
    follower.expect("following");
    hears(&mut follower, &bus, &publisher);

    let calls = calls_between_marks(&mut publisher, "marks 1000");

    assert!(calls.is_empty(), "system calls between the marks: {calls:?}");
    publisher.say("100");
    follower.expect("received 100 lost 0 torn 0");
}

#[test]
fn a_foreign_publisher_is_seen_and_named_and_none_of_its_messages_delivered() {
    let Some(python) = Python::with_iceoryx2() else { return };
    let mut bus = Bus::start();
    let mut plain = bus.advertise::<Plain>();
    let mut stream = bus.stream::<Plain>();
    let generation = plain.publish(&Plain { value: 0 }).unwrap().get();
    assert_eq!(stream.update(), Some(&Plain { value: 0 }));
    let peer = bus.peer_of(std::process::id());

    let mut forgers: Vec<_> = (1..=2)
        .map(|count| {
            let mut forger = python.spawn(&bus, "forge", "plain", &["4"]);
            forger.expect("publishing");
            eventually("it is seen", || foreigners(&bus, "plain").publishers == count);
            forger
        })
        .collect();
    let log = fs::read_to_string(bus.system.log()).unwrap();
    for forger in &forgers {
        let named = format!("plain0: a foreign program (pid {}) publishes", forger.pid());
        assert!(log.contains(&named), "no {named:?} in: {log}");
    }

    // What is to come next, by us; what came long ago; what never will.
    for value in 1..=100 {
        let next = generation.wrapping_add(value);
        for first in [next, next.wrapping_sub(50), next.wrapping_add(1 << 30)] {
            forgers[0].say(&format!("{first} {peer} 3"));
            forgers[0].expect("sent");
        }
        assert_eq!(stream.update(), None);
        plain.publish(&Plain { value }).unwrap();
        assert_eq!(stream.update(), Some(&Plain { value }));
        assert_eq!(stream.last_copied().unwrap().generation.get(), next);
    }
    assert_eq!(stream.update(), None);
    assert_eq!(stream.lost(), 0);
    assert_eq!(foreigners(&bus, "plain").dropped, 900);

    for mut forger in forgers {
        forger.finish();
    }
    eventually("they are gone", || foreigners(&bus, "plain").publishers == 0);
}

#[test]
fn a_foreign_program_that_is_killed_is_cleaned_up_after() {
    let Some(python) = Python::with_iceoryx2() else { return };
    let bus = Bus::start();
    let mut publisher = publisher(&bus);
    let mut steady = python.spawn(&bus, "follow", "sensor_accel", &["2000"]);
    steady.expect("following");
    hears(&mut steady, &bus, &publisher);
    let before = names_of(&bus);
    let mut holder = python.spawn(&bus, "hold", "sensor_accel", &[]);
    holder.expect("following");
    holder.expect("holds one");
    eventually("both are seen", || foreigners(&bus, "sensor_accel").subscribers == 2);

    publisher.say("2000");
    holder.kill();

    eventually("it is seen no more", || foreigners(&bus, "sensor_accel").subscribers == 1);
    eventually("nothing of it is left", || names_of(&bus) == before);
    publisher.expect("published 2000");
    steady.expect("received 2000 lost 0 torn 0");
}

/// What the bus's world has in shared memory.
fn names_of(bus: &Bus) -> Vec<String> {
    let prefix = uorb_core::World::of(&bus.system).prefix;
    let names = fs::read_dir("/dev/shm").unwrap().flatten();
    let names = names.map(|entry| entry.file_name().into_string().unwrap());
    let mut names: Vec<_> = names.filter(|name| name.starts_with(&prefix)).collect();
    names.sort();
    names
}

#[test]
fn a_foreign_program_misses_nothing_of_a_broker_s_restart() {
    let Some(python) = Python::with_iceoryx2() else { return };
    let mut bus = Bus::start();
    let mut first = publisher(&bus);
    let mut follower = python.spawn(&bus, "follow", "sensor_accel", &["2000"]);
    follower.expect("following");
    hears(&mut follower, &bus, &first);

    first.say("2000");
    bus.kill_broker();
    bus.start_broker();
    first.expect("published 2000");
    follower.expect("received 2000 lost 0 torn 0");

    // The new broker introduces it to publishers that come later.
    first.finish();
    let mut second = publisher(&bus);
    hears(&mut follower, &bus, &second);
    second.say("2000");
    follower.expect("received 2000 lost 0 torn 0");
    assert_eq!(foreigners(&bus, "sensor_accel").subscribers, 1);
}

#[test]
fn a_foreign_program_that_follows_an_old_layout_is_why_the_new_one_has_no_stream() {
    let Some(python) = Python::with_iceoryx2() else { return };
    let mut bus = Bus::start();
    drop(bus.advertise::<Stamped>());
    let mut follower = python.spawn(&bus, "follow", "stamped", &["1"]);
    follower.expect("following");

    bus.spawn(&["hold-other-layout"]).expect("subscribed");

    let why = "stamped0 has no stream: cannot open the stream uorb/0/stamped/0: iceoryx2 says \
               IncompatibleAttributes";
    let log = || fs::read_to_string(bus.system.log()).unwrap();
    eventually("the log says why", || log().contains(why));
}
