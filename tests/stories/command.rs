//! `uorb start`, `stop` and `status`: the broker from the command line.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Stdio};

use nix::mount::{MsFlags, mount};
use nix::sched::{CloneFlags, unshare};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use uorb_core::{Error, Session, System, World};
use uorb_tests::{Actor, Bus, Plain, Stamped, eventually, instance, is_running, program};

fn end(pid: u32, signal: Signal) {
    kill(Pid::from_raw(pid as i32), signal).expect("it lives");
}

#[test]
fn start_returns_when_the_broker_is_ready() {
    let bus = Bus::without_broker();

    let started = bus.uorb(&["start"]);

    let session = Session::connect_to(&bus.system).expect("it takes whoever comes");
    assert_eq!((started.code, &*started.out), (0, ""), "{}", started.words);
    let pid = bus.running_broker().expect("it has the lock");
    let (system, words) = (&bus.system, started.words);
    assert_eq!(words, format!("uorb: broker started at {system}, pid {pid}\n"));
    drop(session);
}

#[test]
fn a_second_start_says_that_it_is_running_already_and_succeeds() {
    let bus = Bus::without_broker();
    let pid = bus.start_by_command();

    let second = bus.uorb(&["start"]);

    assert_eq!(second.code, 0);
    assert_eq!(second.words, format!("uorb: already running at {}\n", bus.system));
    assert_eq!(bus.running_broker(), Some(pid));
}

#[test]
fn a_broker_is_started_in_a_relative_directory_and_found_from_elsewhere() {
    let bus = Bus::without_broker();
    let mut start = bus.command(&program("uorb"));
    start.current_dir(bus.system.base()).env("UORB_DIR", "by/name").arg("start");
    start.stderr(Stdio::piped());
    fs::create_dir_all(bus.system.base().join("by/name")).unwrap();

    let started = Actor::spawn(start).end();

    assert_eq!(started.code, 0);
    let dir = bus.system.base().join("by/name");
    let dir = dir.to_str().unwrap();
    bus.uorb(&["--dir", dir, "ls"]).fine();
    let stopped = bus.uorb(&["--dir", dir, "stop"]);
    assert!(stopped.words.starts_with("uorb: stopped at "), "{}", stopped.words);
}

#[test]
fn a_system_of_another_number_is_another_system() {
    let bus = Bus::start();
    bus.uorb(&["pub", "orb_test", "val=5"]);

    assert_eq!(bus.uorb(&["--system", "1", "start"]).code, 0);

    assert_eq!(bus.uorb(&["--system", "1", "ls"]).fine(), "");
    assert_eq!(bus.uorb(&["ls"]).fine(), "orb_test0\n");
    assert_eq!(bus.uorb(&["stop", "--system", "1"]).code, 0);
    assert!(!bus.system.base().join("1").exists());
    assert_eq!(bus.uorb(&["ls"]).fine(), "orb_test0\n");
}

#[test]
fn start_leaves_a_directory_of_strangers_alone() {
    let bus = Bus::without_broker();
    fs::create_dir(bus.system.dir()).unwrap();
    let precious = bus.system.dir().join("thesis.txt");
    fs::write(&precious, "years of work").unwrap();

    bus.uorb(&["start"]).failed(&["thesis.txt"]);

    assert_eq!(fs::read_to_string(precious).unwrap(), "years of work");
    assert_eq!(fs::read_dir(bus.system.dir()).unwrap().count(), 1, "nothing was added");
}

#[test]
fn start_leaves_another_user_s_directory_alone() {
    if !nix::unistd::geteuid().is_root() {
        eprintln!("skipped: only root can make a directory of another user");
        return;
    }
    let bus = Bus::without_broker();
    fs::create_dir(bus.system.dir()).unwrap();
    std::os::unix::fs::chown(bus.system.dir(), Some(65_534), None).unwrap();
    bus.uorb(&["start"]).failed(&["belongs to user 65534", "UORB_DIR"]);
}

#[test]
fn start_says_where_it_cannot_write() {
    let bus = Bus::without_broker();
    let file = bus.system.base().join("a file");
    fs::write(&file, "").unwrap();
    bus.uorb(&["--dir", file.to_str().unwrap(), "start"]).failed(&["a file", "irectory"]);
}

