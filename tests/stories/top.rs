//! `uorb top`: who publishes how fast, and what is lost.

use nix::sys::signal::Signal;
use serde_json::Value;
use uorb_msg::{SensorAccel, SensorGyro};
use uorb_tests::{Bus, Foreigner, Plain, eventually, program};

use crate::flight_logs::{FlightLog, logs};
use crate::terminal::Terminal;

/// One update of `uorb top --json`.
struct Update(Value);

impl Update {
    fn next(top: &mut uorb_tests::Actor) -> Self {
        let line = top.line().expect("it goes on until Ctrl-C");
        Self(serde_json::from_str(&line).expect("JSON"))
    }

    fn dt_s(&self) -> f64 {
        self.0["dt_s"].as_f64().unwrap()
    }

    fn row(&self, topic: &str, instance: u8) -> Option<&Value> {
        let rows = self.0["topics"].as_array().unwrap();
        rows.iter().find(|row| row["topic"] == topic && row["instance"] == instance)
    }

    fn published(&self, topic: &str, instance: u8) -> u64 {
        self.row(topic, instance).map_or(0, |row| row["published"].as_u64().unwrap())
    }

    fn rate_hz(&self, topic: &str, instance: u8) -> f64 {
        self.row(topic, instance).map_or(0.0, |row| row["rate_hz"].as_f64().unwrap())
    }
}

/// So many updates in a row make a stretch.
const UPDATES: usize = 10;

/// Whether over these updates every topic instance had the rate that it has in
/// the log, to a tenth; if not, which had not.
///
/// The stretch of the log is that between the messages of its fastest topic
/// that were the newest when top looked for the first and for the last time.
fn compare(log: &FlightLog, updates: &[Update]) -> Result<usize, String> {
    let [first, .., last] = updates else { panic!("a stretch has a beginning and an end") };
    let fastest = log.fastest();
    let series = &log.series[fastest];
    let newest = |update: &Update| update.published(&series.topic, series.instance) as usize;
    let (from, to) = (newest(first), newest(last));
    // Their places in the file, counted from 1.
    let mut places = log.order.iter().enumerate().filter(|(_, number)| **number == fastest);
    let begin = places.nth(from - 1).expect("it is in the log").0;
    let end = places.nth(to - from - 1).expect("it is in the log").0;
    let log_s = (series.timestamp_us(to - 1) - series.timestamp_us(from - 1)) as f64 / 1e6;

    let time_s: f64 = updates[1..].iter().map(Update::dt_s).sum();
    let mut compared = 0;
    for (number, series) in log.series.iter().enumerate() {
        let logged = log.order[begin..end].iter().filter(|at| **at == number).count();
        let expected_hz = logged as f64 / log_s;
        if expected_hz <= 5.0 {
            continue;
        }
        let messages =
            |update: &Update| update.rate_hz(&series.topic, series.instance) * update.dt_s();
        let shown_hz = updates[1..].iter().map(messages).sum::<f64>() / time_s;
        if (shown_hz / expected_hz - 1.0).abs() > 0.1 {
            let (topic, instance) = (&series.topic, series.instance);
            return Err(format!("{topic}{instance}: {shown_hz} Hz, and {expected_hz} in the log"));
        }
        compared += 1;
    }
    Ok(compared)
}

#[test]
fn top_shows_every_topic_of_a_replayed_flight_at_its_rate_in_the_log() {
    // A minute, so that a machine which is too busy in one stretch can be
    // measured in the next.
    let Some(log) = logs().iter().max_by_key(|log| log.length_us()) else { return };
    let bus = Bus::start();
    let fastest = &log.series[log.fastest()];
    let mut replay = bus.spawn_uorb(&["replay", log.name(), "--quiet"]);
    let mut top = bus.spawn_uorb(&["top", "--json", "-a"]);
    let mut updates = vec![Update::next(&mut top)];
    while updates[0].published(&fastest.topic, fastest.instance) == 0 {
        updates[0] = Update::next(&mut top);
    }

    let mut wrong = Vec::new();
    let compared = loop {
        updates.push(Update::next(&mut top));
        let newest = updates.last().expect("just pushed");
        let is_over = newest.published(&fastest.topic, fastest.instance) == fastest.count() as u64;
        assert!(!is_over, "in no stretch of the log were all rates right: {wrong:#?}");
        if updates.len() > UPDATES {
            match compare(log, &updates[updates.len() - UPDATES - 1..]) {
                Ok(compared) => break compared,
                Err(why) => wrong.push(why),
            }
        }
    };

    assert!(compared >= 5, "{compared} topics");
    assert_eq!(top.interrupt().fine(), "");
    assert_eq!(replay.interrupt().code, 130);
}

