//! The modules, each a process of its own, as a shell starts them.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use nix::sys::signal::Signal;
use uorb_core::{Subscription, poll};
use uorb_msg::{SensorAccel, SensorCombined, VehicleAcceleration, VehicleAttitude};
use uorb_tests::{Actor, Bus, PATIENCE, eventually, instance, is_running, program};

/// One device, or some, as a process that has advertised.
fn sensor_sim(bus: &Bus, devices: &str, first: &str) -> Actor {
    let mut sim = bus.spawn_heard("sensor_sim", &["--only", devices]);
    sim.expect(&format!("[sensor_sim] {first}"));
    sim
}

/// `sensors`, which does not take a busy machine for a sensor that is silent.
fn sensors(bus: &Bus) -> Actor {
    bus.spawn_heard("sensors", &["--timeout-ms", "20000"])
}

/// Waits for so many messages, and checks that each is later than the one before
/// and has a reading of an accelerometer.
fn goes_on(combined: &mut Subscription<SensorCombined>, messages: usize) {
    let mut before = combined.copy().map_or(0, |message| message.timestamp);
    for _ in 0..messages {
        assert_eq!(poll(&mut [combined], Some(PATIENCE)).unwrap(), 1, "sensor_combined is silent");
        let message = combined.update().expect("it was updated");
        assert!(message.timestamp > before);
        before = message.timestamp;
        let relative = message.accelerometer_timestamp_relative;
        assert_ne!(relative, SensorCombined::RELATIVE_TIMESTAMP_INVALID);
        let z = message.accelerometer_m_s2[2];
        assert!((-11.0..-8.5).contains(&z), "gravity is {z}");
    }
}

#[test]
fn sensors_switches_when_the_best_accelerometer_is_killed_and_back_when_it_is_there_again() {
    let mut bus = Bus::start();
    let mut best = sensor_sim(&bus, "accel0", "accel0 is sensor_accel instance 0, priority 100");
    let _next = sensor_sim(&bus, "accel1", "accel1 is sensor_accel instance 1, priority 75");
    let _rest = sensor_sim(&bus, "mag,baro,gyro", "mag is sensor_mag instance 0, priority 75");
    let mut sensors = sensors(&bus);
    sensors.until(&["accelerometer 0, priority 100"]);
    let mut combined = bus.subscribe::<SensorCombined>();
    goes_on(&mut combined, 20);

    best.kill();

    sensors.expect("[sensors] switched from accelerometer 0 to 1, priority 75");
    goes_on(&mut combined, 20);
    let info = bus.uorb(&["info", "sensor_accel"]).fine();
    assert!(info.contains("\ninstance 0: not advertised, "), "{info}");
    assert!(info.contains("\ninstance 1: advertised, priority 75, "), "{info}");

    let _best = sensor_sim(&bus, "accel0", "accel0 is sensor_accel instance 0, priority 100");

    sensors.expect("[sensors] switched from accelerometer 1 to 0, priority 100");
    goes_on(&mut combined, 20);
    assert_eq!(sensors.interrupt().fine(), "");
}

#[test]
fn sensors_waits_for_the_gyroscope_which_sets_its_pace() {
    let bus = Bus::start();
    let accel = "accel2 is sensor_accel instance 0, priority 50";
    let _accel = sensor_sim(&bus, "accel2", accel);
    let mut sensors = sensors(&bus);
    sensors.expect("[sensors] no gyroscope for a second: sensor_combined has to wait");
    let _gyro = sensor_sim(&bus, "gyro", "gyro is sensor_gyro instance 0, priority 75");
    sensors.expect("[sensors] the gyroscope is there");
    sensors.expect("[sensors] uses accelerometer 0, priority 50");
}

