//! `uorb replay`: what was recorded is on the bus as it was.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;
use uorb_core::zerocopy::{FromBytes, IntoBytes};
use uorb_core::{
    Field, FieldType, Instance, Layout, Message, RawSubscription, Subscription, message_hash, poll,
};
use uorb_msg::{SensorAccel, SensorCombined, SensorGyro, VehicleAttitude};
use uorb_tests::{Actor, Bus, PATIENCE, eventually, program};

use crate::flight_logs::{FlightLog, Recording, Series, logs};

/// Messages by topic and instance.
type Counts = BTreeMap<(String, u64), u64>;

/// What the closing line says.
struct Closing {
    line: Value,
    counts: Counts,
}

fn closing(line: &str) -> Closing {
    let line: Value = serde_json::from_str(line).expect("JSON");
    let series = line["series"].as_array().expect("a list").iter();
    let counts = series
        .map(|series| {
            let topic = series["topic"].as_str().expect("a topic").to_string();
            let instance = series["instance"].as_u64().expect("an instance");
            ((topic, instance), series["messages"].as_u64().expect("a count"))
        })
        .collect();
    Closing { line, counts }
}

/// Replays a log as fast as it goes, and returns its closing line.
fn replay(bus: &Bus, log: &FlightLog, more: &[&str]) -> Closing {
    let arguments = [&["replay", log.name(), "--speed", "max", "--json"], more].concat();
    closing(&bus.uorb(&arguments).fine())
}

/// The counts of those series of a log of which this is true.
fn counts(log: &FlightLog, is_meant: impl Fn(&Series) -> bool) -> Counts {
    let meant = log.series.iter().filter(|series| is_meant(series));
    meant
        .map(|series| ((series.topic.clone(), series.instance.into()), series.count() as u64))
        .collect()
}

/// A log of a story's own, in the directory of its bus.
fn save(bus: &Bus, name: &str, recording: &Recording) -> PathBuf {
    let path = bus.system.base().join(name);
    recording.save(&path);
    path
}

/// A listener for a topic instance that nobody has described yet.
fn listener(bus: &Bus, series: &Series, count: usize) -> Actor {
    let (count, instance) = (count.to_string(), series.instance.to_string());
    let mut listener = bus.spawn_uorb(&[
        "listener",
        &series.topic,
        "-n",
        &count,
        "-i",
        &instance,
        "--wait",
        "--json",
        "--meta",
    ]);
    let word = listener.word().expect("it says that it waits");
    assert!(word.contains("waiting"), "{word}");
    listener
}

/// Checks that what a listener shows is what was logged, and how many it shows.
fn check(listener: &mut Actor, series: &Series, count: usize) {
    // Where it was slower than the log was read it has lost some, and says so.
    let shown = listener.end();
    assert_eq!((shown.code, shown.out.lines().count()), (0, count), "{}", shown.words);
    for line in shown.out.lines() {
        let mut json: Value = serde_json::from_str(line).expect("JSON");
        let meta = json.as_object_mut().and_then(|members| members.remove("_meta")).unwrap();
        // A generation is the number of a message, counted from 1.
        let number = meta["generation"].as_u64().unwrap() as usize - 1;
        series.check_json(number, &json);
    }
}

/// The topics to listen to: all that are intricate, the fastest, and the
/// longest messages.
fn telling(log: &FlightLog) -> Vec<&Series> {
    let intricate = log.series.iter().filter(|series| series.is_intricate());
    let mut longest: Vec<&Series> =
        log.series.iter().filter(|series| !series.is_intricate()).collect();
    longest.sort_by_key(|series| std::cmp::Reverse(series.format.size()));
    longest.truncate(6);
    intricate.chain([&log.series[log.fastest()]]).chain(longest).collect()
}

#[test]
fn a_listener_shows_the_values_that_are_in_the_file() {
    for log in logs() {
        let bus = Bus::start();
        let telling = telling(log);
        let count = |series: &Series| series.count().min(5);
        let mut listeners: Vec<Actor> =
            telling.iter().map(|series| listener(&bus, series, count(series))).collect();

        replay(&bus, log, &["--queue", "128"]);

        for (listener, series) in listeners.iter_mut().zip(telling) {
            check(listener, series, count(series));
        }
    }
}

