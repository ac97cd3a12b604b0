//! Processes in C beside processes in Rust: they see each other's messages, and
//! each other's deaths.

use std::path::PathBuf;
use std::process::Stdio;

use uorb_core::poll;
use uorb_msg::OrbTest;
use uorb_tests::{Actor, Bus, Ended, Installed, Language, PATIENCE, eventually};

use crate::c_door::source;

/// tests/c/actor.c, compiled for a story.
struct Actors {
    program: PathBuf,
}

impl Actors {
    fn compile(story: &str) -> Self {
        let name = format!("actor-{story}");
        let program = Installed::get().compile(Language::C, &[&source("actor.c")], &name, &[]);
        Self { program: program.unwrap_or_else(|words| panic!("{words}")) }
    }

    fn spawn(&self, bus: &Bus) -> CActor {
        let mut command = bus.command(&self.program);
        command.stderr(Stdio::piped());
        CActor { actor: Actor::spawn(command) }
    }
}

/// A process in C.
struct CActor {
    actor: Actor,
}

impl CActor {
    /// Says a command to it, and returns its answer.
    fn ask(&mut self, command: &str) -> String {
        self.actor.say(command);
        self.actor.line().expect("it answers")
    }

    /// Says a command to it, whose answer is known.
    #[track_caller]
    fn does(&mut self, command: &str, answer: &str) {
        assert_eq!(self.ask(command), answer, "{command}");
    }
}

#[test]
fn c_and_rust_see_each_others_messages_field_by_field() {
    let mut bus = Bus::start();
    let mut c = Actors::compile("fields").spawn(&bus);
    c.does("advertise 0", "ok");
    c.does("subscribe 0", "ok");
    c.does("publish -42", "ok");

    let mut rust = bus.subscribe::<OrbTest>();
    assert_eq!(rust.update().map(|message| message.val), Some(-42));
    let shown = bus.uorb(&["listener", "orb_test", "--json"]).fine();
    let shown: serde_json::Value = serde_json::from_str(&shown).expect("JSON");
    assert_eq!(shown["val"], -42);
    assert_eq!(shown["timestamp"], 0);
    assert_eq!(shown.as_object().map(serde_json::Map::len), Some(2), "{shown}");
    let info = bus.uorb(&["info", "orb_test"]).fine();
    assert!(info.contains(&format!("pid {}", c.actor.pid())), "{info}");

    c.does("copy 0", "-42");
    let mut publication = bus.advertise::<OrbTest>();
    publication.publish(&OrbTest { val: 43, ..Default::default() }).unwrap();
    c.does("poll 30000", "ready");
    c.does("copy 0", "43");
    c.does("check 0", "nothing new");
    assert_eq!(bus.uorb(&["pub", "orb_test", "val=44"]).code, 0);
    c.does("poll 30000", "ready");
    c.does("copy 0", "44");
}

#[test]
fn a_c_publisher_that_is_killed_is_unadvertised_and_its_restart_gets_its_instance_back() {
    let bus = Bus::start();
    let actors = Actors::compile("killed");
    let mut publishers = [actors.spawn(&bus), actors.spawn(&bus), actors.spawn(&bus)];
    for (instance, publisher) in publishers.iter_mut().enumerate() {
        publisher.does("advertise_multi 0", &instance.to_string());
        publisher.does(&format!("publish {instance}"), "ok");
    }
    let mut reader = actors.spawn(&bus);
    reader.does("subscribe 1", "ok");
    reader.does("exists 1", "yes");

    publishers[1].actor.kill();

    eventually("it is unadvertised", || reader.ask("exists 1") == "no");
    reader.does("exists 2", "yes");
    reader.does("check 0", "updated");
    reader.does("copy 0", "1");
    let mut late = actors.spawn(&bus);
    late.does("subscribe 1", "ok");
    late.does("copy 0", "1");

    let mut restarted = actors.spawn(&bus);
    restarted.does("advertise_multi 0", "1");
    reader.does("check 0", "nothing new");
    restarted.does("publish 11", "ok");
    reader.does("copy 0", "11");
}