#[test]
fn sensors_publishes_how_the_vehicle_accelerates_once_for_each_reading() {
    let mut bus = Bus::start();
    let _sim = bus.spawn_heard("sensor_sim", &["--only", "accel0,gyro"]);
    let _sensors = sensors(&bus);
    let mut acceleration = bus.subscribe::<VehicleAcceleration>();
    let mut sampled = 0;
    for _ in 0..20 {
        assert_eq!(poll(&mut [&mut acceleration], Some(PATIENCE)).unwrap(), 1);
        let message = acceleration.update().expect("it was updated");
        assert!(
            message.timestamp_sample > sampled && message.timestamp >= message.timestamp_sample
        );
        sampled = message.timestamp_sample;
        assert!((-11.0..-8.5).contains(&message.xyz[2]), "gravity is {:?}", message.xyz);
    }
}

#[test]
fn modules_go_on_while_the_broker_is_killed_and_started_again() {
    let mut bus = Bus::start();
    let mut sim = bus.spawn_heard("sensor_sim", &[]);
    let mut sensors = sensors(&bus);
    sensors.until(&["uses accelerometer 0"]);
    let mut combined = bus.subscribe::<SensorCombined>();
    goes_on(&mut combined, 20);

    bus.kill_broker();
    goes_on(&mut combined, 20);
    bus.start_broker();
    goes_on(&mut combined, 20);

    eventually("all have re-joined", || {
        let info = bus.uorb(&["info", "sensor_accel", "--window", "0"]).fine();
        let publisher = format!("publisher  sensor_sim (pid {})", sim.pid());
        let subscriber = format!("subscriber sensors (pid {})", sensors.pid());
        info.matches(&publisher).count() == 3 && info.matches(&subscriber).count() == 3
    });
    assert_eq!(sensors.interrupt().fine(), "");
    assert_eq!(sim.interrupt().code, 0);
}

#[test]
fn sensor_sim_is_a_vehicle_with_three_accelerometers_that_can_fail() {
    let bus = Bus::start();
    let arguments = ["--duration", "0.5", "--seed", "42", "--fail-accel", "1@0.25"];
    let ended = bus.spawn_heard("sensor_sim", &arguments).end();

    let out = ended.fine();
    let lines: Vec<&str> = out.lines().collect();
    assert_eq!(
        lines[..7],
        [
            "[sensor_sim] accel0 is sensor_accel instance 0, priority 100",
            "[sensor_sim] accel1 is sensor_accel instance 1, priority 75",
            "[sensor_sim] accel2 is sensor_accel instance 2, priority 50",
            "[sensor_sim] mag is sensor_mag instance 0, priority 75",
            "[sensor_sim] baro is sensor_baro instance 0, priority 75",
            "[sensor_sim] gps is vehicle_gps_position instance 0, priority 75",
            "[sensor_sim] gyro is sensor_gyro instance 0, priority 75",
        ]
    );
    assert_eq!(lines[7], "[sensor_sim] accel1 fails");
    // What a busy machine had no time for is counted, and not forgotten.
    for (device, readings) in
        [("accel0", 125), ("accel1", 62), ("accel2", 125), ("mag", 50), ("baro", 25), ("gyro", 125)]
    {
        let start = format!("[sensor_sim] {device} has published ");
        let line = lines.iter().find_map(|line| line.strip_prefix(&start)).expect("it reports");
        let numbers = line.split(' ').filter_map(|word| word.parse::<u32>().ok());
        let sum: u32 = numbers.sum();
        assert!((readings - 1..=readings + 1).contains(&sum), "{device}: {line}");
    }
    let mut bus = bus;
    let accel = bus.subscribe_instance::<SensorAccel>(2).copy().expect("it outlives its sensor");
    assert!((-11.0..-8.5).contains(&accel.z), "gravity is {}", accel.z);
}

