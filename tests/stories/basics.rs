use std::time::Duration;

use uorb_core::{AdvertiseOptions, Error, Publication, QueueLength, RawPublication, Topic, poll};
use uorb_tests::{Bus, PATIENCE, Plain};

fn plain(value: u32) -> Plain {
    Plain { value }
}

fn advertise_with_queue(bus: &mut Bus, length: u32) -> Publication<Plain> {
    let queue_length = Some(QueueLength::new(length).unwrap());
    let options = AdvertiseOptions { queue_length, ..AdvertiseOptions::default() };
    Publication::advertise_with(&bus.session(), options).unwrap()
}

#[test]
fn a_late_subscriber_copies_the_last_message() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    publication.publish(&plain(1)).unwrap();

    let mut late = bus.subscribe::<Plain>();

    assert!(late.updated());
    assert_eq!(late.copy(), Some(plain(1)));
    assert!(!late.updated());
    assert_eq!(late.copy(), Some(plain(1)), "with nothing new, the last message again");
}

#[test]
fn a_subscriber_may_come_before_the_publisher() {
    let mut bus = Bus::start();
    let mut early = bus.subscribe::<Plain>();
    assert!(!early.updated() && !early.advertised());
    assert_eq!(early.copy(), None, "nothing was ever published");
    assert_eq!(early.last_publish_time_us(), None);

    let mut publication = bus.advertise::<Plain>();
    assert!(early.advertised() && !early.updated());
    publication.publish(&plain(1)).unwrap();

    assert!(early.updated());
    assert_eq!(early.update(), Some(plain(1)));
    assert!(early.last_publish_time_us().is_some());
}

#[test]
fn a_newcomer_to_a_deep_queue_has_only_the_newest_pending() {
    let mut bus = Bus::start();
    let mut publication = advertise_with_queue(&mut bus, 16);
    for value in 0..10 {
        publication.publish(&plain(value)).unwrap();
    }
    let mut late = bus.subscribe::<Plain>();
    assert_eq!(late.pending(), 1);
    assert_eq!(late.update(), Some(plain(9)));
    assert_eq!(late.update(), None);
}

#[test]
fn a_subscriber_that_fell_behind_gets_the_newest_q_and_counts_the_rest_as_lost() {
    let mut bus = Bus::start();
    let mut publication = advertise_with_queue(&mut bus, 4);
    let mut slow = bus.subscribe::<Plain>();
    for value in 1..=10 {
        publication.publish(&plain(value)).unwrap();
    }
    let copied: Vec<u32> = std::iter::from_fn(|| slow.update()).map(|plain| plain.value).collect();
    assert_eq!(copied, [7, 8, 9, 10]);
    assert_eq!(slow.lost(), 6);
}

#[test]
fn two_publishers_share_an_instance_and_one_may_leave() {
    let mut bus = Bus::start();
    let mut first = bus.advertise::<Plain>();
    let mut second = bus.advertise::<Plain>();
    let mut subscription = bus.subscribe::<Plain>();
    assert_eq!(first.publish(&plain(1)).unwrap().get(), 1);
    assert_eq!(second.publish(&plain(2)).unwrap().get(), 2, "one generation counter for both");

    drop(first);

    assert!(bus.is_advertised("plain"), "publishers are counted");
    second.publish(&plain(3)).unwrap();
    assert_eq!(subscription.copy(), Some(plain(3)));

    drop(second);

    assert!(!bus.is_advertised("plain"));
    assert_eq!(subscription.copy(), Some(plain(3)), "the last value stays readable");
    assert!(bus.subscribe::<Plain>().updated(), "and is pending for a newcomer");
}

#[test]
fn advertising_again_without_publishing_makes_nothing_pending() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    let mut subscription = bus.subscribe::<Plain>();
    publication.publish(&plain(1)).unwrap();
    subscription.copy();
    drop(publication);

    let _again = bus.advertise::<Plain>();

    assert!(!subscription.updated());
}

#[test]
fn poll_returns_at_once_when_there_is_something_and_at_the_end_of_its_time_when_not() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    let mut updated = bus.subscribe::<Plain>();
    let mut silent = bus.subscribe_instance::<Plain>(1);
    publication.publish(&plain(1)).unwrap();

    assert_eq!(poll(&mut [&mut updated, &mut silent], None).unwrap(), 1);
    assert_eq!(poll(&mut [&mut updated], None).unwrap(), 1, "until it is copied");
    updated.copy();
    for timeout in [Duration::ZERO, Duration::from_millis(1)] {
        assert_eq!(poll(&mut [&mut updated, &mut silent], Some(timeout)).unwrap(), 0);
        assert_eq!(poll(&mut [&mut silent], Some(timeout)).unwrap(), 0);
    }
}

#[test]
fn a_sleeper_is_woken_for_every_message_it_waits_for() {
    let mut bus = Bus::start();
    let mut there = bus.advertise::<Plain>();
    let mut back = bus.advertise_multi::<Plain>();
    let mut ours = bus.subscribe::<Plain>();
    let mut theirs = bus.subscribe_instance::<Plain>(1);
    // Each waits for the other's message before it sends its own: a wake that
    // was lost would leave both asleep.
    let echo = std::thread::spawn(move || {
        loop {
            poll(&mut [&mut ours], Some(PATIENCE)).unwrap();
            let message = ours.update().expect("it was woken for something");
            back.publish(&message).unwrap();
            if message.value == u32::MAX {
                return;
            }
        }
    });
    for value in (0..10_000).chain([u32::MAX]) {
        there.publish(&plain(value)).unwrap();
        assert_eq!(poll(&mut [&mut theirs], Some(PATIENCE)).unwrap(), 1);
        assert_eq!(theirs.update(), Some(plain(value)));
    }
    echo.join().unwrap();
}

#[test]
fn a_message_of_the_wrong_size_is_refused() {
    let mut bus = Bus::start();
    let session = bus.session();
    let mut raw =
        RawPublication::advertise(&session, Plain::METADATA, AdvertiseOptions::default()).unwrap();
    let refused = raw.publish(&[0; 5]);
    assert!(matches!(refused, Err(Error::WrongSize { expected_bytes: 4, given_bytes: 5, .. })));
    assert!(!bus.subscribe::<Plain>().updated());
}