#[test]
fn at_the_recorded_pace_a_listener_shows_the_first_messages_one_by_one() {
    for log in logs() {
        let bus = Bus::start();
        let fastest = &log.series[log.fastest()];
        let mut listener = listener(&bus, fastest, 5);
        let mut replay = bus.spawn_uorb(&["replay", log.name(), "--quiet"]);
        check(&mut listener, fastest, 5);
        assert_eq!(replay.interrupt().code, 130);
    }
}

/// A layout with these fields, one after the other.
fn layout(name: &'static str, fields: &[(&'static str, FieldType, Option<u32>)]) -> Layout {
    let mut size_bytes = 0;
    let mut listed = Vec::new();
    for (name, ty, array_length) in fields {
        let (name, ty) = (Cow::Borrowed(*name), ty.clone());
        let offset_bytes = size_bytes;
        let (array_length, unit) = (*array_length, Cow::Borrowed(""));
        let field = Field { name, ty, array_length, offset_bytes, unit };
        size_bytes += field.size_bytes() as u32;
        listed.push(field);
    }
    let message_hash = message_hash(&listed);
    Layout { name: name.into(), size_bytes, message_hash, fields: listed.into() }
}

#[test]
fn every_type_of_field_comes_through_at_any_depth() {
    let bus = Bus::start();
    let point =
        layout("point", &[("label", FieldType::Char, Some(3)), ("x", FieldType::Int16, None)]);
    let nested = |layout: &Layout| FieldType::Message(Cow::Owned(layout.clone()));
    let path =
        layout("path", &[("points", nested(&point), Some(2)), ("open", FieldType::Bool, None)]);
    let all = layout(
        "one_of_each",
        &[
            ("timestamp", FieldType::Uint64, None),
            ("i64", FieldType::Int64, None),
            ("f64", FieldType::Float64, Some(2)),
            ("f32", FieldType::Float32, Some(3)),
            ("u32", FieldType::Uint32, None),
            ("i32", FieldType::Int32, None),
            ("u16", FieldType::Uint16, Some(2)),
            ("u8", FieldType::Uint8, None),
            ("i8", FieldType::Int8, None),
            ("letter", FieldType::Char, None),
            ("name", FieldType::Char, Some(8)),
            ("flags", FieldType::Bool, Some(2)),
            ("path", nested(&path), None),
        ],
    );
    let mut message = Vec::new();
    message.extend(u64::MAX.to_le_bytes());
    message.extend(i64::MIN.to_le_bytes());
    message.extend([1.0 / 3.0, f64::NAN].map(f64::to_le_bytes).concat());
    message.extend([f32::MIN_POSITIVE / 2.0, -0.0, f32::INFINITY].map(f32::to_le_bytes).concat());
    message.extend(u32::MAX.to_le_bytes());
    message.extend(i32::MIN.to_le_bytes());
    message.extend([u16::MAX, 1].map(u16::to_le_bytes).concat());
    message.extend([u8::MAX, i8::MIN as u8, b'A']);
    message.extend(b"a \"b\"\0zz");
    message.extend([1, 0]);
    message.extend(b"ab\0\x01\x80xyz\xff\xff\x01");
    assert_eq!(message.len(), all.size_bytes as usize);
    let mut recording = Recording::begin(0);
    for layout in [&all, &path, &point] {
        recording.describe(layout);
    }
    let id = recording.announce("one_of_each", 9);
    recording.message(id, &all, &message);
    let file = save(&bus, "each.ulg", &recording);
    let log = FlightLog::read(&file);
    let series = log.series("one_of_each", 9).unwrap();
    let mut listener = listener(&bus, series, 1);

    let Closing { counts, .. } = replay(&bus, &log, &[]);

    assert_eq!(counts, Counts::from([(("one_of_each".into(), 9), 1)]));
    check(&mut listener, series, 1);
    let text = ["listener", "one_of_each", "-i", "9", "--field", "name,f64,path.points[1]"];
    let [name, numbers, point] = [
        "name: \"a \\\"b\\\"\"",
        "f64: [0.333333, nan]",
        "path.points[1] (point):\n  label: \"xyz\"\n  x: -1",
    ];
    let head = "\nTOPIC: one_of_each instance 9 #1";
    assert_eq!(bus.uorb(&text).fine(), format!("{head}\n{name}\n{numbers}\n{point}\n"));
}

