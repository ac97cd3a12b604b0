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

#[test]
fn a_stream_that_is_followed_makes_no_system_call_and_copies_nothing_aside() {
    let bus = Bus::start();
    let mut actor = bus.spawn(&["hot-path-of-a-stream"]);
    actor.expect("ready");
    // The bell is rung for who joins, and the first message maps its queue.
    let joining = calls_between_marks(&mut actor, "somebody joins");
    eprintln!("while somebody joined: {} system calls: {joining:?}", joining.len());
    actor.expect("joined");
    let calls = calls_between_marks(&mut actor, "go");
    assert!(calls.is_empty(), "system calls between the marks: {calls:?}");
    // iceoryx2 allocates 48 bytes for each message that it loans.
    actor.expect("allocations 1000");
}
