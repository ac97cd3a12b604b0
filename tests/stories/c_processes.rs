//! C programs that fork, have threads, and publish from signal handlers.

use std::path::Path;

use uorb_core::{Instance, RawSubscription, StreamOptions};
use uorb_tests::{Bus, Installed, Language};

const SOURCES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/c");

/// Compiles one of the programs in tests/c, under a name of the story's own.
fn compile(name: &str, as_name: &str) -> std::path::PathBuf {
    let source = Path::new(SOURCES).join(format!("{name}.c"));
    let program = Installed::get().compile(Language::C, &[&source], as_name, &["-pthread"]);
    program.unwrap_or_else(|words| panic!("{words}"))
}

/// The numbers in a line.
fn numbers(line: &str) -> Vec<u64> {
    line.split(' ').filter_map(|word| word.parse().ok()).collect()
}

/// What tests/c/interrupted.c publishes.
struct Interrupted {
    number: u32,
    writer: u32,
}

impl Interrupted {
    fn whole(bytes: &[u8]) -> Self {
        let number = u32::from_ne_bytes(bytes[0..4].try_into().unwrap());
        let writer = u32::from_ne_bytes(bytes[4..8].try_into().unwrap());
        let check = i64::from_ne_bytes(bytes[8..16].try_into().unwrap());
        assert_eq!(check, !((i64::from(number) << 32) + i64::from(writer)), "a torn message");
        Self { number, writer }
    }
}

#[test]
fn a_signal_handler_publishes_into_the_topic_that_it_interrupted() {
    let mut bus = Bus::start();
    let mut program = bus.spawn_program(&compile("interrupted", "interrupted"), &[]);
    program.expect("ready");
    let session = bus.session();
    let subscribe =
        |topic| RawSubscription::subscribe(&session, topic, Instance::FIRST).expect("subscribed");
    let (mut same, mut other) = (subscribe("interrupted"), subscribe("other"));

    program.say("go");
    let line = program.line().expect("it says what it has published");
    program.finish();
    let [by_program, by_handler, refused] = numbers(&line)[..] else { panic!("{line}") };
    assert_eq!((refused, by_handler >= 100), (0, true), "{line}");

    let mut message = Vec::new();
    assert_eq!(same.pending(), by_program + by_handler, "each was published once");
    assert!(same.copy(&mut message));
    let last = Interrupted::whole(&message);
    let lasts = [by_program, by_handler];
    assert_eq!(u64::from(last.number), lasts[last.writer as usize], "the last one is the newest");
    assert_eq!(other.pending(), by_handler);
    assert!(other.copy(&mut message));
    assert_eq!(u64::from(Interrupted::whole(&message).number), by_handler);
}

#[test]
fn a_signal_handler_publishes_while_somebody_follows_the_stream() {
    let mut bus = Bus::start();
    let mut program = bus.spawn_program(&compile("interrupted", "interrupted-and-followed"), &[]);
    program.expect("ready");
    let session = bus.session();
    let options = StreamOptions::default();
    let mut every =
        RawSubscription::subscribe_stream(&session, "interrupted", Instance::FIRST, options)
            .unwrap();
    program.say("go");
    let line = program.line().expect("it does not hang");
    let [by_program, by_handler, 0] = numbers(&line)[..] else { panic!("{line}") };

    let mut seen = [0; 2];
    let mut received = 0;
    let mut message = Vec::new();
    while every.updated() {
        assert!(every.copy(&mut message));
        let Interrupted { number, writer } = Interrupted::whole(&message);
        assert!(number > seen[writer as usize], "each writer's are in order");
        seen[writer as usize] = number;
        received += 1;
    }
    program.finish();
    assert_eq!(received + every.lost(), by_program + by_handler);
    // What it sends from outside the handler arrives, as far as the queue goes.
    assert!(received > 100, "{received} received, {} lost", every.lost());
}

#[test]
fn the_child_of_a_fork_has_handles_of_its_own_and_harms_none_of_its_parents() {
    let bus = Bus::start();
    let mut program = bus.spawn_program(&compile("forked", "forked"), &[]);
    assert_eq!(program.finish(), [""; 0]);
}

#[test]
fn threads_share_a_publication_and_open_and_close_handles_beside_each_other() {
    let bus = Bus::start();
    let mut program = bus.spawn_program(&compile("threaded", "threaded"), &[]);
    assert_eq!(program.finish(), [""; 0]);
}
