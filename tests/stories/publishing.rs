//! `uorb pub`, and what `uorb info` and `uorb ls` then show of it.

use nix::sys::signal::Signal;
use serde_json::Value;
use uorb_msg::{BatteryStatus, SensorAccel, VehicleAttitude};
use uorb_tests::{Actor, Bus, Foreigner, Image, Stamped, eventually, program};

fn published(ended: uorb_tests::Ended, words: &str) {
    assert_eq!((ended.code, &*ended.out, &*ended.words), (0, "", words));
}

/// The newest message of instance 0.
fn newest(bus: &Bus, topic: &str) -> Value {
    let line = bus.uorb(&["listener", topic, "1", "--json"]).fine();
    serde_json::from_str(&line).expect("JSON")
}

fn info(bus: &Bus, topic: &str) -> Value {
    let line = bus.uorb(&["info", topic, "--json", "--window", "0"]).fine();
    serde_json::from_str(&line).expect("JSON")
}

#[test]
fn scalars_arrays_and_nested_fields_are_published_as_they_were_written() {
    let mut bus = Bus::start();
    published(
        bus.uorb(&["pub", "vehicle_attitude", "q=[1,0.5,-0.25]", "q[3]=1e-3", "roll=-0.1"]),
        "uorb: published 1 message on vehicle_attitude instance 0\n",
    );
    let attitude = bus.subscribe::<VehicleAttitude>().copy().expect("it outlives its publisher");
    assert_eq!((attitude.q, attitude.roll), ([1.0, 0.5, -0.25, 1e-3], -0.1));
    assert!(attitude.timestamp > 0, "it was stamped");

    let escs = ["timestamp=7", "esc_count=0x08", "esc[7].esc_rpm=-5", "esc[2].esc_voltage=12.6"];
    published(
        bus.uorb(&[&["pub", "esc_status"], &escs[..]].concat()),
        "uorb: published 1 message on esc_status instance 0\n",
    );
    let status = newest(&bus, "esc_status");
    assert_eq!((&status["timestamp"], &status["esc_count"]), (&7.into(), &8.into()));
    assert_eq!(status["esc"][7]["esc_rpm"], -5);
    assert_eq!(status["esc"][2]["esc_voltage"].as_f64().unwrap() as f32, 12.6);
    assert_eq!(status["esc"][3]["esc_rpm"], 0);

    bus.uorb(&["pub", "safety", "safety_off=True"]);
    let safety = bus.uorb(&["listener", "safety", "1", "--field", "safety_off"]).fine();
    assert_eq!(safety, "\nTOPIC: safety #1\nsafety_off: True\n");
}

#[test]
fn a_topic_that_was_defined_in_a_program_s_code_can_be_published_by_name() {
    let mut bus = Bus::start();
    let mut holder = bus.spawn(&["follow"]);
    holder.expect("subscribed");
    let sent = Stamped::new(5, 6);
    let check = format!("check=[{}]", sent.check.map(|word| word.to_string()).join(","));
    published(
        bus.uorb(&["pub", "stamped", "count=5", "sender=6", &check]),
        "uorb: published 1 message on stamped instance 0\n",
    );
    assert_eq!(bus.subscribe::<Stamped>().copy(), Some(sent));
}

#[test]
fn what_cannot_be_published_is_an_error_that_names_the_field() {
    let bus = Bus::start();
    let refused = |topic: &str, field: &str, words: &[&str]| {
        bus.uorb(&["pub", topic, field]).failed(words);
    };
    refused("sensor_accel", "w=1", &["sensor_accel", "no field \"w\""]);
    refused("sensor_accel", "x_rw=1", &["\"x_rw\"", "did you mean x_raw, "]);
    refused("sensor_accel", "x_raw=32768", &["x_raw is int16", "-32768 to 32767"]);
    refused("sensor_accel", "error_count=-1", &["error_count is uint64", "-1 is not in 0"]);
    refused("sensor_accel", "x=fast", &["x", "\"fast\""]);
    refused("sensor_accel", "x", &["\"x\" is not of the form field=value"]);
    refused("safety", "safety_off=2", &["safety_off is bool", "\"2\""]);
    refused("vehicle_attitude", "q=[1,2,3,4,5]", &["q is float32[4]", "5 elements are too many"]);
    refused("vehicle_attitude", "q[4]=1", &["q", "4"]);
    refused("vehicle_attitude", "q=1", &["q is float32[4]", "q[0]="]);
    refused("esc_status", "esc[1].esc_rmp=1", &["esc_report", "did you mean esc_rpm?"]);
    refused("esc_status", "esc[1]=1", &["esc[1]", "esc_report"]);
    let twice = ["pub", "vehicle_attitude", "q[0]=1", "roll=1", "q[0]=2"];
    bus.uorb(&twice).failed(&["q[0] is given twice"]);
    refused("sensor_acel", "x=1", &["no topic \"sensor_acel\"", "sensor_accel"]);
    assert_eq!(bus.uorb(&["ls"]).fine(), "", "nothing was advertised");
}