#[test]
fn start_says_where_it_looked_for_a_broker_that_is_not_installed() {
    let bus = Bus::without_broker();
    let alone = bus.system.base().join("uorb");
    fs::copy(program("uorb"), &alone).unwrap();
    let start = |path: &str| {
        let mut command = bus.command(&alone);
        command.arg("start").env("PATH", path).stderr(Stdio::piped());
        Actor::spawn(command).end()
    };

    start("/nowhere").failed(&["uorbd", "PATH", alone.parent().unwrap().to_str().unwrap()]);

    let program = program("uorbd");
    let beside: &Path = program.parent().unwrap();
    let started = start(&format!("/nowhere:{}", beside.display()));
    assert_eq!(started.code, 0, "it is found on PATH: {}", started.words);
}

#[test]
fn stop_ends_every_handle_and_removes_the_directory() {
    let mut bus = Bus::without_broker();
    let pid = bus.start_by_command();
    let mut publication = bus.advertise::<Plain>();
    let mut module = bus.spawn_heard("random_integer", &["publish"]);
    eventually("the module publishes", || bus.is_advertised("random_integer"));

    let stopped = bus.uorb(&["stop"]);

    assert_eq!((stopped.code, &*stopped.out), (0, ""), "{}", stopped.words);
    assert_eq!(stopped.words, format!("uorb: stopped at {}\n", bus.system));
    assert!(!bus.system.dir().exists());
    eventually("the broker has exited", || !is_running(pid));
    assert!(matches!(publication.publish(&Plain { value: 1 }), Err(Error::Ended { .. })));
    let ended = module.end();
    assert_eq!(ended.code, 0, "a module ends with the system");
    assert!(ended.words.contains("has ended (`uorb stop`)"), "{}", ended.words);
}

/// What of a world of iceoryx2 is in shared memory.
fn shared_memory_of(world: &World) -> Vec<String> {
    let entries = fs::read_dir("/dev/shm").unwrap().flatten();
    let names = entries.map(|entry| entry.file_name().into_string().unwrap());
    names.filter(|name| name.starts_with(&world.prefix)).collect()
}

#[test]
fn stop_removes_the_world_of_the_streams_while_they_are_followed() {
    let bus = Bus::without_broker();
    bus.start_by_command();
    let world = World::of(&bus.system);
    let mut publisher = bus.spawn(&["publish-for-ever", "1"]);
    publisher.expect("advertised");
    let all = ["listener", "stamped", "--all-messages", "--json", "--field", "count"];
    let mut listener = bus.spawn_uorb(&all);
    listener.line().expect("a message");
    assert!(world.root.is_dir() && !shared_memory_of(&world).is_empty());

    let stopped = bus.uorb(&["stop"]);

    assert_eq!(stopped.code, 0, "{}", stopped.words);
    assert_eq!(shared_memory_of(&world), Vec::<String>::new());
    assert_eq!(fs::read_dir(bus.system.base()).unwrap().count(), 0);
    let ended = listener.end();
    assert_eq!(ended.code, 1);
    assert!(ended.words.contains("has ended (`uorb stop`)"), "{}", ended.words);
    publisher.until(&["has ended"]);
    publisher.end();
    assert_eq!(shared_memory_of(&world), Vec::<String>::new(), "nor do they who were left");
    assert_eq!(fs::read_dir(bus.system.base()).unwrap().count(), 0);
}

/// A system in the default directory, a publisher and a follower of a stream
/// there, and what all this leaves.
const IN_THE_DEFAULT_DIRECTORY: &str = "
trap 'uorb stop' EXIT
uorb start
uorb pub orb_test val=7 -r 1000 &
uorb listener orb_test 3 --all-messages --csv --field val
uorb status --json
uorb stop
wait
ls -A /dev/shm
ls -A /tmp
";

