//! `reach` between machines: network namespaces, and links that are late, lossy,
//! slow, and cut. Where a test may not make them these are skipped, and say so.
//!
//! `UORB_REACH_KILLS=50` kills more often than CI has time for; `UORB_SEED` repeats one
//! that was printed.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use serde_json::Value;
use uorb_core::{Publication, StreamSubscription, Topic, now_us, poll};
use uorb_msg::{SensorGyro, VehicleAttitude};
use uorb_tests::{Actor, Host, Link, PATIENCE, Plain, Stamped, Weather, eventually};

use crate::flight_logs::{FlightLog, logs};
use crate::reach::{links, look, says};

/// 50 ms each way, 5 % loss, 1 Mbit/s.
const POOR: Weather = Weather {
    delay: Duration::from_millis(50),
    lost_of_1000: 50,
    bits_per_second: 1_000_000,
    is_cut: false,
};

/// Where the first machine of a link listens.
const FIRST: &str = "tcp/10.9.1.1:7447";

/// A reach of this name on a machine.
fn reach(host: &Host, name: &str, arguments: &[&str]) -> Actor {
    let mut arguments = arguments.to_vec();
    arguments.extend(["--name", name]);
    let mut reach = host.spawn("reach", &arguments);
    reach.expect(&format!("[reach] this is {name}/0"));
    reach
}

/// Two machines with a link, and a topic of the first wanted on the second.
fn two(weather: Weather) -> Option<([Host; 2], Link)> {
    let (a, b) = (Host::start(0)?, Host::start(0)?);
    let link = Link::between([&a, &b], 1, 0x5eed, weather);
    Some(([a, b], link))
}

fn next<T: Topic>(subscription: &mut StreamSubscription<T>) -> T::Message {
    assert_eq!(poll(&mut [subscription], Some(PATIENCE)).unwrap(), 1, "nothing comes");
    *subscription.update().expect("it was updated")
}

fn lost(host: &Host, topic: &str) -> u64 {
    links(&host.bus, "import", topic).first().map_or(0, |link| link["lost"].as_u64().unwrap())
}