#[test]
fn every_message_has_the_bytes_of_the_file_and_they_come_in_its_order() {
    for log in logs() {
        let mut bus = Bus::start();
        let session = bus.session();
        let subscribe = |series: &Series| {
            let instance = Instance::new(series.instance).expect("0 to 9");
            RawSubscription::subscribe(&session, &series.topic, instance).unwrap()
        };
        let mut subscriptions: Vec<RawSubscription> = log.series.iter().map(subscribe).collect();
        let mut replay =
            bus.spawn_uorb(&["replay", log.name(), "--speed", "max", "--queue", "128", "--json"]);

        let mut message = Vec::new();
        let mut seen = vec![0; subscriptions.len()];
        let is_last = |seen: &[usize]| {
            seen.iter().zip(&log.series).all(|(seen, series)| *seen == series.count())
        };
        while !is_last(&seen) {
            let mut all: Vec<&mut RawSubscription> = subscriptions.iter_mut().collect();
            assert!(poll(&mut all, Some(PATIENCE)).unwrap() > 0, "the rest never came");
            for ((subscription, series), seen) in
                subscriptions.iter_mut().zip(&log.series).zip(&mut seen)
            {
                while subscription.updated() && subscription.copy(&mut message) {
                    let number = subscription.last_copied().unwrap().generation.get() as usize;
                    assert!(number > *seen, "{}: {number} after {seen}", series.topic);
                    *seen = number;
                    let logged = series.message(number - 1);
                    let (start, padding) = message.split_at(logged.len());
                    assert_eq!(start, logged, "{} message {number}", series.topic);
                    assert!(padding.iter().all(|byte| *byte == 0));
                }
            }
        }
        closing(&replay.end().fine());
    }
}

#[test]
fn the_closing_counts_are_those_of_the_file() {
    for log in logs() {
        let bus = Bus::start();

        let Closing { line, counts } = replay(&bus, log, &[]);

        let expected = self::counts(log, |_| true);
        assert_eq!(counts, expected, "{}", log.name());
        assert_eq!(line["messages"], log.order.len());
        assert_eq!(line["instances"], log.series.len());
        assert_eq!((&line["whole"], &line["interrupted"]), (&true.into(), &false.into()));
        // And it is what the nodes say.
        let status: Value = serde_json::from_str(&bus.uorb(&["status", "--json"]).fine()).unwrap();
        let nodes = status["nodes"].as_array().unwrap().iter();
        let published: Counts = nodes
            .filter(|node| node["published"] != 0)
            .map(|node| {
                let topic = node["topic"].as_str().unwrap().to_string();
                ((topic, node["instance"].as_u64().unwrap()), node["published"].as_u64().unwrap())
            })
            .collect();
        assert_eq!(published, expected, "{}", log.name());
        assert_eq!(status["broker"]["advertised"], 0, "it has unadvertised what it advertised");
    }
}

#[test]
fn the_closing_line_for_people_says_how_much_it_was() {
    let Some(log) = logs().first() else { return };
    let bus = Bus::start();
    let closing = bus.uorb(&["replay", log.name(), "--speed", "max"]).fine();
    let (messages, instances) = (log.order.len(), log.series.len());
    assert!(closing.starts_with(&format!("{messages} messages, ")), "{closing}");
    assert!(closing.contains(&format!(" topics, {instances} instances, ")), "{closing}");
    assert_eq!(bus.uorb(&["replay", log.name(), "--speed", "max", "--quiet"]).fine(), "");
}

#[test]
fn topics_and_instances_can_be_picked() {
    for log in logs() {
        let bus = Bus::start();
        let sensors = replay(&bus, log, &["--topic", "sensor_*", "--topic", "vehicle_attitude"]);
        let is_sensor = |series: &Series| {
            series.topic.starts_with("sensor_") || series.topic == "vehicle_attitude"
        };
        assert_eq!(sensors.counts, counts(log, is_sensor));
        let second = replay(&bus, log, &["-i", "1"]);
        assert_eq!(second.counts, counts(log, |series| series.instance == 1));
        let others = replay(&bus, log, &["--exclude", "sensor_*", "--exclude", "vehicle_attitude"]);
        assert_eq!(others.counts, counts(log, |series| !is_sensor(series)));
        let some = replay(&bus, log, &["--topic", "sensor_*", "--exclude", "sensor_combined"]);
        let is_meant = |series: &Series| {
            is_sensor(series) && !["sensor_combined", "vehicle_attitude"].contains(&&*series.topic)
        };
        assert_eq!(some.counts, counts(log, is_meant));
        for option in ["--topic", "--exclude"] {
            let refused = bus.uorb(&["replay", log.name(), option, "sensr_*"]);
            refused.failed(&["sensr_*", log.name()]);
        }
        bus.uorb(&["replay", log.name(), "--exclude", "*"]).failed(&["all are left out"]);
    }
}

