//! `uorb record`: what was on the bus is in the log, and readers of another house
//! find it there.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::Path;

use nix::sys::signal::Signal;
use uorb_tests::{Bus, Plain, eventually};
use yule_log::model::msg::UlogMessage;
use yule_log::parser::ULogParser;

use crate::flight_logs::{FlightLog, logs};

/// The payloads of each topic instance, in order, as px4-ulog reads them.
fn payloads(log: &FlightLog) -> BTreeMap<(String, u8), Vec<Vec<u8>>> {
    let of = |series: &crate::flight_logs::Series| {
        (0..series.count()).map(|number| series.message(number).to_vec()).collect()
    };
    log.series.iter().map(|one| ((one.topic.clone(), one.instance), of(one))).collect()
}

/// How many messages yule_log finds, and whether it came to an end without an
/// error.
fn count_by_yule_log(path: &Path) -> (usize, bool) {
    let reader = BufReader::new(File::open(path).expect("it is there"));
    let mut messages = 0;
    for message in ULogParser::new(reader).expect("it reads") {
        match message {
            Ok(UlogMessage::LoggedData(_)) => messages += 1,
            Ok(_) => {}
            Err(_) => return (messages, false),
        }
    }
    (messages, true)
}

#[test]
fn what_is_replayed_and_recorded_is_what_was_in_the_log() {
    for log in logs() {
        let bus = Bus::start();
        let path = bus.system.base().join("recorded.ulg");
        let output = path.to_str().unwrap();
        let mut recorder = bus.spawn_uorb(&["record", "-o", output, "--back-pressure", "--quiet"]);
        bus.uorb(&["replay", log.name(), "--speed", "max", "--back-pressure", "--quiet"]).fine();
        recorder.interrupt().fine();

        let recorded = FlightLog::read(&path);
        assert!(payloads(&recorded) == payloads(log), "{}", log.name());
        assert_eq!(count_by_yule_log(&path), (log.order.len(), true), "{}", log.name());
    }
}

#[test]
fn a_recorder_that_is_killed_leaves_a_log_of_whole_messages() {
    let bus = Bus::start();
    let _sensors = bus.spawn_program(&uorb_tests::program("sensor_sim"), &["--rate-scale", "4"]);
    let size = |path: &Path| fs::metadata(path).map_or(0, |file| file.len());
    for round in 0..20_u64 {
        let path = bus.system.base().join(format!("killed{round}.ulg"));
        let mut recorder = bus.spawn_uorb(&["record", "-o", path.to_str().unwrap(), "--quiet"]);
        // Each time somewhere else: its head alone has tens of thousands of bytes.
        let enough = 60_000 + 7_919 * round;
        eventually("so much is in the file", || size(&path) >= enough);
        recorder.kill();

        let (mut messages, mut series) = (0, 0);
        let mut file = BufReader::new(File::open(&path).unwrap());
        let ending = uorb_ulog::read::<uorb_ulog::Fault>(&mut file, u64::MAX, |told| {
            match told {
                uorb_ulog::Told::Message(_) => messages += 1,
                uorb_ulog::Told::Series(_) => series += 1,
                uorb_ulog::Told::Began { .. } => {}
            }
            Ok(())
        });
        let ending = ending.unwrap_or_else(|fault| panic!("round {round}: {fault}"));
        // yule_log fills a message that is cut off with zeros, and counts it.
        let more = count_by_yule_log(&path).0 - messages;
        let is_cut_off = ending != uorb_ulog::Ending::Whole;
        assert!(more <= usize::from(is_cut_off), "round {round}: {more} more");
        assert!(series > 0, "round {round}");
    }
}

#[test]
fn a_recorder_ends_on_sigterm_and_has_topics_that_appeared_later() {
    let mut bus = Bus::start();
    let path = bus.system.base().join("later.ulg");
    const FIRST: u32 = 0xfeed_beef;
    let mut recorder = bus.spawn_uorb(&["record", "-o", path.to_str().unwrap(), "--quiet"]);
    eventually("it records", || path.exists());
    let mut plain = bus.advertise::<Plain>();
    // Whoever begins to follow has the newest message, and all from there on.
    plain.publish(&Plain { value: FIRST }).unwrap();
    let has_first =
        || fs::read(&path).unwrap().windows(4).any(|bytes| bytes == FIRST.to_le_bytes());
    eventually("it is followed", has_first);
    for value in 0..500 {
        plain.publish(&Plain { value }).unwrap();
    }
    recorder.signal(Signal::SIGTERM);
    recorder.end().fine();

    let recorded = FlightLog::read(&path);
    let series = recorded.series("plain", 0).expect("it was recorded");
    // Behind a timestamp that the topic has not.
    let values = (0..series.count()).map(|n| series.message(n)[8..].to_vec());
    assert!(
        values.eq(std::iter::once(FIRST).chain(0..500).map(|value| value.to_le_bytes().to_vec()))
    );
}

#[test]
fn a_log_that_is_there_is_not_written_over() {
    let bus = Bus::start();
    let path = bus.system.base().join("mine.ulg");
    fs::write(&path, "mine").unwrap();
    let ended = bus.uorb(&["record", "-o", path.to_str().unwrap()]);
    ended.failed(&["mine.ulg", "remove it, or record elsewhere with -o"]);
    assert_eq!(fs::read_to_string(&path).unwrap(), "mine");
}
