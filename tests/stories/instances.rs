use uorb_core::{Error, Priority, Publication, Refusal, Session};
use uorb_tests::{Bus, Plain, Stamped, instance};

#[test]
fn instances_claimed_by_many_processes_at_once_are_all_different() {
    let bus = Bus::start();
    let mut claimants: Vec<_> = (0..10).map(|_| bus.spawn(&["claim", "75"])).collect();
    claimants.iter_mut().for_each(|claimant| claimant.expect("ready"));
    claimants.iter_mut().for_each(|claimant| claimant.say("go"));
    let mut instances: Vec<_> = claimants.iter_mut().map(|c| c.line().unwrap()).collect();
    instances.sort();
    let expected: Vec<_> = (0..10).map(|number| format!("instance {number}")).collect();
    assert_eq!(instances, expected);

    let session = Session::connect_to(&bus.system).unwrap();
    let eleventh = Publication::<Stamped>::advertise_multi(&session, Priority::DEFAULT);
    let Err(Error::Refused(Refusal::InstancesTaken { topic })) = eleventh else {
        panic!("the eleventh was granted: {eleventh:?}");
    };
    assert_eq!(topic, "stamped");
    let log = std::fs::read_to_string(bus.system.log()).unwrap();
    assert!(log.contains("topic stamped has all its 10 instances advertised"), "{log}");
}

#[test]
fn an_instance_that_is_only_subscribed_can_be_claimed() {
    let mut bus = Bus::start();
    let mut third = bus.subscribe_instance::<Plain>(2);
    let mut claimed: Vec<_> = (0..3).map(|_| bus.advertise_multi::<Plain>()).collect();
    let numbers: Vec<_> = claimed.iter().map(|one| one.instance().number()).collect();
    assert_eq!(numbers, [0, 1, 2]);
    claimed[2].publish(&Plain { value: 204 }).unwrap();
    assert_eq!(third.update(), Some(Plain { value: 204 }));
}

#[test]
fn the_lowest_free_instance_is_claimed_again() {
    let mut bus = Bus::start();
    let mut claimed: Vec<_> = (0..3).map(|_| bus.advertise_multi::<Plain>()).collect();
    drop(claimed.remove(1));
    assert_eq!(bus.advertise_multi::<Plain>().instance(), instance(1));
}

#[test]
fn advertise_shares_instance_0_and_advertise_multi_does_not() {
    let mut bus = Bus::start();
    let single = bus.advertise::<Plain>();
    let multi = bus.advertise_multi::<Plain>();
    let shared = bus.advertise::<Plain>();
    let numbers = [single.instance(), multi.instance(), shared.instance()].map(|i| i.number());
    assert_eq!(numbers, [0, 1, 0]);
    assert_eq!(bus.session().group_count("plain"), 2);
}

#[test]
fn an_instance_has_the_priority_of_whoever_advertised_it_last() {
    let mut bus = Bus::start();
    let subscription = bus.subscribe::<Plain>();
    assert_eq!(subscription.priority(), Priority::DEFAULT);
    let session = bus.session();
    for priority in [Priority::MAX, Priority::MIN] {
        let claimed = Publication::<Plain>::advertise_multi(&session, priority).unwrap();
        assert_eq!(claimed.instance(), instance(0));
        assert_eq!(subscription.priority(), priority);
    }
}

#[test]
fn a_node_takes_sixteen_publishers() {
    let mut bus = Bus::start();
    let mut publishers: Vec<_> = (0..16).map(|_| bus.advertise::<Plain>()).collect();
    let refused = Publication::<Plain>::advertise(&bus.session());
    assert!(matches!(refused, Err(Error::Refused(Refusal::PublishersTaken { limit: 16, .. }))));
    for (count, publisher) in publishers.iter_mut().enumerate() {
        let generation = publisher.publish(&Plain { value: 0 }).unwrap();
        assert_eq!(generation.get() as usize, count + 1);
    }
}