#[test]
fn the_newest_message_can_be_changed_field_by_field() {
    let mut bus = Bus::start();
    let from_last = ["pub", "battery_status", "voltage_v=10.5", "--from-last"];
    bus.uorb(&from_last).failed(&["nothing was published on battery_status", "--from-last"]);
    let mut publication = bus.advertise::<BatteryStatus>();
    let full = BatteryStatus { voltage_v: 12.6, current_a: 3.5, ..Default::default() };
    publication.publish(&full).unwrap();

    assert_eq!(bus.uorb(&from_last).code, 0);

    let changed = bus.subscribe::<BatteryStatus>().copy().unwrap();
    assert_eq!((changed.voltage_v, changed.current_a), (10.5, 3.5));
}

#[test]
fn an_instance_is_claimed_with_its_priority_and_kept_until_ctrl_c() {
    let mut bus = Bus::start();
    let _first = bus.advertise_multi::<SensorAccel>();
    let keep = ["pub", "sensor_accel", "x=1", "--multi", "--priority", "100", "--keep"];
    let mut second = bus.spawn_uorb(&keep);
    let word = second.word().expect("it says what it has done");
    assert_eq!(word, "uorb: published 1 message on sensor_accel instance 1");

    let info = info(&bus, "sensor_accel");

    assert_eq!(info["instances"][1]["publishers"][0]["priority"], 100);
    assert_eq!(second.interrupt().fine(), "");
    let mut listener = bus.subscribe_instance::<SensorAccel>(1);
    eventually("it is unadvertised", || !listener.advertised());
    assert_eq!(listener.copy().unwrap().x, 1.0);
}

#[test]
fn so_many_messages_are_published_at_a_rate_and_ctrl_c_comes_too_early() {
    let mut bus = Bus::start();
    published(
        bus.uorb(&["pub", "orb_test", "val=3", "-n", "20", "-r", "1000"]),
        "uorb: published 20 messages on orb_test instance 0\n",
    );
    assert_eq!(info(&bus, "orb_test")["instances"][0]["published"], 20);

    let mut slow = bus.spawn_uorb(&["pub", "orb_test", "-n", "1000", "-r", "0.01"]);
    eventually("the first is published", || {
        info(&bus, "orb_test")["instances"][0]["published"] == 21
    });
    assert!(bus.is_advertised("orb_test"));
    let ended = slow.interrupt();
    assert_eq!(
        (ended.code, &*ended.words),
        (130, "uorb: published 1 message on orb_test instance 0\n")
    );
}

/// The processes of a list, by name and process id.
fn processes(list: &Value) -> Vec<(String, u32)> {
    let list = list.as_array().expect("a list").iter();
    let mut processes: Vec<_> = list
        .map(|process| {
            let pid = process["pid"].as_u64().expect("a process id") as u32;
            (process["name"].as_str().expect("a name").to_string(), pid)
        })
        .collect();
    processes.sort();
    processes
}

fn actors(actors: &[&Actor]) -> Vec<(String, u32)> {
    let mut processes: Vec<_> =
        actors.iter().map(|actor| ("actor".to_string(), actor.pid())).collect();
    processes.sort();
    processes
}

