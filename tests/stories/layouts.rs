use uorb_core::{Error, Instance, Publication, RawSubscription, Subscription, poll, topic};
use uorb_tests::{Bus, PATIENCE, Plain, Stamped};

topic! {
    /// Topic `plain` with other fields of the same size.
    pub struct OtherPlain = "plain" { pub other: f32 }
}

#[test]
fn a_live_layout_that_does_not_match_is_refused_with_both_field_lists() {
    let mut bus = Bus::start();
    let mut other = bus.spawn(&["hold-other-layout"]);
    other.expect("subscribed");

    let refused = Publication::<Stamped>::advertise(&bus.session());

    let Err(Error::LayoutMismatch(mismatch)) = &refused else { panic!("{refused:?}") };
    assert_eq!(mismatch.users, [format!("actor (pid {})", other.pid())]);
    let text = refused.unwrap_err().to_string();
    assert!(text.contains("uint64_t count;") && text.contains("uint64_t other;"), "{text}");
    assert!(text.contains("0x"), "both hashes: {text}");
}

#[test]
fn a_layout_that_no_live_process_uses_gives_way() {
    let mut bus = Bus::start();
    let mut old = bus.advertise::<Plain>();
    old.publish(&Plain { value: 1 }).unwrap();
    assert!(Subscription::<OtherPlain>::subscribe(&bus.session()).is_err());
    drop(old);

    let mut new = Publication::<OtherPlain>::advertise(&bus.session()).unwrap();

    let mut subscription = Subscription::<OtherPlain>::subscribe(&bus.session()).unwrap();
    assert!(!subscription.updated(), "the old message went with its layout");
    new.publish(&OtherPlain { other: 1.5 }).unwrap();
    assert_eq!(subscription.update(), Some(OtherPlain { other: 1.5 }));
    let log = std::fs::read_to_string(bus.system.log()).unwrap();
    assert!(
        log.contains("plain: nobody uses the old layout any more, its node gives way"),
        "{log}"
    );
}

#[test]
fn a_topic_that_is_known_by_name_only_is_read_from_its_node() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    publication.publish(&Plain { value: 7 }).unwrap();
    let mut by_name = bus.subscribe_by_name("plain");

    let mut message = Vec::new();
    assert!(by_name.updated() && by_name.copy(&mut message));

    assert_eq!(message, 7_u32.to_ne_bytes());
    let layout = by_name.metadata().unwrap().layout.clone();
    assert_eq!(layout.o_fields(), "uint32_t value;");
}

#[test]
fn a_subscription_by_name_waits_for_a_topic_that_nobody_has_described() {
    let mut bus = Bus::start();
    let mut follower = bus.spawn(&["follow-name", "plain"]);
    follower.expect("subscribed");
    let mut here = bus.subscribe_by_name("plain");
    assert!(!here.updated() && here.metadata().is_none());
    assert_eq!(bus.system.list_nodes().unwrap(), [], "waiting makes no node");

    let mut publication = bus.advertise::<Plain>();
    publication.publish(&Plain { value: 7 }).unwrap();

    follower.expect("4 bytes");
    assert_eq!(poll(&mut [&mut here], Some(PATIENCE)).unwrap(), 1);
    let mut message = Vec::new();
    assert!(here.copy(&mut message));
    publication.publish(&Plain { value: 8 }).unwrap();
    follower.expect("4 bytes");
}

#[test]
fn an_optional_topic_is_there_or_it_is_not() {
    let mut bus = Bus::start();
    let optional = |bus: &mut Bus| {
        RawSubscription::subscribe_optional(&bus.session(), "plain", Instance::FIRST).unwrap()
    };
    assert!(optional(&mut bus).is_none());
    let _publication = bus.advertise::<Plain>();
    assert!(optional(&mut bus).is_some());
}

#[test]
fn a_name_that_cannot_be_a_topic_s_is_refused() {
    let mut bus = Bus::start();
    for name in ["", "../escape", "with space", "9lives", &"x".repeat(58)] {
        let refused = RawSubscription::subscribe(&bus.session(), name, Instance::FIRST);
        assert!(matches!(refused, Err(Error::Refused(_))), "{name:?}: {refused:?}");
    }
}

#[test]
fn what_was_published_after_a_waiting_subscription_is_all_there() {
    use uorb_core::{AdvertiseOptions, QueueLength};
    let mut bus = Bus::start();
    let mut waiting = bus.subscribe_by_name("plain");
    let queue_length = QueueLength::new(8);
    let options = AdvertiseOptions { queue_length, ..AdvertiseOptions::default() };
    let mut publication = Publication::<Plain>::advertise_with(&bus.session(), options).unwrap();
    (1..=5).for_each(|value| _ = publication.publish(&Plain { value }).unwrap());
    assert_eq!(poll(&mut [&mut waiting], Some(PATIENCE)).unwrap(), 1);
    let (mut copied, mut message) = (Vec::new(), Vec::new());
    while waiting.updated() && waiting.copy(&mut message) {
        copied.push(message[0]);
    }
    assert_eq!((&copied[..], waiting.lost()), (&[1, 2, 3, 4, 5][..], 0));
}

#[test]
fn two_layouts_in_turn_on_one_session_never_meet() {
    topic! {
        /// Topic `plain` of another size.
        pub struct WidePlain = "plain" { pub values: [u64; 4] }
    }
    fn in_turn<T: uorb_core::Topic>(session: uorb_core::Session) {
        let mut granted = 0;
        while granted < 300 {
            // The other thread's turn is a mismatch.
            let Ok(mut subscription) = Subscription::<T>::subscribe(&session) else { continue };
            let layout = &subscription.metadata().unwrap().layout;
            assert_eq!(layout.size_bytes as usize, size_of::<T::Message>());
            assert!(!subscription.has_ended());
            granted += 1;
        }
    }
    let mut bus = Bus::start();
    let (session, other) = (bus.session(), bus.session());
    let thread = std::thread::spawn(move || in_turn::<Plain>(other));
    in_turn::<WidePlain>(session);
    thread.join().unwrap();
}

#[test]
fn a_subscription_that_was_swapped_for_another_s_copies_nothing() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    publication.publish(&Plain { value: 7 }).unwrap();
    let mut plain = bus.subscribe::<Plain>();
    let mut stamped = bus.subscribe::<Stamped>();
    let (one, other): (&mut RawSubscription, &mut RawSubscription) = (&mut plain, &mut stamped);
    std::mem::swap(one, other);
    assert!(stamped.copy().is_none(), "four bytes are no message of two hundred and fifty-six");
}