#[test]
fn px4_simple_app_prints_what_it_copies_and_publishes_it_as_an_attitude() {
    let mut bus = Bus::start();
    let mut app = bus.spawn_heard("px4_simple_app", &["--count", "2"]);
    app.expect("Hello Sky!");
    app.expect("[px4_simple_app] Got no data within a second");
    let mut attitude = bus.subscribe::<VehicleAttitude>();
    attitude.copy();
    let mut combined = bus.advertise::<SensorCombined>();
    for number in [1.0_f32, 2.0] {
        let accelerometer_m_s2 = [number / 3.0, -number, -9.806_65];
        combined.publish(&SensorCombined { accelerometer_m_s2, ..Default::default() }).unwrap();
        let [x, y, z] = accelerometer_m_s2;
        app.until(&[&format!("[px4_simple_app] Accelerometer:\t{x:8.4}\t{y:8.4}\t{z:8.4}")]);
        assert_eq!(poll(&mut [&mut attitude], Some(PATIENCE)).unwrap(), 1);
        let attitude = attitude.update().unwrap();
        assert_eq!([attitude.roll, attitude.pitch, attitude.yaw], accelerometer_m_s2);
        assert!(attitude.timestamp > 0);
    }
    assert_eq!(app.end().fine(), "");
}

#[test]
fn color_counter_counts_three_colours_and_the_seconds_without_any() {
    let mut bus = Bus::start();
    let mut counter = bus.spawn_heard("color_counter", &["--count", "3"]);
    counter.expect("timeout");
    let mut timeouts = bus.subscribe_by_name("color_timeouts");
    let mut bytes = Vec::new();
    eventually("it is published", || timeouts.copy(&mut bytes) && bytes == 1_i32.to_ne_bytes());
    for color in ["red", "green", "blue"] {
        let mut publisher = bus.spawn_heard("color_publisher", &[color, "--count", "1"]);
        counter.until(&[&format!("{color} is now 1")]);
        assert_eq!(publisher.end().fine(), "");
    }
    assert_eq!(counter.end().fine(), "");
}

#[test]
fn position_is_published_by_two_receivers_and_shown_with_who_has_sent_it() {
    let bus = Bus::start();
    let mut receivers = ["beidou", "gps"].map(|name| {
        let mut receiver = bus.spawn_heard("position", &[name, "--rate", "100"]);
        let number = if name == "beidou" { 0 } else { 1 };
        receiver.expect(&format!("instance_{name} = {number}"));
        receiver
    });
    let mut show = bus.spawn_heard("position", &["show"]);
    for (number, receiver) in (0..).zip(&receivers) {
        let sender = format!("sent by position (pid {})", receiver.pid());
        show.until(&[&format!("instance {number}: x "), &sender]);
    }
    let second = bus.spawn_heard("position", &["show", "--instance", "1", "--count", "3"]).end();
    let second = second.fine();
    assert!(second.lines().all(|line| line.starts_with("instance 1: ")), "{second}");
    assert_eq!(second.lines().count(), 3);

    receivers[1].kill();
    eventually("it is unadvertised", || {
        bus.uorb(&["info", "position"]).fine().contains("instance 1: not advertised")
    });
    receivers[1] = bus.spawn_heard("position", &["gps", "--rate", "100"]);
    receivers[1].expect("instance_gps = 1");
    let sender = format!("sent by position (pid {})", receivers[1].pid());
    show.until(&["instance 1: x ", &sender]);
    assert_eq!(show.interrupt().code, 0);
}

#[test]
fn random_integers_are_checked_as_they_were_published() {
    let bus = Bus::start();
    let mut check = bus.spawn_heard("random_integer", &["check", "--rate", "1000", "--count", "2"]);
    eventually("it has subscribed", || bus.uorb(&["ls"]).fine() == "random_integer0\n");
    for seed in ["1", "2"] {
        let publish = ["publish", "--count", "1", "--seed", seed];
        assert_eq!(bus.spawn_heard("random_integer", &publish).end().fine(), "");
        let shown = bus.uorb(&["listener", "random_integer", "--json"]).fine();
        let integer = shown.trim_end().trim_start_matches("{\"r\":").trim_end_matches('}');
        check.expect(&format!("Random integer is now {integer}"));
    }
    assert_eq!(check.end().fine(), "");
}

