use std::os::fd::AsFd;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, PollTimeout};
use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags, EpollTimeout};
use tokio::io::unix::AsyncFd;
use uorb_core::{RawSubscription, Subscription, poll};
use uorb_tests::{Bus, PATIENCE, Plain, may_hold};

fn plain(value: u32) -> Plain {
    Plain { value }
}

/// Whether poll(2) calls it readable within this time.
fn is_readable(subscription: &RawSubscription, timeout: PollTimeout) -> bool {
    let mut ready = [PollFd::new(subscription.as_fd(), PollFlags::POLLIN)];
    nix::poll::poll(&mut ready, timeout).expect("poll(2) works") == 1
}

#[test]
fn a_descriptor_is_readable_exactly_while_there_is_something_to_copy() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    publication.publish(&plain(0)).unwrap();
    let mut one = bus.subscribe::<Plain>();
    let mut other = bus.subscribe::<Plain>();
    for value in 1..100 {
        assert!(is_readable(&one, PollTimeout::ZERO), "pending since before it was opened");
        one.copy();
        assert!(!is_readable(&one, PollTimeout::ZERO));
        assert!(is_readable(&other, PollTimeout::ZERO), "each is readable by itself");
        other.copy();
        publication.publish(&plain(value)).unwrap();
        publication.publish(&plain(value)).unwrap();
    }
}

#[test]
fn a_descriptor_stays_readable_until_the_whole_queue_is_copied() {
    let mut bus = Bus::start();
    let options = uorb_core::AdvertiseOptions {
        queue_length: uorb_core::QueueLength::new(8),
        ..Default::default()
    };
    let mut publication =
        uorb_core::Publication::<Plain>::advertise_with(&bus.session(), options).unwrap();
    let mut subscription = bus.subscribe::<Plain>();
    subscription.open_descriptor().unwrap();
    for value in 0..5 {
        publication.publish(&plain(value)).unwrap();
    }
    for value in 0..5 {
        assert!(is_readable(&subscription, PollTimeout::ZERO));
        assert_eq!(subscription.copy(), Some(plain(value)));
    }
    assert!(!is_readable(&subscription, PollTimeout::ZERO));
}

#[test]
fn poll_and_the_descriptor_can_be_used_in_turn() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    let mut subscription = bus.subscribe::<Plain>();
    for value in 0..100 {
        assert_eq!(poll(&mut [&mut subscription], Some(Duration::ZERO)).unwrap(), 0);
        publication.publish(&plain(value)).unwrap();
        assert_eq!(poll(&mut [&mut subscription], Some(PATIENCE)).unwrap(), 1);
        assert!(is_readable(&subscription, PollTimeout::ZERO));
        assert_eq!(subscription.update(), Some(plain(value)));
        assert!(!is_readable(&subscription, PollTimeout::ZERO));
    }
}

#[test]
fn a_thread_in_epoll_is_woken_by_a_publish() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    let mut answer = bus.advertise_multi::<Plain>();
    let mut asked = bus.subscribe::<Plain>();
    let mut answered = bus.subscribe_instance::<Plain>(1);
    let thread = std::thread::spawn(move || {
        let epoll = Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC).unwrap();
        let edge = EpollFlags::EPOLLIN | EpollFlags::EPOLLET;
        epoll.add(&*asked, EpollEvent::new(edge, 0)).unwrap();
        loop {
            let mut events = [EpollEvent::empty()];
            epoll.wait(&mut events, EpollTimeout::NONE).unwrap();
            while let Some(message) = asked.update() {
                answer.publish(&message).unwrap();
                if message.value == 2_000 {
                    return;
                }
            }
        }
    });
    for value in 1..=2_000 {
        publication.publish(&plain(value)).unwrap();
        assert_eq!(poll(&mut [&mut answered], Some(PATIENCE)).unwrap(), 1);
        assert_eq!(answered.update(), Some(plain(value)));
    }
    thread.join().unwrap();
}

