//! What the network says is not believed: messages that are none, topics that are
//! none, and descriptions of nothing.

use std::net::TcpListener;

use serde_json::Value;
use uorb_core::broker_side::{Node, Role};
use uorb_core::{Instance, poll};
use uorb_tests::{Actor, Bus, PATIENCE, Plain, eventually, program};
use zenoh::{Config, Session, Wait};

fn reach(bus: &Bus, name: &str, arguments: &[&str]) -> Actor {
    let mut arguments = arguments.to_vec();
    arguments.extend(["--name", name]);
    let mut reach = bus.spawn_heard("reach", &arguments);
    reach.expect(&format!("[reach] this is {name}/0"));
    reach
}

/// Somebody who may connect, and says what they like.
fn stranger(at: &str) -> Session {
    let mut config = Config::default();
    config.insert_json5("mode", "\"client\"").unwrap();
    config.insert_json5("scouting/multicast/enabled", "false").unwrap();
    config.insert_json5("connect/endpoints", &format!("[{at:?}]")).unwrap();
    zenoh::open(config).wait().unwrap()
}

/// What `reach status` says of an import.
fn import(bus: &Bus, machine: &str) -> Option<Value> {
    let out = bus.spawn_program(&program("reach"), &["status", "--json"]).end().out;
    let status: Value = serde_json::from_str(&out).ok()?;
    let links = status["links"].as_array()?.clone();
    links.into_iter().find(|link| link["kind"] == "import" && link["machine"] == machine)
}

/// FNV-1a, as revisions are.
fn revision(description: &[u8]) -> u32 {
    let step = |hash: u32, byte: &u8| (hash ^ u32::from(*byte)).wrapping_mul(0x0100_0193);
    description.iter().fold(0x811c_9dc5, step)
}

#[test]
fn what_is_no_message_is_counted_and_touches_no_node() {
    let (mut a, mut b) = (Bus::start(), Bus::start());
    let free = TcpListener::bind("127.0.0.1:0").unwrap();
    let at = format!("tcp/{}", free.local_addr().unwrap());
    drop(free);
    let _a = reach(&a, "a", &["--listen", &at, "--export", "*,reliable"]);
    let mut importing = reach(&b, "b", &["--connect", &at, "--import", "*/*"]);
    let mut plain = a.advertise::<Plain>();
    plain.publish(&Plain { value: 1 }).unwrap();
    eventually("it is advertised there", || b.is_advertised("plain"));
    let mut there = b.stream::<Plain>();
    assert_eq!(poll(&mut [&mut there], Some(PATIENCE)).unwrap(), 1);
    assert_eq!(there.update(), Some(&Plain { value: 1 }));

    let stranger = stranger(&at);
    let key = "uorb/a/0/plain/0";
    let header = |version: u8, size_bytes: u32| {
        let mut bytes = vec![version, 75, 1, 0, 1, 2, 3, 4];
        bytes.extend_from_slice(&size_bytes.to_le_bytes());
        bytes.resize(32, 0);
        bytes
    };
    let forged = [
        Vec::new(),
        vec![0xff; 1_000],
        header(1, 4),
        [header(1, 4), vec![9; 4]].concat(),
        [header(1, 5), vec![9; 5]].concat(),
        [header(2, 4), vec![9; 4]].concat(),
    ];
    for bytes in &forged {
        stranger.put(key, bytes.clone()).wait().unwrap();
    }
    let description = b"nothing that anybody has described";
    let token = format!("uorb/evil/0/plain/3/@topic/{:08x}", revision(description));
    let names = [
        token.as_str(),
        "uorb/evil/0/plain/12/@topic/00000001",
        "uorb/evil/0/pl-ain/1/@topic/00000001",
        "uorb/evil/zero/plain/1/@topic/00000001",
    ];
    let answer = move |query: zenoh::query::Query| {
        query.reply(query.key_expr().clone(), description.as_slice()).wait().unwrap();
    };
    stranger
        .declare_queryable("uorb/evil/0/*/*/@about")
        .callback(answer)
        .background()
        .wait()
        .unwrap();
    let tokens = names.map(|name| stranger.liveliness().declare_token(name).wait().unwrap());

    assert_eq!(
        importing.word().as_deref(),
        Some("reach: evil/0/plain/3 is refused: its description is none")
    );
    eventually("each is counted", || {
        import(&b, "a").is_some_and(|link| link["refused"] == forged.len())
    });
    eventually("the topic is refused", || {
        import(&b, "evil").is_some_and(|link| link["state"] == "refused")
    });
    plain.publish(&Plain { value: 2 }).unwrap();
    assert_eq!(poll(&mut [&mut there], Some(PATIENCE)).unwrap(), 1);
    assert_eq!(there.update(), Some(&Plain { value: 2 }));
    let node = |number| {
        let number = Instance::new(number).unwrap();
        Node::open(&b.system, "plain", number, Role::Observer)
    };
    assert_eq!(node(0).unwrap().status().published, 2);
    assert!((1..10).all(|number| node(number).is_err()));
    drop(tokens);
}

#[test]
fn however_many_topics_somebody_announces_there_is_an_end_and_a_word_about_it() {
    let (mut a, b) = (Bus::start(), Bus::start());
    let free = TcpListener::bind("127.0.0.1:0").unwrap();
    let at = format!("tcp/{}", free.local_addr().unwrap());
    drop(free);
    let mut importing = reach(&b, "b", &["--listen", &at, "--import", "*/*"]);
    let stranger = stranger(&at);
    let tokens: Vec<_> = (0..4_100)
        .map(|number| format!("uorb/evil/0/topic{}/{}/@topic/1", number / 10, number % 10))
        .map(|token| stranger.liveliness().declare_token(token).wait().unwrap())
        .collect();

    let words = importing.word().expect("it says so");
    assert!(words.contains("evil/0/topic") && words.contains("is refused: 4096 topics"), "{words}");

    // They make room again when they are gone.
    drop(tokens);
    let _a = reach(&a, "a", &["--connect", &at, "--export", "*"]);
    let _plain = a.advertise::<Plain>();
    eventually("it is advertised there", || {
        let node = Node::open(&b.system, "plain", Instance::FIRST, Role::Observer);
        node.is_ok_and(|node| !node.status().publishers.is_empty())
    });
}
