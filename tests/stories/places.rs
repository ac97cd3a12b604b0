use std::fs;
use std::os::unix::net::UnixListener;

use uorb_core::{Error, Instance, Session, System};
use uorb_tests::{Bus, Plain};

#[test]
fn systems_side_by_side_never_see_each_other() {
    let mut one = Bus::start();
    let mut other = Bus::start();
    let mut publication = one.advertise::<Plain>();
    publication.publish(&Plain { value: 1 }).unwrap();
    assert!(!other.subscribe::<Plain>().updated());
    assert!(!other.is_advertised("plain"));
    assert!(one.is_advertised("plain"));
}

#[test]
fn two_systems_of_one_directory_never_see_each_other() {
    let mut bus = Bus::start();
    let second = System::new(bus.system.base(), 1);
    let mut broker = std::process::Command::new(uorb_tests::program("uorbd"))
        .args(["--system", "1", "--ready-fd", "1", "--dir"])
        .arg(bus.system.base())
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    std::io::BufRead::read_line(
        &mut std::io::BufReader::new(broker.stdout.as_mut().unwrap()),
        &mut line,
    )
    .unwrap();
    let session = Session::connect_to(&second).unwrap();
    let _publication = bus.advertise::<Plain>();
    assert!(bus.is_advertised("plain"));
    assert!(!session.exists("plain", Instance::FIRST).unwrap());
    drop(session);
    broker.kill().unwrap();
    broker.wait().unwrap();
}

#[test]
fn a_directory_with_other_things_in_it_is_not_touched() {
    let bus = Bus::without_broker();
    fs::create_dir(bus.system.dir()).unwrap();
    let precious = bus.system.dir().join("thesis.txt");
    fs::write(&precious, "years of work").unwrap();

    let (mut broker, line) = bus.try_start_broker();

    assert!(!broker.wait().unwrap().success());
    assert!(line.contains("thesis.txt") && line.contains("--dir"), "{line}");
    assert!(precious.exists());
}

#[test]
fn another_user_s_directory_is_refused() {
    if !nix::unistd::geteuid().is_root() {
        eprintln!("skipped: only root can make a directory of another user");
        return;
    }
    let bus = Bus::without_broker();
    fs::create_dir(bus.system.dir()).unwrap();
    std::os::unix::fs::chown(bus.system.dir(), Some(65_534), None).unwrap();

    let (mut broker, line) = bus.try_start_broker();

    assert!(!broker.wait().unwrap().success());
    assert!(line.contains("belongs to user 65534") && line.contains("UORB_DIR"), "{line}");
}

#[test]
fn a_stale_socket_is_no_broker_and_no_hindrance() {
    let mut bus = Bus::without_broker();
    fs::create_dir(bus.system.dir()).unwrap();
    drop(UnixListener::bind(bus.system.socket()).unwrap());
    let error = Session::connect_to(&bus.system).unwrap_err();
    assert!(error.to_string().contains("broker.sock"), "{error}");

    bus.start_broker();

    assert!(Session::connect_to(&bus.system).is_ok());
}

#[test]
fn what_an_earlier_boot_left_is_removed() {
    let mut bus = Bus::start();
    bus.advertise::<Plain>().publish(&Plain { value: 1 }).unwrap();
    // Nobody lives any more but the test, which lets go.
    let mut bus = bus.without_session();
    bus.kill_broker();

    bus.start_broker();

    assert_eq!(bus.system.list_nodes().unwrap(), []);
    assert!(fs::read_dir(bus.system.peers()).unwrap().next().is_none());
}

#[test]
fn a_node_file_of_another_version_is_named_as_such() {
    use std::os::unix::fs::FileExt;
    let mut bus = Bus::start();
    let _publication = bus.advertise::<Plain>();
    let path = bus.system.node("plain", Instance::FIRST);
    let file = fs::File::options().write(true).open(&path).unwrap();
    file.write_all_at(&99_u32.to_ne_bytes(), 8).unwrap();

    let error = bus.session().exists("plain", Instance::FIRST).unwrap_err();

    assert!(matches!(error, Error::NodeVersion { found: 99, .. }));
    let text = error.to_string();
    assert!(text.contains("plain0") && text.contains("uorb stop"), "{text}");
}

#[test]
fn a_node_file_that_is_garbage_or_cut_off_is_named_as_such() {
    let mut bus = Bus::start();
    let _publication = bus.advertise::<Plain>();
    let path = bus.system.node("plain", Instance::FIRST);
    let whole = fs::read(&path).unwrap();
    let other = bus.system.node("other", Instance::FIRST);
    for bytes in [&b"garbage"[..], &[0; 10_000], &whole[..100], &whole[..5_000], &whole] {
        fs::write(&other, bytes).unwrap();
        let error = bus.session().exists("other", Instance::FIRST).unwrap_err();
        assert!(matches!(error, Error::CorruptNode { .. }), "{error}");
        assert!(error.to_string().contains("other0"), "{error}");
    }
}

#[test]
fn when_shared_memory_is_full_the_error_has_the_sum_and_nothing_dies() {
    let bus = Bus::without_broker();
    let mut actor = bus.spawn(&["fill-small-memory"]);
    let line = actor.line().expect("it says what happened");
    if line.starts_with("skipped") {
        eprintln!("{line}");
        return;
    }
    assert!(line.contains("large") && line.contains("bytes; free some"), "{line}");
    let lines = actor.finish();
    let [line, full @ ..] = &lines[..] else { panic!("it publishes on") };
    let topics: u32 = line.split(' ').next().unwrap().parse().unwrap();
    // Each takes twenty slots of 64 KiB.
    assert!((45..=51).contains(&topics), "64 MiB hold {line}");
    assert!(line.ends_with(" 0 unfinished"), "{line}");
    // Not a byte is left: who joins now looks and copies, and is told what does
    // not fit.
    assert_eq!(full.len(), 6, "{full:?}");
    for (line, [command, code, words]) in full.iter().zip([
        ["status", "0", "large0"],
        ["listener large0 1", "0", "TOPIC: large0"],
        ["pub large0", "0", "published 1 message"],
        ["pub orb_test val=1", "1", "obj/orb_test0: it needs "],
        ["start", "1", "0/broker.lock: it needs 100 bytes; free some, or mount a larger /dev/shm"],
        ["left", "brim.", ""],
    ]) {
        assert!(line.starts_with(&format!("{command}: {code}")) && line.contains(words), "{line}");
    }
}
