//! `uorb replay`: again and again, in part, under other names, and key by key.

use std::fs;
use std::path::PathBuf;

use nix::sys::signal::Signal;
use serde_json::Value;
use uorb_core::zerocopy::IntoBytes;
use uorb_core::{Message, Subscription, poll};
use uorb_msg::{SensorAccel, SensorGyro};
use uorb_tests::{Bus, PATIENCE};

use crate::exports::with_notes;
use crate::flight_logs::{FlightLog, Recording, logs};
use crate::terminal::Terminal;

/// A log in which an accelerometer says its number, once in so many seconds.
fn counting(bus: &Bus, messages: u64, every_s: u64) -> PathBuf {
    let mut recording = Recording::begin(1_000_000);
    recording.describe(SensorAccel::LAYOUT);
    let id = recording.announce("sensor_accel", 0);
    for number in 0..messages {
        let timestamp = 1_000_000 * (1 + every_s * number);
        let accel = SensorAccel { timestamp, x: number as f32, ..Default::default() };
        recording.message(id, SensorAccel::LAYOUT, accel.as_bytes());
    }
    let path = bus.system.base().join("counting.ulg");
    recording.save(&path);
    path
}

fn replay(bus: &Bus, arguments: &[&str]) -> Value {
    let more = ["--speed", "max", "--json"];
    let line = bus.uorb(&[&["replay"], arguments, &more].concat()).fine();
    serde_json::from_str(&line).expect("JSON")
}

/// The next message that this one hears.
fn next(accel: &mut Subscription<SensorAccel>) -> f32 {
    assert_eq!(poll(&mut [accel], Some(PATIENCE)).unwrap(), 1, "nothing came");
    accel.update().expect("it was updated").x
}

#[test]
fn a_loop_publishes_the_log_as_often_as_it_is_told() {
    let Some(log) = logs().first() else { return };
    let bus = Bus::start();
    let path = bus.system.base().join("recorded.ulg");
    let mut recorder =
        bus.spawn_uorb(&["record", "-o", path.to_str().unwrap(), "--back-pressure", "--quiet"]);
    let closing = replay(&bus, &[log.name(), "--loop=2", "--back-pressure"]);
    recorder.interrupt().fine();

    assert_eq!(
        (&closing["rounds"], &closing["messages"]),
        (&2.into(), &(2 * log.order.len()).into())
    );
    let recorded = FlightLog::read(&path);
    for series in &log.series {
        let found = recorded.series(&series.topic, series.instance).expect("it was recorded");
        let messages = (0..found.count()).map(|number| found.message(number));
        let twice = (0..2).flat_map(|_| (0..series.count()).map(|number| series.message(number)));
        assert!(messages.eq(twice), "{}{}", series.topic, series.instance);
    }
}

#[test]
fn a_loop_without_a_number_ends_by_ctrl_c() {
    let mut bus = Bus::start();
    let path = counting(&bus, 3, 0);
    let mut accel: Subscription<SensorAccel> = bus.subscribe();
    let mut replay =
        bus.spawn_uorb(&["replay", path.to_str().unwrap(), "--loop", "--speed", "max", "--json"]);
    let mut rounds = 0;
    while rounds < 100 {
        rounds += u32::from(next(&mut accel) == 0.0);
    }
    let ended = replay.interrupt();
    assert_eq!((ended.code, &*ended.words), (130, ""));
    let closing: Value = serde_json::from_str(&ended.out).unwrap();
    assert!(closing["rounds"].as_u64().unwrap() >= 100, "{closing}");
    assert_eq!(bus.uorb(&["replay", path.to_str().unwrap(), "--loop=0"]).code, 2);
}

#[test]
fn a_part_of_the_log_is_from_its_start_for_its_duration() {
    let bus = Bus::start();
    let path = counting(&bus, 10, 1);
    let name = path.to_str().unwrap();
    for (start, duration, messages) in
        [("0", "3", 3), ("2", "3", 3), ("2.5", "3", 3), ("8", "100", 2), ("2", "0.5", 1)]
    {
        let closing = replay(&bus, &[name, "--start", start, "--duration", duration]);
        assert_eq!(closing["messages"], messages, "{start} {duration}");
    }
    let closing = replay(&bus, &[name, "--start", "2", "--duration", "3", "--loop=4"]);
    assert_eq!((&closing["messages"], &closing["rounds"]), (&12.into(), &4.into()));
    assert_eq!(closing["log_seconds"], 8.0);
}