#[test]
fn info_names_who_publishes_who_subscribes_and_who_sent_the_last_message() {
    let bus = Bus::start();
    let mut publishers = [bus.spawn(&["publish", "1", "4"]), bus.spawn(&["publish", "1", "4"])];
    let mut subscribers = [bus.spawn(&["follow"]), bus.spawn(&["follow-name", "stamped"])];
    publishers.iter_mut().for_each(|publisher| publisher.expect("advertised"));
    subscribers.iter_mut().for_each(|subscriber| subscriber.expect("subscribed"));
    let instance = || info(&bus, "stamped")["instances"][0].clone();
    assert!(instance()["last"].is_null(), "nothing was sent yet");

    for sender in [0, 1] {
        publishers[sender].say("go");
        publishers[sender].expect("published");
        let last = &instance()["last"];
        assert_eq!(
            (&last["name"], &last["pid"]),
            (&"actor".into(), &publishers[sender].pid().into())
        );
    }

    let instance = instance();
    assert_eq!(instance["advertised"], true);
    assert_eq!((&instance["queue_length"], &instance["published"]), (&4.into(), &2.into()));
    let [first, second] = &publishers;
    assert_eq!(processes(&instance["publishers"]), actors(&[first, second]));
    let [one, other] = &subscribers;
    assert_eq!(processes(&instance["subscribers"]), actors(&[one, other]));

    let shown = bus.uorb(&["info", "stamped", "--window", "0"]).fine();
    assert!(shown.starts_with("TOPIC: stamped\nmessage stamped, 256 bytes "), "{shown}");
    assert!(shown.contains("\n    16 uint64[30] check\n"), "{shown}");
    let line = format!("\n  publisher  actor (pid {}), priority 75\n", first.pid());
    assert!(shown.contains(&line), "{shown}");
    assert!(shown.contains(&format!("\n  subscriber actor (pid {})\n", other.pid())), "{shown}");
    assert!(shown.contains(&format!(" seconds ago by actor (pid {})\n", second.pid())), "{shown}");
}

#[test]
fn info_forgets_whoever_was_killed_but_not_what_it_sent() {
    let bus = Bus::start();
    let mut publisher = bus.spawn(&["publish", "1", "1"]);
    publisher.expect("advertised");
    publisher.say("go");
    publisher.expect("published");
    publisher.kill();
    eventually("it is seen to be gone", || {
        info(&bus, "stamped")["instances"][0]["advertised"] == false
    });
    let instance = &info(&bus, "stamped")["instances"][0];
    assert_eq!(instance["publishers"], serde_json::json!([]));
    assert_eq!(instance["published"], 1);
    assert!(instance["last"]["publish_time_us"].as_u64().is_some());
}

#[test]
fn a_topic_s_fields_are_shown_with_their_units_before_anybody_uses_it() {
    let bus = Bus::start();
    let shown = bus.uorb(&["info", "sensor_accel"]).fine();
    assert!(shown.starts_with("TOPIC: sensor_accel\n"), "{shown}");
    assert!(shown.contains(" float32 x               m/s^2\n"), "{shown}");
    assert!(shown.ends_with("no instance: nobody has advertised it or subscribed to it\n"));
    bus.uorb(&["info", "sensor_acel"]).failed(&["did you mean sensor_accel?"]);
}

#[test]
fn info_names_who_follows_a_stream_how_deep_and_what_they_lost() {
    let bus = Bus::start();
    let mut publisher = bus.spawn(&["publish", "100", "1"]);
    publisher.expect("advertised");
    // One after the other: they are named in this order.
    let streamers = [["follow", "16"], ["follow-and-press", "32"]].map(|arguments| {
        let mut streamer = bus.spawn_program(&program("streamer"), &arguments);
        streamer.expect("subscribed");
        streamer.stop();
        streamer
    });
    publisher.say("go");
    publisher.expect("published");
    let stream = || info(&bus, "stamped")["instances"][0]["stream"].clone();
    let follower = |depth: u64| {
        let all = stream()["followers"].as_array().unwrap().clone();
        all.into_iter().find(|follower| follower["depth"] == depth).expect("it follows")
    };

    assert_eq!(stream()["name"], "uorb/0/stamped/0");
    assert_eq!(stream()["depth_max"], 1_024);
    for (streamer, (depth, presses)) in streamers.iter().zip([(16, false), (32, true)]) {
        let follower = follower(depth);
        assert_eq!(
            (&follower["name"], &follower["pid"]),
            (&"streamer".into(), &streamer.pid().into())
        );
        assert_eq!(
            (&follower["back_pressure"], &follower["pending"]),
            (&presses.into(), &100.into())
        );
        assert_eq!(follower["lost"], 0, "it has not looked yet");
    }
    let [slow, pressing] = &streamers;
    let shown = bus.uorb(&["info", "stamped", "--window", "0"]).fine();
    let lines = format!(
        "
  stream     uorb/0/stamped/0, queues of up to 1024 messages
  follower   streamer (pid {}), queue of 16, pending 100, lost 0
  follower   streamer (pid {}), queue of 32, back-pressure, pending 100, lost 0
",
        slow.pid(),
        pressing.pid()
    );
    assert!(shown.contains(&lines), "{shown}");

    slow.signal(Signal::SIGCONT);
    eventually("it has looked", || follower(16)["pending"] == 0);
    assert_eq!(follower(16)["lost"], 84);
}