/// Every module, and what it needs to be told.
const MODULES: [&[&str]; 11] = [
    &["sensor_sim"],
    &["sensors"],
    &["px4_simple_app"],
    &["color_publisher", "red"],
    &["color_publisher", "green"],
    &["color_counter"],
    &["position", "beidou"],
    &["position", "gps"],
    &["position", "show"],
    &["random_integer", "publish"],
    &["random_integer", "check"],
];

fn spawn_all(bus: &Bus) -> Vec<Actor> {
    let modules: Vec<Actor> =
        MODULES.iter().map(|module| bus.spawn_heard(module[0], &module[1..])).collect();
    eventually("all are on the bus", || bus.processes().len() == modules.len());
    modules
}

#[test]
fn ctrl_c_ends_every_module_and_nothing_of_it_is_left() {
    for signal in [Signal::SIGINT, Signal::SIGTERM] {
        let bus = Bus::start();
        for (module, words) in spawn_all(&bus).iter_mut().zip(MODULES) {
            module.signal(signal);
            let ended = module.end();
            assert_eq!((ended.code, &*ended.words), (0, ""), "{words:?}");
        }
        assert!(bus.processes().is_empty(), "nobody is left");
        let status = bus.uorb(&["status", "--json"]).fine();
        let status: serde_json::Value = serde_json::from_str(&status).unwrap();
        assert_eq!(status["broker"]["advertised"], 0, "nothing is advertised any more");
        assert_eq!(status["peers"], serde_json::json!([]));
    }
}

#[test]
fn stop_ends_every_module_and_it_says_why() {
    let bus = Bus::start();
    let mut modules = spawn_all(&bus);
    assert_eq!(bus.uorb(&["stop"]).code, 0);
    for (module, words) in modules.iter_mut().zip(MODULES) {
        let ended = module.end();
        assert_eq!(ended.code, 0, "{words:?}");
        let says = format!("{}: the system at {} has ended (`uorb stop`)\n", words[0], bus.system);
        assert_eq!(ended.words, says);
    }
    assert!(!bus.system.dir().exists());
}

#[test]
fn without_a_broker_every_module_says_what_to_do() {
    let bus = Bus::without_broker();
    for module in MODULES {
        let ended = bus.spawn_heard(module[0], &module[1..]).end();
        assert_eq!(ended.code, 1, "{module:?}");
        let says = ended.words.starts_with(&format!("{}: no broker runs at ", module[0]));
        assert!(says && ended.words.contains("uorb start"), "{}", ended.words);
    }
}

#[test]
fn a_module_whose_reader_has_seen_enough_ends() {
    let bus = Bus::start();
    let mut show = bus.spawn_heard("position", &["show"]);
    let mut receiver = bus.spawn_heard("position", &["gps", "--rate", "100"]);
    assert!(show.line().is_some());
    show.stop_reading();
    assert_eq!(show.end().fine(), "");
    assert_eq!(receiver.interrupt().code, 0);
}

