//! `uorb record`: what was on the bus is in the log, and readers of another house
//! find it there.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use nix::sys::signal::Signal;
use serde_json::Value;
use uorb_core::broker_side::{Node, Reply, Request, Role, Subject, Subscribe, Wish};
use uorb_core::{
    AdvertiseOptions, Instance, Layout, Metadata, Publication, QueueLength, RawPublication, Session,
};
use uorb_tests::{Actor, Bus, Ended, Plain, Stamped, Stranger, eventually, program};
use uorb_ulog::ReplayReady;

use crate::flight_logs::{FlightLog, logs};
use crate::log_readers::{
    Found, by_px4_ulog, by_pyulog, by_yule_log, check_same, read_by_all, records,
};

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
        check_same(&found.payloads, &by_px4_ulog(&log.path).payloads);
        check_same(&by_yule_log(&path).payloads, &by_yule_log(&log.path).payloads);
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
fn a_replay_is_answered_when_all_that_it_has_advertised_is_followed() {
    let mut bus = Bus::start();
    let recording = Recording::begin(&bus, "asked.ulg", &["--back-pressure"]);
    let mut question = bus.advertise_multi::<ReplayReady>();
    let session = bus.session();
    let follower = |topic: &str| {
        let node = Node::open(session.system(), topic, Instance::FIRST, Role::Observer).unwrap();
        node.streams().into_iter().find(|it| it.entry.back_pressure && it.has_begun)
    };
    eventually("it hears questions", || follower("replay_ready").is_some());
    recording.recorder.stop();
    let topics = ["one", "two", "three"].map(|topic| {
        let layout = Layout::untyped(topic.to_string(), 8);
        let metadata = Metadata {
            name: topic.into(),
            layout: std::borrow::Cow::Owned(layout),
            queue_length: QueueLength::ONE,
        };
        RawPublication::advertise(&session, &metadata, AdvertiseOptions::default()).unwrap()
    });
    question.publish(&ReplayReady { timestamp: 1 }).unwrap();
    recording.recorder.signal(Signal::SIGCONT);
    eventually("it answers", || follower("replay_ready").is_some_and(|it| it.pending == 0));
    for topic in &topics {
        let topic = &topic.metadata().name;
        assert!(follower(topic).is_some(), "{topic} is not followed");
    }
}

/// Between the two, whoever publishes must not take it for one that hears everything.
#[test]
fn a_stream_that_the_broker_has_granted_has_not_begun() {
    let mut bus = Bus::start();
    let _plain = bus.advertise::<Plain>();
    let follower = Stranger::connect(&bus.system);
    follower.join("slow").unwrap();
    let wish = Wish { depth: 8, back_pressure: true, place: None };
    for stream in [None, Some(wish)] {
        let subject = Subject::Named("plain".into());
        let subscribe = Subscribe { handle: 1, subject, instance: Instance::FIRST, stream };
        let reply = follower.ask(Request::Subscribe(subscribe));
        assert!(!matches!(reply, None | Some(Reply::Refused(_))), "{reply:?}");
    }
    let node = Node::open(&bus.system, "plain", Instance::FIRST, Role::Observer).unwrap();
    let have_begun = || node.streams().iter().map(|it| it.has_begun).collect::<Vec<_>>();
    assert_eq!(have_begun(), [false]);
    let _stream = bus.stream::<Plain>();
    assert_eq!(have_begun(), [false, true]);
}

