//! The programs of the seed documents, compiled and run as they stand there.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use uorb_core::{RawSubscription, poll, topic};
use uorb_msg::{SensorCombined, VehicleAcceleration, VehicleAttitude};
use uorb_tests::{Actor, Bus, Installed, Language, PATIENCE, eventually, is_there};

use crate::c_door::valgrind;

topic! {
    /// What mytopic.h declares.
    pub(crate) struct RandomInteger = "random_integer" {
        /// A number.
        pub(crate) r: i32,
    }
}

/// An example's program: its name, its language and its sources, and whether it
/// is a module of PX4, which has no main function of its own.
struct Example {
    name: &'static str,
    language: Language,
    sources: &'static [&'static str],
    is_module: bool,
}

const fn program(name: &'static str, sources: &'static [&'static str]) -> Example {
    Example { name, language: Language::C, sources, is_module: false }
}

const HELLO: Example = module("px4_simple_app_1_hello", &["px4_simple_app_1_hello.c"]);
const SUBSCRIBE: Example = module("px4_simple_app_2_subscribe", &["px4_simple_app_2_subscribe.c"]);
const PUBLISH: Example = module("px4_simple_app_3_publish", &["px4_simple_app_3_publish.c"]);
const MYTOPIC_PUBLISH: Example =
    program("mytopic_publish", &["mytopic_publish.c", "mytopic_publish_main.c"]);
const MYTOPIC_SUBSCRIBER: Example =
    program("mytopic_subscriber", &["mytopic_subscriber.c", "mytopic_subscriber_main.c"]);
const COLOR_COUNTER: Example =
    program("color_counter", &["color_counter.c", "color_counter_main.c"]);
const COLOR_PUBLISHER: Example = program("color_publisher", &["color_publisher.c"]);
const POSITION: Example = program("position", &["position.c"]);
const CA_TRAJECTORY: Example =
    in_cpp("ca_trajectory", &["ca_trajectory.cpp", "objects_common.cpp"]);
const VEHICLE_ACCELERATION: Example = in_cpp("vehicle_acceleration", &["vehicle_acceleration.cpp"]);

const fn module(name: &'static str, sources: &'static [&'static str]) -> Example {
    Example { is_module: true, ..program(name, sources) }
}

const fn in_cpp(name: &'static str, sources: &'static [&'static str]) -> Example {
    Example { language: Language::Cpp, ..program(name, sources) }
}

impl Example {
    /// Compiles it, with -Wall and -Werror and no other warnings, for a story.
    fn compile(&self, story: &str) -> PathBuf {
        let installed = Installed::get();
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../uorb-c/examples");
        let mut sources: Vec<PathBuf> = self.sources.iter().map(|name| folder.join(name)).collect();
        let mut flags = vec!["-Wno-extra"];
        if self.is_module {
            flags.push("-DPX4_MAIN=px4_simple_app");
            sources
                .extend(installed.pkg_config(&["--variable=px4_main"]).iter().map(PathBuf::from));
        }
        let sources: Vec<&Path> = sources.iter().map(PathBuf::as_path).collect();
        let name = format!("{}-{story}", self.name);
        let program = installed.compile(self.language, &sources, &name, &flags);
        program.unwrap_or_else(|words| panic!("{words}"))
    }

    /// Compiles and starts it, with its stderr heard.
    fn spawn(&self, bus: &Bus, story: &str, arguments: &[&str]) -> Actor {
        let mut command = bus.command(&self.compile(story));
        command.args(arguments).stderr(Stdio::piped());
        Actor::spawn(command)
    }
}

#[test]
fn hello_sky() {
    let bus = Bus::without_broker();
    assert_eq!(HELLO.spawn(&bus, "hello", &[]).end().fine(), "Hello Sky!\n");
}

#[test]
fn px4_simple_app_in_c_prints_what_the_sensors_publish() {
    let bus = Bus::start();
    let mut app = SUBSCRIBE.spawn(&bus, "subscribe", &[]);
    app.expect("Hello Sky!");
    app.expect("[px4_simple_app] Got no data within a second");

    let _sim = bus.spawn_program(&uorb_tests::program("sensor_sim"), &["--seed", "42"]);
    let _sensors = bus.spawn_program(&uorb_tests::program("sensors"), &[]);

    for _ in 0..5 {
        let line = app.until(&["[px4_simple_app] Accelerometer:\t"]);
        let values: Vec<f32> =
            line.split('\t').skip(1).map(|value| value.trim().parse().unwrap()).collect();
        let [_, _, z] = values[..] else { panic!("{line}") };
        assert!((-11.0..-8.5).contains(&z), "gravity is {z}");
    }
}

#[test]
fn px4_simple_app_in_c_publishes_an_attitude_that_rust_reads() {
    let mut bus = Bus::start();
    let mut app = PUBLISH.spawn(&bus, "publish", &[]);
    app.expect("Hello Sky!");
    app.expect("[px4_simple_app] Got no data within a second");
    let mut attitude = bus.subscribe::<VehicleAttitude>();
    // The zeros that it has advertised.
    assert_eq!(attitude.update(), Some(VehicleAttitude::default()));

    let mut combined = bus.advertise::<SensorCombined>();
    for number in [1.0_f32, 2.0] {
        let accelerometer_m_s2 = [number / 3.0, -number, -9.806_65];
        combined.publish(&SensorCombined { accelerometer_m_s2, ..Default::default() }).unwrap();
        let [x, y, z] = accelerometer_m_s2;
        app.until(&[&format!("[px4_simple_app] Accelerometer:\t{x:8.4}\t{y:8.4}\t{z:8.4}")]);
        assert_eq!(poll(&mut [&mut attitude], Some(PATIENCE)).unwrap(), 1);
        let attitude = attitude.update().unwrap();
        assert_eq!([attitude.roll, attitude.pitch, attitude.yaw], accelerometer_m_s2);
    }
}

#[test]
fn random_integers_go_from_one_c_program_to_another() {
    let mut bus = Bus::start();
    let mut subscriber = MYTOPIC_SUBSCRIBER.spawn(&bus, "integers", &[]);
    eventually("it has subscribed", || bus.uorb(&["ls"]).fine() == "random_integer0\n");
    let mut watch = bus.subscribe::<RandomInteger>();

    let published = MYTOPIC_PUBLISH.spawn(&bus, "integers", &["0"]).end().fine();

    assert_eq!(published, "published\n");
    let integer = watch.update().expect("advertised with a number").r;
    subscriber.expect(&format!("Random integer is now {integer}"));
    // Rust's program of this topic publishes for the subscriber in C, too.
    let mut publication = bus.advertise::<RandomInteger>();
    publication.publish(&RandomInteger { r: -7 }).unwrap();
    subscriber.expect("Random integer is now -7");
}

#[test]
fn the_colours_are_counted_in_c() {
    let mut bus = Bus::start();
    let mut counter = COLOR_COUNTER.spawn(&bus, "colours", &[]);
    counter.expect("timeout");
    let mut timeouts = bus.subscribe_by_name("color_timeouts");
    let mut bytes = Vec::new();
    eventually("it is published", || timeouts.copy(&mut bytes) && bytes == 1_i32.to_ne_bytes());
    for color in ["red", "green", "blue"] {
        let mut publisher = COLOR_PUBLISHER.spawn(&bus, color, &[color, "1"]);
        counter.until(&[&format!("{color} is now 1")]);
        assert_eq!(publisher.end().fine(), "");
    }
    // And Rust's counts colours of C.
    drop(counter);
    let mut counter = bus.spawn_heard("color_counter", &["--count", "1"]);
    counter.until(&[" is now 1"]);
}

#[test]
fn two_receivers_in_c_have_an_instance_each() {
    let bus = Bus::start();
    let mut readers = [0, 1].map(|instance: u8| {
        POSITION.spawn(&bus, &format!("reader-{instance}"), &["read", &instance.to_string(), "1"])
    });
    let mut beidou = POSITION.spawn(&bus, "beidou", &["beidou"]);
    beidou.expect("instance_beidou = 0");
    let mut gps = POSITION.spawn(&bus, "gps", &["gps"]);
    gps.expect("instance_gps = 1");

    let [first, second] = readers.each_mut().map(|reader| reader.end().fine());
    assert!(first.starts_with("instance 0: x 12"), "{first}");
    assert_eq!(second, "instance 1: x 90, y 110, z 10\n");
    // The receivers of Rust share the topic: the third instance is theirs.
    let mut rust = bus.spawn_heard("position", &["gps", "--count", "1"]);
    rust.expect("instance_gps = 2");
}

#[test]
fn a_trajectory_of_the_programs_own_definition_arrives_whole() {
    let mut bus = Bus::start();
    let mut reader = CA_TRAJECTORY.spawn(&bus, "reader", &["read", "1"]);
    eventually("it has subscribed", || bus.uorb(&["ls"]).fine() == "ca_trajectory_msg0\n");

    let published = CA_TRAJECTORY.spawn(&bus, "publisher", &["publish", "7"]).end().fine();

    assert_eq!(published, "");
    let line = "trajectory 7: 1000000 us, coefficients 7.000 to 7.964\n";
    assert_eq!(reader.end().fine(), line);
    // The definition says exactly the struct's bytes, and no fields.
    let mut raw: RawSubscription = bus.subscribe_by_name("ca_trajectory_msg");
    let mut bytes = Vec::new();
    assert!(raw.copy(&mut bytes));
    assert_eq!(bytes.len(), 144);
    let coefficients: Vec<f32> = bytes[24..136]
        .chunks(4)
        .map(|float| f32::from_ne_bytes(float.try_into().unwrap()))
        .collect();
    assert_eq!(coefficients.len(), 28);
    assert!(coefficients.iter().zip(0..).all(|(c, i)| (c - (7.0 + i as f32 / 28.0)).abs() < 1e-6));
    assert_eq!(u16::from_ne_bytes([bytes[136], bytes[137]]), 7);
}

#[test]
fn a_definition_with_five_arguments_is_the_topic_that_others_know() {
    let mut bus = Bus::start();

    let printed = VEHICLE_ACCELERATION.spawn(&bus, "five", &[]).end().fine();

    let id = uorb_msg::OrbId::VehicleAcceleration as u16;
    assert_eq!(
        printed,
        format!(
            "vehicle_acceleration: 32 bytes, 28 without padding, id {id}\n\
             uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;uint8_t[4] _padding0;\n\
             x 0.00, y 0.00, z -9.81\n"
        )
    );
    let acceleration = bus.subscribe::<VehicleAcceleration>().copy();
    assert_eq!(acceleration.expect("it outlives its publisher").xyz, [0.0, 0.0, -9.81]);
}

#[test]
fn the_lines_of_the_readme_build_every_example() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../uorb-c/examples");
    let here = Path::new(env!("CARGO_TARGET_TMPDIR")).join("examples");
    let _ = fs::remove_dir_all(&here);
    fs::create_dir_all(here.join("topics")).unwrap();
    for file in ["", "topics"] {
        for entry in fs::read_dir(folder.join(file)).unwrap().flatten() {
            if entry.path().is_file() {
                fs::copy(entry.path(), here.join(file).join(entry.file_name())).unwrap();
            }
        }
    }
    let readme = fs::read_to_string(folder.join("README.md")).unwrap();
    let is_compiler = |line: &&str| line.starts_with("    cc ") || line.starts_with("    c++ ");
    let lines: Vec<&str> = readme.lines().filter(is_compiler).collect();
    assert_eq!(lines.len(), 10);
    let mut shell = Installed::get().command("sh");
    shell.current_dir(&here).args(["-euc", &lines.join("\n")]);
    let done = shell.output().expect("a shell");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));

    // Every source is in one of them.
    for entry in fs::read_dir(&here).unwrap().flatten() {
        let name = entry.file_name().into_string().unwrap();
        let is_source = name.ends_with(".c") || name.ends_with(".cpp");
        assert!(!is_source || lines.iter().any(|line| line.contains(&name)), "{name}");
    }
}

#[test]
fn the_examples_are_clean_under_valgrind() {
    if !is_there("valgrind") {
        return;
    }
    let bus = Bus::start();
    let runs: [(&Example, &[&str], &str); 10] = [
        (&HELLO, &[], ""),
        (&PUBLISH, &[], "Got no data"),
        (&SUBSCRIBE, &[], "Got no data"),
        (&COLOR_PUBLISHER, &["red", "1"], ""),
        (&COLOR_COUNTER, &[], "red is now 1"),
        (&POSITION, &["beidou", "1"], ""),
        (&MYTOPIC_PUBLISH, &["0"], ""),
        (&MYTOPIC_SUBSCRIBER, &[], "Random integer is now"),
        (&CA_TRAJECTORY, &["publish", "1"], ""),
        (&VEHICLE_ACCELERATION, &[], ""),
    ];
    for (example, arguments, until) in runs {
        valgrind(&bus, example.name, &example.compile("valgrind"), arguments, until);
    }
}
