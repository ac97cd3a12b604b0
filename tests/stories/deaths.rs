use std::os::fd::{AsFd, AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::fs::PermissionsExt;
use std::time::Duration;

use nix::poll::{PollFd, PollFlags, PollTimeout};
use nix::sys::signal::Signal;
use nix::sys::socket::{SockFlag, accept4};
use uorb_core::broker_side::{
    Ending, FromBroker, Node, Reply, Request, Role, ToBroker, decode, encode, listen_as_broker,
    receive_packet, send_packet,
};
use uorb_core::{
    AdvertiseOptions, Error, Instance, Priority, Publication, QueueLength, Session, Subscription,
    System, World, poll, topic,
};
use uorb_tests::{Bus, PATIENCE, Plain, Stamped, eventually, instance, may_hold};

fn claimed(bus: &Bus, priority: &str) -> (uorb_tests::Actor, String) {
    let mut actor = bus.spawn(&["claim", priority]);
    actor.expect("ready");
    actor.say("go");
    let line = actor.line().expect("an instance");
    (actor, line)
}

#[test]
fn a_killed_publisher_is_unadvertised_and_its_restart_gets_its_instance_again() {
    let mut bus = Bus::start();
    let (_first, _) = claimed(&bus, "100");
    let (mut victim, line) = claimed(&bus, "75");
    let (_third, _) = claimed(&bus, "50");
    assert_eq!(line, "instance 1");
    victim.say("41");
    victim.expect("published");

    victim.kill();

    let session = bus.session();
    eventually("the topic is unadvertised", || !session.exists("stamped", instance(1)).unwrap());
    let mut late = bus.subscribe_instance::<Stamped>(1);
    assert_eq!(late.update(), Some(Stamped::new(41, victim.pid().into())), "readable for ever");
    let (mut restarted, line) = claimed(&bus, "75");
    assert_eq!(line, "instance 1");
    assert!(!late.updated(), "being advertised again is nothing new");
    restarted.say("42");
    restarted.expect("published");
    assert_eq!(late.update().unwrap().count, 42);
}

#[test]
fn a_killed_publisher_is_noticed_while_its_forked_child_lives() {
    let mut bus = Bus::start();
    let mut parent = bus.spawn(&["fork-and-hold"]);
    parent.expect("child true true true true true");
    let child: i32 = parent.line().unwrap().parse().unwrap();
    assert!(bus.is_advertised("stamped"));

    parent.kill();

    eventually("the topic is unadvertised", || !bus.is_advertised("stamped"));
    let child = nix::unistd::Pid::from_raw(child);
    nix::sys::signal::kill(child, Signal::SIGKILL).expect("the child outlived its parent");
}

#[test]
fn a_broker_that_is_killed_under_load_costs_no_message() {
    const MESSAGES: u32 = 2_000;
    let mut bus = Bus::start();
    let queue_length = QueueLength::new(16);
    let options = AdvertiseOptions { queue_length, ..AdvertiseOptions::default() };
    let mut publication = Publication::<Plain>::advertise_with(&bus.session(), options).unwrap();
    let mut subscription = bus.subscribe::<Plain>();
    let (mut first, _) = claimed(&bus, "100");
    let (_second, _) = claimed(&bus, "50");
    let before = counts(&bus);

    // The publisher waits for the subscriber every 16 messages, so that nothing
    // may be lost; the broker is killed and started again in between.
    let (acknowledge, acknowledged) = std::sync::mpsc::channel();
    let publisher = std::thread::spawn(move || {
        for value in 1..=MESSAGES {
            publication.publish(&Plain { value }).unwrap();
            if value % 16 == 0 {
                acknowledged.recv_timeout(PATIENCE).unwrap();
            }
        }
        publication
    });
    for expected in 1..=MESSAGES {
        if expected % 500 == 0 {
            bus.kill_broker();
        }
        if expected % 500 == 100 && expected > 500 {
            bus.start_broker();
        }
        assert_eq!(poll(&mut [&mut subscription], Some(PATIENCE)).unwrap(), 1);
        assert_eq!(subscription.update(), Some(Plain { value: expected }));
        if expected % 16 == 0 {
            acknowledge.send(()).unwrap();
        }
    }
    let publication = publisher.join().unwrap();
    assert_eq!(subscription.lost(), 0);
    bus.start_broker();

    eventually("everybody has re-joined", || counts(&bus) == before);
    first.say("7");
    first.expect("published");
    let (_third, line) = claimed(&bus, "75");
    assert_eq!(line, "instance 2", "no instance was given away");
    drop(publication);
    assert!(!bus.is_advertised("plain"), "what was advertised before can be unadvertised after");
}

/// Who publishes on a node with which priority, and how many subscribe to it.
type NodeCounts = (String, Instance, Vec<(u16, Priority)>, u64);

/// The counts of every node.
fn counts(bus: &Bus) -> Vec<NodeCounts> {
    let nodes = bus.system.list_nodes().unwrap().into_iter();
    nodes
        .map(|(topic, instance)| {
            let status =
                Node::open(&bus.system, &topic, instance, Role::Observer).unwrap().status();
            let publishers = status.publishers.iter().map(|p| (p.peer, p.priority)).collect();
            (topic, instance, publishers, status.subscribers)
        })
        .collect()
}

#[test]
fn a_publisher_that_died_while_no_broker_ran_is_found_by_the_next() {
    let mut bus = Bus::start();
    let _keeps_the_system = bus.subscribe::<Plain>();
    let (mut victim, _) = claimed(&bus, "75");
    bus.kill_broker();
    victim.kill();
    assert!(bus.is_advertised("stamped"), "nobody could know yet");

    bus.start_broker();

    assert!(!bus.is_advertised("stamped"));
    let (_next, line) = claimed(&bus, "75");
    assert_eq!(line, "instance 0");
}

#[test]
fn a_stopped_process_keeps_its_instance_over_a_broker_s_restart() {
    let mut bus = Bus::start();
    let (mut sleeper, _) = claimed(&bus, "75");
    sleeper.signal(Signal::SIGSTOP);
    bus.kill_broker();
    bus.start_broker();

    let (_other, line) = claimed(&bus, "75");

    assert_eq!(line, "instance 1", "claims are served at once, and not at the sleeper's cost");
    sleeper.signal(Signal::SIGCONT);
    sleeper.say("7");
    sleeper.expect("published");
}

#[test]
fn requests_wait_for_the_next_broker() {
    let mut bus = Bus::start();
    let session = bus.session();
    bus.kill_broker();
    let asker = std::thread::spawn(move || Publication::<Plain>::advertise(&session));
    bus.start_broker();
    // The system is another, since nobody held anything of the old one but us:
    // and we do live, so it is the same.
    asker.join().unwrap().unwrap();
}

#[test]
fn without_a_broker_the_error_says_where_it_was_looked_for_and_what_to_do() {
    let bus = Bus::without_broker();
    let error = Session::connect_to(&bus.system).unwrap_err();
    assert!(matches!(error, Error::NoBroker { .. }));
    let text = error.to_string();
    assert!(text.contains("broker.sock") && text.contains("uorb start"), "{text}");
}

#[test]
fn when_the_system_ends_every_handle_says_so_and_what_was_published_can_be_copied() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    publication.publish(&Plain { value: 5 }).unwrap();
    let mut reader = bus.subscribe::<Plain>();
    let mut sleeper = bus.subscribe::<Plain>();
    let mut waiting = bus.subscribe_by_name("never_described");
    sleeper.copy();
    let asleep = std::thread::spawn(move || {
        let first = poll(&mut [&mut sleeper], None).map(|_| ());
        let second = poll(&mut [&mut waiting], None).map(|_| ());
        [first, second]
    });

    bus.stop();

    for ended in asleep.join().unwrap() {
        assert!(matches!(ended, Err(Error::Ended { .. })), "{ended:?}");
    }
    assert!(matches!(publication.publish(&Plain { value: 6 }), Err(Error::Ended { .. })));
    assert_eq!(poll(&mut [&mut reader], None).unwrap(), 1, "first what there is");
    assert_eq!(reader.update(), Some(Plain { value: 5 }));
    assert!(matches!(poll(&mut [&mut reader], None), Err(Error::Ended { .. })));
    let session = bus.session();
    eventually("the session knows", || session.has_ended());
    assert!(matches!(Publication::<Plain>::advertise(&session), Err(Error::Ended { .. })));
    assert!(!bus.system.dir().exists());
}