#[test]
fn ten_c_processes_that_advertise_at_once_have_an_instance_each() {
    let bus = Bus::start();
    let actors = Actors::compile("race");
    let mut processes: Vec<CActor> = (0..11).map(|_| actors.spawn(&bus)).collect();
    // Each has joined the bus, so that they come close to each other.
    processes.iter_mut().for_each(|process| process.does("exists 0", "no"));

    processes.iter_mut().for_each(|process| process.actor.say("advertise_multi 0"));

    let mut instances: Vec<String> =
        processes.iter_mut().map(|process| process.actor.line().expect("it answers")).collect();
    instances.sort();
    assert_eq!(instances, ["0", "1", "2", "3", "4", "5", "6", "7", "8", "9", "EIO"]);
}

#[test]
fn forty_c_processes_are_woken_by_one_publish() {
    let mut bus = Bus::start();
    let actors = Actors::compile("waiters");
    let mut waiters: Vec<CActor> = (0..40).map(|_| actors.spawn(&bus)).collect();
    waiters.iter_mut().for_each(|waiter| waiter.does("subscribe 0", "ok"));
    waiters.iter_mut().for_each(|waiter| waiter.actor.say("poll -1"));

    let mut publication = bus.advertise::<OrbTest>();
    publication.publish(&OrbTest { val: 7, ..Default::default() }).unwrap();

    for waiter in &mut waiters {
        assert_eq!(waiter.actor.line().as_deref(), Some("ready"));
        waiter.does("copy 0", "7");
    }
}

#[test]
fn a_system_that_ends_or_is_not_there_is_an_errno() {
    let mut bus = Bus::start();
    let actors = Actors::compile("ended");
    let mut process = actors.spawn(&bus);
    process.does("advertise 0", "ok");
    process.does("subscribe 0", "ok");
    process.does("publish 1", "ok");
    process.does("copy 0", "1");
    process.actor.say("poll -1");

    bus.stop();

    assert_eq!(process.actor.line().as_deref(), Some("ESHUTDOWN"), "it was asleep");
    process.does("publish 2", "ESHUTDOWN");
    process.does("copy 0", "1");
    let mut late = actors.spawn(&bus);
    late.does("advertise 0", "ECONNREFUSED");
    let word = late.actor.word().expect("it says why");
    assert!(word.contains("orb_advertise orb_test: no broker runs at"), "{word}");
    assert!(word.contains("uorb start"), "{word}");
}

#[test]
fn programs_built_from_different_texts_are_told_so() {
    let bus = Bus::start();
    let [one, two] = ["1", "2"].map(|values| {
        let (name, flag) = (format!("layout-{values}"), format!("-DVALUES={values}"));
        let compiled =
            Installed::get().compile(Language::C, &[&source("layout.c")], &name, &[&flag]);
        compiled.unwrap_or_else(|words| panic!("{words}"))
    });
    let run = |program: &PathBuf, role: &str| {
        let mut command = bus.command(program);
        command.arg(role).stderr(Stdio::piped());
        Actor::spawn(command)
    };
    let mut first = run(&one, "advertise");
    first.expect("ok");

    for (role, function) in [("advertise", "orb_advertise"), ("subscribe", "orb_subscribe")] {
        let Ended { code, out, words } = run(&two, role).end();
        assert_eq!((code, &*out), (1, "EINVAL\n"));
        assert!(words.contains(&format!("{function} disputed: ")), "{words}");
        assert!(words.contains('4') && words.contains('8'), "both sizes: {words}");
    }
    // Nobody uses it any more: it gives way.
    first.finish();
    let mut second = run(&two, "advertise");
    second.expect("ok");
    second.finish();
}

#[test]
fn a_c_program_and_a_rust_program_take_turns() {
    let mut bus = Bus::start();
    let mut c = Actors::compile("turns").spawn(&bus);
    c.does("advertise_multi 0", "0");
    c.does("subscribe 1", "ok");
    let mut answer = bus.advertise_multi::<OrbTest>();
    let mut asked = bus.subscribe_instance::<OrbTest>(0);
    for val in 1..=200 {
        c.does(&format!("publish {val}"), "ok");
        assert_eq!(poll(&mut [&mut asked], Some(PATIENCE)).unwrap(), 1);
        let message = asked.update().expect("it is pending");
        assert_eq!(message.val, val);
        answer.publish(&OrbTest { val: -val, ..message }).unwrap();
        c.does("poll 30000", "ready");
        c.does("copy 0", &(-val).to_string());
    }
}