#[test]
fn info_tells_of_foreign_programs_and_what_was_dropped_of_theirs() {
    let bus = Bus::start();
    let mut publisher = bus.spawn(&["publish", "1", "1"]);
    publisher.expect("advertised");
    let foreign = || info(&bus, "stamped")["instances"][0]["stream"]["foreign"].clone();
    let of = |followers: u64, publishers: u64, dropped: u64| {
        serde_json::json!({
            "followers": followers, "publishers": publishers, "dropped": dropped
        })
    };
    assert_eq!(foreign(), of(0, 0, 0));

    let foreigner = Foreigner::open(&bus.system, "stamped");
    let followers = [foreigner.follow(), foreigner.follow()];
    let publish = foreigner.publish();

    eventually("they are seen", || foreign() == of(2, 1, 0));
    let all = ["listener", "stamped", "1", "--all-messages", "--json", "--field", "count"];
    let mut listener = bus.spawn_uorb(&all);
    assert!(listener.word().expect("it waits").contains("waiting"));
    for _ in 0..3 {
        publish();
    }
    publisher.say("go");
    publisher.expect("published");
    assert_eq!(listener.end().fine(), "{\"count\":0}\n", "only the one of ours");
    assert_eq!(foreign(), of(2, 1, 3));
    let shown = bus.uorb(&["info", "stamped", "--window", "0"]).fine();
    let lines = "\n  foreign    followers: 2\n  foreign    publishers: 1, messages dropped: 3\n";
    assert!(shown.ends_with(lines), "{shown}");

    drop((followers, publish));
    eventually("they are gone", || foreign() == of(0, 0, 3));
}

#[test]
fn info_says_where_the_messages_of_a_large_topic_live() {
    let mut bus = Bus::start();
    let _image = bus.advertise::<Image>();
    let _follower = bus.subscribe::<Image>();

    let large = info(&bus, "image");

    assert_eq!(
        (&large["is_large"], &large["instances"][0]["stream"]["depth_max"]),
        (&true.into(), &2.into())
    );
    assert_eq!(large["instances"][0]["stream"]["followers"][0]["depth"], 1, "as deep as the node");
    let shown = bus.uorb(&["info", "image", "--window", "0"]).fine();
    let line = "its messages live on the stream: they are larger than the 65535 bytes of a node";
    assert_eq!(shown.lines().nth(2), Some(line), "{shown}");
    assert_eq!(info(&bus, "sensor_accel")["is_large"], false);
}

#[test]
fn ls_lists_the_nodes_as_the_directory_does() {
    let mut bus = Bus::start();
    assert_eq!(bus.uorb(&["ls", "/obj"]).fine(), "");
    let _accels = [bus.advertise_multi::<SensorAccel>(), bus.advertise_multi::<SensorAccel>()];
    let _attitude = bus.subscribe::<VehicleAttitude>();
    let _third = bus.subscribe_instance::<SensorAccel>(2);

    let listed = bus.uorb(&["ls", "/obj"]).fine();

    assert_eq!(listed, "sensor_accel0\nsensor_accel1\nsensor_accel2\nvehicle_attitude0\n");
    let directory = std::fs::read_dir(bus.system.nodes()).unwrap();
    let mut names: Vec<_> =
        directory.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    assert_eq!(listed.lines().collect::<Vec<_>>(), names);
    bus.uorb(&["ls", "/dev"]).failed(&["/dev", "/obj"]);
}