#[test]
fn a_replay_stays_until_its_last_messages_are_taken() {
    let Some(log) = logs().iter().min_by_key(|log| log.length_us()) else { return };
    // Fewer than a queue holds, so that nothing else makes the replay wait.
    let all = by_px4_ulog(&log.path).payloads;
    let small = all.iter().filter(|(_, messages)| (50..900).contains(&messages.len()));
    let ((topic, _), _) = small.max_by_key(|(_, messages)| messages.len()).expect("such a topic");
    let bus = Bus::start();
    let recording = Recording::begin(&bus, "last.ulg", &["--back-pressure"]);
    let replay = ["replay", log.name(), "--speed", "4", "--topic", topic, "--back-pressure"];
    let mut replay = bus.spawn_uorb(&replay);
    let has_some = || {
        let file = fs::read(&recording.path).unwrap();
        records(&file).iter().any(|(kind, _)| *kind == 'D')
    };
    eventually("it records", has_some);
    recording.recorder.stop();
    assert!(replay.word().expect("it waits").contains("slow to take the last messages"));
    recording.recorder.signal(Signal::SIGCONT);
    assert_eq!(replay.end().code, 0);
    let (found, summary) = recording.end();
    assert_eq!((summary.lost, summary.messages as usize), (0, found.count()));
    for (series, messages) in all.iter().filter(|((name, _), _)| name == topic) {
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
fn a_topic_keeps_its_layout_while_it_is_recorded() {
    const FIRST: u32 = 0xfeed_beef;
    let mut bus = Bus::start();
    let session = Session::connect_to(&bus.system).unwrap();
    let mut plain = bus.advertise::<Plain>();
    plain.publish(&Plain { value: FIRST }).unwrap();
    let recording = Recording::begin(&bus, "layout.ulg", &[]);
    eventually("it is followed", || has(&recording.path, FIRST));
    drop(plain);
    let advertise = || Publication::<wider::Wider>::advertise(&session);
    // As with any subscriber: nobody is left with messages that he cannot read.
    let refused = advertise().unwrap_err().to_string();
    assert!(refused.contains(&format!("uorb (pid {})", recording.recorder.pid())), "{refused}");
    let (found, _) = recording.end();
    assert_eq!(values(found.of("plain")), [FIRST]);
    eventually("it may have another one", || advertise().is_ok());
}

#[test]
fn a_topic_that_no_head_has_begins_a_new_file() {
    let mut bus = Bus::start();
    let mut stamped = bus.advertise::<Stamped>();
    stamped.publish(&Stamped::new(1, 0xfeed_beef)).unwrap();
    let Recording { mut recorder, path } = Recording::begin(&bus, "first.ulg", &[]);
    eventually("it is followed", || has(&path, 0xfeed_beef));
    // It is in no .msg file.
    let mut plain = bus.advertise::<Plain>();
    plain.publish(&Plain { value: 0xfeed_feed }).unwrap();
    let second = path.with_file_name("first_2.ulg");
    eventually("it is followed", || has(&second, 0xfeed_feed));
    stamped.publish(&Stamped::new(2, 7)).unwrap();
    let summary = Summary::of(&recorder.interrupt());

    assert_eq!(summary, Summary { messages: 3, lost: 0, dropouts: 0 });
    let (first, second) = (read_by_all(&path), read_by_all(&second));
    assert_eq!((first.count(), first.of("stamped").len()), (1, 1));
    assert_eq!((second.of("stamped").len(), second.of("plain").len()), (1, 1));
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
    check_same(&read_by_all(one).payloads, &read_by_all(other).payloads);
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
fn a_topic_that_nobody_knows_is_waited_for_and_told() {
    let bus = Bus::start();
    let path = bus.system.base().join("mine.ulg");
    let output = path.to_str().unwrap();
    let topics = ["-t", "sensor_acel", "-t", "sensor_*", "-t", "orb_test:5"];
    let record = [&["record", "--duration", "0.1", "-o", output], &topics[..]].concat();
    let ended = bus.uorb(&record);
    let told: Vec<_> = ended.words.lines().filter(|line| line.contains("no topic")).collect();
    assert_eq!(told, ["uorb: no topic is named sensor_acel yet; did you mean sensor_accel?"]);
    assert_eq!(ended.code, 0);
}

/// How many messages were published, as the nodes count.
fn published(bus: &Bus) -> u64 {
    let nodes = bus.system.list_nodes().unwrap().into_iter();
    let open = |(topic, instance): (String, Instance)| {
        Node::open(&bus.system, &topic, instance, Role::Observer).unwrap()
    };
    nodes.map(|node| open(node).status().published).sum()
}

#[test]
fn what_sensors_publish_is_recorded_or_counted_and_their_time_never_goes_back() {
    let bus = Bus::start();
    let recording = Recording::begin(&bus, "sensors.ulg", &[]);
    let sim = bus.spawn_program(&program("sensor_sim"), &["--rate-scale", "4"]);
    let is_long = || fs::metadata(&recording.path).is_ok_and(|file| file.len() > 400_000);
    eventually("there are many messages", is_long);
    sim.stop();
    let published = published(&bus);
    let path = recording.path.clone();
    let (found, summary) = recording.end();

    assert_eq!(summary.messages as usize, found.count());
    assert_eq!(summary.messages + summary.lost, published, "{summary:?}");
    eprintln!("{published} messages, {} before their topics were followed", summary.lost);
    let log = FlightLog::read(&path);
    for series in &log.series {
        let timestamps = (0..series.count()).map(|number| series.timestamp_us(number));
        assert!(timestamps.is_sorted(), "{}", series.topic);
    }
}

#[test]
fn two_thousand_messages_a_second_are_recorded_without_a_loss() {
    let rate = |log: &FlightLog| log.order.len() as f64 / (log.length_us() as f64 / 1e6);
    let Some(log) = logs().iter().max_by(|a, b| rate(a).total_cmp(&rate(b))) else { return };
    // Ten times as fast as it was recorded, or more, and the last ten seconds of it.
    let speed = (2_000.0 / rate(log)).max(10.0);
    let start = (log.length_us() as f64 / 1e6 - 10.0 * speed).max(0.0).to_string();
    let bus = Bus::start();
    let recording = Recording::begin(&bus, "fast.ulg", &["--back-pressure"]);
    let cpu_before_s = cpu_s(recording.recorder.pid());
    let speed = speed.to_string();
    let replay = ["replay", log.name(), "--start", &start, "--speed", &speed, "--back-pressure"];
    let replayed = bus.uorb(&[&replay[..], &["--json"]].concat()).fine();
    let replayed: Value = serde_json::from_str(&replayed).unwrap();
    let cpu_s = cpu_s(recording.recorder.pid()) - cpu_before_s;
    // And the question of the replay, which is not recorded.
    let published = published(&bus) - 1;
    let (found, summary) = recording.end();

    assert_eq!(Some(published), replayed["messages"].as_u64());
    assert_eq!(summary, Summary { messages: published, lost: 0, dropouts: 0 });
    assert_eq!(found.count() as u64, published);
    let seconds = replayed["seconds"].as_f64().unwrap();
    eprintln!(
        "{published} messages in {seconds:.1} s, {:.0} a second, at {speed} times recorded speed; \
         CPU of the recorder: {:.1} %",
        published as f64 / seconds,
        100.0 * cpu_s / seconds
    );
}

/// The seconds that a process has computed for.
fn cpu_s(pid: u32) -> f64 {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    let after_name: Vec<&str> = stat.rsplit(") ").next().unwrap().split(' ').collect();
    let ticks: f64 = after_name[11..13].iter().map(|ticks| ticks.parse::<f64>().unwrap()).sum();
    ticks / nix::unistd::sysconf(nix::unistd::SysconfVar::CLK_TCK).unwrap().unwrap() as f64
}