#[test]
fn a_second_broker_leaves_the_system_to_the_first() {
    let mut bus = Bus::start();
    let _publication = bus.advertise::<Plain>();
    let (mut second, line) = bus.try_start_broker();
    assert_eq!(line, "running");
    assert!(second.wait().unwrap().success());
    assert!(bus.is_advertised("plain"));
}

#[test]
fn of_many_brokers_that_start_at_once_one_runs() {
    let mut bus = Bus::without_broker();
    let mut started: Vec<_> = std::thread::scope(|scope| {
        let starting: Vec<_> = (0..6).map(|_| scope.spawn(|| bus.try_start_broker())).collect();
        starting.into_iter().map(|start| start.join().unwrap()).collect()
    });
    let ready = started.iter().position(|(_, line)| line == "ready").expect("one runs");
    let (broker, _) = started.remove(ready);
    for (mut other, line) in started {
        assert_eq!(line, "running");
        assert!(other.wait().unwrap().success());
    }
    assert!(Session::connect_to(&bus.system).is_ok());
    bus.adopt_broker(broker);
    bus.stop();
}

#[test]
fn a_process_that_sleeps_through_its_publisher_s_death_is_woken_by_the_next() {
    let mut bus = Bus::start();
    let (mut victim, _) = claimed(&bus, "75");
    let mut sleeper = bus.subscribe::<Stamped>();
    assert_eq!(poll(&mut [&mut sleeper], Some(Duration::from_millis(1))).unwrap(), 0);
    victim.kill();
    let mut publication = bus.advertise::<Stamped>();
    let woken = std::thread::spawn(move || poll(&mut [&mut sleeper], Some(PATIENCE)).unwrap());
    publication.publish(&Stamped::new(1, 1)).unwrap();
    assert_eq!(woken.join().unwrap(), 1);
}