/// `rc.sensors` and what it starts in one folder: those that were built with the
/// tests.
fn rc_sensors(bus: &Bus) -> PathBuf {
    let folder = bus.system.base().join("bin");
    fs::create_dir(&folder).unwrap();
    for name in ["sensor_sim", "sensors"] {
        symlink(program(name), folder.join(name)).unwrap();
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scripts/rc.sensors");
    symlink(script.canonicalize().unwrap(), folder.join("rc.sensors")).unwrap();
    folder.join("rc.sensors")
}

#[test]
fn rc_sensors_starts_the_sensor_modules_once_and_ends_them() {
    let bus = Bus::start();
    let script = rc_sensors(&bus);
    let rc = |arguments: &[&str]| {
        let mut command = bus.command(Path::new("sh"));
        command.arg(&script).args(arguments).stderr(Stdio::piped());
        Actor::spawn(command).end()
    };
    let pids = |words: &str, out: &str, of: [&str; 2]| -> Vec<u32> {
        let lines: Vec<&str> = out.lines().collect();
        assert_eq!(lines.len(), 2, "{out}");
        let pid = |(line, name): (&&str, &&str)| {
            let start = words.replace("NAME", name);
            line.strip_prefix(&start).unwrap_or_else(|| panic!("{out}")).trim().parse().unwrap()
        };
        lines.iter().zip(&of).map(pid).collect()
    };

    let started = pids(
        "started NAME: pid ",
        &rc(&["start", "--seed", "42"]).fine(),
        ["sensor_sim", "sensors"],
    );
    let again = pids("NAME runs already: pid ", &rc(&[]).fine(), ["sensor_sim", "sensors"]);
    assert_eq!(started, again);
    let processes = bus.processes();
    assert!(started.iter().all(|pid| processes.contains(pid)));

    let ended = pids("ended NAME: pid ", &rc(&["stop"]).fine(), ["sensors", "sensor_sim"]);
    assert_eq!(ended, [started[1], started[0]]);
    eventually("they are gone", || !started.iter().any(|pid| is_running(*pid)));
    assert_eq!(rc(&["stop"]).fine(), "sensors does not run\nsensor_sim does not run\n");
    assert_eq!(rc(&["restart"]).code, 2);
    assert_eq!(bus.uorb(&["stop"]).code, 0);
    rc(&["start"]).failed(&["no broker runs at", "uorb start"]);
}

#[test]
fn rc_sensors_feeds_the_listener() {
    let mut bus = Bus::start();
    let script = rc_sensors(&bus);
    let mut start = bus.command(Path::new("sh"));
    start.arg(&script);
    let started = Actor::spawn(start).end().fine();
    let mut combined = bus.subscribe::<SensorCombined>();
    goes_on(&mut combined, 5);

    let shown = bus.uorb(&["listener", "sensor_accel", "5"]).fine();

    for number in 1..=5 {
        assert!(
            shown.contains(&format!("\nTOPIC: sensor_accel #{number}\ntimestamp: ")),
            "{shown}"
        );
    }
    assert_eq!(shown.matches("\nintegral_dt: ").count(), 5);
    let accels = bus.uorb(&["listener", "sensor_accel"]).fine();
    for number in 0..3 {
        assert!(accels.contains(&format!("\nTOPIC: sensor_accel instance {number} #1\n")));
    }
    let nodes = bus.uorb(&["ls", "/obj"]).fine();
    assert_eq!(
        nodes,
        "sensor_accel0\nsensor_accel1\nsensor_accel2\nsensor_baro0\nsensor_combined0\n\
         sensor_gyro0\nsensor_mag0\nvehicle_acceleration0\nvehicle_gps_position0\n"
    );
    assert!(bus.session().exists("sensor_accel", instance(2)).unwrap());
    // They are nobody's children, and end with the system.
    let pids: Vec<u32> = started.split(' ').filter_map(|word| word.trim().parse().ok()).collect();
    bus.stop();
    eventually("they are gone", || !pids.iter().any(|pid| is_running(*pid)));
}

#[test]
fn every_module_and_each_of_its_roles_has_help_with_examples() {
    let bus = Bus::without_broker();
    let commands: [&[&str]; 12] = [
        &["color_counter"],
        &["color_publisher"],
        &["position"],
        &["position", "beidou"],
        &["position", "gps"],
        &["position", "show"],
        &["px4_simple_app"],
        &["random_integer"],
        &["random_integer", "publish"],
        &["random_integer", "check"],
        &["sensor_sim"],
        &["sensors"],
    ];
    for command in commands {
        let help = [&command[1..], &["--help"]].concat();
        let help = bus.spawn_heard(command[0], &help).end().fine();
        assert!(help.contains("Examples"), "{command:?}: {help}");
    }
    let rate = bus.spawn_heard("position", &["gps", "--rate", "-1"]).end();
    assert_eq!(rate.code, 2);
    assert!(rate.words.contains("not a number above 0"), "{}", rate.words);
}
