use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use uorb_core::broker_side::{
    Advertise, Join, PROTOCOL_VERSION, Refusal, Reply, Request, ToBroker, encode,
};
use uorb_core::{Claim, Error, Instance, Priority, Publication, Session, Topic};
use uorb_tests::{Bus, Plain, Stamped, Stranger, eventually, may_hold};

fn advertise<T: Topic>(handle: u32) -> Request {
    Request::Advertise(Advertise {
        handle,
        metadata: T::METADATA.clone(),
        claim: Claim::Shared(Instance::FIRST),
        priority: Priority::DEFAULT,
        queue_length: None,
    })
}

fn log(bus: &Bus) -> String {
    std::fs::read_to_string(bus.system.log()).unwrap()
}

#[test]
fn garbage_is_cut_off_with_a_line_in_the_log_and_nobody_else_notices() {
    let mut bus = Bus::start();
    let _publication = bus.advertise::<Plain>();
    let half = encode(&ToBroker { number: 1, request: advertise::<Plain>(1) });
    let packets: [&[u8]; 4] = [b"garbage", &[255; 1_000], &[0], &half[..half.len() / 2]];
    for packet in packets {
        let stranger = Stranger::connect(&bus.system);
        assert!(stranger.send(packet));
        assert_eq!(stranger.hear(), None, "{packet:?}");
    }
    assert!(log(&bus).contains("it sent what is no request"));
    assert!(bus.is_advertised("plain"));
    assert_eq!(bus.advertise::<Plain>().instance(), Instance::FIRST);
}

#[test]
fn a_layout_that_nests_without_end_does_not_reach_the_broker_s_stack() {
    let mut bus = Bus::start();
    // An advertise whose layout has one field, a message with one field, ...
    let mut packet = vec![1, 2, 1, 1, b'a'];
    (0..20_000).for_each(|_| packet.extend_from_slice(&[0, 0, 0, 1, 0, 12]));
    let stranger = Stranger::connect(&bus.system);
    assert!(stranger.send(&packet));
    assert_eq!(stranger.hear(), None);
    assert_eq!(bus.advertise::<Plain>().instance(), Instance::FIRST, "the broker lives");
}

#[test]
fn a_process_of_another_version_is_told_both_numbers() {
    let bus = Bus::start();
    let stranger = Stranger::connect(&bus.system);
    let join = Join { version: 99, name: "old".into(), rejoin: None };
    let reply = stranger.ask(Request::Join(join));
    assert_eq!(reply, Some(Reply::Refused(Refusal::Version { broker: PROTOCOL_VERSION })));

    // Even if the rest of its words are different ones.
    let stranger = Stranger::connect(&bus.system);
    assert!(stranger.send(&[1, 0, 99, 200, 200, 200]));
    let Some(uorb_core::broker_side::FromBroker::Reply { reply, .. }) = stranger.hear() else {
        panic!("it was not answered");
    };
    assert_eq!(reply, Reply::Refused(Refusal::Version { broker: PROTOCOL_VERSION }));
}

#[test]
fn a_request_before_joining_is_refused() {
    let mut bus = Bus::start();
    let stranger = Stranger::connect(&bus.system);
    for request in [Request::Stop, Request::Peers, advertise::<Plain>(1)] {
        let reply = stranger.ask(request);
        assert!(matches!(reply, Some(Reply::Refused(Refusal::OutOfOrder { .. }))), "{reply:?}");
    }
    assert_eq!(bus.advertise::<Plain>().instance(), Instance::FIRST);
}

#[test]
fn a_long_name_is_cut_and_hinders_no_answer() {
    let mut bus = Bus::start();
    let strangers: Vec<_> = (0..3).map(|_| Stranger::connect(&bus.system)).collect();
    for stranger in &strangers {
        assert!(matches!(stranger.join(&"x".repeat(120_000)), Some(Reply::Welcome { .. })));
    }
    let Ok(Reply::Peers(peers)) = bus.session().ask(Request::Peers) else { panic!("no answer") };
    assert_eq!(peers.len(), 4);
    assert!(peers.iter().all(|peer| peer.name.len() <= 32));
}

#[test]
fn a_handle_cannot_stand_for_two_things() {
    let mut bus = Bus::start();
    let stranger = Stranger::connect(&bus.system);
    stranger.join("careless").unwrap();
    assert_eq!(stranger.ask(advertise::<Plain>(1)), Some(Reply::Advertised(Instance::FIRST)));
    let again = stranger.ask(advertise::<Stamped>(1));
    assert!(matches!(again, Some(Reply::Refused(Refusal::OutOfOrder { .. }))), "{again:?}");
    assert!(bus.is_advertised("plain"));
    drop(stranger);
    eventually("its publication goes with it", || !bus.is_advertised("plain"));
}

