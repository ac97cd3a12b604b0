//! `uorb record`: what was on the bus is in the log, and readers of another house
//! find it there.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use nix::sys::signal::Signal;
use serde_json::Value;
use uorb_core::{Publication, Session};
use uorb_tests::{Actor, Bus, Ended, Plain, eventually};

use crate::flight_logs::{FlightLog, logs};
use crate::log_readers::{Found, by_px4_ulog, by_pyulog, by_yule_log, read_by_all};

/// A recorder on its way, and its log.
pub(crate) struct Recording {
    pub(crate) recorder: Actor,
    pub(crate) path: PathBuf,
}

/// What a recorder says at its end.
#[derive(Debug, PartialEq)]
pub(crate) struct Summary {
    pub(crate) messages: u64,
    pub(crate) lost: u64,
    pub(crate) dropouts: u64,
}

impl Recording {
    /// Begins to record, and waits until there is a log.
    pub(crate) fn begin(bus: &Bus, name: &str, arguments: &[&str]) -> Self {
        let path = bus.system.base().join(name);
        let output = ["record", "-o", path.to_str().unwrap()];
        let recorder = bus.spawn_uorb(&[&output, arguments].concat());
        eventually("it records", || fs::metadata(&path).is_ok_and(|file| file.len() > 0));
        Self { recorder, path }
    }

    /// Presses Ctrl-C.
    pub(crate) fn end(mut self) -> (Found, Summary) {
        let ended = self.recorder.interrupt();
        (read_by_all(&self.path), Summary::of(&ended))
    }
}

impl Summary {
    #[track_caller]
    pub(crate) fn of(ended: &Ended) -> Self {
        assert_eq!((ended.code, &*ended.out), (0, ""), "{}", ended.words);
        let words: Vec<&str> = ended.words.split_whitespace().collect();
        let before = |what: &str| {
            let at = words.iter().position(|word| word.trim_end_matches(',') == what);
            at.and_then(|at| words[at - 1].parse().ok()).unwrap_or_else(|| {
                panic!("no number of {what} in {}", ended.words);
            })
        };
        let [messages, lost, dropouts] = ["messages", "lost", "dropouts"].map(before);
        Self { messages, lost, dropouts }
    }
}

/// Waits until a number stands in a file.
pub(crate) fn has(path: &Path, value: u32) -> bool {
    let file = fs::read(path).unwrap_or_default();
    file.windows(4).any(|bytes| bytes == value.to_le_bytes())
}

/// The last number of each message: that of `plain`, behind the timestamp that
/// the topic has not.
pub(crate) fn values(messages: &[Vec<u8>]) -> Vec<u32> {
    let value = |message: &Vec<u8>| *message.last_chunk().expect("four bytes");
    messages.iter().map(value).map(u32::from_le_bytes).collect()
}

fn series_by_pyulog(log: &Path) -> Option<Value> {
    by_pyulog(&[log.into()]).map(|found| found[0]["series"].clone())
}

#[test]
fn what_is_replayed_and_recorded_is_what_was_in_the_log() {
    for log in logs() {
        let bus = Bus::start();
        let recording = Recording::begin(&bus, "recorded.ulg", &["--back-pressure"]);
        bus.uorb(&["replay", log.name(), "--speed", "max", "--back-pressure", "--quiet"]).fine();
        let path = recording.path.clone();
        let (found, summary) = recording.end();

        let messages = log.order.len() as u64;
        assert_eq!(summary, Summary { messages, lost: 0, dropouts: 0 }, "{}", log.name());
        assert!(found.payloads == by_px4_ulog(&log.path).payloads, "{}", log.name());
        assert!(found.payloads == by_yule_log(&log.path).payloads, "{}", log.name());
        assert_eq!(series_by_pyulog(&path), series_by_pyulog(&log.path), "{}", log.name());
    }
}

#[test]
fn a_log_that_is_replayed_at_its_own_pace_is_recorded_without_a_loss() {
    let Some(log) = logs().iter().min_by_key(|log| log.length_us()) else { return };
    // Its last seconds; all of it where that is asked for.
    let seconds = match std::env::var("UORB_WHOLE_LOG") {
        Ok(_) => u64::MAX,
        Err(_) => 10,
    };
    let start = (log.length_us() / 1_000_000).saturating_sub(seconds).to_string();
    let bus = Bus::start();
    let recording = Recording::begin(&bus, "recorded.ulg", &["--back-pressure"]);
    let replay = ["replay", log.name(), "--start", &start, "--back-pressure", "--json"];
    let replayed: Value = serde_json::from_str(&bus.uorb(&replay).fine()).unwrap();
    let (found, summary) = recording.end();

    assert_eq!((Some(summary.messages), summary.lost), (replayed["messages"].as_u64(), 0));
    eprintln!("{} messages in {} s", replayed["messages"], replayed["seconds"]);
    let published: BTreeMap<_, _> = (replayed["series"].as_array().unwrap().iter())
        .map(|it| {
            let series = (it["topic"].as_str().unwrap(), it["instance"].as_u64().unwrap());
            (series, it["messages"].as_u64().unwrap() as usize)
        })
        .collect();
    assert!(!published.is_empty());
    assert_eq!(found.payloads.len(), published.len());
    let whole = by_px4_ulog(&log.path).payloads;
    for ((topic, instance), messages) in &found.payloads {
        assert_eq!(messages.len(), published[&(&**topic, u64::from(*instance))], "{topic}");
        assert!(whole[&(topic.clone(), *instance)].ends_with(messages), "{topic}");
    }
}