#[test]
fn a_topic_is_published_under_another_name_with_the_bytes_of_the_log() {
    let mut bus = Bus::start();
    // With other fields than the log has.
    let _live = bus.advertise::<SensorGyro>();
    let mut recording = Recording::begin(0);
    recording.record(b'F', b"sensor_gyro:uint64_t timestamp;float x;");
    recording.describe(SensorAccel::LAYOUT);
    let gyro = recording.announce("sensor_gyro", 0);
    let accel = recording.announce("sensor_accel", 0);
    recording
        .record(b'D', &[&gyro.to_le_bytes()[..], &7_u64.to_le_bytes(), &[1, 2, 3, 4]].concat());
    recording.message(accel, SensorAccel::LAYOUT, SensorAccel::default().as_bytes());
    let path = bus.system.base().join("remapped.ulg");
    recording.save(&path);
    let name = path.to_str().unwrap();
    bus.uorb(&["replay", name]).failed(&["sensor_gyro", "--remap sensor_gyro=NAME"]);

    let closing = replay(&bus, &[name, "--remap", "sensor_gyro=recorded_gyro"]);

    assert_eq!(closing["messages"], 2);
    let mut recorded = bus.subscribe_by_name("recorded_gyro");
    let mut bytes = Vec::new();
    assert!(recorded.copy(&mut bytes));
    assert_eq!(bytes, [&7_u64.to_le_bytes()[..], &[1, 2, 3, 4]].concat());
    bus.uorb(&["replay", name, "-r", "sensor_gyro=sensor_accel"])
        .failed(&["would both be published as sensor_accel0", "remap them to two names"]);
    bus.uorb(&["replay", name, "-r", "sensor_giro=other"])
        .failed(&["is named sensor_giro; did you mean sensor_gyro?"]);
    for odd in ["sensor_gyro", "sensor_gyro=../x", "sensor_*=x"] {
        assert_eq!(bus.uorb(&["replay", name, "-r", odd]).code, 2, "{odd}");
    }
}

#[test]
fn keys_pause_step_and_end_a_replay_and_the_terminal_is_as_it_was() {
    let mut bus = Bus::start();
    // Whoever waits for these does not wait in vain for a key.
    let path = counting(&bus, 20, 1_000);
    let name = path.to_str().unwrap();
    let mut accel: Subscription<SensorAccel> = bus.subscribe();
    let mut terminal = Terminal::uorb(&bus, &["replay", name, "--paused", "--json"]);
    terminal.until("1x, paused");
    assert!(!terminal.is_as_before(), "keys are read one by one");
    assert!(!accel.updated(), "it is paused");
    for (number, key) in [".", "s", "\x1b[C", "."].iter().enumerate() {
        terminal.press(key);
        assert_eq!(next(&mut accel), number as f32, "{key:?}");
    }
    // At a thousand times as fast they come once a second.
    terminal.press("++++++++++ ");
    assert_eq!(next(&mut accel), 4.0);
    assert_eq!(next(&mut accel), 5.0);
    terminal.press(" ");
    terminal.until("1024x, paused");
    terminal.press("-");
    terminal.until("512x, paused");
    terminal.press("q");
    let (code, rest) = terminal.end();
    assert_eq!(code, Some(0));
    assert!(rest.contains("\"interrupted\":false"), "{rest}");

    for (signal, key, code) in [(None, "\x03", Some(130)), (Some(Signal::SIGTERM), "", None)] {
        let mut terminal = Terminal::uorb(&bus, &["replay", name, "--paused"]);
        terminal.until("1x, paused");
        terminal.press(key);
        if let Some(signal) = signal {
            terminal.signal(signal);
        }
        assert_eq!(terminal.end().0, code, "{signal:?}");
    }
    bus.uorb(&["replay", name, "--paused"]).failed(&["--paused needs a terminal"]);
}

#[test]
fn dropouts_and_parameters_in_flight_do_not_disturb_a_replay_of_any_version() {
    let bus = Bus::start();
    let path = bus.system.base().join("notes.ulg");
    with_notes().save(&path);
    let first = fs::read(&path).unwrap();
    let mut second = first.clone();
    // Version 0 has no flags.
    second.drain(16..16 + 43);
    second[7] = 0;
    for bytes in [first, second] {
        fs::write(&path, bytes).unwrap();
        let closing = replay(&bus, &[path.to_str().unwrap()]);
        assert_eq!((&closing["messages"], &closing["log_seconds"]), (&3.into(), &2.0.into()));
        assert_eq!((&closing["dropouts"], &closing["dropped_ms"]), (&2.into(), &100.into()));
        assert_eq!(closing["parameter_changes"], 1);
        let line = bus.uorb(&["replay", path.to_str().unwrap(), "--speed", "max"]).fine();
        assert!(line.ends_with("; 2 dropouts, 100 ms, in it\n"), "{line}");
    }
}
