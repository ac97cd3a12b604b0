//! Ground stations and programs that others wrote see a vehicle on our bus.

use std::fs;
use std::path::Path;

use uorb_tests::{Actor, Bus, Python, eventually, program};

use super::flight_logs::logs;
use super::ground_station::port_of_next_link;

/// The dialect that has the message of our own.
const DIALECT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../modules/mavlink/dialect/uorb.xml");

/// A vehicle that stands still, and commands are answered for.
struct Vehicle {
    bus: Bus,
    bridge: Actor,
    port: String,
    _modules: Vec<Actor>,
}

impl Vehicle {
    fn begin() -> Self {
        let bus = Bus::start();
        let modules: [(&str, &[&str]); 3] =
            [("sensor_sim", &["--vehicle"]), ("sensors", &[]), ("commander", &[])];
        let modules: Vec<Actor> = modules
            .iter()
            .map(|(name, options)| bus.spawn_program(&program(name), options))
            .collect();
        let parameters = bus.system.base().join("parameters");
        fs::write(&parameters, "SYS_AUTOSTART 4001\nMC_ROLL_P 6.5\n").unwrap();
        let parameters = parameters.to_str().unwrap();
        let options = ["-u", "0", "-m", "onboard", "--parameters", parameters];
        let (bridge, port) = bridge(&bus, &options);
        Self { bus, bridge, port, _modules: modules }
    }
}

fn bridge(bus: &Bus, options: &[&str]) -> (Actor, String) {
    let mut bridge = bus.spawn_heard("mavlink", options);
    let port = port_of_next_link(&mut bridge).to_string();
    (bridge, port)
}

#[test]
fn pymavlink_sees_the_vehicle_and_commands_it() {
    let Some(python) = Python::with_ground_stations() else { return };
    let vehicle = Vehicle::begin();

    let story = ["sees_and_commands", &vehicle.port];
    let station = python.spawn_story(&vehicle.bus, "mavlink_station.py", &story);

    let all =
        ["sees all", "at their rates", "and at others", "commands", "parameters and missions"];
    assert_eq!(finished(station), all);
}

#[test]
fn mavsdk_sees_the_vehicle_and_commands_it() {
    let Some(python) = Python::with_ground_stations() else { return };
    let vehicle = Vehicle::begin();

    let story = ["sees_and_commands", &vehicle.port];
    let station = python.spawn_story(&vehicle.bus, "mavsdk_station.py", &story);

    assert_eq!(finished(station), ["sees all", "commands", "parameters"]);
}

#[test]
fn mavproxy_says_that_the_vehicle_is_online() {
    let Some(python) = Python::with_ground_stations() else { return };
    let vehicle = Vehicle::begin();

    let mut mavproxy =
        python.spawn_mavproxy(&vehicle.bus, &format!("udpout:127.0.0.1:{}", vehicle.port));

    mavproxy.until(&["online system 1"]);
}

#[test]
fn what_pymavlink_sees_of_a_simulated_vehicle_was_published() {
    let Some(python) = Python::with_ground_stations() else { return };
    let vehicle = Vehicle::begin();
    let log = vehicle.bus.system.base().join("seen.ulg");
    let mut recorder = vehicle.bus.spawn_uorb(&["record", "-o", log.to_str().unwrap()]);
    eventually("it records", || fs::metadata(&log).is_ok_and(|file| file.len() > 100_000));

    let mut station = compare(&python, &vehicle.bus, &vehicle.port, &log);
    eventually("a while is recorded", || fs::metadata(&log).unwrap().len() > 2_000_000);
    station.say("it is enough");
    station.expect("heard enough");
    // What came may still be on its way into the log.
    let size = fs::metadata(&log).unwrap().len();
    eventually("more is recorded", || fs::metadata(&log).unwrap().len() > size + 500_000);
    recorder.interrupt();
    station.say("it is written");

    let all = ["ATTITUDE_QUATERNION", "HIGHRES_IMU", "GPS_RAW_INT", "BATTERY_STATUS"];
    assert_eq!(finished(station), all.map(|name| format!("{name} True")));
}

