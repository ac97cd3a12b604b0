//! `uorb test`: PX4's unit tests of uORB, against the live bus.

use uorb_tests::Bus;

/// PX4's tests, in PX4's order.
const TESTS: [&str; 10] = [
    "test_single",
    "test_SubscriptionMulti",
    "test_multi",
    "test_multi_reversed",
    "test_unadvertise",
    "test_multi2",
    "test_wrap_around",
    "test_queue",
    "test_queue_poll_notify",
    "test_single_unadvertise",
];

#[test]
fn px4s_tests_pass_twice_on_one_system() {
    let bus = Bus::start();
    let run = || bus.uorb(&[&["test"], &TESTS[..]].concat()).fine();
    let expected: Vec<String> = TESTS.iter().map(|name| format!("PASS {name}")).collect();
    let expected = format!("{}\n10 passed, 0 failed\n", expected.join("\n"));
    assert_eq!(run(), expected, "the first time generations begin before the wrap");
    let again = run();
    let notes = again.lines().filter(|line| line.starts_with("note: "));
    let without_notes =
        notes.fold(again.clone(), |all, note| all.replace(&format!("{note}\n"), ""));
    assert_eq!(without_notes, expected);
}

#[test]
fn px4s_latency_test_prints_and_does_not_judge() {
    let bus = Bus::start();
    let printed = bus.uorb(&["test", "latency_test"]).fine();
    let lines: Vec<&str> = printed.lines().collect();
    let [small, medium, large, passed, counts] = lines[..] else { panic!("{printed}") };
    for (line, topic) in
        [(small, "orb_test "), (medium, "orb_test_medium "), (large, "orb_test_large ")]
    {
        assert!(line.starts_with(&format!("latency {topic}(")), "{line}");
        for figure in ["mean ", "std dev ", "min ", "max ", "missed topic updates "] {
            assert!(line.contains(figure), "{line}");
        }
    }
    assert_eq!((passed, counts), ("PASS latency_test", "1 passed, 0 failed"));
}

#[test]
fn without_names_all_tests_run() {
    let bus = Bus::start();
    let mut tests = bus.spawn_uorb(&["test"]);
    tests.expect("PASS test_single");
    tests.expect("PASS test_SubscriptionMulti");
    tests.until(&["PASS latency_test"]);
    assert_eq!(tests.end().fine(), "11 passed, 0 failed\n");
}

#[test]
fn a_test_that_is_disturbed_fails_by_its_name() {
    let mut bus = Bus::start();
    // It wants all ten instances for itself.
    let _taken = bus.advertise_multi::<uorb_msg::OrbTest>();
    let ended = bus.uorb(&["test", "test_SubscriptionMulti", "test_queue"]);
    assert_eq!(ended.code, 1, "{}", ended.out);
    assert!(ended.out.starts_with("FAIL test_SubscriptionMulti: "), "{}", ended.out);
    assert!(ended.out.ends_with("PASS test_queue\n1 passed, 1 failed\n"), "{}", ended.out);
    assert_eq!(ended.words, "uorb: 1 of 2 tests failed\n");
    let ended = bus.uorb(&["test", "test_nothing"]);
    assert_eq!(ended.code, 2);
    assert!(ended.words.contains("test_queue_poll_notify"), "{}", ended.words);
}