#[test]
fn in_the_default_world_stop_leaves_what_is_iceoryx2_s_and_nothing_else() {
    let mut shell = Command::new("sh");
    shell.args(["-c", IN_THE_DEFAULT_DIRECTORY]).stdin(Stdio::null());
    for name in ["UORB_DIR", "UORB_SYSTEM", "UORB_LOG"] {
        shell.env_remove(name);
    }
    let uorb = program("uorb");
    let paths = [uorb.parent().unwrap(), "/usr/bin".as_ref(), "/bin".as_ref()];
    shell.env("PATH", std::env::join_paths(paths).unwrap());
    let in_private = || {
        let none: Option<&str> = None;
        let of_memory = |dir| mount(Some("tmpfs"), dir, Some("tmpfs"), MsFlags::empty(), none);
        unshare(CloneFlags::CLONE_NEWNS)?;
        mount(none, "/", none, MsFlags::MS_REC | MsFlags::MS_PRIVATE, none)?;
        of_memory("/dev/shm")?;
        Ok(of_memory("/tmp")?)
    };
    // SAFETY: between fork and exec there are but system calls.
    #[allow(unsafe_code)]
    let spawned = unsafe { shell.pre_exec(in_private) }.output();
    let ended = match spawned {
        Ok(ended) => ended,
        Err(error) => return eprintln!("skipped: no mount namespace can be made here: {error}"),
    };

    let out = String::from_utf8(ended.stdout).unwrap();
    let lines: Vec<&str> = out.lines().collect();
    let ["val", "7", "7", "7", status, left @ ..] = &lines[..] else {
        panic!("{out} {}", String::from_utf8_lossy(&ended.stderr))
    };
    let status: Value = serde_json::from_str(status).unwrap();
    assert_eq!(status["streams"]["prefix"], "iox2_");
    assert_eq!(status["streams"]["root"], "/tmp/iceoryx2");
    assert!(left[0].starts_with("iox2_") && left[0].ends_with(".global_mgmt"), "{left:?}");
    assert_eq!(left[1..], ["iceoryx2"], "{left:?}");
}

#[test]
fn foreground_is_the_broker_itself_and_a_signal_ends_it_and_leaves_nothing() {
    for signal in [Signal::SIGTERM, Signal::SIGINT] {
        let bus = Bus::without_broker();
        let mut foreground = bus.spawn_uorb(&["start", "--foreground"]);
        eventually("it is ready", || Session::connect_to(&bus.system).is_ok());
        assert_eq!(bus.running_broker(), Some(foreground.pid()));
        assert_eq!(bus.uorb(&["pub", "orb_test", "val=1"]).code, 0);

        foreground.signal(signal);

        assert_eq!(foreground.end().code, 0, "{signal}");
        assert!(!bus.system.dir().exists());
    }
}

#[test]
fn start_takes_over_what_a_killed_broker_left() {
    let mut bus = Bus::without_broker();
    let first = bus.start_by_command();
    let mut subscription = bus.subscribe::<Plain>();
    let mut publication = bus.advertise::<Plain>();
    let mut claimer = bus.spawn(&["claim", "75"]);
    claimer.expect("ready");
    claimer.say("go");
    claimer.expect("instance 0");
    end(first, Signal::SIGKILL);
    eventually("it is gone", || bus.running_broker().is_none());
    bus.uorb(&["info", "plain"]).failed(&["no broker runs", "uorb start"]);
    let stopped = bus.uorb(&["stop"]);
    assert_eq!(stopped.code, 0);
    assert!(stopped.words.contains("a broker was killed there; `uorb start` takes over"));
    publication.publish(&Plain { value: 1 }).unwrap();

    let second = bus.start_by_command();

    assert_ne!(first, second);
    publication.publish(&Plain { value: 2 }).unwrap();
    assert_eq!(subscription.update(), Some(Plain { value: 2 }));
    eventually("everybody has re-joined", || {
        let status = status(&bus);
        let nodes: Vec<_> = status["nodes"].as_array().unwrap().iter().map(node).collect();
        nodes == [("plain", 1, 1, 2), ("stamped", 1, 0, 0)]
    });
    assert_eq!(bus.uorb(&["stop"]).code, 0);
    assert!(!bus.system.dir().exists());
}

#[test]
fn a_broker_is_replaced_while_it_runs_and_nobody_loses_anything() {
    let mut bus = Bus::without_broker();
    let first = bus.start_by_command();
    let mut subscription = bus.subscribe::<Plain>();
    let mut publication = bus.advertise::<Plain>();
    publication.publish(&Plain { value: 1 }).unwrap();

    let replaced = bus.uorb(&["start", "--replace"]);

    let second = bus.running_broker().expect("another one runs");
    assert_ne!(first, second);
    // The kernel takes a killed process's locks from it a little before its life.
    eventually("the first one has gone", || !is_running(first));
    assert_eq!(replaced.code, 0, "{}", replaced.words);
    let (system, words) = (&bus.system, replaced.words);
    assert_eq!(words, format!("uorb: broker started at {system}, pid {second}\n"));
    assert_eq!(subscription.update(), Some(Plain { value: 1 }));
    publication.publish(&Plain { value: 2 }).unwrap();
    assert_eq!(subscription.update(), Some(Plain { value: 2 }));
    eventually("everybody has re-joined", || {
        let status = status(&bus);
        let nodes: Vec<_> = status["nodes"].as_array().unwrap().iter().map(node).collect();
        nodes == [("plain", 1, 1, 2)]
    });
    assert_eq!(subscription.lost(), 0);
}

