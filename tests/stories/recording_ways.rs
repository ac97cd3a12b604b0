//! What can be asked of a recording: several files, fewer messages, parameters,
//! words; and PX4's `logger`.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use uorb_msg::{LogMessage, SensorAccel};
use uorb_tests::{Bus, Ended, Plain, Stamped, eventually, is_running};

use crate::log_readers::{Found, by_pyulog, read_by_all, records};
use crate::recording::{Recording, Summary, has, values};

/// Publishes numbers until there are so many files, and returns them in order.
fn publish_until(bus: &mut Bus, first: &Path, count: u32) -> (Vec<PathBuf>, u32) {
    let mut plain = bus.advertise::<Plain>();
    plain.publish(&Plain { value: 0 }).unwrap();
    eventually("it is followed", || fs::read(first).is_ok_and(|it| it.len() > 100));
    let name = |number: u32| match number {
        1 => first.to_path_buf(),
        _ => first.with_file_name(format!("some_{number}.ulg")),
    };
    let mut next = 1;
    eventually("there are so many", || {
        plain.publish(&Plain { value: next }).unwrap();
        next += 1;
        std::thread::sleep(Duration::from_micros(200));
        name(count).exists()
    });
    ((1..=count).map(name).collect(), next)
}

/// Checks that files have one message after the other, up to the newest.
fn check_all(files: &[PathBuf], summary: &Summary, published: u32) {
    let found: Vec<Found> = files.iter().map(|file| read_by_all(file)).collect();
    let all: Vec<u32> = found.iter().flat_map(|one| values(one.of("plain"))).collect();
    assert_eq!(all.len() as u64, summary.messages);
    // The first ones may have been there before it followed.
    assert_eq!(all.len() as u64 + summary.lost, u64::from(published));
    assert!(all.iter().copied().eq(all[0]..published), "{all:?}");
    assert!(found.iter().rev().skip(1).all(|one| one.count() > 0));
}

#[test]
fn a_recording_goes_on_in_the_next_file_when_one_is_large() {
    let mut bus = Bus::start();
    let Recording { mut recorder, path } =
        Recording::begin(&bus, "some.ulg", &["--max-size", "0.15"]);
    // A file of this name is somebody else's.
    let (files, published) = publish_until(&mut bus, &path, 3);
    let summary = Summary::of(&recorder.interrupt());
    check_all(&files, &summary, published);
    for file in &files[..2] {
        let bytes = fs::metadata(file).unwrap().len();
        assert!(bytes >= (150 << 20) / 1_000, "{bytes}");
    }
}

#[test]
fn a_recording_goes_on_in_the_next_file_when_one_is_old() {
    let mut bus = Bus::start();
    let Recording { mut recorder, path } =
        Recording::begin(&bus, "some.ulg", &["--rotate-every", "0.3"]);
    let (files, published) = publish_until(&mut bus, &path, 3);
    let summary = Summary::of(&recorder.interrupt());
    let last = path.with_file_name("some_4.ulg");
    let files = [files, if last.exists() { vec![last] } else { Vec::new() }].concat();
    check_all(&files, &summary, published);
}

#[test]
fn the_next_file_leaves_one_that_is_there_alone() {
    let mut bus = Bus::start();
    let mine = bus.system.base().join("some_2.ulg");
    fs::write(&mine, "mine").unwrap();
    let Recording { recorder: _recorder, path } =
        Recording::begin(&bus, "some.ulg", &["--rotate-every", "0.2"]);
    let mut plain = bus.advertise::<Plain>();
    let next = path.with_file_name("some_2_2.ulg");
    eventually("it goes on", || {
        plain.publish(&Plain { value: 1 }).unwrap();
        next.exists()
    });
    assert_eq!(fs::read_to_string(mine).unwrap(), "mine");
}

#[test]
fn a_recording_says_who_was_on_the_bus_when_it_began() {
    let mut bus = Bus::start();
    let mut plain = bus.advertise::<Plain>();
    plain.publish(&Plain { value: 1 }).unwrap();
    let Recording { mut recorder, path } = Recording::begin(&bus, "who.ulg", &[]);
    recorder.interrupt();

    let info = bus.uorb(&["ulog", "info", "-v", path.to_str().unwrap()]).out;

    let us = format!("{:>7} ", std::process::id());
    let ours = info.lines().find(|line| line.starts_with(&us)).unwrap_or_else(|| panic!("{info}"));
    assert!(ours.ends_with("   1    0"), "{ours}");
}

#[test]
fn a_topic_with_a_rate_has_no_more_messages_than_that() {
    let mut bus = Bus::start();
    let mut plain = bus.advertise::<Plain>();
    let mut stamped = bus.advertise::<Stamped>();
    let recording = Recording::begin(&bus, "rate.ulg", &["-t", "plain:20", "-t", "stam*"]);
    let began = Instant::now();
    let mut published = 0;
    while began.elapsed() < Duration::from_millis(1_000) {
        plain.publish(&Plain { value: published }).unwrap();
        stamped.publish(&Stamped::new(published.into(), 7)).unwrap();
        published += 1;
        std::thread::sleep(Duration::from_millis(1));
    }
    let (found, summary) = recording.end();
    let seconds = began.elapsed().as_secs_f64();
    let sampled = found.of("plain").len();
    assert!(sampled >= 2 && sampled as f64 <= seconds * 20.0 + 2.0, "{sampled} in {seconds} s");
    // That it was not asked for is no loss.
    assert_eq!((summary.lost, summary.dropouts), (0, 0));
    assert!(found.of("stamped").len() > sampled && published as usize > sampled);
}

