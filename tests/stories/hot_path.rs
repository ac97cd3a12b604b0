use uorb_core::SPIN_VARIABLE;
use uorb_tests::{Actor, Bus, calls_between_marks, program};

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

#[test]
fn a_wait_spins_before_it_sleeps_for_as_long_as_the_user_says() {
    let bus = Bus::start();
    let calls_with = |spin_us: &str| {
        let mut command = bus.command(&program("actor"));
        command.arg("wait-between-marks").env(SPIN_VARIABLE, spin_us);
        let mut actor = Actor::spawn(command);
        actor.expect("ready");
        let calls = calls_between_marks(&mut actor, "go");
        actor.finish();
        calls
    };
    assert!(calls_with("60000000").is_empty(), "it never slept");
    assert!(!calls_with("0").is_empty(), "it slept at once");

    let mut command = bus.command(&program("actor"));
    command.arg("wait-between-marks").env(SPIN_VARIABLE, "long");
    let ended = Actor::spawn(command).end();
    assert_eq!(
        (ended.code, &*ended.out),
        (1, "error: UORB_SPIN_US=\"long\" is not a time in microseconds, 0 and up\n")
    );
}