#[test]
fn a_replay_does_not_wait_for_topics_that_the_recorder_leaves_out_or_samples() {
    let Some(log) = logs().iter().min_by_key(|log| log.order.len()) else { return };
    let all = by_px4_ulog(&log.path).payloads;
    let mut names: Vec<_> = all.keys().map(|(topic, _)| topic.as_str()).collect();
    names.dedup();
    let (whole, sampled) = (names[0], format!("{}:5", names[1]));
    let bus = Bus::start();
    // The replay waits for a recorder, not for a certain time.
    let replay = ["replay", log.name(), "--speed", "max", "--back-pressure"];
    let mut replay = bus.spawn_uorb(&replay);
    assert!(replay.word().unwrap().contains("nobody follows with back-pressure yet"));
    let chosen = ["--back-pressure", "-t", whole, "-t", &sampled];
    let recording = Recording::begin(&bus, "chosen.ulg", &chosen);
    assert_eq!(replay.end().code, 0);
    let (found, summary) = recording.end();

    assert_eq!(summary.lost, 0);
    let is_chosen = |(topic, _): &&(String, u8)| [whole, names[1]].contains(&&**topic);
    assert!(found.payloads.keys().all(|series| is_chosen(&series)));
    for (series, messages) in all.iter().filter(|((topic, _), _)| topic == whole) {
        assert!(found.payloads[series] == *messages, "{series:?}");
    }
}

#[test]
fn a_recorder_ends_on_sigterm_and_has_topics_that_appeared_later() {
    const FIRST: u32 = 0xfeed_beef;
    let mut bus = Bus::start();
    let Recording { mut recorder, path } = Recording::begin(&bus, "later.ulg", &[]);
    let mut plain = bus.advertise::<Plain>();
    // Whoever begins to follow has the newest message, and all from there on.
    plain.publish(&Plain { value: FIRST }).unwrap();
    eventually("it is followed", || has(&path, FIRST));
    for value in 0..500 {
        plain.publish(&Plain { value }).unwrap();
    }
    recorder.signal(Signal::SIGTERM);
    let summary = Summary::of(&recorder.end());

    assert_eq!(summary, Summary { messages: 501, lost: 0, dropouts: 0 });
    let expected: Vec<u32> = std::iter::once(FIRST).chain(0..500).collect();
    assert_eq!(values(read_by_all(&path).of("plain")), expected);
}

#[test]
fn what_is_published_before_a_new_topic_is_followed_is_recorded_or_counted() {
    const LAST: u32 = 0xfeed_beef;
    let mut bus = Bus::start();
    let recording = Recording::begin(&bus, "missed.ulg", &[]);
    let mut plain = bus.advertise::<Plain>();
    for value in 0..499 {
        plain.publish(&Plain { value }).unwrap();
    }
    plain.publish(&Plain { value: LAST }).unwrap();
    eventually("it is followed", || has(&recording.path, LAST));
    let (found, Summary { messages, lost, dropouts }) = recording.end();

    assert_eq!(messages + lost, 500);
    assert_eq!(messages as usize, found.of("plain").len());
    assert_eq!(dropouts > 0, lost > 0);
    assert_eq!(found.dropouts_ms.len() as u64, dropouts);
}

#[test]
fn what_is_queued_when_a_recorder_is_told_to_end_is_recorded() {
    const FIRST: u32 = 0xfeed_beef;
    let mut bus = Bus::start();
    let mut plain = bus.advertise::<Plain>();
    plain.publish(&Plain { value: FIRST }).unwrap();
    let recording = Recording::begin(&bus, "queued.ulg", &[]);
    eventually("it is followed", || has(&recording.path, FIRST));
    recording.recorder.stop();
    for value in 0..1_000 {
        plain.publish(&Plain { value }).unwrap();
    }
    // Both are there when it goes on.
    recording.recorder.signal(Signal::SIGINT);
    recording.recorder.signal(Signal::SIGCONT);
    let Recording { mut recorder, path } = recording;
    let summary = Summary::of(&recorder.end());

    assert_eq!(summary, Summary { messages: 1_001, lost: 0, dropouts: 0 });
    assert_eq!(values(&read_by_all(&path).of("plain")[1..]), (0..1_000).collect::<Vec<u32>>());
}

