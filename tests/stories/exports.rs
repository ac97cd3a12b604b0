//! `uorb ulog info` and `uorb export`: what is in a log, as others find it there.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;
use uorb_core::Message;
use uorb_core::zerocopy::IntoBytes;
use uorb_msg::SensorAccel;
use uorb_tests::{Bus, Python};

use crate::flight_logs::{FlightLog, Recording, logs};

/// Neither command needs a bus; the story needs a directory.
fn place() -> (Bus, PathBuf) {
    let bus = Bus::without_broker();
    let base = bus.system.base().to_path_buf();
    fs::create_dir_all(&base).unwrap();
    (bus, base)
}

fn info(bus: &Bus, log: &Path) -> Value {
    let json = bus.uorb(&["ulog", "info", log.to_str().unwrap(), "--json"]).fine();
    serde_json::from_str(&json).expect("JSON")
}

#[test]
fn the_tables_of_a_log_have_the_columns_and_values_of_ulog2csv() {
    let Some(python) = Python::with_log_readers() else { return };
    for log in logs() {
        let (bus, base) = place();
        let dir = base.join("tables");
        bus.uorb(&["export", log.name(), "--csv", "-o", dir.to_str().unwrap(), "-q"]).fine();
        let counted = python.compare_exported("csv", &log.path, &dir);
        let expected = format!("{} {} ", log.series.len(), log.order.len());
        assert!(counted.starts_with(&expected), "{}: {counted}", log.name());
    }
}

#[test]
fn the_mcap_file_of_a_log_has_the_values_that_pyulog_finds_in_the_log() {
    let Some(python) = Python::with_log_readers() else { return };
    for log in logs() {
        let (bus, base) = place();
        let file = base.join("log.mcap");
        bus.uorb(&["export", log.name(), "--mcap", "-o", file.to_str().unwrap(), "-q"]).fine();
        let counted = python.compare_exported("mcap", &log.path, &file);
        let expected = format!("{} {} ", log.series.len(), log.order.len());
        assert!(counted.starts_with(&expected), "{}: {counted}", log.name());
        assert!(!base.join("log.mcap.part").exists());
    }
}

#[test]
fn info_counts_the_messages_of_each_topic_as_px4_ulog_finds_them() {
    for log in logs() {
        let (bus, _) = place();
        let info = info(&bus, &log.path);
        assert_eq!((&info["whole"], &info["messages"]), (&true.into(), &log.order.len().into()));
        let topics = info["topics"].as_array().unwrap();
        for series in &log.series {
            let found = topics.iter().find(|topic| {
                topic["topic"] == *series.topic && topic["instance"] == series.instance
            });
            let found = found.unwrap_or_else(|| panic!("no {}", series.topic));
            let bytes: usize = (0..series.count()).map(|n| series.message(n).len()).sum();
            assert_eq!(
                (&found["messages"], &found["bytes"]),
                (&series.count().into(), &bytes.into())
            );
        }
        let silent = topics.iter().filter(|topic| topic["messages"] == 0).count();
        assert_eq!(topics.len() - silent, log.series.len());
        let text = bus.uorb(&["ulog", "info", log.name(), "-v"]).fine();
        for words in ["Logging start time: ", "Whole, to its end", "Parameters: "] {
            assert!(text.contains(words), "no {words} in {text}");
        }
    }
}

/// A name and a value, as they stand in a note.
fn named(before: &[u8], name: &str, value: &[u8]) -> Vec<u8> {
    [before, &[name.len() as u8], name.as_bytes(), value].concat()
}

/// A log with one of everything that stands beside messages.
pub(crate) fn with_notes() -> Recording {
    let mut recording = Recording::begin(5_000_000);
    recording.record(b'I', &named(b"", "char[3] sys_name", b"PX4"));
    let version = 0x010f_02ff_u32.to_le_bytes();
    recording.record(b'I', &named(b"", "uint32_t ver_sw_release", &version));
    recording.describe(SensorAccel::LAYOUT);
    recording.record(b'P', &named(b"", "float MC_ROLL_P", &6.5_f32.to_le_bytes()));
    recording.record(b'Q', &named(&[3], "float MC_ROLL_P", &4_f32.to_le_bytes()));
    recording.record(b'M', &named(&[0], "char[4] boot", b"one "));
    recording.record(b'M', &named(&[1], "char[4] boot", b"more"));
    let id = recording.announce("sensor_accel", 0);
    let message = |timestamp: u64, recording: &mut Recording| {
        let accel = SensorAccel { timestamp, ..Default::default() };
        recording.message(id, SensorAccel::LAYOUT, accel.as_bytes());
    };
    message(5_000_000, &mut recording);
    recording.record(b'O', &70_u16.to_le_bytes());
    recording.record(b'P', &named(b"", "float MC_ROLL_P", &7_f32.to_le_bytes()));
    let time = 5_400_000_u64.to_le_bytes();
    recording.record(b'L', &[b"4", &time[..], b"battery low"].concat());
    recording.record(b'S', &[0x2f, 0x73, 0x13, 0x20, 0x25, 0x0c, 0xbb, 0x12]);
    recording.record(b'O', &30_u16.to_le_bytes());
    message(6_500_000, &mut recording);
    message(7_000_000, &mut recording);
    recording
}