#[test]
fn a_child_that_drops_what_it_inherited_leaves_its_parent_s_handles_alone() {
    let bus = Bus::start();
    let mut actor = bus.spawn(&["fork-and-drop"]);
    actor.expect("readable true copied true answered true");
}

#[test]
fn a_topic_that_is_described_while_a_process_re_joins_is_not_missed() {
    let mut bus = Bus::start();
    let mut waiting = bus.spawn(&["wait-and-hold", "3000"]);
    waiting.expect("subscribed");
    bus.kill_broker();
    bus.start_broker();
    let session = bus.session();
    let subscriptions_of_others = || {
        let Ok(Reply::Peers(peers)) = session.ask(Request::Peers) else { panic!("no answer") };
        let others = peers.iter().filter(|peer| peer.peer != session.peer());
        others.map(|peer| peer.subscriptions).max().unwrap_or(0)
    };
    eventually("it names its handles again", || subscriptions_of_others() > 1);
    let mut publication = bus.advertise::<Plain>();
    publication.publish(&Plain { value: 1 }).unwrap();
    waiting.expect("described");
}

#[test]
fn a_publication_that_is_dropped_around_a_cut_off_is_unadvertised() {
    if !may_hold(3_000) {
        return;
    }
    let mut bus = Bus::start();
    let mut actor = bus.spawn(&["hold-and-drop", "3000"]);
    actor.expect("ready");
    actor.signal(Signal::SIGSTOP);
    // Three thousand times "it is there now", and it does not read.
    let _publication = bus.advertise::<Plain>();
    actor.say("go");
    actor.signal(Signal::SIGCONT);
    actor.expect("dropped");
    eventually("the topic is unadvertised", || !bus.is_advertised("stamped"));
}

#[test]
fn a_session_that_ended_while_no_broker_ran_is_buried_though_its_process_lives() {
    let mut bus = Bus::start();
    let keeper = Session::connect_to(&bus.system).unwrap();
    let session = Session::connect_to(&bus.system).unwrap();
    let publication = Publication::<Plain>::advertise(&session).unwrap();
    bus.kill_broker();
    drop((publication, session));
    bus.start_broker();
    eventually("it is unadvertised", || !keeper.exists("plain", Instance::FIRST).unwrap());
}

