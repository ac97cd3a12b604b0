//! `uorb listener --all-messages`, and topics that are too large for a node.

use nix::sys::signal::Signal;
use serde_json::Value;
use uorb_core::Instance;
use uorb_core::depth_max;
use uorb_msg::OrbTest;
use uorb_tests::{Actor, Bus, Image, eventually, program};

fn numbered(val: i32) -> OrbTest {
    OrbTest { val, ..Default::default() }
}

/// A listener of all messages of `orb_test`, which prints their numbers.
fn listener(bus: &Bus, arguments: &[&str]) -> Actor {
    let all = ["listener", "orb_test", "--all-messages", "--json", "--field", "val"];
    bus.spawn_uorb(&[&all[..], arguments].concat())
}

/// Waits for the messages of these numbers, in this order.
#[track_caller]
fn expect_numbers(listener: &mut Actor, numbers: std::ops::RangeInclusive<i32>) {
    for number in numbers {
        listener.expect(&format!("{{\"val\":{number}}}"));
    }
}

#[test]
fn a_listener_of_all_messages_has_every_one_though_the_node_keeps_a_single_one() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<OrbTest>();
    assert_eq!(publication.queue_length().get(), 1);
    publication.publish(&numbered(1)).unwrap();
    let mut listener = listener(&bus, &["-n", "1000"]);
    expect_numbers(&mut listener, 1..=1);

    listener.stop();
    for number in 2..=1_000 {
        publication.publish(&numbered(number)).unwrap();
    }
    listener.signal(Signal::SIGCONT);

    expect_numbers(&mut listener, 2..=1_000);
    assert_eq!(listener.end().fine(), "", "so many, and no more");
}

#[test]
fn without_a_count_all_messages_are_followed_until_ctrl_c() {
    let mut bus = Bus::start();
    let _first = bus.advertise_multi::<OrbTest>();
    let mut second = bus.advertise_multi::<OrbTest>();
    second.publish(&numbered(1)).unwrap();
    let mut listener =
        bus.spawn_uorb(&["listener", "orb_test", "-i", "1", "--all-messages", "--field", "val"]);
    listener.expect_all("\nTOPIC: orb_test instance 1 #1\nval: 1");
    for number in 2..=20 {
        second.publish(&numbered(number)).unwrap();
    }
    for number in 2..=20 {
        listener.expect_all(&format!("\nTOPIC: orb_test instance 1 #{number}\nval: {number}"));
    }
    assert_eq!(listener.interrupt().fine(), "");
}

#[test]
fn a_listener_of_all_messages_waits_for_the_first_and_for_no_longer_than_it_is_told() {
    let mut bus = Bus::start();
    let mut waiting = listener(&bus, &["3"]);
    let word = waiting.word().expect("it says that it waits");
    assert!(word.contains("nothing was published yet; waiting"), "{word}");
    let mut publication = bus.advertise::<OrbTest>();
    publication.publish(&numbered(1)).unwrap();
    expect_numbers(&mut waiting, 1..=1);
    for number in 2..=3 {
        publication.publish(&numbered(number)).unwrap();
    }
    expect_numbers(&mut waiting, 2..=3);
    assert_eq!(waiting.end().fine(), "");

    let late = listener(&bus, &["--timeout", "0.01"]).end();
    assert_eq!((late.code, &*late.out), (124, "{\"val\":3}\n"));
    assert_eq!(late.words, "uorb: no message of orb_test for 0.01 s\n");
}