#[test]
fn the_first_seconds_can_be_left_out_and_the_rest_go_faster() {
    let mut bus = Bus::start();
    let mut recording = Recording::begin(0);
    recording.describe(SensorAccel::LAYOUT);
    let id = recording.announce("sensor_accel", 0);
    for second in 10..20 {
        let accel = SensorAccel { timestamp: second * 1_000_000, ..Default::default() };
        recording.message(id, SensorAccel::LAYOUT, accel.as_bytes());
    }
    let path = save(&bus, "ten-seconds.ulg", &recording);
    let arguments =
        ["replay", path.to_str().unwrap(), "--start", "2.5", "--speed", "1000", "--json"];
    let Closing { line, counts } = closing(&bus.uorb(&arguments).fine());
    assert_eq!(counts.values().sum::<u64>(), 7, "those of the seconds 3 to 9");
    assert_eq!(line["log_seconds"], 6.5);
    let beyond = ["replay", path.to_str().unwrap(), "--start", "9.5"];
    bus.uorb(&beyond).failed(&["ten-seconds.ulg is 9.0 s long", "--start 9.5"]);
    assert!(!bus.is_advertised("sensor_accel"));
}

#[test]
fn a_log_may_come_through_a_pipe() {
    let Some(log) = logs().first() else { return };
    let bus = Bus::start();
    let mut command = bus.command(Path::new("sh"));
    let script = "cat \"$1\" | \"$0\" replay /dev/stdin --speed max --json";
    command.args(["-c", script]).arg(program("uorb")).arg(&log.path);
    let ended = Actor::spawn(command).end();
    assert_eq!(closing(&ended.fine()).counts, counts(log, |_| true));
}

#[test]
fn ctrl_c_ends_a_replay_with_the_counts_so_far_and_unadvertises_its_topics() {
    let Some(log) = logs().first() else { return };
    let mut bus = Bus::start();
    let fastest = &log.series[log.fastest()];
    let mut replay = bus.spawn_uorb(&["replay", log.name(), "--json"]);
    let mut follower = bus.subscribe_by_name(&fastest.topic);
    assert_eq!(poll(&mut [&mut follower], Some(PATIENCE)).unwrap(), 1);
    assert!(follower.advertised());

    let ended = replay.interrupt();

    assert_eq!((ended.code, &*ended.words), (130, ""));
    let Closing { line, counts } = closing(&ended.out);
    assert_eq!((&line["interrupted"], &line["file"]), (&true.into(), &log.name().into()));
    let count = counts[&(fastest.topic.clone(), 0)];
    assert!(count > 0 && count < fastest.count() as u64, "{count}");
    assert!(!follower.advertised());
}

#[test]
fn logs_with_different_formats_replay_one_after_the_other() {
    let bus = Bus::start();
    for log in logs().iter().chain(logs().iter().rev()) {
        let Closing { counts, .. } = replay(&bus, log, &[]);
        assert_eq!(counts, self::counts(log, |_| true));
        for series in &log.series {
            let instance = series.instance.to_string();
            let last = bus.uorb(&["listener", &series.topic, "-i", &instance, "--json"]).fine();
            let last: Value = serde_json::from_str(&last).expect("JSON");
            series.check_json(series.count() - 1, &last);
        }
    }
}