/// Removes a directory in which a broker may just be making a file.
fn remove_all(dir: &std::path::Path) {
    eventually("the directory is removed", || {
        let _ = std::fs::remove_dir_all(dir);
        !dir.exists()
    });
}

#[test]
fn when_its_directory_is_removed_the_system_ends_for_everybody() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    let mut sleeper = bus.subscribe::<Plain>();
    // It has its bell open, which is lost to everybody else with its path.
    poll(&mut [&mut sleeper], Some(Duration::from_millis(1))).unwrap();
    let asleep = std::thread::spawn(move || poll(&mut [&mut sleeper], None));
    remove_all(&bus.system.dir());
    let ended = asleep.join().unwrap();
    assert!(matches!(ended, Err(Error::Ended { .. })), "{ended:?}");
    assert!(matches!(publication.publish(&Plain { value: 1 }), Err(Error::Ended { .. })));
}

#[test]
fn a_broker_whose_directory_was_removed_leaves_the_next_one_s_alone() {
    let mut bus = Bus::start();
    let session = bus.session();
    let first = nix::unistd::Pid::from_raw(bus.broker_pid() as i32);
    nix::sys::signal::kill(first, Signal::SIGSTOP).unwrap();
    remove_all(&bus.system.dir());
    let (second, line) = bus.try_start_broker();
    assert_eq!(line, "ready");
    nix::sys::signal::kill(first, Signal::SIGCONT).unwrap();
    eventually("the old session ends", || session.has_ended());
    bus.kill_broker();
    bus.adopt_broker(second);
    assert!(Session::connect_to(&bus.system).is_ok());
    assert!(bus.system.lock().exists());
}

#[test]
fn a_broker_that_was_killed_while_it_ended_the_system_does_not_revive_it() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    let session = bus.session();
    bus.kill_broker();
    let node = Node::open(&bus.system, "plain", Instance::FIRST, Role::Broker).unwrap();
    node.end(Ending::System);
    bus.start_broker();
    eventually("its sessions end", || session.has_ended());
    assert!(matches!(publication.publish(&Plain { value: 1 }), Err(Error::Ended { .. })));
    let fresh = Session::connect_to(&bus.system).unwrap();
    Publication::<Plain>::advertise(&fresh).unwrap().publish(&Plain { value: 1 }).unwrap();
}

#[test]
fn a_broker_that_was_killed_while_nodes_gave_way_leaves_one_layout_in_the_topic() {
    let mut bus = Bus::start();
    let keeper = bus.session();
    let second = bus.system.node("plain", instance(1));
    let old = {
        let _old = [bus.advertise_multi::<Plain>(), bus.advertise_multi::<Plain>()];
        std::fs::read(&second).unwrap()
    };
    let mut new = Publication::<WidePlain>::advertise(&keeper).unwrap();
    assert!(!second.exists());
    bus.kill_broker();
    // As it was before the last of the old ones went.
    std::fs::write(&second, old).unwrap();
    bus.start_broker();
    new.publish(&WidePlain { values: [3; 4] }).unwrap();
    let mut subscription =
        Subscription::<WidePlain>::subscribe_instance(&keeper, instance(1)).unwrap();
    assert_eq!(subscription.copy(), None);
    let mut subscription = Subscription::<WidePlain>::subscribe(&keeper).unwrap();
    assert_eq!(subscription.copy(), Some(WidePlain { values: [3; 4] }));
}

topic! {
    /// Topic `plain` of another size.
    pub struct WidePlain = "plain" { pub values: [u64; 4] }
}

/// A broker of whom a story says what it answers, and when it is gone.
struct StagedBroker {
    system: System,
    socket: OwnedFd,
}

impl StagedBroker {
    /// Listens, with the lock file in place.
    fn new(bus: &Bus) -> Self {
        let system = bus.system.clone();
        for dir in [system.dir(), system.nodes(), system.peers()] {
            std::fs::create_dir_all(dir).unwrap();
        }
        std::fs::write(system.lock(), "").unwrap();
        let socket = listen_as_broker(&system).unwrap();
        Self { system, socket }
    }

    /// Waits until somebody connects.
    fn wait(&self) {
        let mut ready = [PollFd::new(self.socket.as_fd(), PollFlags::POLLIN)];
        nix::poll::poll(&mut ready, PollTimeout::NONE).unwrap();
    }