#[test]
fn one_update_is_px4s_table() {
    let mut bus = Bus::start();
    let _silent = bus.advertise::<SensorGyro>();
    let mut accels = [bus.advertise_multi::<SensorAccel>(), bus.advertise_multi::<SensorAccel>()];
    let _follower = bus.subscribe_instance::<SensorAccel>(1);
    for accel in &mut accels {
        accel.publish(&SensorAccel::default()).unwrap();
    }
    let mut publisher = bus.spawn(&["publish-for-ever", "4"]);
    publisher.expect("advertised");

    let table = bus.uorb(&["top", "-1"]).fine();
    let [title, head, row] = table.lines().collect::<Vec<_>>()[..] else { panic!("{table}") };
    assert!(title.starts_with("update: ") && title.ends_with("s, num topics: 4"), "{title}");
    // A rate that PX4 never had makes its column wider.
    let columns: Vec<&str> = head.split_whitespace().collect();
    assert_eq!(columns.join(" "), "TOPIC NAME INST #SUB #MSG #LOST #QSIZE SIZE kB/s #STR");
    assert_eq!(head.len(), row.len(), "{table}");
    let words: Vec<&str> = row.split_whitespace().collect();
    let [topic, instance, subscriptions, messages, lost, queue, size, _kb, streams] = words[..]
    else {
        panic!("{row}")
    };
    assert_eq!(
        [topic, instance, subscriptions, lost, queue, size, streams],
        ["stamped", "0", "0", "0", "4", "256", "0"]
    );
    assert!(messages.parse::<u64>().unwrap() > 0);

    // Those that are asked for are shown also where they are silent.
    for (arguments, expected) in [
        (
            &["-a"][..],
            &["sensor_accel 0 0", "sensor_accel 1 1", "sensor_gyro 0 0", "stamped 0 0"][..],
        ),
        (&["sensor_"], &["sensor_accel 0 0", "sensor_accel 1 1", "sensor_gyro 0 0"]),
        (&["gyro", "stamp"], &["sensor_gyro 0 0", "stamped 0 0"]),
        (&["nothing"], &[]),
    ] {
        let table = bus.uorb(&[&["top", "-1"], arguments].concat()).fine();
        let rows: Vec<String> = (table.lines().skip(2))
            .map(|row| row.split_whitespace().take(3).collect::<Vec<_>>().join(" "))
            .collect();
        assert_eq!(rows, expected, "{arguments:?}");
        assert!(table.lines().next().unwrap().ends_with(&format!(": {}", expected.len())));
    }
}

#[test]
fn top_goes_on_until_ctrl_c_and_sees_topics_come_and_what_they_lose() {
    let mut bus = Bus::start();
    let mut top = bus.spawn_uorb(&["top", "--json"]);
    assert_eq!(Update::next(&mut top).0["num_topics"], 0);
    let mut publication = bus.advertise::<Plain>();
    let mut slow = bus.subscribe::<Plain>();
    for value in 0..10 {
        publication.publish(&Plain { value }).unwrap();
    }
    slow.copy();
    let row = loop {
        let update = Update::next(&mut top);
        if let Some(row) = update.row("plain", 0) {
            break row.clone();
        }
    };
    assert_eq!((&row["published"], &row["subscribers"]), (&10.into(), &1.into()));
    assert_eq!((&row["queue_length"], &row["size_bytes"]), (&1.into(), &4.into()));
    assert_eq!(row["advertised"], true);
    eventually("the loss is counted", || {
        let json = bus.uorb(&["top", "-1", "--json", "plain"]).fine();
        let update = Update(serde_json::from_str(&json).unwrap());
        update.row("plain", 0).unwrap()["lost"] == 9
    });
    // The broker is not asked.
    bus.kill_broker();
    publication.publish(&Plain { value: 10 }).unwrap();
    while Update::next(&mut top).published("plain", 0) < 11 {}
    assert_eq!(top.interrupt().code, 0);
}