#[test]
fn a_log_whose_formats_a_live_process_contradicts_is_refused_before_anything_is_published() {
    let mut skipped = true;
    for log in logs() {
        let attitude = log.series("vehicle_attitude", 0);
        if attitude.is_none_or(|series| series.matches(VehicleAttitude::LAYOUT)) {
            continue;
        }
        skipped = false;
        let mut bus = Bus::start();
        let typed = bus.subscribe::<VehicleAttitude>();

        let refused = bus.uorb(&["replay", log.name(), "--speed", "max"]);

        refused.failed(&["vehicle_attitude", "float roll", "float[4] q"]);
        refused.failed(&["in use: hash 0x", "this program: no hash, "]);
        refused.failed(&["--exclude vehicle_attitude", "--topic"]);
        let published = bus.uorb(&["status", "--json"]).fine();
        let status: Value = serde_json::from_str(&published).unwrap();
        assert_eq!(status["broker"]["advertised"], 0);
        let nodes = status["nodes"].as_array().unwrap();
        assert!(nodes.iter().all(|node| node["published"] == 0), "nothing was published");
        let without = replay(&bus, log, &["--exclude", "vehicle_attitude"]);
        assert_eq!(without.counts, counts(log, |series| series.topic != "vehicle_attitude"));
        drop(typed);
        eventually("the node gives way", || {
            bus.uorb(&["replay", log.name(), "--speed", "max", "--quiet"]).code == 0
        });
    }
    if skipped {
        eprintln!("skipped: no log has a vehicle_attitude of another format");
    }
}

#[test]
fn px4_simple_app_works_on_a_flight_whose_messages_it_knows() {
    let known = |log: &&FlightLog| {
        let combined = log.series("sensor_combined", 0);
        combined.is_some_and(|series| series.matches(SensorCombined::LAYOUT))
    };
    let Some(log) = logs().iter().find(known) else {
        eprintln!("skipped: no log has sensor_combined as it is compiled in");
        return;
    };
    let bus = Bus::start();
    let mut app = bus.spawn_heard("px4_simple_app", &["--count", "2"]);
    app.expect("Hello Sky!");
    eventually("it has subscribed", || bus.processes().contains(&app.pid()));
    let pick = ["--topic", "sensor_combined", "--quiet"];
    let mut replay = bus.spawn_uorb(&[&["replay", log.name()], &pick[..]].concat());

    let series = log.series("sensor_combined", 0).unwrap();
    let lines: Vec<String> = (0..series.count())
        .map(|number| {
            let combined = SensorCombined::read_from_prefix(series.message(number)).unwrap().0;
            let [x, y, z] = combined.accelerometer_m_s2;
            format!("[px4_simple_app] Accelerometer:\t{x:8.4}\t{y:8.4}\t{z:8.4}")
        })
        .collect();
    let mut from = 0;
    for _ in 0..2 {
        let printed = app.until(&["Accelerometer:"]);
        let found = lines[from..].iter().position(|line| *line == printed);
        from += found.unwrap_or_else(|| panic!("it was not recorded: {printed}")) + 1;
    }
    assert_eq!(app.end().fine(), "");
    assert_eq!(replay.interrupt().code, 130);
}

#[test]
fn sensors_works_on_a_recording_whose_messages_it_knows() {
    // No log of a flight has the raw sensors in the form of 2017.
    let mut bus = Bus::start();
    let mut recording = Recording::begin(1_000_000);
    for layout in [SensorAccel::LAYOUT, SensorGyro::LAYOUT] {
        recording.describe(layout);
    }
    let accel_id = recording.announce("sensor_accel", 0);
    let gyro_id = recording.announce("sensor_gyro", 0);
    for number in 0..500 {
        let timestamp = 1_000_000 + 4_000 * number;
        let accel = SensorAccel { timestamp, z: -(number as f32), ..Default::default() };
        recording.message(accel_id, SensorAccel::LAYOUT, accel.as_bytes());
        let gyro = SensorGyro { timestamp: timestamp + 1, x: number as f32, ..Default::default() };
        recording.message(gyro_id, SensorGyro::LAYOUT, gyro.as_bytes());
    }
    let file = save(&bus, "sensors.ulg", &recording);
    let mut sensors = bus.spawn_heard("sensors", &[]);
    eventually("it publishes", || bus.is_advertised("sensor_combined"));
    let mut combined: Subscription<SensorCombined> = bus.subscribe();
    let mut replay = bus.spawn_uorb(&["replay", file.to_str().unwrap(), "--quiet"]);

    sensors.until(&["[sensors] uses accelerometer 0, priority "]);
    let message = loop {
        assert_eq!(poll(&mut [&mut combined], Some(PATIENCE)).unwrap(), 1, "it is silent");
        // The first ones may be from before the accelerometer was found.
        match combined.update().expect("it was updated") {
            message if message.accelerometer_m_s2[2] == 0.0 => {}
            message => break message,
        }
    };

    let number = message.gyro_rad[0];
    assert_eq!(message.timestamp, 1_000_001 + 4_000 * number as u64);
    // The accelerometer's newest, which is the gyroscope's contemporary or,
    // where the module was slow, one that came since.
    assert!(-message.accelerometer_m_s2[2] >= number, "{message:?}");
    assert!(message.accelerometer_timestamp_relative >= -1);
    assert_eq!(replay.end().code, 0);
    assert_eq!(sensors.interrupt().code, 0);
}