#[test]
fn what_overran_even_the_stream_is_told_when_it_happens_and_at_the_end() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<OrbTest>();
    publication.publish(&numbered(1)).unwrap();
    let mut listener = listener(&bus, &["--meta"]);
    listener.line().expect("the first");

    listener.stop();
    let depth = depth_max(publication.metadata().layout.size_bytes);
    let last = 1 + 3 * depth;
    for number in 2..=last {
        publication.publish(&numbered(number as i32)).unwrap();
    }
    listener.signal(Signal::SIGCONT);

    let lost = 2 * depth;
    for number in 2 + lost..=last {
        let message: Value = serde_json::from_str(&listener.line().unwrap()).unwrap();
        assert_eq!((&message["val"], &message["_meta"]["lost"]), (&number.into(), &lost.into()));
    }
    assert_eq!(listener.word(), Some(format!("uorb: messages lost before #2: {lost}")));
    let ended = listener.interrupt();
    assert_eq!(ended.code, 0);
    let at_the_end =
        format!("uorb: {lost} messages were overwritten before they could be copied\n");
    assert_eq!(ended.words, at_the_end);
}

#[test]
fn a_rate_is_not_for_all_messages() {
    let ended = Bus::without_broker().uorb(&["listener", "orb_test", "--all-messages", "-r", "1"]);
    assert_eq!(ended.code, 2);
    assert!(ended.words.contains("--all-messages"), "{}", ended.words);
}

fn publish_image(image: &mut uorb_core::Publication<Image>, count: u64) {
    let mut loan = image.loan().unwrap();
    loan.count = count;
    loan.publish().unwrap();
}

#[test]
fn a_topic_that_is_too_large_for_a_node_is_listened_to_as_any_other() {
    let mut bus = Bus::start();
    let mut image = bus.advertise::<Image>();
    publish_image(&mut image, 1);

    let newest = bus.uorb(&["listener", "image", "--field", "count,pixels[7]"]);
    assert_eq!(newest.fine(), "\nTOPIC: image #1\ncount: 1\npixels[7]: 0\n");

    for arguments in [&["3"][..], &["3", "--all-messages"]] {
        let fields = ["listener", "image", "--csv", "--field", "count"];
        publish_image(&mut image, 1);
        let mut listener = bus.spawn_uorb(&[&fields[..], arguments].concat());
        listener.expect_all("count\n1");
        for count in 2..=3 {
            publish_image(&mut image, count);
            listener.expect(&count.to_string());
        }
        assert_eq!(listener.end().fine(), "");
    }
    drop(image);
    let last = bus.uorb(&["listener", "image", "1", "--csv", "--field", "count"]);
    assert_eq!(last.fine(), "count\n3\n", "it outlives its publication");
}

#[test]
fn an_instance_whose_large_message_is_gone_does_not_hide_the_others() {
    let mut bus = Bus::start();
    let mut first = bus.spawn_program(&program("streamer"), &["hold-image"]);
    first.expect("published");
    let mut second = bus.advertise_multi::<Image>();
    assert_eq!(second.instance(), Instance::new(1).unwrap());
    publish_image(&mut second, 8);
    // What both had in memory is gone.
    bus.kill_broker();
    first.kill();
    bus.start_broker();
    eventually("the publisher of the other is back", || {
        bus.uorb(&["ls", "-l"]).fine().contains("   1    1    0          1 image1\n")
    });
    let shown = bus.uorb(&["listener", "image", "--field", "count"]);
    assert_eq!(shown.out, "\nTOPIC: image #1\ncount: 8\n", "{}", shown.words);
}

#[test]
fn the_tables_have_room_for_a_large_topic() {
    let mut bus = Bus::start();
    let mut image = bus.advertise::<Image>();
    publish_image(&mut image, 1);
    assert_eq!(
        bus.uorb(&["ls", "-l"]).fine(),
        "   SIZE  #Q #PUB #SUB       #MSG NODE\n6291456   1    1    0          1 image0\n"
    );
    let status = bus.uorb(&["status"]).fine();
    assert!(
        status.contains("INST #SUB #Q    SIZE PATH\nimage       0    0  1 6291456 /obj/image0")
    );
    let top = bus.uorb(&["top", "-1", "image"]).fine();
    let [_, head, row] = top.lines().collect::<Vec<_>>()[..] else { panic!("{top}") };
    assert_eq!(head.len(), row.len(), "{top}");
}
