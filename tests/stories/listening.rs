//! `uorb listener`: what it prints, what it waits for, and how it ends.

use std::os::unix::fs::symlink;
use std::process::Stdio;

use nix::sys::signal::Signal;
use uorb_core::{AdvertiseOptions, Publication, QueueLength};
use uorb_msg::{EscStatus, SensorAccel, SensorGyro};
use uorb_tests::{Actor, Bus, Stamped, eventually, program};

/// A reading that says by its numbers which one it is.
fn accel(number: u16) -> SensorAccel {
    let share = f32::from(number) / 8.0;
    SensorAccel {
        timestamp: 84_978_861 + u64::from(number),
        integral_dt: 4_044,
        x: -0.123_456,
        y: share,
        z: -9.81,
        x_raw: -7,
        device_id: 1_246_218,
        ..Default::default()
    }
}

/// What the listener prints of it.
fn accel_text(head: &str, number: u16) -> String {
    let (timestamp, share) = (84_978_861 + u64::from(number), f32::from(number) / 8.0);
    format!(
        "
TOPIC: sensor_accel {head}
timestamp: {timestamp}
integral_dt: 4044
error_count: 0
x: -0.12346
y: {share:.5}
z: -9.81000
x_integral: 0.00000
y_integral: 0.00000
z_integral: 0.00000
temperature: 0.00000
range_m_s2: 0.00000
scaling: 0.00000
x_raw: -7
y_raw: 0
z_raw: 0
temperature_raw: 0
device_id: 1246218
"
    )
}

/// A listener that has subscribed and waits for a first message.
fn waiting(bus: &Bus, arguments: &[&str]) -> Actor {
    let mut listener = bus.spawn_uorb(&[&["listener"], arguments].concat());
    let word = listener.word().expect("it says that it waits");
    assert!(word.contains("nothing was published yet; waiting"), "{word}");
    listener
}

#[test]
fn five_messages_are_shown_in_the_form_of_the_first_listener() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<SensorAccel>();
    publication.publish(&accel(1)).unwrap();

    let mut listener = bus.spawn_uorb(&["listener", "sensor_accel", "5"]);

    for number in 1..=5 {
        listener.expect_all(&accel_text(&format!("#{number}"), number));
        publication.publish(&accel(number + 1)).unwrap();
    }
    assert_eq!(listener.end().fine(), "", "five, and no more");
}

#[test]
fn a_listener_takes_a_count_in_both_forms() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<SensorAccel>();
    publication.publish(&accel(1)).unwrap();
    for form in [&["1"][..], &["-n", "1"]] {
        let listener = [&["listener", "sensor_accel"], form].concat();
        assert_eq!(bus.uorb(&listener).fine(), accel_text("#1", 1));
    }
}

#[test]
fn without_a_count_the_newest_of_every_instance_is_shown() {
    let mut bus = Bus::start();
    let mut first = bus.advertise_multi::<SensorAccel>();
    first.publish(&accel(0)).unwrap();
    assert_eq!(bus.uorb(&["listener", "sensor_accel"]).fine(), accel_text("#1", 0));

    let mut second = bus.advertise_multi::<SensorAccel>();
    let _silent = bus.advertise_multi::<SensorAccel>();
    for number in 1..=3 {
        first.publish(&accel(number)).unwrap();
        second.publish(&accel(10 + number)).unwrap();
    }

    let expected = accel_text("instance 0 #1", 3) + &accel_text("instance 1 #1", 13);
    assert_eq!(bus.uorb(&["listener", "sensor_accel"]).fine(), expected);
}

#[test]
fn an_instance_can_be_chosen() {
    let mut bus = Bus::start();
    let mut first = bus.advertise_multi::<SensorAccel>();
    let mut second = bus.advertise_multi::<SensorAccel>();
    first.publish(&accel(1)).unwrap();
    second.publish(&accel(2)).unwrap();

    let shown = bus.uorb(&["listener", "sensor_accel", "-i", "1"]).fine();
    assert_eq!(shown, accel_text("instance 1 #1", 2));

    let mut listener = bus.spawn_uorb(&["listener", "sensor_accel", "-i", "1", "-n", "2"]);
    listener.expect_all(&accel_text("instance 1 #1", 2));
    first.publish(&accel(3)).unwrap();
    second.publish(&accel(4)).unwrap();
    listener.expect_all(&accel_text("instance 1 #2", 4));
    assert_eq!(listener.end().fine(), "");
}