#[test]
fn what_pymavlink_sees_of_a_replayed_flight_is_in_its_log() {
    let Some(python) = Python::with_ground_stations() else { return };
    for log in logs() {
        let bus = Bus::start();
        let (_bridge, port) = bridge(&bus, &["-u", "0", "-m", "onboard"]);
        let mut station = compare(&python, &bus, &port, &log.path);

        let path = log.path.to_str().unwrap();
        let replayed = bus.uorb(&["replay", path, "--speed", "4", "--duration", "20"]);
        assert_eq!(replayed.code, 0, "{}", replayed.words);
        station.say("it has landed");
        station.expect("heard enough");
        station.say("the log is whole");

        let found = finished(station);
        assert!(found.contains(&"ATTITUDE_QUATERNION True".to_string()), "{path}: {found:?}");
    }
}

/// A station that listens, until it is told that it is enough, and once more when
/// the log is there.
fn compare(python: &Python, bus: &Bus, port: &str, log: &Path) -> Actor {
    let story = ["compares", port, log.to_str().expect("a path of ours")];
    let mut station = python.spawn_story(bus, "mavlink_station.py", &story);
    station.expect("listens");
    station
}

#[test]
fn a_message_of_our_own_goes_to_pymavlink_and_comes_from_it() {
    exchange_trajectories("mavlink_station.py");
}

#[test]
fn a_message_of_our_own_goes_to_mavsdk_and_comes_from_it() {
    exchange_trajectories("mavsdk_station.py");
}

#[track_caller]
fn exchange_trajectories(client: &str) {
    let Some(python) = Python::with_ground_stations() else { return };
    let bus = Bus::start();
    let (_bridge, port) = bridge(&bus, &["-u", "0", "-m", "onboard"]);
    let mut listener = bus.spawn_uorb(&["listener", "ca_trajectory_msg", "1", "--json"]);
    let mut station = python.spawn_story(&bus, client, &["custom_message", &port, DIALECT]);
    station.expect("sent");

    let heard: serde_json::Value = serde_json::from_str(&listener.until(&["time_start"])).unwrap();
    let heard = heard.get("message").unwrap_or(&heard);
    assert_eq!(heard["time_start_usec"], 1_000_001);
    assert_eq!(heard["time_stop_usec"], 2_000_002);
    assert_eq!(heard["seq_id"], 77);
    let coefficients: Vec<f64> = (0..28).map(|k| f64::from(k) / 4.0).collect();
    assert_eq!(heard["coefficients"], serde_json::json!(coefficients));
    assert!(heard["timestamp"].as_u64().is_some_and(|timestamp| timestamp > 0), "{heard}");

    let coefficients: Vec<f64> = (0..28).map(|k| -f64::from(k) / 8.0).collect();
    let coefficients = format!("coefficients={}", serde_json::json!(coefficients));
    let fields = ["time_start_usec=5", "time_stop_usec=6", "seq_id=8", &coefficients];
    let published = bus.uorb(&[&["pub", "ca_trajectory_msg"], &fields[..]].concat());
    assert_eq!(published.code, 0, "{}", published.words);
    station.say("it is published");

    assert_eq!(finished(station), ["received"]);
}

#[test]
fn mavsdk_finds_a_bridge_again_that_was_killed() {
    let Some(python) = Python::with_ground_stations() else { return };
    let vehicle = Vehicle::begin();
    let Vehicle { bus, mut bridge, port, _modules } = vehicle;
    let mut station = python.spawn_story(&bus, "mavsdk_station.py", &["reconnects", &port]);
    station.expect("is there");

    bridge.kill();
    station.expect("is gone");
    let (_bridge, _) = self::bridge(&bus, &["-u", &port, "-m", "onboard"]);

    assert_eq!(finished(station), ["is there again"]);
}

#[test]
fn two_vehicles_of_one_machine_are_seen_and_not_mixed_up() {
    let Some(python) = Python::with_ground_stations() else { return };
    let buses = [Bus::start(), Bus::start()];
    let bridges =
        [0, 1].map(|n| bridge(&buses[n], &["-u", "0", "-m", "onboard", "-i", &n.to_string()]));
    let story = ["two_vehicles", &bridges[0].1, &bridges[1].1];

    let station = python.spawn_story(&buses[0], "mavlink_station.py", &story);

    assert_eq!(finished(station), ["each is itself"]);
}

/// Reads what a station says to its end, which must be a good one.
#[track_caller]
fn finished(mut station: Actor) -> Vec<String> {
    station.finish()
}