#[test]
fn info_shows_parameters_dropouts_and_what_was_said() {
    let (bus, base) = place();
    let path = base.join("notes.ulg");
    with_notes().save(&path);

    let info = info(&bus, &path);

    assert_eq!((&info["start_us"], &info["duration_s"]), (&5_000_000.into(), &2.0.into()));
    assert_eq!(info["dropouts"].to_string(), r#"{"count":2,"longest_ms":70,"total_ms":100}"#);
    assert_eq!(info["info"]["sys_name"], "PX4");
    assert_eq!(info["multi_info"].to_string(), r#"{"boot":["one more"]}"#);
    assert_eq!(info["parameters"].to_string(), r#"{"MC_ROLL_P":6.5}"#);
    assert_eq!(info["parameter_defaults"].to_string(), r#"{"MC_ROLL_P":4.0}"#);
    assert_eq!(
        info["parameter_changes"].to_string(),
        r#"[{"name":"MC_ROLL_P","timestamp":5000000,"value":7.0}]"#
    );
    assert_eq!(
        info["logged"].to_string(),
        r#"[{"level":"4","text":"battery low","timestamp":5400000}]"#
    );
    assert_eq!(info["topics"][0]["rate_hz"], 1.0);

    let name = path.to_str().unwrap();
    let text = bus.uorb(&["ulog", "info", name]).fine();
    for line in [
        "Logging start time: 0:00:05, duration: 0:00:02",
        "Dropouts: count: 2, total duration: 100 ms, longest: 70 ms",
        "SW Version: v1.15.2",
        " sys_name: PX4",
        "Parameters: 1, 1 changed in flight",
    ] {
        assert!(text.lines().any(|found| found == line), "no {line:?} in {text}");
    }
    let text = bus.uorb(&["ulog", "info", name, "-v"]).fine();
    for line in [
        " boot: one more",
        " MC_ROLL_P: 6.5 (default 4.0)",
        " at 0:00:05: MC_ROLL_P: 7.0",
        " 0:00:05 WARNING battery low",
    ] {
        assert!(text.lines().any(|found| found == line), "no {line:?} in {text}");
    }
}

#[test]
fn chosen_topics_alone_are_exported_beside_the_log() {
    let (bus, base) = place();
    let path = base.join("notes.ulg");
    let mut recording = with_notes();
    let id = recording.announce("sensor_accel", 1);
    recording.message(id, SensorAccel::LAYOUT, SensorAccel::default().as_bytes());
    recording.save(&path);
    let name = path.to_str().unwrap();

    let said = bus.uorb(&["export", name, "--csv", "-t", "sensor_*"]).fine();
    let csv = |instance| base.join(format!("notes_sensor_accel_{instance}.csv"));
    let (first, second) = (csv(0), csv(1));
    assert_eq!(
        said,
        format!("{} (3 messages)\n{} (1 messages)\n", first.display(), second.display())
    );
    let table = fs::read_to_string(first).unwrap();
    assert!(table.starts_with("timestamp,"), "{table}");
    assert_eq!(table.lines().count(), 4);

    bus.uorb(&["export", name, "--csv", "-t", "sensor_acel"])
        .failed(&["no topic in", "is named sensor_acel; did you mean sensor_accel?"]);
    let mcap = bus.uorb(&["export", name, "--mcap"]).fine();
    assert_eq!(mcap, format!("{} (4 messages)\n", base.join("notes.mcap").display()));
    let ended = bus.uorb(&["export", name]);
    assert_eq!(ended.code, 2, "{}", ended.words);
    for format in ["--csv", "--mcap"] {
        let nowhere = base.join("nowhere/there");
        fs::write(base.join("nowhere"), "a file").unwrap();
        bus.uorb(&["export", name, format, "-o", nowhere.to_str().unwrap()]).failed(&["nowhere"]);
    }
}

#[test]
fn a_log_that_is_cut_anywhere_is_shown_and_exported_up_to_there_and_the_byte_is_named() {
    let (bus, base) = place();
    let path = base.join("cut.ulg");
    with_notes().save(&path);
    let whole = fs::read(&path).unwrap();
    // Where records begin.
    let mut starts = vec![16];
    while let Some(&[low, high]) = whole.get(starts[starts.len() - 1]..).and_then(|it| it.get(..2))
    {
        starts.push(starts[starts.len() - 1] + 3 + usize::from(u16::from_le_bytes([low, high])));
    }
    let name = path.to_str().unwrap();
    for end in (0..whole.len()).step_by(7) {
        fs::write(&path, &whole[..end]).unwrap();
        let commands: [&[&str]; 3] = [
            &["ulog", "info", name],
            &["export", name, "--csv", "-q"],
            &["export", name, "--mcap", "-q"],
        ];
        for command in commands {
            let ended = bus.uorb(command);
            if starts.contains(&end) {
                assert_eq!((ended.code, &*ended.words), (0, ""), "{end}");
                continue;
            }
            let at_byte = starts.iter().rev().find(|&&start| start <= end).copied();
            let words = match at_byte {
                _ if end == 0 => "it is empty".to_string(),
                None => format!("it ends at byte {end}, inside the header"),
                Some(at_byte) => format!("cut off: the record at byte {at_byte} is not whole"),
            };
            assert_eq!(ended.code, 1, "{end}");
            assert!(ended.words.contains(&words), "{end}: no {words:?} in {}", ended.words);
            assert!(ended.words.contains(name), "{}", ended.words);
        }
    }
    assert!(!base.join("cut.mcap.part").exists());
}

#[test]
fn what_is_wrong_with_a_log_is_told_with_its_byte_by_every_command_that_reads_one() {
    let (bus, base) = place();
    let path = base.join("odd.ulg");
    let name = path.to_str().unwrap();
    let commands: [&[&str]; 4] = [
        &["ulog", "info", name],
        &["export", name, "--csv", "-q"],
        &["export", name, "--mcap", "-q"],
        &["plot", name, "odd", "x", "--svg", "odd.svg"],
    ];
    let recorded = |record: &dyn Fn(&mut Recording)| {
        let mut recording = Recording::begin(0);
        record(&mut recording);
        recording.save(&path);
        fs::read(&path).unwrap()
    };
    // A record of flags stands before what is recorded.
    const FIRST: usize = 16 + 3 + 40;
    let million = recorded(&|recording| {
        for topic in 0..=256 {
            recording.record(b'F', format!("m{topic}:uint64_t timestamp;").as_bytes());
        }
        for number in 0..1_000_000_u32 {
            let [low, high, ..] = number.to_le_bytes();
            let topic = format!("m{}", number / 256 % 257);
            recording.record(b'A', &[&[number as u8, low, high], topic.as_bytes()].concat());
        }
    });
    let formats = recorded(&|recording| {
        for topic in 0..5_000 {
            recording.record(b'F', format!("m{topic}:uint64_t timestamp;").as_bytes());
        }
    });
    let cases = [
        (b"Dear diary, today I flew my kite.\n".to_vec(), "it is not a ULog".to_string()),
        (
            recorded(&|recording| {
                recording.record(b'F', b"odd:uint64_t timestamp;quaternion x;");
                recording.announce("odd", 0);
            }),
            format!("byte {FIRST}: field x of message odd is of type quaternion"),
        ),
        (
            recorded(&|recording| {
                recording.record(b'F', b"odd:uint64_t timestamp;even x;");
                recording.record(b'F', b"even:odd x;");
                recording.announce("odd", 0);
            }),
            format!("byte {FIRST}: the formats go round in a circle: odd in even in odd"),
        ),
        (
            recorded(&|recording| {
                recording.record(b'D', &[9, 0, 1, 2, 3]);
            }),
            format!("byte {FIRST}: a message of number 9, under which no topic was announced"),
        ),
        (million, ": number 0 is m2560, and was m00".to_string()),
        (formats, ": there are more than 4096 formats".to_string()),
    ];
    for (bytes, words) in cases {
        fs::write(&path, bytes).unwrap();
        for command in commands {
            let ended = bus.uorb(command);
            assert_eq!(ended.code, 1, "{command:?}: {}", ended.words);
            for expected in [&words, &name.to_string()] {
                assert!(ended.words.contains(expected), "{command:?}: {}", ended.words);
            }
        }
    }
    // Of a note the rest of the log can be read without.
    let mut recording = with_notes();
    recording.record(b'I', b"\xffodd");
    recording.save(&path);
    for command in &commands[..3] {
        if command[0] == "export" && command[2] == "--csv" {
            bus.uorb(command).fine();
            continue;
        }
        let ended = bus.uorb(command);
        assert_eq!(ended.code, 1);
        assert!(ended.words.contains(": a record of type I has 4 bytes"), "{}", ended.words);
    }
    assert!(base.join("odd.mcap").exists());
}

#[test]
fn thousands_of_topics_are_a_table_each() {
    let (bus, base) = place();
    let path = base.join("many.ulg");
    let mut recording = Recording::begin(0);
    for topic in 0..12 {
        recording.record(b'F', format!("m{topic}:uint64_t timestamp;").as_bytes());
    }
    for (topic, instance) in (0..12).flat_map(|topic| (0..=255).map(move |it| (topic, it))) {
        let id = recording.announce(&format!("m{topic}"), instance);
        recording.record(b'D', &[&id.to_le_bytes()[..], &[1; 8]].concat());
    }
    recording.save(&path);
    let log = FlightLog::read(&path);
    let dir = base.join("tables");
    let (name, dir_name) = (path.to_str().unwrap(), dir.to_str().unwrap());
    bus.uorb(&["export", name, "--csv", "-q", "-o", dir_name]).fine();
    assert_eq!(log.series.len(), 12 * 256);
    assert_eq!(fs::read_dir(dir).unwrap().count(), log.series.len());
}