/// The memory that a process has had at most.
fn peak_kib(process: &Actor) -> u64 {
    let status = fs::read_to_string(format!("/proc/{}/status", process.pid())).expect("it runs");
    let line = status.lines().find(|line| line.starts_with("VmHWM")).expect("it has some");
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

fn percentile(sorted: &[u64], of_100: usize) -> u64 {
    sorted[(sorted.len() * of_100 / 100).min(sorted.len() - 1)]
}

#[test]
fn over_a_poor_link_reliable_topics_lose_nothing_and_the_others_stay_fresh() {
    const SECONDS: u64 = 8;
    let Some(([mut a, mut b], link)) = two(Weather::FINE) else { return };
    let export = ["--listen", FIRST, "--export", "*", "--export", "stamped,reliable"];
    let sending = reach(&a, "a", &export);
    let receiving = reach(&b, "b", &["--connect", FIRST, "--import", "a/*"]);
    let mut reliable = a.bus.advertise::<Stamped>();
    let mut fresh = a.bus.advertise::<Plain>();
    for topic in ["stamped", "plain"] {
        eventually("it is advertised there", || b.bus.is_advertised(topic));
    }
    let (mut all, mut newest) = (b.bus.stream::<Stamped>(), b.bus.stream::<Plain>());
    reliable.publish(&Stamped::new(0, 0)).unwrap();
    fresh.publish(&Plain { value: now_us() as u32 }).unwrap();
    assert_eq!(next(&mut all).count, 0);
    next(&mut newest);
    let before_kib = [peak_kib(&sending), peak_kib(&receiving)];

    // What fits, 50 times a second; and 6,000 times a second what does not.
    let mut run = |weather: Weather, from: u64, count: u64| {
        link.set(weather);
        let (mut took_ns, mut ages_us, mut received) = (Vec::new(), Vec::new(), Vec::new());
        let begun = Instant::now();
        for tick in 0..count * 60 {
            let due = begun + Duration::from_micros(tick * 1_000_000 / 3_000);
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            let publishing = Instant::now();
            fresh.publish(&Plain { value: now_us() as u32 }).unwrap();
            took_ns.push(publishing.elapsed().as_nanos() as u64);
            fresh.publish(&Plain { value: now_us() as u32 }).unwrap();
            if tick % 60 == 0 {
                reliable.publish(&Stamped::new(from + tick / 60, 0)).unwrap();
            }
            while let Some(message) = newest.update() {
                ages_us.push(u64::from((now_us() as u32).wrapping_sub(message.value)));
            }
            while let Some(message) = all.update() {
                received.push(message.count);
            }
        }
        while received.last() != Some(&(from + count - 1)) {
            received.push(next(&mut all).count);
        }
        assert_eq!(received, (from..from + count).collect::<Vec<_>>());
        took_ns.sort_unstable();
        ages_us.sort_unstable();
        (percentile(&took_ns, 50), ages_us)
    };
    let (fine_ns, _) = run(Weather::FINE, 1, 50);
    let (poor_ns, ages_us) = run(POOR, 51, SECONDS * 50);

    assert_eq!(lost(&b, "stamped"), 0);
    let dropped = lost(&b, "plain");
    let peak_kib = [peak_kib(&sending), peak_kib(&receiving)];
    let [p50, p99] = [50, 99].map(|of_100| percentile(&ages_us, of_100) / 1_000);
    println!(
        "best effort: {} arrived, {dropped} dropped, age p50 {p50} ms, p99 {p99} ms; publish \
         median {fine_ns} ns on a good link, {poor_ns} ns on a poor one; memory {before_kib:?} \
         KiB before, {peak_kib:?} KiB after",
        ages_us.len()
    );
    assert!(dropped > 0, "more was published than the link carries");
    // A minute of what is published would be 6 MB; of what waits there is a bound.
    for (peak, before) in peak_kib.into_iter().zip(before_kib) {
        assert!(peak < before + 32 * 1024, "{peak} KiB, {before} KiB before");
    }
}

/// Everything of the first host goes to the second, and waits for room on the way.
fn reliably(a: &Host, b: &Host) -> [Actor; 2] {
    let sending = reach(a, "a", &["--listen", FIRST, "--export", "*,reliable"]);
    [sending, reach(b, "b", &["--connect", FIRST, "--import", "a/*"])]
}

/// A publisher here and a follower there, who has its first message.
fn first_message(
    a: &mut Host,
    b: &mut Host,
) -> (Publication<Stamped>, StreamSubscription<Stamped>) {
    let mut stamped = a.bus.advertise::<Stamped>();
    stamped.publish(&Stamped::new(1, 0)).unwrap();
    eventually("it is advertised there", || b.bus.is_advertised("stamped"));
    let mut there = b.bus.stream::<Stamped>();
    assert_eq!(next(&mut there).count, 1);
    (stamped, there)
}

#[test]
fn what_a_publisher_has_sent_arrives_over_a_slow_link_though_it_ends() {
    const MESSAGES: u64 = 500;
    let Some(([mut a, mut b], link)) = two(Weather::FINE) else { return };
    let _reaches = reliably(&a, &b);
    let (mut stamped, mut there) = first_message(&mut a, &mut b);

    // They take some seconds.
    link.set(Weather { bits_per_second: 400_000, ..Weather::FINE });
    for count in 2..=MESSAGES {
        stamped.publish(&Stamped::new(count, 0)).unwrap();
    }
    drop(stamped);

    for count in 2..=MESSAGES {
        assert_eq!(next(&mut there).count, count);
    }
    eventually("it has no publisher there either", || !b.bus.is_advertised("stamped"));
    assert_eq!(lost(&b, "stamped"), 0);
}

#[test]
fn a_link_that_is_cut_for_10_s_comes_back_by_itself_and_what_is_missing_is_counted() {
    let Some(([mut a, mut b], link)) = two(Weather::FINE) else { return };
    let _reaches = reliably(&a, &b);
    let (mut stamped, mut there) = first_message(&mut a, &mut b);

    link.set(Weather::CUT);
    let cut = Instant::now();
    let mut count = 1;
    let mut publish = |count: &mut u64| {
        *count += 1;
        stamped.publish(&Stamped::new(*count, 0)).unwrap();
        std::thread::sleep(Duration::from_millis(10));
    };
    while cut.elapsed() < Duration::from_secs(10) {
        publish(&mut count);
    }
    assert!(!b.bus.is_advertised("stamped"), "it has no publisher there");
    let before_mending = count;
    link.set(Weather::FINE);

    let mended = Instant::now();
    let (mut received, mut last) = (1, 1);
    let mut first = None;
    while first.is_none() || count < before_mending + 100 {
        publish(&mut count);
        while let Some(message) = there.update() {
            first.get_or_insert((message.count, mended.elapsed()));
            (received, last) = (received + 1, message.count);
        }
        assert!(mended.elapsed() < PATIENCE, "it does not come back");
    }
    while last < count {
        last = next(&mut there).count;
        received += 1;
    }
    let (first, after) = first.expect("it came back");
    println!("back {} ms after the link, with message {first} of {count}", after.as_millis());
    assert!(b.bus.is_advertised("stamped"));
    // The newest comes first: of 1,000 missing ones none is sent again.
    assert!(first >= before_mending, "{first}, and {before_mending} when it was mended");
    eventually("all is counted", || lost(&b, "stamped") + received >= count);
    assert_eq!(lost(&b, "stamped"), first - 2);
}

#[test]
fn whoever_is_killed_all_comes_back_and_every_message_arrives_or_is_counted() {
    let rounds = std::env::var("UORB_REACH_KILLS").map_or(6, |text| text.parse().unwrap());
    let seed = std::env::var("UORB_SEED").map_or_else(|_| now_us(), |text| text.parse().unwrap());
    println!("UORB_SEED={seed} UORB_REACH_KILLS={rounds}");
    let Some(([mut a, mut b], _link)) = two(Weather::FINE) else { return };
    let export = ["--listen", FIRST, "--export", "*,reliable"];
    let import = ["--connect", FIRST, "--import", "a/*"];
    let mut sending = reach(&a, "a", &export);
    let mut receiving = reach(&b, "b", &import);
    let topic = "sensor_gyro";
    let publish = ["--only", "gyro"];
    // The first one is alone, so that all that follow are counted.
    let mut first = a.bus.advertise_multi::<SensorGyro>();
    first.publish(&SensorGyro::default()).unwrap();
    eventually("it is advertised there", || b.bus.is_advertised(topic));
    let mut there = b.bus.stream::<SensorGyro>();
    next(&mut there);
    drop(first);
    let mut publishing = a.bus.spawn_heard("sensor_sim", &publish);
    let published = |host: &Host| look(&host.bus, topic, 0).map_or(0, |node| node.published);
    let mut received = 1;
    says(&b.bus, "import", topic, "state", "crossing");

    let mut random = seed | 1;
    for round in 0..rounds {
        random =
            random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        std::thread::sleep(Duration::from_millis((random >> 40) % 200));
        // Each in turn, beginning with any.
        match (seed + round) % 5 {
            0 => {
                sending.kill();
                sending = reach(&a, "a", &export);
            }
            1 => {
                receiving.kill();
                receiving = reach(&b, "b", &import);
            }
            2 => {
                publishing.kill();
                publishing = a.bus.spawn_heard("sensor_sim", &publish);
            }
            3 => {
                a.bus.kill_broker();
                a.bus.start_broker();
            }
            _ => {
                b.bus.kill_broker();
                b.bus.start_broker();
            }
        }
        let now = published(&b);
        eventually("it goes on", || published(&b) >= now + 20 && b.bus.is_advertised(topic));
        while there.update().is_some() {
            received += 1;
        }
    }
    publishing.interrupt();
    // It may be the reach of the last round that is to be asked.
    let total = published(&a);
    eventually("each has arrived or is counted", || published(&b) + lost(&b, topic) == total);
    while there.update().is_some() {
        received += 1;
    }
    println!("{total} published, {received} received, {} lost and counted", lost(&b, topic));
    assert_eq!(received, published(&b), "what came in is on the bus, once");
    assert!(look(&b.bus, topic, 1).is_none(), "it got its instance back each time");
}

#[test]
fn a_real_flight_that_is_replayed_on_one_machine_is_recorded_whole_on_the_other() {
    let Some(log) = logs().iter().min_by_key(|log| log.order.len()) else { return };
    let Some(([a, b], _link)) = two(Weather::FINE) else { return };
    let _sending = reach(&a, "a", &["--listen", FIRST, "--export", "*,reliable"]);
    let _receiving = reach(&b, "b", &["--connect", FIRST, "--import", "a/*"]);
    let files = [&a, &b].map(|host| host.bus.system.dir().join("flight.ulg"));
    let mut records = Vec::new();
    for (host, file) in [&a, &b].into_iter().zip(&files) {
        let file = file.to_str().unwrap();
        records.push(host.bus.spawn_uorb(&["record", "-o", file, "--quiet"]));
    }
    eventually("both record", || files.iter().all(|file| file.exists()));

    let replayed = a.bus.uorb(&["replay", log.path.to_str().unwrap(), "--back-pressure", "--json"]);
    assert_eq!(replayed.code, 0, "{}", replayed.words);
    let replayed: Value = serde_json::from_str(&replayed.out).unwrap();

    let crossed = || {
        let links = all_links(&b, "import");
        links.iter().map(|link| link["messages"].as_u64().unwrap()).sum::<u64>()
    };
    let messages = replayed["messages"].as_u64().unwrap();
    eventually("all has crossed", || crossed() >= messages);
    for record in &mut records {
        record.interrupt();
    }
    let [here, there] = [&a, &b].map(|host| contents(host.bus.system.dir().as_path()));
    assert_eq!(here.keys().collect::<Vec<_>>(), there.keys().collect::<Vec<_>>());
    for (series, ours) in &here {
        let theirs = &there[series];
        assert_eq!(ours, theirs, "{series:?}: messages and their bytes");
    }
    let total: usize = here.values().map(|(messages, _)| messages).sum();
    println!("{total} messages of {} topic instances, equal on both", here.len());
    assert_eq!(total as u64, messages);
    assert!(all_links(&b, "import").iter().all(|link| link["lost"] == 0));
}

fn all_links(host: &Host, kind: &str) -> Vec<Value> {
    let mut status = host.spawn("reach", &["status", "--json"]);
    let status: Value = serde_json::from_str(&status.end().fine()).unwrap();
    let links = status["links"].as_array().unwrap().clone();
    links.into_iter().filter(|link| link["kind"] == kind).collect()
}

/// How many messages the logs in a directory have of each series, and their bytes, one
/// after the other. What reach says of itself, before the flight begins, is a log of its own.
fn contents(dir: &Path) -> BTreeMap<(String, u8), (usize, Vec<u8>)> {
    let files = fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path());
    let logs = files.filter(|path| path.extension().is_some_and(|extension| extension == "ulg"));
    let mut contents: BTreeMap<(String, u8), (usize, Vec<u8>)> = BTreeMap::new();
    for log in logs.map(|path| FlightLog::read(&path)) {
        for series in log.series.iter().filter(|series| series.topic != "reach_status") {
            let key = (series.topic.clone(), series.instance);
            let replaced = contents.insert(key, (series.count(), series.bytes()));
            assert!(replaced.is_none(), "{} is in two logs", series.topic);
        }
    }
    contents.retain(|_, (messages, _)| *messages > 0);
    contents
}