    /// Takes the next one who connects, and hears its first request.
    fn accept(&self) -> OwnedFd {
        self.wait();
        let accepted = accept4(self.socket.as_raw_fd(), SockFlag::SOCK_CLOEXEC);
        // SAFETY: it has just been made, and nobody else knows its number.
        #[allow(unsafe_code)]
        let accepted = unsafe { OwnedFd::from_raw_fd(accepted.unwrap()) };
        Self::hear(&accepted);
        accepted
    }

    fn hear(client: &OwnedFd) -> ToBroker {
        decode(receive_packet(client, &mut Vec::new()).unwrap()).expect("a request")
    }

    fn say(client: &OwnedFd, word: &FromBroker) {
        // Who has seen enough may be gone.
        let _ = send_packet(client, &encode(word));
    }

    fn welcome(&self, client: &OwnedFd) {
        let reply = Reply::Welcome { peer: 1, system_id: 7, world: World::of(&self.system) };
        Self::say(client, &FromBroker::Reply { number: 0, reply });
    }

    fn remove_socket(&self) {
        std::fs::remove_file(self.system.socket()).unwrap();
    }
}

#[test]
fn a_process_that_joins_while_the_system_ends_hears_that_it_has_ended() {
    type Stage = fn(StagedBroker);
    let stages: [(&str, Stage); 4] = [
        ("nobody accepts it any more", |broker| {
            broker.wait();
            broker.remove_socket();
        }),
        ("the broker says so instead of an answer", |broker| {
            let client = broker.accept();
            broker.remove_socket();
            StagedBroker::say(&client, &FromBroker::Ended);
        }),
        ("the broker hangs up", |broker| {
            let _client = broker.accept();
            broker.remove_socket();
        }),
        ("it is welcome, and its file is gone", |broker| {
            let client = broker.accept();
            broker.remove_socket();
            broker.welcome(&client);
            StagedBroker::say(&client, &FromBroker::Ended);
        }),
    ];
    for (stage, play) in stages {
        let bus = Bus::without_broker();
        let broker = StagedBroker::new(&bus);
        let player = std::thread::spawn(move || play(broker));
        let refused = Session::connect_to(&bus.system).map(|_| ());
        player.join().unwrap();
        assert!(matches!(refused, Err(Error::Ended { .. })), "{stage}: {refused:?}");
    }
}

#[test]
fn a_broker_that_hangs_up_and_leaves_its_socket_has_not_ended_the_system() {
    let bus = Bus::without_broker();
    let broker = StagedBroker::new(&bus);
    let player = std::thread::spawn(move || drop(broker.accept()));
    let refused = Session::connect_to(&bus.system).map(|_| ());
    player.join().unwrap();
    assert!(matches!(refused, Err(Error::NoBroker { .. })), "{refused:?}");
}

#[test]
fn a_grant_whose_node_is_gone_with_the_system_says_that_it_has_ended() {
    type Stage = fn(&StagedBroker, &OwnedFd, u32);
    fn grant(client: &OwnedFd, number: u32) {
        let reply = Reply::Advertised(Instance::FIRST);
        StagedBroker::say(client, &FromBroker::Reply { number, reply });
    }
    let stages: [(&str, Stage); 2] = [
        ("the broker says so next", |broker, client, number| {
            grant(client, number);
            broker.remove_socket();
            StagedBroker::say(client, &FromBroker::Ended);
        }),
        ("the directory is gone, and the broker has not noticed", |broker, client, number| {
            std::fs::remove_dir_all(broker.system.dir()).unwrap();
            grant(client, number);
            let ToBroker { number, .. } = StagedBroker::hear(client);
            StagedBroker::say(client, &FromBroker::Reply { number, reply: Reply::Done });
        }),
    ];
    for (how, play) in stages {
        let bus = Bus::without_broker();
        let broker = StagedBroker::new(&bus);
        std::fs::write(bus.system.peer(1), "").unwrap();
        let player = std::thread::spawn(move || {
            let client = broker.accept();
            broker.welcome(&client);
            let ToBroker { number, .. } = StagedBroker::hear(&client);
            play(&broker, &client, number);
            // Until the process has what it came for, nobody hangs up.
            (broker, client)
        });
        let session = Session::connect_to(&bus.system).unwrap();
        let refused = Publication::<Plain>::advertise(&session).map(|_| ());
        assert!(matches!(refused, Err(Error::Ended { .. })), "{how}: {refused:?}");
        drop(player.join().unwrap());
    }
}