mod wider {
    uorb_core::topic! {
        /// `plain` with another field.
        pub struct Wider = "plain" {
            /// The other.
            pub more: u64,
            /// The value.
            pub value: u64,
        }
    }
}

#[test]
fn a_topic_that_gives_way_to_another_layout_goes_on_in_a_new_file() {
    const FIRST: u32 = 0xfeed_beef;
    const LAST: u32 = 0xdead_beef;
    let bus = Bus::start();
    let session = Session::connect_to(&bus.system).unwrap();
    let mut plain = Publication::<Plain>::advertise(&session).unwrap();
    plain.publish(&Plain { value: FIRST }).unwrap();
    let Recording { mut recorder, path } = Recording::begin(&bus, "ways.ulg", &[]);
    eventually("it is followed", || has(&path, FIRST));
    recorder.stop();
    for value in 0..300 {
        plain.publish(&Plain { value }).unwrap();
    }
    drop(plain);
    let mut wider = Publication::<wider::Wider>::advertise(&session).unwrap();
    wider.publish(&wider::Wider { more: 1, value: LAST.into() }).unwrap();
    recorder.signal(Signal::SIGCONT);
    let second = bus.system.base().join("ways_2.ulg");
    eventually("the new one is followed", || has(&second, LAST));
    let summary = Summary::of(&recorder.interrupt());

    let (first, second) = (read_by_all(&path), read_by_all(&second));
    // A queue outlives its publisher for a second; this machine may be slower.
    assert_eq!(summary.messages + summary.lost, 302);
    assert_eq!(summary.dropouts > 0, summary.lost > 0);
    let first = values(first.of("plain"));
    assert_eq!(first[..], [&[FIRST], &(0..300).collect::<Vec<_>>()[..]].concat()[..first.len()]);
    assert_eq!(second.of("plain").len(), 1);
}

#[test]
fn two_recorders_at_once_have_the_same_messages() {
    const FIRST: u32 = 0xfeed_beef;
    let mut bus = Bus::start();
    let mut plain = bus.advertise::<Plain>();
    plain.publish(&Plain { value: FIRST }).unwrap();
    let dir = bus.system.base().join("logs");
    let record = ["record", "-o", dir.to_str().unwrap()];
    let mut recorders = [bus.spawn_uorb(&record), bus.spawn_uorb(&record)];
    let files = || -> Vec<PathBuf> {
        let days = fs::read_dir(&dir).into_iter().flatten().flatten();
        let files = days.flat_map(|day| fs::read_dir(day.path()).unwrap().flatten());
        files.map(|file| file.path()).collect()
    };
    eventually("both follow", || {
        let files = files();
        files.len() == 2 && files.iter().all(|file| has(file, FIRST))
    });
    for value in 0..500 {
        plain.publish(&Plain { value }).unwrap();
    }
    for recorder in &mut recorders {
        let summary = Summary::of(&recorder.interrupt());
        assert_eq!(summary, Summary { messages: 501, lost: 0, dropouts: 0 });
    }
    let [one, other] = &files()[..] else { panic!("two files") };
    assert_eq!(read_by_all(one).payloads, read_by_all(other).payloads);
    // 2026-11-28/14_05_59.ulg, in one second or in two.
    for name in [one, other].map(|path| path.file_name().unwrap().to_str().unwrap().to_string()) {
        let digits = name.trim_end_matches(".ulg").split('_').map(str::parse::<u8>);
        assert!((3..=4).contains(&digits.clone().count()) && digits.clone().all(|it| it.is_ok()));
    }
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

#[test]
fn timestamps_of_a_recorded_series_never_go_back() {
    let bus = Bus::start();
    let _sensors = bus.spawn_program(&uorb_tests::program("sensor_sim"), &["--rate-scale", "4"]);
    let recording = Recording::begin(&bus, "sensors.ulg", &[]);
    let is_long = || fs::metadata(&recording.path).is_ok_and(|file| file.len() > 300_000);
    eventually("there are many messages", is_long);
    let path = recording.path.clone();
    let (found, summary) = recording.end();
    assert_eq!((summary.lost, summary.messages as usize), (0, found.count()));
    let log = FlightLog::read(&path);
    for series in &log.series {
        let timestamps = (0..series.count()).map(|number| series.timestamp_us(number));
        assert!(timestamps.is_sorted(), "{}", series.topic);
    }
}