#[test]
fn an_instance_that_cannot_be_is_refused() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<SensorAccel>();
    publication.publish(&accel(1)).unwrap();
    for number in ["10", "-1", "first"] {
        let instance = format!("--instance={number}");
        let ended = bus.uorb(&["listener", "sensor_accel", &instance, "-n", "1"]);
        assert_eq!((ended.code, &*ended.out), (2, ""), "{}", ended.words);
        assert!(ended.words.contains(number) && ended.words.contains("0..9"), "{}", ended.words);
    }
}

fn publish_escs(bus: &mut Bus) -> Publication<EscStatus> {
    let mut escs = EscStatus { timestamp: u64::MAX, counter: 3, ..Default::default() };
    escs.esc[1].esc_rpm = -5;
    escs.esc[1].esc_voltage = 1.0 / 3.0;
    escs.esc[7].esc_current = f32::NAN;
    let mut publication = bus.advertise::<EscStatus>();
    publication.publish(&escs).unwrap();
    publication
}

#[test]
fn json_is_one_object_a_line_in_which_nothing_is_rounded() {
    let mut bus = Bus::start();
    let _publication = publish_escs(&mut bus);
    let shown = bus.uorb(&["listener", "esc_status", "1", "--json"]).fine();
    assert_eq!(shown.lines().count(), 1);
    assert!(shown.starts_with("{\"timestamp\":18446744073709551615,\"counter\":3,"), "{shown}");
    let escs: serde_json::Value = serde_json::from_str(&shown).expect("JSON");
    let esc = |number: usize| &escs["esc"][number];
    assert_eq!(escs["esc"].as_array().unwrap().len(), 8);
    assert_eq!(esc(1)["esc_rpm"], -5);
    assert_eq!(esc(1)["esc_voltage"].as_f64().unwrap() as f32, 1.0_f32 / 3.0);
    assert!(esc(7)["esc_current"].is_null(), "JSON has no NaN");
}

#[test]
fn csv_has_a_column_for_every_number_as_pyulog_names_them() {
    let mut bus = Bus::start();
    let mut publication = publish_escs(&mut bus);
    let fields = "--field=timestamp,esc[1].esc_rpm,esc[7].esc_current,counter";
    let head = "timestamp,esc[1].esc_rpm,esc[7].esc_current,counter";
    let mut listener = bus.spawn_uorb(&["listener", "esc_status", "2", "--csv", fields]);
    listener.expect(head);
    listener.expect("18446744073709551615,-5,nan,3");
    publication.publish(&EscStatus { timestamp: 7, ..Default::default() }).unwrap();
    listener.expect("7,0,0.0,0");
    assert_eq!(listener.end().fine(), "");

    let all = bus.uorb(&["listener", "esc_status", "1", "--csv"]).fine();
    let [head, row] = all.lines().collect::<Vec<_>>()[..] else { panic!("{all}") };
    assert!(head.starts_with("timestamp,counter,esc_count,esc_connectiontype,esc[0].timestamp,"));
    // Four fields, and eight times twelve.
    assert_eq!((head.split(',').count(), row.split(',').count()), (100, 100));
}

#[test]
fn fields_are_picked_by_their_paths() {
    let mut bus = Bus::start();
    let _publication = publish_escs(&mut bus);
    let picked = |field: &str| bus.uorb(&["listener", "esc_status", "1", "--field", field]);
    assert_eq!(
        picked("esc[1].esc_rpm,counter").fine(),
        "\nTOPIC: esc_status #1\nesc[1].esc_rpm: -5\ncounter: 3\n"
    );
    assert!(picked("esc[1]").fine().contains("\nesc[1] (esc_report):\n  timestamp: 0\n"));
    picked("esc_rpm").failed(&["esc_status", "no field \"esc_rpm\""]);
    picked("countr").failed(&["did you mean counter?"]);
    picked("esc[8].esc_rpm").failed(&["esc", "8"]);
}

#[test]
fn a_listener_waits_for_a_publisher_that_comes_later() {
    let mut bus = Bus::start();
    let mut listener = waiting(&bus, &["sensor_accel", "2"]);
    let mut publication = bus.advertise::<SensorAccel>();
    for number in 1..=2 {
        publication.publish(&accel(number)).unwrap();
        listener.expect_all(&accel_text(&format!("#{number}"), number));
    }
    assert_eq!(listener.end().fine(), "");
}