#[test]
fn whoever_never_reads_is_cut_off() {
    let mut bus = Bus::start();
    let stranger = Stranger::connect(&bus.system);
    stranger.join("deaf").unwrap();
    // The broker hangs up before it has kept a megabyte for it.
    let packet = encode(&ToBroker { number: 1, request: Request::Peers });
    while stranger.send(&packet) {}
    eventually("it is in the log", || log(&bus).contains("does not read"));
    assert_eq!(bus.advertise::<Plain>().instance(), Instance::FIRST);
}

#[test]
fn a_description_that_is_too_long_is_refused_with_its_size() {
    use uorb_core::{AdvertiseOptions, Field, FieldType, Layout, Metadata, RawPublication};
    let mut bus = Bus::start();
    let fields: Vec<_> = (0..2_000)
        .map(|index| Field {
            name: format!("a_field_with_a_long_name_of_its_own_{index}").into(),
            ty: FieldType::Uint64,
            array_length: None,
            offset_bytes: index * 8,
            unit: "metres per second squared".into(),
        })
        .collect();
    let metadata = Metadata {
        name: "huge".into(),
        layout: std::borrow::Cow::Owned(Layout {
            name: "huge".into(),
            size_bytes: 16_000,
            message_hash: 0,
            fields: fields.into(),
        }),
        queue_length: uorb_core::QueueLength::ONE,
    };
    let options = AdvertiseOptions::default();
    let refused = RawPublication::advertise(&bus.session(), &metadata, options);
    assert!(matches!(refused, Err(Error::DescriptionTooLong { size_bytes: 65_537.., .. })));
    assert_eq!(bus.advertise::<Plain>().instance(), Instance::FIRST);
}

#[test]
fn a_broker_without_descriptors_turns_newcomers_away_and_serves_those_it_knows() {
    use std::os::unix::process::CommandExt;
    let mut bus = Bus::without_broker();
    let mut command = std::process::Command::new(uorb_tests::program("uorbd"));
    command.args(["--ready-fd", "1", "--dir"]).arg(bus.system.base());
    // SAFETY: one system call, between fork and exec.
    #[allow(unsafe_code)]
    unsafe {
        command.pre_exec(|| {
            use nix::sys::resource::{Resource, setrlimit};
            Ok(setrlimit(Resource::RLIMIT_NOFILE, 40, 40)?)
        });
    }
    let mut broker = command.stdout(std::process::Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    let stdout = broker.stdout.as_mut().unwrap();
    std::io::BufRead::read_line(&mut std::io::BufReader::new(stdout), &mut line).unwrap();
    assert_eq!(line, "ready\n");
    bus.adopt_broker(broker);
    let _publication = bus.advertise::<Plain>();

    let idle: Vec<_> = (0..60).map(|_| Stranger::connect(&bus.system)).collect();

    let turned_away = idle.iter().filter(|stranger| stranger.join("late").is_none()).count();
    assert!(turned_away > 10, "{turned_away}");
    assert!(log(&bus).contains("ulimit -n"));
    assert!(bus.session().ask(Request::Status).is_ok(), "whom it knows it serves");
    drop(idle);
    eventually("there is room again", || Session::connect_to(&bus.system).is_ok());
    assert!(std::fs::metadata(bus.system.log()).unwrap().len() < 10_000, "it did not shout");
}

#[test]
fn a_stopped_broker_is_an_error_that_names_it_and_grants_nothing_later() {
    let mut bus = Bus::start();
    let session = bus.session();
    let subscriptions: Vec<_> = (0..20).map(|_| bus.subscribe::<Stamped>()).collect();
    let broker = Pid::from_raw(bus.broker_pid() as i32);
    kill(broker, Signal::SIGSTOP).unwrap();

    let refused = Publication::<Plain>::advertise(&session);

    assert!(matches!(refused, Err(Error::NoAnswer { seconds: 5, .. })), "{refused:?}");
    // One wait is enough to know it: these do not take five seconds each, or
    // the watchdog would end us.
    drop(subscriptions);
    kill(broker, Signal::SIGCONT).unwrap();
    let again = Publication::<Plain>::advertise_multi(&session, Priority::DEFAULT).unwrap();
    assert_eq!(again.instance(), Instance::FIRST, "nobody holds what nobody got");
    drop(again);
    assert!(!bus.is_advertised("plain"));
}

#[test]
fn thousands_of_connections_hinder_nobody_whom_the_broker_knows() {
    const MANY: u64 = 2_500;
    if !may_hold(MANY) {
        return;
    }
    let mut bus = Bus::start();
    let mut plain = bus.subscribe::<Plain>();
    let idle: Vec<_> = (0..MANY).map(|_| Stranger::connect(&bus.system)).collect();

    bus.advertise::<Plain>().publish(&Plain { value: 1 }).unwrap();

    assert_eq!(plain.update(), Some(Plain { value: 1 }));
    // The last of them found the broker full, and are told so by its hanging up.
    assert!(idle.last().unwrap().join("late").is_none());
    assert!(log(&bus).contains("refused a connection"));
    drop(idle);
    eventually("there is room again", || Session::connect_to(&bus.system).is_ok());
    assert!(std::fs::metadata(bus.system.log()).unwrap().len() < 100_000, "it did not shout");
}
