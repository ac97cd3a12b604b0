//! `uorb plot`: on a terminal, and as a picture.

use std::fs;

use nix::sys::signal::Signal;
use uorb_core::now_us;
use uorb_msg::SensorAccel;
use uorb_tests::{Bus, program};

use crate::exports::with_notes;
use crate::flight_logs::logs;
use crate::terminal::Terminal;

#[test]
fn a_picture_of_a_log_has_its_fields_with_axes_units_and_a_legend() {
    let bus = Bus::without_broker();
    fs::create_dir_all(bus.system.base()).unwrap();
    let svg = bus.system.base().join("out.svg");
    for log in logs() {
        let fastest = &log.series[log.fastest()];
        let name = &fastest.topic;
        let fields: Vec<&str> = (fastest.format.fields.iter())
            .map(|field| &*field.flattened_field_name)
            .filter(|field| *field != "timestamp")
            .take(3)
            .collect();
        let plot = ["plot", log.name(), name, "--svg", svg.to_str().unwrap()];
        bus.uorb(&[&plot, &fields[..]].concat()).fine();
        let picture = fs::read_to_string(&svg).unwrap();
        assert!(picture.starts_with("<svg") && picture.trim_end().ends_with("</svg>"));
        let file = log.path.file_name().unwrap().to_str().unwrap();
        let title = format!("{file}, {name}0");
        for words in [&*title, "seconds since "].iter().chain(&fields) {
            assert!(picture.contains(words), "no {words:?} in it");
        }
    }
    let path = bus.system.base().join("notes.ulg");
    with_notes().save(&path);
    let (name, out) = (path.to_str().unwrap(), svg.to_str().unwrap());
    bus.uorb(&["plot", name, "sensor_accel", "x", "y", "--svg", out]).fine();
    let picture = fs::read_to_string(&svg).unwrap();
    for words in ["x [m/s^2]", "m/s^2", "seconds since 5.000 s"] {
        assert!(picture.contains(words), "no {words:?} in {picture}");
    }

    fs::remove_file(&svg).unwrap();
    for (words, expected) in [
        (&["sensor_acel", "x"][..], "is named sensor_acel; did you mean sensor_accel?"),
        (&["sensor_accel", "w"], "message sensor_accel has no field \"w\""),
        (&["sensor_accel"], "which fields of sensor_accel? It has "),
        (&["sensor_accel", "x", "-i", "3"], "has no instance 3: it has [0]"),
        (&[], "which topic of "),
    ] {
        bus.uorb(&[&["plot", name, "--svg", out], words].concat()).failed(&[expected]);
    }
    bus.uorb(&["plot", name, "sensor_accel", "x"]).failed(&["--svg FILE.svg"]);
    assert!(!svg.exists());
}

#[test]
fn a_picture_of_a_bus_has_what_was_published_meanwhile() {
    let mut bus = Bus::start();
    let svg = bus.system.base().join("out.svg");
    let out = svg.to_str().unwrap().to_string();
    let silent = ["plot", "sensor_accel", "x", "--svg", &out, "--seconds", "0.1"];
    bus.uorb(&silent).failed(&["no message of sensor_accel0 was published in 0.1 s"]);
    let mut accel = bus.advertise::<SensorAccel>();
    let mut plot = bus.spawn_uorb(&["plot", "sensor_accel", "x", "z", "--svg", &out]);
    // Until it has seen enough.
    uorb_tests::eventually("it follows", || {
        let info = bus.uorb(&["info", "sensor_accel", "--json"]).fine();
        info.contains("\"depth\"")
    });
    for number in 0..100 {
        let message = SensorAccel { timestamp: now_us(), x: number as f32, ..Default::default() };
        accel.publish(&message).unwrap();
    }
    uorb_tests::eventually("it has all", || {
        let info = bus.uorb(&["info", "sensor_accel", "--json"]).fine();
        info.contains("\"pending\":0") || info.contains("\"pending\": 0")
    });
    plot.interrupt().fine();
    let picture = fs::read_to_string(&svg).unwrap();
    for words in ["sensor_accel0", "x [m/s^2]", "z [m/s^2]", "<polyline"] {
        assert!(picture.contains(words), "no {words:?} in {picture}");
    }
}

#[test]
fn on_a_terminal_a_plot_moves_and_leaves_it_as_it_was() {
    let bus = Bus::start();
    let _sensors = bus.spawn_program(&program("sensor_sim"), &[]);
    uorb_tests::eventually("the sensors publish", || {
        bus.uorb(&["ls"]).out.contains("sensor_accel0")
    });
    for (end, code) in [(Ok("q"), Some(0)), (Ok("\x03"), Some(0)), (Err(Signal::SIGTERM), None)] {
        let mut terminal = Terminal::uorb(&bus, &["plot", "sensor_accel", "x", "z"]);
        let shown = terminal.until("m/s^2");
        assert!(shown.contains("sensor_accel0"), "{shown}");
        match end {
            Ok(key) => terminal.press(key),
            Err(signal) => terminal.signal(signal),
        }
        let (ended, rest) = terminal.end();
        assert_eq!(ended, code, "{end:?}");
        assert!(rest.contains("\x1b[?1049l"), "{end:?}: not the first screen");
    }
    // Without a terminal.
    bus.uorb(&["plot", "sensor_accel", "x"]).failed(&[
        "this is no terminal",
        "--svg FILE.svg",
        "uorb listener sensor_accel --csv",
    ]);
}