#[test]
fn a_listener_without_a_count_waits_for_the_first_message_of_any_instance() {
    let mut bus = Bus::start();
    let _silent = bus.advertise_multi::<SensorAccel>();
    let mut second = bus.advertise_multi::<SensorAccel>();
    let mut listener = waiting(&bus, &["sensor_accel"]);
    second.publish(&accel(7)).unwrap();
    assert_eq!(listener.end().fine(), accel_text("#1", 7));
}

#[test]
fn a_listener_waits_for_a_topic_that_nobody_has_described_yet() {
    let bus = Bus::start();
    let mut listener = waiting(&bus, &["stamped", "1", "--wait", "--json", "--field", "count"]);
    let mut publisher = bus.spawn(&["publish", "1", "1"]);
    publisher.expect("advertised");
    publisher.say("go");
    assert_eq!(listener.end().fine(), "{\"count\":0}\n");
}

#[test]
fn ctrl_c_is_how_a_listener_ends_that_has_no_other_end() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<SensorAccel>();
    publication.publish(&accel(1)).unwrap();
    for arguments in [&["--follow"][..], &["-r", "1000"]] {
        let arguments = [&["listener", "sensor_accel"], arguments].concat();
        let mut listener = bus.spawn_uorb(&arguments);
        listener.expect_all(&accel_text("#1", 1));
        assert_eq!(listener.interrupt().fine(), "");
    }
    eventually("nobody has subscribed any more", || {
        bus.uorb(&["ls", "-l"]).fine().contains("   1    1    0          1 sensor_accel0\n")
    });
}

#[test]
fn ctrl_c_before_all_has_come_is_told_by_the_exit_code() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<SensorAccel>();
    let silent = waiting(&bus, &["sensor_accel"]).interrupt();
    assert_eq!((silent.code, &*silent.out, &*silent.words), (130, "", ""));

    publication.publish(&accel(1)).unwrap();
    let mut listener = bus.spawn_uorb(&["listener", "sensor_accel", "2"]);
    listener.expect_all(&accel_text("#1", 1));
    let counted = listener.interrupt();
    assert_eq!((counted.code, &*counted.out, &*counted.words), (130, "", ""));
}

#[test]
fn a_timeout_ends_it_with_a_code_of_its_own() {
    let bus = Bus::start();
    let ended = bus.uorb(&["listener", "sensor_accel", "1", "--timeout", "0.01"]);
    assert_eq!((ended.code, &*ended.out), (124, ""));
    assert!(ended.words.ends_with("uorb: no message of sensor_accel for 0.01 s\n"));
}

#[test]
fn a_reader_that_has_seen_enough_is_no_error() {
    let mut bus = Bus::start();
    let queue_length = QueueLength::new(128);
    let options = AdvertiseOptions { queue_length, ..Default::default() };
    let mut publication = Publication::<SensorGyro>::advertise_with(&bus.session(), options);
    let publication = publication.as_mut().unwrap();

    for publishes_on in [true, false] {
        publication.publish(&SensorGyro::default()).unwrap();
        let mut listener = bus.spawn_uorb(&["listener", "sensor_gyro", "100", "--json"]);
        listener.line().expect("a message");
        listener.stop_reading();
        if publishes_on {
            for _ in 0..100 {
                publication.publish(&SensorGyro::default()).unwrap();
            }
        }
        // Where nothing comes any more it is noticed all the same.
        let ended = listener.end();
        assert_eq!((ended.code, &*ended.words), (0, ""));
    }
}

#[test]
fn under_the_name_of_px4_s_listener_it_is_the_listener() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<SensorAccel>();
    publication.publish(&accel(1)).unwrap();
    for name in ["listener", "px4-listener"] {
        let link = bus.system.base().join(name);
        symlink(program("uorb"), &link).unwrap();
        let mut command = bus.command(&link);
        command.args(["sensor_accel", "1"]).stderr(Stdio::piped());
        assert_eq!(Actor::spawn(command).end().fine(), accel_text("#1", 1));

        let mut help = bus.command(&link);
        help.arg("--help");
        let help = Actor::spawn(help).end().fine();
        assert!(help.contains("Usage: ") && help.contains("[COUNT]"), "{help}");
    }
}