#[test]
fn a_log_that_is_cut_off_is_replayed_as_far_as_it_is_whole_and_then_it_is_an_error() {
    let Some(log) = logs().first() else { return };
    let bus = Bus::start();
    let whole = fs::read(&log.path).unwrap();
    let path = bus.system.base().join("cut-off.ulg");
    let name = path.to_str().unwrap();
    let mut before = 0;
    for quarters in 2..=4 {
        // A record is three bytes long at least: of three sizes side by side,
        // one at most is where a record ends.
        for size in (whole.len() * quarters / 4 - 3..whole.len() * quarters / 4).take(2) {
            fs::write(&path, &whole[..size]).unwrap();
            let ended = bus.uorb(&["replay", name, "--speed", "max", "--json"]);
            let Closing { line, counts } = closing(&ended.out);
            let messages: u64 = counts.values().sum();
            assert!((before..=log.order.len() as u64).contains(&messages) && messages > 0);
            before = messages;
            if line["whole"] == true {
                assert_eq!((ended.code, &*ended.words), (0, ""));
                continue;
            }
            assert_eq!(ended.code, 1);
            assert!(ended.words.contains(&format!("{name} is cut off: ")), "{}", ended.words);
        }
    }
    replay(&bus, log, &[]);
}

#[test]
fn a_message_that_is_cut_off_anywhere_is_not_published_and_those_before_it_are() {
    let bus = Bus::start();
    let mut recording = Recording::begin(0);
    recording.describe(SensorAccel::LAYOUT);
    let id = recording.announce("sensor_accel", 0);
    for _ in 0..2 {
        recording.message(id, SensorAccel::LAYOUT, SensorAccel::default().as_bytes());
    }
    let path = save(&bus, "cut-off.ulg", &recording);
    let whole = fs::read(&path).unwrap();
    // Its length, its type, its number, its fields.
    let record = 3 + 2 + SensorAccel::LAYOUT.size_no_padding_bytes() as usize;
    for missing in [1, record / 2, record - 4, record - 3, record - 2, record - 1] {
        fs::write(&path, &whole[..whole.len() - missing]).unwrap();
        let name = path.to_str().unwrap();
        let ended = bus.uorb(&["replay", name, "--speed", "max", "--json"]);
        assert_eq!(ended.code, 1);
        let at_byte = whole.len() - record;
        let words = format!("{name} is cut off: the record at byte {at_byte} is not whole");
        assert!(ended.words.contains(&words), "{}", ended.words);
        assert_eq!(closing(&ended.out).counts.values().sum::<u64>(), 1);
    }
}

