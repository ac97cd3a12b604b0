use uorb_tests::{Bus, Stamped};

#[test]
fn a_subscriber_that_writes_into_the_ring_dies_alone() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Stamped>();
    let mut subscription = bus.subscribe::<Stamped>();
    publication.publish(&Stamped::new(1, 1)).unwrap();
    let mut actor = bus.spawn(&["write-into-the-ring"]);
    actor.expect("writes");
    assert_eq!(actor.line(), None, "it has died there");
    assert_eq!(actor.signal_of_death(), Some(nix::libc::SIGSEGV));
    assert_eq!(subscription.update(), Some(Stamped::new(1, 1)));
    publication.publish(&Stamped::new(2, 1)).unwrap();
    assert_eq!(subscription.update(), Some(Stamped::new(2, 1)));
}

#[test]
fn where_no_memory_can_be_mapped_the_error_says_so_and_nothing_aborts() {
    let bus = Bus::start();
    let mut actor = bus.spawn(&["little-address-space"]);
    let line = actor.line().unwrap();
    assert!(line.contains("map wide0") && line.contains("memory"), "{line}");
    actor.until(&["another session:"]);
    assert_eq!(actor.finish(), ["published"]);
}