#[test]
fn a_broker_is_replaced_where_none_runs() {
    let bus = Bus::without_broker();

    assert_eq!(bus.uorb(&["start", "--replace"]).code, 0);

    assert!(bus.running_broker().is_some());
}

#[test]
fn a_broker_that_could_not_take_over_does_not_replace_one() {
    let bus = Bus::without_broker();
    let first = bus.start_by_command();
    let lock = fs::read_to_string(bus.system.lock()).unwrap();
    let other: Vec<_> = lock
        .lines()
        .map(|line| if line.starts_with("version ") { "version 999" } else { line })
        .collect();
    fs::write(bus.system.lock(), other.join("\n")).unwrap();

    bus.uorb(&["start", "--replace"]).failed(&["version 999", "uorb stop"]);

    assert_eq!(bus.running_broker(), Some(first));
    fs::write(bus.system.lock(), lock).unwrap();
}

/// Topic, publishers, subscribers and messages so far.
fn node(node: &Value) -> (&str, u64, u64, u64) {
    let count = |name: &str| node[name].as_u64().unwrap();
    (node["topic"].as_str().unwrap(), count("publishers"), count("subscribers"), count("published"))
}

fn status(bus: &Bus) -> Value {
    serde_json::from_str(&bus.uorb(&["status", "--json"]).fine()).expect("JSON")
}

#[test]
fn status_names_the_broker_the_processes_the_nodes_and_what_was_lost() {
    let bus = Bus::start();
    let mut publisher = bus.spawn(&["publish", "3", "1"]);
    publisher.expect("advertised");
    let mut slow = bus.spawn(&["follow-name", "stamped"]);
    slow.expect("subscribed");
    slow.stop();
    publisher.say("go");
    publisher.expect("published");

    let status = status(&bus);

    assert_eq!(status["broker"]["pid"], bus.broker_pid());
    assert_eq!(status["broker"]["directory"], bus.system.to_string());
    let world = World::of(&bus.system);
    assert_eq!(status["streams"]["prefix"], world.prefix);
    assert_eq!(status["streams"]["root"], world.root.to_str().unwrap());
    assert!(status["streams"]["none_because"].is_null());
    let peers: Vec<_> = status["peers"].as_array().unwrap().iter().collect();
    let mut pids: Vec<u64> = peers.iter().map(|peer| peer["pid"].as_u64().unwrap()).collect();
    pids.sort_unstable();
    let mut expected = [u64::from(publisher.pid()), u64::from(slow.pid())];
    expected.sort_unstable();
    assert_eq!(pids, expected);
    assert!(peers.iter().all(|peer| peer["name"] == "actor"), "{peers:?}");
    let shown = bus.uorb(&["status"]).fine();
    let pid = bus.broker_pid();
    assert!(shown.contains(&format!("pid {pid}, up ")) && shown.contains("processes: 2,"));
    assert!(shown.contains("\nstamped     0    1  1  256 /obj/stamped0\n"), "{shown}");
    let (prefix, root) = (&world.prefix, world.root.display());
    let streams = format!("\nstreams: iceoryx2 with prefix {prefix} and root {root}\n");
    assert!(shown.contains(&streams), "{shown}");
    assert!(shown.ends_with("\nNo lost messages\n"), "nobody was asked for them yet: {shown}");

    slow.signal(Signal::SIGCONT);
    slow.expect("256 bytes");

    eventually("the loss is counted", || {
        bus.uorb(&["status"]).fine().ends_with("\nTOPIC, NR LOST MSGS\nstamped0: 2\n")
    });
}

