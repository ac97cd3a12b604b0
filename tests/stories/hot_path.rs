use uorb_tests::{Bus, calls_between_marks};

#[test]
fn publish_updated_and_copy_make_no_system_call_and_allocate_nothing() {
    let bus = Bus::start();
    let mut actor = bus.spawn(&["hot-path"]);
    actor.expect("ready");
    let calls = calls_between_marks(&mut actor, "go");
    assert!(calls.is_empty(), "system calls between the marks: {calls:?}");
    actor.expect("allocations 0");
}