#[test]
fn top_counts_those_who_follow_a_stream_and_what_they_lose() {
    let bus = Bus::start();
    let mut publisher = bus.spawn(&["publish", "100", "1"]);
    publisher.expect("advertised");
    let mut node_alone = bus.spawn(&["follow-name", "stamped"]);
    node_alone.expect("subscribed");
    let mut streamers =
        ["16", "64"].map(|depth| bus.spawn_program(&program("streamer"), &["follow", depth]));
    streamers.iter_mut().for_each(|streamer| streamer.expect("subscribed"));
    let foreigner = Foreigner::open(&bus.system, "stamped");
    let _follower = foreigner.follow();
    let row = || {
        let json = bus.uorb(&["top", "-1", "--json", "stamped"]).fine();
        let update = Update(serde_json::from_str(&json).unwrap());
        update.row("stamped", 0).unwrap().clone()
    };
    eventually("the foreign one is seen", || row()["stream_followers"] == 3);
    assert_eq!((&row()["stream_depth"], &row()["stream_lost"]), (&64.into(), &0.into()));
    assert_eq!(row()["subscribers"], 3, "of the bus");
    let table = bus.uorb(&["top", "-1", "stamped"]).fine();
    assert!(table.ends_with("    0.0    3\n"), "{table}");

    let [slow, _] = &streamers;
    slow.stop();
    publisher.say("go");
    publisher.expect("published");
    slow.signal(Signal::SIGCONT);

    eventually("the loss is counted", || row()["stream_lost"].as_u64() >= Some(84));
    assert!(row()["lost"].as_u64() >= row()["stream_lost"].as_u64());
    assert!(!row()["stream_depth"].is_null());
}

#[test]
fn top_ends_with_the_system_and_with_its_reader() {
    let mut bus = Bus::start();
    let mut read = bus.spawn_uorb(&["top"]);
    assert!(read.line().unwrap().starts_with("update: "));
    read.stop_reading();
    let ended = read.end();
    assert_eq!((ended.code, &*ended.words), (0, ""));

    let mut top = bus.spawn_uorb(&["top"]);
    assert!(top.line().unwrap().starts_with("update: "));
    bus.stop();
    let ended = top.end();
    let says = format!("uorb: the system at {} has ended (`uorb stop`)\n", bus.system);
    assert_eq!((ended.code, ended.words), (1, says), "as a listener ends");
    bus.uorb(&["top", "-1"]).failed(&["no broker runs", "uorb start"]);
}

#[test]
fn on_a_terminal_top_is_a_live_view_that_leaves_it_as_it_was() {
    let bus = Bus::start();
    let mut publisher = bus.spawn(&["publish-for-ever", "1"]);
    publisher.expect("advertised");
    for (end, code) in [(Ok("q"), Some(0)), (Ok("\x03"), Some(0)), (Err(Signal::SIGTERM), None)] {
        let mut terminal = Terminal::uorb(&bus, &["top"]);
        let shown = terminal.until("stamped");
        assert!(shown.contains("\x1b[?1049h"), "the other screen");
        assert!(!terminal.is_as_before(), "keys are read one by one");

        match end {
            Ok(key) => terminal.press(key),
            Err(signal) => terminal.signal(signal),
        }

        let (ended, rest) = terminal.end();
        assert_eq!(ended, code, "{end:?}");
        for (what, sequence) in [("the first screen", "\x1b[?1049l"), ("a cursor", "\x1b[?25h")] {
            assert!(rest.contains(sequence), "{end:?}: no {what} in {rest:?}");
        }
    }
}