#[test]
fn another_machine_s_clock_is_known_and_its_timestamps_are_translated() {
    const AHEAD_S: u64 = 5_000;
    let (Some(a), Some(mut b)) = (Host::start(AHEAD_S), Host::start(0)) else { return };
    let _link = Link::between([&a, &b], 1, 1, Weather { delay: POOR.delay, ..Weather::FINE });
    let _sending = reach(&a, "a", &["--listen", FIRST, "--export", "*"]);
    let translate = ["--connect", FIRST, "--import", "a/*", "--translate-time"];
    let _receiving = reach(&b, "b", &translate);
    let attitude = a.spawn(
        "uorb",
        &["pub", "vehicle_attitude", "--rate", "50", "--number", "100000", "roll=0.5"],
    );
    eventually("it is advertised there", || b.bus.is_advertised("vehicle_attitude"));
    let mut there = b.bus.stream::<VehicleAttitude>();
    let mut ages_us = Vec::new();
    for _ in 0..100 {
        let message = next(&mut there);
        ages_us.push(now_us().wrapping_sub(message.timestamp) as i64);
    }
    drop(attitude);

    let machine = &all_links(&b, "machine")[0];
    let offset_us = machine["offset_us"].as_i64().unwrap();
    let uncertainty_us = machine["uncertainty_us"].as_i64().unwrap();
    let wrong_us = (offset_us - AHEAD_S as i64 * 1_000_000).abs();
    ages_us.sort_unstable();
    let age_us = ages_us[ages_us.len() / 2];
    println!(
        "offset wrong by {wrong_us} us, said to be within {uncertainty_us} us; age {age_us} us"
    );
    assert!(wrong_us <= uncertainty_us, "{machine}");
    // Half a round trip of 100 ms, and 50 ms on its way, as far as its timestamp can be
    // known.
    assert!(uncertainty_us >= 50_000, "{machine}");
    assert!(age_us >= 50_000 - uncertainty_us, "{age_us} us old");
}