#[test]
fn a_paced_subscription_sees_its_first_update_at_once_and_then_one_an_interval() {
    const INTERVAL: Duration = Duration::from_millis(30);
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    let mut paced = bus.subscribe::<Plain>();
    paced.set_interval(INTERVAL);
    assert_eq!(paced.interval(), INTERVAL);
    publication.publish(&plain(1)).unwrap();
    assert_eq!(paced.update(), Some(plain(1)));
    let start = Instant::now();
    publication.publish(&plain(2)).unwrap();
    publication.publish(&plain(3)).unwrap();
    assert!(!paced.updated(), "the interval has begun");

    // Nobody publishes any more: the end of the interval is what wakes.
    assert_eq!(poll(&mut [&mut paced], Some(PATIENCE)).unwrap(), 1);

    assert!(start.elapsed() >= INTERVAL - Duration::from_millis(1));
    assert_eq!(paced.update(), Some(plain(3)));
    assert_eq!(paced.lost(), 0, "nobody wanted what an interval skips");
}

#[test]
fn a_paced_descriptor_is_silent_until_its_interval_ends() {
    const INTERVAL: Duration = Duration::from_millis(50);
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    // Rings the bell all the time, for itself.
    let mut restless = bus.subscribe::<Plain>();
    restless.open_descriptor().unwrap();
    let mut paced = bus.subscribe::<Plain>();
    paced.set_interval(INTERVAL);
    paced.open_descriptor().unwrap();
    publication.publish(&plain(1)).unwrap();
    assert!(is_readable(&paced, PollTimeout::ZERO));
    let start = Instant::now();
    assert_eq!(paced.update(), Some(plain(1)));
    let mut value = 1;
    while !is_readable(&paced, PollTimeout::ZERO) {
        value += 1;
        publication.publish(&plain(value)).unwrap();
        restless.update();
        assert!(start.elapsed() < PATIENCE);
    }
    assert!(start.elapsed() >= INTERVAL - Duration::from_millis(1), "it was readable too early");
    assert_eq!(paced.update(), Some(plain(value)));
    assert!(!is_readable(&paced, PollTimeout::ZERO));
}

#[test]
fn a_paced_descriptor_with_nothing_pending_hears_the_bell_again() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    let mut paced = bus.subscribe::<Plain>();
    paced.set_interval(Duration::from_millis(5));
    paced.open_descriptor().unwrap();
    for value in 0..20 {
        publication.publish(&plain(value)).unwrap();
        // Readable is a hint, `updated` decides.
        while !paced.updated() {
            assert!(is_readable(&paced, PollTimeout::try_from(PATIENCE).unwrap()));
        }
        assert_eq!(paced.copy(), Some(plain(value)));
    }
}

#[test]
fn an_interval_that_is_taken_back_leaves_the_descriptor_readable() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    let mut paced = bus.subscribe::<Plain>();
    paced.open_descriptor().unwrap();
    paced.set_interval(Duration::from_secs(1_000));
    publication.publish(&plain(1)).unwrap();
    assert_eq!(paced.update(), Some(plain(1)));
    publication.publish(&plain(2)).unwrap();
    assert!(!paced.updated() && !is_readable(&paced, PollTimeout::ZERO));
    paced.set_interval(Duration::ZERO);
    assert!(is_readable(&paced, PollTimeout::ZERO));
    assert_eq!(paced.update(), Some(plain(2)));
    publication.publish(&plain(3)).unwrap();
    assert!(is_readable(&paced, PollTimeout::ZERO));
}

#[test]
fn a_descriptor_that_waits_for_its_topic_becomes_readable() {
    let mut bus = Bus::start();
    let mut waiting = bus.subscribe_by_name("plain");
    assert!(!is_readable(&waiting, PollTimeout::ZERO));
    let mut publication = bus.advertise::<Plain>();
    publication.publish(&plain(1)).unwrap();
    while !waiting.updated() {
        assert!(is_readable(&waiting, PollTimeout::try_from(PATIENCE).unwrap()));
    }
    let mut message = Vec::new();
    assert!(waiting.copy(&mut message));
    assert!(!is_readable(&waiting, PollTimeout::ZERO));
    publication.publish(&plain(2)).unwrap();
    assert!(is_readable(&waiting, PollTimeout::ZERO));
}