#[test]
fn a_broker_that_was_killed_while_it_made_a_stream_does_not_stop_the_next_one() {
    let mut bus = Bus::start();
    drop(bus.stream::<Plain>());
    let mut bus = bus.without_session();
    // Somebody who lives, so that the next broker adopts what is there.
    let mut survivor = bus.spawn(&["claim", "75"]);
    survivor.expect("ready");
    bus.kill_broker();
    // As after the first of two system calls that make a file of a size.
    let prefix = World::of(&bus.system).prefix;
    let names = std::fs::read_dir("/dev/shm").unwrap().flatten();
    let begins = |entry: &std::fs::DirEntry| {
        let name = entry.file_name().into_string().unwrap();
        name.starts_with(&prefix) && name.ends_with(".dynamic")
    };
    let made: Vec<_> = names.filter(begins).map(|entry| entry.path()).collect();
    assert!(!made.is_empty());
    for path in made {
        std::fs::File::create(path).unwrap();
    }

    bus.start_broker();

    let mut plain = bus.advertise::<Plain>();
    let mut stream = bus.stream::<Plain>();
    plain.publish(&Plain { value: 1 }).unwrap();
    assert_eq!(stream.update(), Some(&Plain { value: 1 }));
    bus.stop();
}

#[test]
fn a_file_of_a_stream_that_nobody_finishes_stops_the_broker_for_a_while_only() {
    let mut bus = Bus::start();
    let _keeper = bus.subscribe::<Plain>();
    let streamer = |words: &[&str], line: &str| {
        let mut streamer = bus.spawn_program(&uorb_tests::program("streamer"), words);
        streamer.expect(line);
        streamer
    };
    let mut publisher = streamer(&["publish", "10"], "advertised");
    let mut follower = streamer(&["follow", "16"], "subscribed");
    publisher.say("go");
    publisher.expect("published, refused 0");
    let broker = nix::unistd::Pid::from_raw(bus.broker_pid() as i32);
    nix::sys::signal::kill(broker, Signal::SIGSTOP).unwrap();
    publisher.kill();
    follower.kill();
    let prefix = World::of(&bus.system).prefix;
    let names = std::fs::read_dir("/dev/shm").unwrap().flatten();
    let is_connection = |entry: &std::fs::DirEntry| {
        let name = entry.file_name().into_string().unwrap();
        name.starts_with(&prefix) && name.ends_with(".connection")
    };
    let made: Vec<_> = names.filter(is_connection).map(|entry| entry.path()).collect();
    assert!(!made.is_empty());
    // As between two system calls of one who makes it, again and again, so that
    // it is always new when the broker begins to clean up.
    let unfinish = || made.iter().for_each(|path| drop(std::fs::File::create(path).unwrap()));
    unfinish();
    nix::sys::signal::kill(broker, Signal::SIGCONT).unwrap();
    let until = std::time::Instant::now() + Duration::from_millis(1_500);
    while std::time::Instant::now() < until {
        unfinish();
        std::thread::yield_now();
    }

    let mut plain = bus.advertise::<Plain>();
    let mut stream = bus.stream::<Plain>();

    plain.publish(&Plain { value: 1 }).unwrap();
    assert_eq!(stream.update(), Some(&Plain { value: 1 }));
    bus.stop();
}

#[test]
fn a_stream_that_a_broker_did_not_live_to_make_is_made_by_the_next() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Plain>();
    drop(bus.stream::<Plain>());
    let services = World::of(&bus.system).root.join("services");
    let described: Vec<_> =
        std::fs::read_dir(services).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert!(described.len() >= 2, "the stream, and its events");

    // As if it were killed before the last step of each.
    bus.kill_broker();
    for path in described {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600)).unwrap();
    }
    bus.start_broker();

    let mut stream = bus.stream::<Plain>();
    publication.publish(&Plain { value: 1 }).unwrap();
    assert_eq!(stream.update(), Some(&Plain { value: 1 }));
    bus.stop();
}