#[test]
fn a_file_that_is_no_log_is_an_error_that_names_it_and_the_bus_is_fine() {
    let mut bus = Bus::start();
    let mut accel = bus.advertise::<SensorAccel>();
    let accel_layout = SensorAccel::LAYOUT;
    let good = |recording: &mut Recording| {
        recording.describe(accel_layout);
        let id = recording.announce("sensor_accel", 0);
        recording.message(id, accel_layout, SensorAccel::default().as_bytes());
    };
    let recorded = |record: &dyn Fn(&mut Recording)| {
        let mut recording = Recording::begin(0);
        record(&mut recording);
        save(&bus, "recorded", &recording);
        fs::read(bus.system.base().join("recorded")).unwrap()
    };
    let whole = recorded(&good);
    for (name, bytes, words) in [
        ("empty", Vec::new(), "it is empty"),
        ("a-text.ulg", b"Dear diary, today I flew my kite.\n".to_vec(), "ULog"),
        ("zeros.ulg", vec![0; 4_096], "ULog"),
        ("header.ulg", whole[..16].to_vec(), "no message"),
        ("half-a-header.ulg", whole[..10].to_vec(), "byte"),
        ("definitions.ulg", whole[..100].to_vec(), "byte"),
        ("no-message.ulg", recorded(&|recording| recording.describe(accel_layout)), "no message"),
        (
            "unknown-type.ulg",
            recorded(&|recording| {
                recording.record(b'F', b"odd:uint64_t timestamp;quaternion q;");
                let id = recording.announce("odd", 0);
                recording.record(b'D', &[&id.to_le_bytes()[..], &[0; 24]].concat());
            }),
            "field q of message odd is of type quaternion",
        ),
        (
            "unknown-message.ulg",
            recorded(&|recording| {
                recording.announce("odd", 0);
            }),
            "no format of message odd",
        ),
        (
            "instance.ulg",
            recorded(&|recording| {
                recording.describe(accel_layout);
                let id = recording.announce("sensor_accel", 10);
                recording.message(id, accel_layout, SensorAccel::default().as_bytes());
            }),
            "instance 10 of sensor_accel",
        ),
        (
            "escape.ulg",
            recorded(&|recording| {
                recording.record(b'F', b"../escape:uint64_t timestamp;");
                let id = recording.announce("../escape", 0);
                recording.record(b'D', &[&id.to_le_bytes()[..], &[0; 8]].concat());
            }),
            "../escape",
        ),
    ] {
        let path = bus.system.base().join(name);
        fs::write(&path, bytes).unwrap();
        let ended = bus.uorb(&["replay", path.to_str().unwrap(), "--speed", "max"]);
        ended.failed(&[words]);
        // What is wrong with the file stands behind its name.
        let says_which = ended.words.contains(path.to_str().unwrap());
        assert!(says_which, "{name}: {}", ended.words);
    }
    let nowhere = bus.system.base().join("nowhere.ulg");
    bus.uorb(&["replay", nowhere.to_str().unwrap()]).failed(&["nowhere.ulg", "No such file"]);
    let directory = bus.system.base().to_str().unwrap();
    bus.uorb(&["replay", directory]).failed(&[directory, "directory"]);
    assert_eq!(bus.uorb(&["replay"]).code, 2);

    assert_eq!(bus.uorb(&["ls"]).fine(), "sensor_accel0\n", "nothing was advertised");
    accel.publish(&SensorAccel { x: 1.0, ..Default::default() }).unwrap();
    assert_eq!(bus.subscribe::<SensorAccel>().copy().unwrap().x, 1.0);
    fs::write(bus.system.base().join("whole.ulg"), whole).unwrap();
    let whole = bus.system.base().join("whole.ulg");
    assert_eq!(bus.uorb(&["replay", whole.to_str().unwrap()]).code, 0);
}

#[test]
fn a_log_that_is_damaged_in_the_middle_is_replayed_up_to_there() {
    let bus = Bus::start();
    let mut recording = Recording::begin(0);
    recording.describe(SensorAccel::LAYOUT);
    let id = recording.announce("sensor_accel", 0);
    for _ in 0..3 {
        recording.message(id, SensorAccel::LAYOUT, SensorAccel::default().as_bytes());
    }
    recording.record(b'D', b"\xff\xffnobody announced this");
    recording.message(id, SensorAccel::LAYOUT, SensorAccel::default().as_bytes());
    let path = save(&bus, "damaged.ulg", &recording);
    let ended = bus.uorb(&["replay", path.to_str().unwrap(), "--speed", "max", "--json"]);
    assert_eq!(ended.code, 1);
    assert!(ended.words.contains("damaged.ulg, after 3 messages: byte "), "{}", ended.words);
    assert_eq!(closing(&ended.out).counts, Counts::from([(("sensor_accel".into(), 0), 3)]));
}

#[test]
fn a_killed_replay_is_unadvertised_and_its_last_messages_stay_readable() {
    let Some(log) = logs().first() else { return };
    let mut bus = Bus::start();
    let fastest = &log.series[log.fastest()];
    let mut replay = bus.spawn_uorb(&["replay", log.name()]);
    let mut follower = bus.subscribe_by_name(&fastest.topic);
    assert_eq!(poll(&mut [&mut follower], Some(PATIENCE)).unwrap(), 1);

    replay.kill();

    eventually("it is unadvertised", || !follower.advertised());
    let last = bus.uorb(&["listener", &fastest.topic, "1", "--json", "--meta"]).fine();
    let mut last: Value = serde_json::from_str(&last).unwrap();
    let meta = last.as_object_mut().unwrap().remove("_meta").unwrap();
    fastest.check_json(meta["generation"].as_u64().unwrap() as usize - 1, &last);
}