#[tokio::test]
async fn four_hundred_descriptors_of_one_node_wake_in_tokio() {
    // More than one open file of a FIFO can carry nested in another epoll.
    const DESCRIPTORS: usize = 1_200;
    if !may_hold(DESCRIPTORS as u64) {
        return;
    }
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    let session = bus.session();
    let mut tasks = Vec::new();
    for _ in 0..DESCRIPTORS {
        let subscription = Subscription::<Plain>::subscribe(&session).unwrap();
        // SAFETY: the subscription's descriptor is open, and the same, for as
        // long as the subscription lives.
        #[allow(unsafe_code)]
        let mut descriptor = unsafe { AsyncFd::register(subscription) }.unwrap();
        tasks.push(tokio::spawn(async move {
            let mut seen = 0;
            while seen < 3 {
                let mut guard = descriptor.readable_mut().await.unwrap();
                while let Some(message) = guard.get_inner_mut().update() {
                    seen = message.value;
                }
                guard.clear_ready();
            }
        }));
    }
    for value in 1..=3 {
        publication.publish(&plain(value)).unwrap();
        tokio::task::yield_now().await;
    }
    for task in tasks {
        tokio::time::timeout(PATIENCE, task).await.expect("woken").unwrap();
    }
}

#[test]
fn ten_thousand_subscriptions_follow_one_node() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    let mut subscriptions: Vec<_> = (0..10_000).map(|_| bus.subscribe::<Plain>()).collect();
    publication.publish(&plain(1)).unwrap();
    for subscription in &mut subscriptions {
        assert_eq!(subscription.update(), Some(plain(1)));
    }
    let node = uorb_core::broker_side::Node::open(
        &bus.system,
        "plain",
        uorb_core::Instance::FIRST,
        uorb_core::broker_side::Role::Observer,
    );
    assert_eq!(node.unwrap().status().subscribers, 10_000);
}

#[test]
fn a_process_without_descriptors_is_told_so() {
    let bus = Bus::start();
    let mut actor = bus.spawn(&["few-descriptors"]);
    let line = actor.line().expect("sixty-four are not enough");
    assert!(line.contains("ulimit -n") && line.contains("64"), "{line}");
    let line = actor.line().expect("a topic that is there and cannot be followed is an error");
    assert!(line.contains("ulimit -n"), "{line}");
    actor.expect("followed at last");
}

#[test]
fn a_stray_ring_does_not_keep_a_descriptor_readable() {
    let mut bus = Bus::start();
    let _publication = bus.advertise::<Plain>();
    let mut subscription = bus.subscribe::<Plain>();
    subscription.open_descriptor().unwrap();
    let node = uorb_core::broker_side::Node::open(
        &bus.system,
        "plain",
        uorb_core::Instance::FIRST,
        uorb_core::broker_side::Role::Broker,
    );
    node.unwrap().ring_bell().unwrap();
    assert!(is_readable(&subscription, PollTimeout::ZERO));
    // As PX4's programs do: copy, without a look.
    assert_eq!(subscription.copy(), None, "nothing was ever published");
    assert!(!is_readable(&subscription, PollTimeout::ZERO));
}

#[test]
fn a_newcomer_s_descriptor_wakes_nobody_else() {
    let mut bus = Bus::start();
    let _publication = bus.advertise::<Plain>();
    let sleeper = bus.subscribe::<Plain>();
    sleeper.open_descriptor().unwrap();
    assert!(!is_readable(&sleeper, PollTimeout::ZERO));
    for _ in 0..3 {
        let mut newcomer = bus.spawn(&["follow-by-descriptor"]);
        let mut other = bus.spawn(&["hold-plain-descriptor"]);
        newcomer.expect("subscribed");
        other.expect("open");
        assert!(!is_readable(&sleeper, PollTimeout::ZERO));
    }
}

#[test]
fn poll_without_subscriptions_sleeps() {
    let start = Instant::now();
    assert_eq!(poll(&mut [], Some(Duration::from_millis(20))).unwrap(), 0);
    assert!(start.elapsed() >= Duration::from_millis(20));
}