#[test]
fn another_user_s_system_is_named_as_such_by_every_command() {
    if !nix::unistd::geteuid().is_root() {
        eprintln!("skipped: only root can be another user");
        return;
    }
    const NOBODY: u32 = 65_534;
    let bus = Bus::without_broker();
    let base = bus.system.base();
    // Where everybody may run it.
    fs::copy(program("uorb"), base.join("uorb")).unwrap();
    let dir = base.join("private");
    let roots = System::new(&dir, 0);
    let dir = dir.to_str().unwrap();
    let as_nobody = |arguments: &[&str]| {
        let mut command = bus.command(&base.join("uorb"));
        command.args(arguments).env("UORB_DIR", dir).uid(NOBODY).gid(NOBODY);
        command.stderr(Stdio::piped());
        Actor::spawn(command).end()
    };
    let commands: [&[&str]; 8] = [
        &["status"],
        &["ls"],
        &["top", "-1"],
        &["info", "orb_test"],
        &["listener", "orb_test", "1"],
        &["pub", "orb_test", "val=1"],
        &["test", "test_single"],
        &["stop"],
    ];
    assert_eq!(bus.uorb(&["--dir", dir, "start"]).code, 0);

    // The directory is closed to others, then it is open to everybody.
    for mode in [0o700, 0o777] {
        for open in [roots.base(), &roots.dir(), &roots.nodes(), &roots.socket()] {
            fs::set_permissions(open, fs::Permissions::from_mode(mode)).unwrap();
        }
        for command in commands {
            if mode == 0o777 && ["ls", "top"].contains(&command[0]) {
                continue; // They ask nobody, and may read what they can.
            }
            let ended = as_nobody(command);
            ended.failed(&["belongs to user 0, not to 65534: set UORB_DIR"]);
        }
    }
    // The broker in a directory of one's own is another user's.
    for owned in [roots.base(), &roots.dir()] {
        std::os::unix::fs::chown(owned, Some(NOBODY), None).unwrap();
    }
    as_nobody(&["status"]).failed(&["broker.sock belongs to user 0, not to 65534: set UORB_DIR"]);

    assert_eq!(bus.uorb(&["--dir", dir, "stop"]).code, 0, "root may");
}

#[test]
fn a_node_that_cannot_be_read_is_shown_with_the_reason_beside_the_others() {
    use std::os::unix::fs::FileExt;
    let mut bus = Bus::start();
    let _publication = bus.advertise::<Plain>();
    bus.advertise::<Stamped>().publish(&Stamped::new(1, 1)).unwrap();
    let path = bus.system.node("stamped", instance(0));
    let file = fs::File::options().write(true).open(&path).unwrap();
    file.write_all_at(&99_u32.to_ne_bytes(), 8).unwrap();
    let why = format!("stamped0: {} has node file version 99", path.display());

    let shown = bus.uorb(&["status"]).fine();
    assert!(shown.contains("\nplain  ") && shown.contains(&format!("\n{why}")), "{shown}");
    let shown = bus.uorb(&["ls", "-l"]).fine();
    assert!(shown.contains(" plain0\n") && shown.contains(&why), "{shown}");
    let shown = bus.uorb(&["top", "-1", "-a"]).fine();
    assert!(shown.contains("\nplain  ") && shown.contains(&format!("\n{why}")), "{shown}");
    let shown = bus.uorb(&["top", "-1", "plain"]).fine();
    assert!(!shown.contains("stamped"), "it was not asked for: {shown}");
    for command in [&["status", "--json"][..], &["top", "-1", "-a", "--json"]] {
        let shown: Value = serde_json::from_str(&bus.uorb(command).fine()).expect("JSON");
        let rows = shown.get("nodes").or(shown.get("topics")).unwrap().as_array().unwrap();
        assert_eq!((rows.len(), &rows[0]["topic"]), (1, &"plain".into()), "{shown}");
        let unreadable = shown["unreadable"].as_array().unwrap();
        assert_eq!((unreadable.len(), &unreadable[0]["topic"]), (1, &"stamped".into()));
        assert!(unreadable[0]["error"].as_str().unwrap().contains("version 99"), "{shown}");
    }
}

#[test]
fn a_broker_that_is_stopped_is_named_by_its_pid() {
    let mut bus = Bus::start();
    end(bus.broker_pid(), Signal::SIGSTOP);
    let pid = bus.broker_pid().to_string();
    bus.uorb(&["status"]).failed(&[&format!("pid {pid}, does not answer")]);
    end(bus.broker_pid(), Signal::SIGCONT);
    bus.stop();
}