#[test]
fn a_log_has_the_parameters_that_it_was_given() {
    let bus = Bus::start();
    let params = bus.system.base().join("vehicle.params");
    fs::write(&params, "# mine\nMC_ROLL_P 6.5 7.0\nSYS_AUTOSTART 4001\nSDLOG_UTC_OFFSET 120\n")
        .unwrap();
    let recording = Recording::begin(&bus, "params.ulg", &["--params", params.to_str().unwrap()]);
    let path = recording.path.clone();
    let (found, _) = recording.end();
    let names: Vec<_> = found.parameters.iter().map(String::as_str).collect();
    assert_eq!(names, ["MC_ROLL_P", "SDLOG_UTC_OFFSET", "SYS_AUTOSTART"]);
    let bytes = fs::read(&path).unwrap();
    let defaults = records(&bytes).iter().filter(|(kind, _)| *kind == 'Q').count();
    assert_eq!(defaults, 1);
    for theirs in by_pyulog(&[path]).iter().flatten() {
        let parameters = &theirs["parameters"];
        assert_eq!(
            (&parameters["MC_ROLL_P"], &parameters["SYS_AUTOSTART"]),
            (&6.5.into(), &4_001.into())
        );
        assert_eq!(theirs["defaults"]["MC_ROLL_P"], 7.0);
        let infos = &theirs["infos"];
        assert_eq!((&infos["sys_name"], &infos["time_ref_utc"]), (&"uORB".into(), &7_200.into()));
    }
}

#[test]
fn what_modules_say_in_words_is_text_in_the_log() {
    let mut bus = Bus::start();
    // yule_log hears nothing before the first topic.
    let mut plain = bus.advertise::<Plain>();
    plain.publish(&Plain { value: 0xfeed_beef }).unwrap();
    let recording = Recording::begin(&bus, "words.ulg", &[]);
    eventually("it is followed", || has(&recording.path, 0xfeed_beef));
    let mut words = bus.advertise::<LogMessage>();
    let mut message = LogMessage { timestamp: 5, severity: 4, ..LogMessage::default() };
    message.text[..11].copy_from_slice(b"battery low");
    words.publish(&message).unwrap();
    let is_there = |what: &str| {
        fs::read(&recording.path).unwrap().windows(what.len()).any(|it| it == what.as_bytes())
    };
    eventually("it is written", || is_there("battery low"));
    message = LogMessage { timestamp: 6, severity: 2, text: [b'x'; 127] };
    words.publish(&message).unwrap();
    let (found, summary) = recording.end();
    let expected = [('4', "battery low".to_string()), ('2', "x".repeat(127))];
    assert_eq!(found.texts, expected);
    assert_eq!((summary.messages, summary.lost, found.count()), (3, 0, 1));
}

/// `logger`, with these arguments.
fn logger(bus: &Bus, arguments: &[&str]) -> Ended {
    bus.spawn_heard("logger", arguments).end()
}

#[test]
fn logger_is_started_asked_and_stopped_as_in_px4() {
    let mut bus = Bus::start();
    let dir = bus.system.base().join("log");
    let dir = dir.to_str().unwrap();
    logger(&bus, &["status"]).failed(&["none runs; begin with `logger start`"]);
    logger(&bus, &["stop"]).failed(&["none runs"]);

    let started = logger(&bus, &["start", "-t", "-e", "-d", dir]).fine();
    let pid = started.trim().strip_prefix("[logger] started: pid ").expect("its pid");
    let pid: u32 = pid.parse().unwrap();
    logger(&bus, &["start", "-d", dir]).failed(&["it runs already", &format!("pid {pid}")]);
    let status = logger(&bus, &["status"]).fine();
    let file = status.lines().find_map(|line| line.strip_prefix("Log file: ")).expect("a file");
    let file = PathBuf::from(file);
    assert!(status.starts_with(&format!("[logger] running: pid {pid}\n")), "{status}");
    assert!(status.contains("Dropouts: 0 (0 messages), buffer: "), "{status}");
    // log/2026-11-28/14_05_59.ulg
    let is_dated = |text: &str, by: char, count: usize| {
        let parts: Vec<_> = text.split(by).collect();
        parts.len() == count && parts.iter().all(|part| part.parse::<u16>().is_ok())
    };
    let day = file.parent().unwrap().file_name().unwrap().to_str().unwrap();
    let time = file.file_stem().unwrap().to_str().unwrap();
    assert!(is_dated(day, '-', 3) && is_dated(time, '_', 3), "{}", file.display());

    let mut accel = bus.advertise::<SensorAccel>();
    accel.publish(&SensorAccel { timestamp: 0xfeed_beef, ..SensorAccel::default() }).unwrap();
    eventually("it records", || has(&file, 0xfeed_beef));
    let stopped = logger(&bus, &["stop"]).fine();
    assert_eq!(stopped, format!("[logger] ended: pid {pid}\n"));
    eventually("it has ended", || !is_running(pid));
    let found = read_by_all(&file);
    assert_eq!(found.of("sensor_accel").len(), 1);
    assert!(!found.of("logger_status").is_empty());
}

#[test]
fn logger_that_cannot_start_says_why() {
    let bus = Bus::start();
    let dir = bus.system.base().join("file");
    fs::write(&dir, "").unwrap();
    let started = logger(&bus, &["start", "-d", dir.to_str().unwrap()]);
    started.failed(&["cannot write", "file"]);
}