#[test]
fn with_certificates_of_both_sides_a_topic_crosses_and_without_one_nothing_does() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("it is in a folder");
    let (Some(mut a), Some(mut b), Some(mut c)) = (Host::start(0), Host::start(0), Host::start(0))
    else {
        return;
    };
    let _links = [
        Link::between([&a, &b], 1, 1, Weather::FINE),
        Link::between([&a, &c], 2, 2, Weather::FINE),
    ];
    let dir = a.bus.system.dir();
    let made = Command::new(root.join("scripts/reach-certificates"))
        .args([dir.as_os_str(), "gcs=10.9.1.1,10.9.2.1".as_ref(), "drone7".as_ref()])
        .output()
        .expect("the script runs");
    if !made.status.success() {
        println!("skipped: {}", String::from_utf8_lossy(&made.stderr));
        return;
    }
    let config = |name: &str| -> String {
        let path: PathBuf = dir.join(format!("{name}.json5"));
        path.to_str().unwrap().to_string()
    };
    let _gcs = reach(
        &a,
        "gcs",
        &["--listen", "tls/0.0.0.0:7447", "--config", &config("gcs"), "--export", "*"],
    );
    let mut plain = a.bus.advertise::<Plain>();
    plain.publish(&Plain { value: 9 }).unwrap();
    // One that trusts the ground station and has nothing to show for itself.
    let naked = dir.join("naked.json5");
    let trusted = dir.join("ca.pem");
    let trusts = format!(
        "{{ transport: {{ link: {{ tls: {{ root_ca_certificate: {:?} }} }} }} }}",
        trusted.to_str().unwrap()
    );
    fs::write(&naked, trusts).unwrap();
    let import = ["--import", "gcs/*"];
    let mut stranger = c.spawn(
        "reach",
        &[
            "--connect",
            "tls/10.9.2.1:7447",
            "--config",
            naked.to_str().unwrap(),
            import[0],
            import[1],
        ],
    );
    let _drone = reach(
        &b,
        "drone7",
        &[&["--connect", "tls/10.9.1.1:7447", "--config", &config("drone7")], &import[..]].concat(),
    );

    eventually("it is advertised where there is a certificate", || b.bus.is_advertised("plain"));
    assert_eq!(next(&mut b.bus.stream::<Plain>()), Plain { value: 9 });

    let words = stranger.word().expect("it says that it waits");
    assert!(words.contains("nobody lets ") && words.contains("it goes on trying"), "{words}");
    assert!(!c.bus.is_advertised("plain"));
    stranger.signal(Signal::SIGTERM);
    assert_eq!(stranger.end().code, 0);
}