#[test]
fn a_topic_that_nobody_knows_is_an_error_that_names_the_nearest() {
    let bus = Bus::start();
    let unknown = |topic: &str| bus.uorb(&["listener", topic, "1"]);
    unknown("sensor_acel").failed(&["no topic \"sensor_acel\"", "did you mean sensor_accel?"]);
    unknown("nothing_like_it").failed(&["no topic \"nothing_like_it\"", "`uorb ls`", "--wait"]);

    // What is on the bus is known, whether it was compiled in or not.
    let mut publisher = bus.spawn(&["publish", "1", "1"]);
    publisher.expect("advertised");
    unknown("stampd").failed(&["did you mean stamped?"]);
    assert_eq!(bus.uorb(&["ls"]).fine(), "stamped0\n", "asking makes no node");
}

#[test]
fn a_topic_that_was_defined_in_a_program_s_code_is_shown_field_by_field() {
    let bus = Bus::start();
    let mut publisher = bus.spawn(&["claim", "75"]);
    publisher.expect("ready");
    publisher.say("go");
    publisher.expect("instance 0");
    publisher.say("41");
    publisher.expect("published");

    let shown = bus.uorb(&["listener", "stamped", "1"]).fine();

    let Stamped { count, sender, check } = Stamped::new(41, publisher.pid().into());
    let check: Vec<String> = check.iter().map(u64::to_string).collect();
    let check = check.join(", ");
    assert_eq!(
        shown,
        format!("\nTOPIC: stamped #1\ncount: {count}\nsender: {sender}\ncheck: [{check}]\n")
    );
}

#[test]
fn a_listener_outlives_a_killed_publisher_and_hears_its_successor() {
    let bus = Bus::start();
    let fields = ["--json", "--field", "count", "--meta"];
    let listen = [&["stamped", "3", "--wait"], &fields[..]].concat();
    let mut listener = waiting(&bus, &listen);
    let mut says = |count: &str| {
        let mut publisher = bus.spawn(&["claim", "75"]);
        publisher.expect("ready");
        publisher.say("go");
        publisher.expect("instance 0");
        publisher.say(count);
        let line = listener.line().expect("a message");
        let object: serde_json::Value = serde_json::from_str(&line).expect("JSON");
        assert_eq!(object["count"].to_string(), count);
        let peer = object["_meta"]["peer"].as_u64().unwrap();
        publisher.kill();
        // Until the broker has seen it die, its instance is not to be had.
        eventually("it is unadvertised", || {
            bus.uorb(&["ls", "-l"]).fine().contains("   1    0    1 ")
        });
        peer
    };

    let peers = [says("1"), says("2")];

    assert_ne!(peers[0], peers[1], "the sender is named with every message");
    let last = bus.uorb(&["listener", "stamped", "1", "--json", "--field", "count"]);
    assert_eq!(last.fine(), "{\"count\":2}\n", "the last value stays readable");
    assert_eq!(listener.interrupt().code, 130);
}

#[test]
fn a_listener_follows_on_while_the_broker_is_killed_and_started_again() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<SensorAccel>();
    let mut listener = waiting(&bus, &["sensor_accel", "-f", "--csv", "--field", "timestamp,y"]);
    let mut number = 0;
    let mut hears = |listener: &mut Actor| {
        number += 1;
        publication.publish(&accel(number)).unwrap();
        if number == 1 {
            listener.expect("timestamp,y");
        }
        let SensorAccel { timestamp, y, .. } = accel(number);
        listener.expect(&format!("{timestamp},{y:?}"));
    };
    hears(&mut listener);
    bus.kill_broker();
    hears(&mut listener);
    hears(&mut listener);
    bus.start_broker();
    hears(&mut listener);
    eventually("it has re-joined", || bus.processes().contains(&listener.pid()));
    hears(&mut listener);

    bus.stop();

    let ended = listener.end();
    assert_eq!((ended.code, &*ended.out), (1, ""));
    assert!(ended.words.contains("has ended (`uorb stop`)"), "{}", ended.words);
}

#[test]
fn what_was_lost_on_the_way_is_said() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<SensorAccel>();
    let mut listener = waiting(&bus, &["sensor_accel", "2", "--json", "--field", "y"]);
    publication.publish(&accel(8)).unwrap();
    listener.expect("{\"y\":1.0}");
    listener.stop();
    for number in 9..=16 {
        publication.publish(&accel(number)).unwrap();
    }
    listener.signal(Signal::SIGCONT);
    listener.expect("{\"y\":2.0}");
    let ended = listener.end();
    assert_eq!(ended.code, 0);
    assert_eq!(ended.words, "uorb: 7 messages were overwritten before they could be copied\n");
}
