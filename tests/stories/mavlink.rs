//! The MAVLink bridge: links, and what goes out.

use std::fs::{self, File};
use std::io::{BufReader, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::os::fd::AsRawFd;
use std::os::unix::fs::PermissionsExt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use mavlink_core::{MAVLinkV2MessageRaw, MavHeader, SigningConfig, SigningData};
use nix::fcntl::OFlag;
use nix::pty::{grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::socket::{
    AddressFamily, Backlog, SockFlag, SockType, SockaddrIn, bind, listen, socket,
};
use uorb_core::{Publication, Session, now_us, topic};
use uorb_mavlink::dialect::{CA_TRAJECTORY_MSG_DATA, MavMessage, PARAM_REQUEST_LIST_DATA};
use uorb_msg::{
    CaTrajectoryMsg, LogMessage, MavlinkStatus, SensorCombined, VehicleAttitude, VehicleStatus,
};
use uorb_tests::{Actor, Bus, PATIENCE, eventually};

use super::ground_station::{
    GroundStation, decode, packet, port_of_next_link, question, read_message, until_answer,
};

pub(crate) fn bridge(bus: &Bus, options: &[&str]) -> Actor {
    bus.spawn_heard("mavlink", options)
}

/// A bridge with one UDP link at any port, and a ground station that has spoken.
fn link(bus: &Bus, options: &[&str]) -> (Actor, GroundStation) {
    let mut bridge = bridge(bus, &[&["-u", "0"], options].concat());
    let station = GroundStation::of(port_of_next_link(&mut bridge));
    (bridge, station)
}

/// Sets a flag when it goes, also when a story fails.
struct AtEnd<'a>(&'a AtomicBool);

impl Drop for AtEnd<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// An attitude of this moment. Without a 0, which MAVLink would not send.
fn turned() -> VehicleAttitude {
    let [rollspeed, pitchspeed, yawspeed] = [0.1, 0.2, 0.3];
    let q = [0.5, 0.5, 0.5, 0.5];
    VehicleAttitude {
        timestamp: now_us(),
        rollspeed,
        pitchspeed,
        yawspeed,
        q,
        ..Default::default()
    }
}

/// Publishes attitudes, 250 a second, while `story` is told.
fn while_turning<R>(bus: &Bus, story: impl FnOnce() -> R) -> R {
    let system = &bus.system;
    let is_over = AtomicBool::new(false);
    thread::scope(|scope| {
        let turning = scope.spawn(|| {
            let session = Session::connect_to(system).expect("the broker takes us");
            let mut attitude = Publication::<VehicleAttitude>::advertise(&session).expect("ours");
            let mut due_us = now_us();
            while !is_over.load(Ordering::Relaxed) {
                attitude.publish(&turned()).expect("published");
                due_us += 4_000;
                thread::sleep(Duration::from_micros(due_us.saturating_sub(now_us())));
            }
        });
        let told = {
            let _over = AtEnd(&is_over);
            story()
        };
        turning.join().expect("it turned");
        told
    })
}

fn attitude_ms(message: &MavMessage) -> Option<u32> {
    match message {
        MavMessage::ATTITUDE(attitude) => Some(attitude.time_boot_ms),
        _ => None,
    }
}

/// How often attitudes come, by the stamps that their publisher wrote. A busy
/// machine may disturb one measurement, and not five.
#[track_caller]
fn attitudes_come_at(station: &mut GroundStation, rate_hz: f64) {
    let mut measured = Vec::new();
    for _ in 0..5 {
        let count = (rate_hz * 3.0) as u32;
        let first = station.until(attitude_ms);
        let last = (0..count).map(|_| station.until(attitude_ms)).last().expect("some");
        let rate = f64::from(count) * 1e3 / f64::from(last - first);
        if (rate / rate_hz - 1.0).abs() < 0.05 {
            return;
        }
        measured.push(rate);
    }
    panic!("not {rate_hz} Hz: {measured:?}");
}

#[test]
fn a_ground_station_that_only_listens_sees_a_vehicle() {
    let mut bus = Bus::start();
    let mut status = bus.advertise::<VehicleStatus>();
    let message = VehicleStatus {
        nav_state: VehicleStatus::NAVIGATION_STATE_POSCTL,
        arming_state: VehicleStatus::ARMING_STATE_ARMED,
        system_type: 13,
        ..VehicleStatus::default()
    };
    status.publish(&message).unwrap();
    let mut station = GroundStation::new();
    let _bridge = bridge(&bus, &["-u", "0", "-o", &station.port().to_string(), "-m", "custom"]);

    let (header, message) = station.next();

    assert_eq!((header.system_id, header.component_id), (1, 1));
    let MavMessage::HEARTBEAT(heartbeat) = message else { panic!("{message:?}") };
    assert_eq!((heartbeat.autopilot, heartbeat.mavtype, heartbeat.custom_mode), (12, 13, 3 << 16));
    assert_eq!(heartbeat.base_mode & 128, 128);
    let (again, message) = station.next();
    assert!(matches!(message, MavMessage::HEARTBEAT(_)));
    assert_eq!(again.sequence, header.sequence.wrapping_add(1));
}

#[test]
fn streams_come_at_the_rates_of_their_mode() {
    let bus = Bus::start();
    while_turning(&bus, || {
        let (_normal, mut station) = link(&bus, &["-m", "normal"]);
        attitudes_come_at(&mut station, 15.0);
        let (_onboard, mut program) = link(&bus, &["-m", "onboard"]);
        attitudes_come_at(&mut program, 100.0);
    });
}

#[test]
fn two_links_of_one_process_have_modes_of_their_own() {
    let mut bus = Bus::start();
    let mut bridge = bridge(&bus, &["-u", "0", "--", "-u", "0", "-m", "onboard"]);
    let mut station = GroundStation::of(port_of_next_link(&mut bridge));
    let mut program = GroundStation::of(port_of_next_link(&mut bridge));
    let _ = (station.next(), program.next());
    let mut sensors = bus.advertise::<SensorCombined>();
    let accelerometer_m_s2 = [0.5, -0.25, -9.75];
    let message = SensorCombined { timestamp: 42, accelerometer_m_s2, ..SensorCombined::default() };
    sensors.publish(&message).unwrap();

    let imu = program.until(|message| match message {
        MavMessage::HIGHRES_IMU(imu) => Some(imu.clone()),
        _ => None,
    });
    assert_eq!((imu.time_usec, imu.xacc, imu.yacc, imu.zacc), (42, 0.5, -0.25, -9.75));
    // SYS_STATUS and the like need topics that nobody publishes here.
    for _ in 0..2 {
        station.until(|message| {
            assert!(!matches!(message, MavMessage::HIGHRES_IMU(_)), "no stream of its mode");
            matches!(message, MavMessage::HEARTBEAT(_)).then_some(())
        });
    }
}

#[test]
fn two_vehicles_on_one_machine_are_not_mixed_up() {
    let mut buses = [Bus::start(), Bus::start()];
    let mut stations: Vec<_> = ["0", "1"]
        .iter()
        .zip(&mut buses)
        .map(|(number, bus)| {
            let (bridge, mut station) = link(bus, &["-i", number, "-m", "onboard"]);
            // It knows its partner, who would miss what is published once.
            let _ = station.next();
            let mut attitude = bus.advertise::<VehicleAttitude>();
            let yaw = number.parse::<f32>().unwrap() + 0.5;
            attitude.publish(&VehicleAttitude { yaw, ..VehicleAttitude::default() }).unwrap();
            (bridge, station, attitude)
        })
        .collect();
    for (number, (_, station, _)) in stations.iter_mut().enumerate() {
        let yaw = station.until(|message| match message {
            MavMessage::ATTITUDE(attitude) => Some(attitude.yaw),
            _ => None,
        });
        assert_eq!(yaw, number as f32 + 0.5);
        let heard = station.all_for(Duration::from_millis(1_200));
        assert!(heard.iter().all(|(header, _)| header.system_id == number as u32 + 1));
    }
}

#[test]
fn a_ground_station_hears_a_bridge_again_that_was_killed() {
    let bus = Bus::start();
    // The port is given back for a moment. Whoever asks for any gets it at 127.0.0.1,
    // where all others are.
    let mut killed = bridge(&bus, &["-u", "0", "--bind", "127.0.0.2", "-m", "custom"]);
    let port = port_of_next_link(&mut killed);
    let mut station = GroundStation::at(([127, 0, 0, 2], port).into());
    let _ = station.next();

    killed.kill();
    let _restarted =
        bridge(&bus, &["-u", &port.to_string(), "--bind", "127.0.0.2", "-m", "custom"]);

    // As ground stations do: it says again and again that it is there.
    eventually("it is heard again", || {
        station.hello();
        !station.all_for(Duration::from_millis(100)).is_empty()
    });
    let info = bus.uorb(&["info", "mavlink_status"]).fine();
    assert!(info.contains("\ninstance 0: advertised"), "{info}");
}

#[test]
fn garbage_is_counted_and_makes_nobody_a_partner() {
    let mut bus = Bus::start();
    let (_bridge, mut station) = link(&bus, &["-m", "custom"]);
    let _ = station.next();
    let stranger = UdpSocket::bind("127.0.0.1:0").unwrap();
    let bridge = ("127.0.0.1", station.bridge_port());
    let heartbeat = packet(MavHeader::default(), &MavMessage::HEARTBEAT(Default::default()));
    let mut unknown = heartbeat.clone();
    unknown[7..10].copy_from_slice(&[0x99, 0x99, 0x09]);
    let mut broken = heartbeat.clone();
    broken[12] ^= 0xff;
    for bytes in [&b"neither this"[..], &heartbeat[..9], &unknown, &broken] {
        stranger.send_to(bytes, bridge).unwrap();
    }

    let mut status = bus.subscribe::<MavlinkStatus>();
    eventually("all of it is counted", || {
        let Some(said) = status.copy() else { return false };
        // The broken one is searched for another that may begin in it.
        let garbage = 12 + 9 + broken.len() as u64;
        (said.rx_unknown, said.rx_bad_checksum) == (1, 1) && said.rx_garbage_bytes == garbage
    });
    let _ = station.all_for(Duration::from_millis(10));
    let (header, _) = station.next();
    assert_eq!(header.system_id, 1, "the ground station is the partner still");
}

#[test]
fn a_signed_link_takes_what_its_key_has_signed() {
    let mut bus = Bus::start();
    let dir = bus.system.base().to_path_buf();
    let key_file = dir.join("key");
    fs::write(&key_file, "07".repeat(32)).unwrap();
    fs::set_permissions(&key_file, fs::Permissions::from_mode(0o600)).unwrap();
    let key = |byte| SigningData::from_config(SigningConfig::new([byte; 32], 9, true, false));
    let (ours, theirs) = (key(7), key(8));
    let options = ["-m", "custom", "--signing-key", key_file.to_str().unwrap()];
    // Unsigned: what the ground station says first does not count.
    let (_bridge, mut station) = link(&bus, &options);
    let signed = |signing: &SigningData, seq_id| {
        let mut raw = MAVLinkV2MessageRaw::new();
        let data = CA_TRAJECTORY_MSG_DATA { seq_id, ..CA_TRAJECTORY_MSG_DATA::DEFAULT };
        let message = MavMessage::CA_TRAJECTORY_MSG(data);
        raw.serialize_message_for_signing(MavHeader::default(), &message);
        signing.sign_message(&mut raw);
        raw.raw_bytes().to_vec()
    };
    let mut trajectory = bus.subscribe::<CaTrajectoryMsg>();
    station.send_bytes(&signed(&theirs, 1));
    station.send_bytes(&signed(&ours, 2));

    let raw = station.next_raw();
    assert!(key(7).verify_signature(&raw) && !key(8).verify_signature(&raw));
    let _ = decode(&raw);
    let mut status = bus.subscribe::<MavlinkStatus>();
    eventually("the others are counted", || {
        let said = status.copy();
        said.is_some_and(|said| (said.rx_bad_signature, said.rx_messages) == (2, 1))
    });
    assert_eq!(trajectory.copy().map(|message| message.seq_id), Some(2));
}

fn connect(port: u16) -> TcpStream {
    let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream
}

#[test]
fn a_partner_may_connect_by_tcp_and_come_again() {
    let bus = Bus::start();
    let mut bridge = bridge(&bus, &["--tcp-listen", "0", "-m", "custom"]);
    let port = port_of_next_link(&mut bridge);
    for _ in 0..2 {
        let mut stream = connect(port);
        let (header, message) = read_message(&mut stream);
        assert!(matches!(message, MavMessage::HEARTBEAT(_)), "{message:?}");
        assert_eq!(header.system_id, 1);
    }
}

#[test]
fn a_bridge_connects_by_tcp_as_soon_as_somebody_listens_and_again() {
    let bus = Bus::start();
    // It has a port, and nobody listens there yet.
    let socket =
        socket(AddressFamily::Inet, SockType::Stream, SockFlag::SOCK_CLOEXEC, None).unwrap();
    bind(socket.as_raw_fd(), &SockaddrIn::new(127, 0, 0, 1, 0)).unwrap();
    let listener = TcpListener::from(socket);
    let address = listener.local_addr().unwrap();
    let mut bridge = bridge(&bus, &["--tcp", &address.to_string(), "-m", "custom"]);
    bridge.until(&["tcp -> ", "not connected"]);
    listen(&listener, Backlog::new(1).unwrap()).unwrap();
    for _ in 0..2 {
        let (mut stream, _) = listener.accept().unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let (_, message) = read_message(&mut stream);
        assert!(matches!(message, MavMessage::HEARTBEAT(_)), "{message:?}");
    }
}

#[test]
fn a_partner_that_broke_off_within_a_packet_does_not_deafen_the_next() {
    let bus = Bus::start();
    let mut bridge = bridge(&bus, &["--tcp-listen", "0", "-m", "custom"]);
    let port = port_of_next_link(&mut bridge);
    let mut first = connect(port);
    // In one piece: with the question, the bridge has what stands behind it.
    first.write_all(&[&question(1)[..], &[0xfd, 255, 0]].concat()).unwrap();
    until_answer(&mut first, 1);
    drop(first);

    let mut second = connect(port);
    second.write_all(&question(2)).unwrap();

    until_answer(&mut second, 2);
}

/// A serial device, and its other end.
fn serial() -> (String, File) {
    let master = posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let device = ptsname_r(&master).unwrap();
    (device, File::from(std::os::fd::OwnedFd::from(master)))
}

#[test]
fn a_serial_device_that_has_lost_bytes_hears_the_next_message() {
    let bus = Bus::start();
    let (device, mut master) = serial();
    let mut bridge = bridge(&bus, &["-d", &device, "-m", "custom"]);
    bridge.until(&["serial ", "57600 baud"]);

    // The beginning of a long packet, whose rest does not come.
    master.write_all(&[&[0xfd, 255, 0], &question(1)[..]].concat()).unwrap();

    until_answer(&mut master, 1);
}

#[test]
fn a_serial_device_carries_messages_both_ways() {
    let mut bus = Bus::start();
    let (device, mut master) = serial();
    let mut reader = BufReader::new(master.try_clone().unwrap());
    let mut bridge = bridge(&bus, &["-d", &device, "-b", "57600", "-m", "custom"]);
    bridge.until(&["serial ", "57600 baud"]);

    let (header, message) = read_message(&mut reader);
    assert!(matches!(message, MavMessage::HEARTBEAT(_)), "{message:?}");
    assert_eq!(header.system_id, 1);
    let mut trajectory = bus.subscribe::<CaTrajectoryMsg>();
    // Bytes that a terminal would act on are bytes here.
    let data = CA_TRAJECTORY_MSG_DATA {
        time_start_usec: 0x0d0a_0311_131a_0403,
        seq_id: 3,
        ..CA_TRAJECTORY_MSG_DATA::DEFAULT
    };
    let message = MavMessage::CA_TRAJECTORY_MSG(data);
    master.write_all(&packet(MavHeader::default(), &message)).unwrap();
    eventually("it arrives", || {
        let copied = trajectory.copy();
        copied.is_some_and(|message| message.time_start_usec == 0x0d0a_0311_131a_0403)
    });
}

#[test]
fn a_flooded_link_disturbs_no_other() {
    let mut bus = Bus::start();
    let mut bridge = bridge(&bus, &["-u", "0", "--", "-u", "0", "-m", "normal"]);
    let flooded = port_of_next_link(&mut bridge);
    let mut station = GroundStation::of(port_of_next_link(&mut bridge));
    let is_over = AtomicBool::new(false);
    let sent = thread::scope(|scope| {
        let flood = scope.spawn(|| {
            let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
            let mut bytes = [0xfd; 60];
            let (begin_us, mut sent) = (now_us(), 0_u64);
            while !is_over.load(Ordering::Relaxed) {
                bytes[10..18].copy_from_slice(&sent.to_le_bytes());
                sent += u64::from(socket.send_to(&bytes, ("127.0.0.1", flooded)).is_ok());
                // 100,000 a second.
                let ahead_us = (begin_us + sent * 10).saturating_sub(now_us());
                thread::sleep(Duration::from_micros(if ahead_us > 1_000 { ahead_us } else { 0 }));
            }
            sent
        });
        {
            let _over = AtEnd(&is_over);
            while_turning(&bus, || attitudes_come_at(&mut station, 15.0));
        }
        flood.join().unwrap()
    });
    assert!(sent > 10_000, "a flood: {sent}");
    let mut status = bus.subscribe::<MavlinkStatus>();
    eventually("it is counted", || {
        status.copy().is_some_and(|said| said.rx_garbage_bytes >= 60 * 1_000)
    });
}

#[test]
fn a_link_that_cannot_keep_up_sends_less_often_and_says_so() {
    let bus = Bus::start();
    while_turning(&bus, || {
        let (_bridge, mut station) = link(&bus, &["-m", "onboard", "-r", "2000"]);
        let session = Session::connect_to(&bus.system).unwrap();
        let mut status = uorb_core::Subscription::<MavlinkStatus>::subscribe(&session).unwrap();
        // Attitudes alone want 100 x 40 + 50 x 44 bytes a second.
        eventually("it keeps to its rate", || {
            let _ = station.all_for(Duration::from_millis(500));
            let Some(said) = status.copy() else { return false };
            said.rate_multiplier < 0.5 && (1_000.0..2_200.0).contains(&said.tx_rate)
        });
        assert_eq!(status.copy().unwrap().tx_dropped, 0);
        let words = bus.spawn_heard("mavlink", &["status"]).end().fine();
        assert!(words.contains("the link is too slow for its mode"), "{words}");
    });
}

#[test]
fn a_list_of_parameters_keeps_to_the_rate_of_its_link_and_streams_give_way() {
    let bus = Bus::start();
    let file = bus.system.base().join("many.params");
    fs::write(&file, (0..5_000).map(|n| format!("P{n} {n}\n")).collect::<String>()).unwrap();
    while_turning(&bus, || {
        let options = ["-m", "onboard", "-r", "2000", "--parameters", file.to_str().unwrap()];
        let (_bridge, mut station) = link(&bus, &options);
        let session = Session::connect_to(&bus.system).unwrap();
        let mut status = uorb_core::Subscription::<MavlinkStatus>::subscribe(&session).unwrap();
        station.send(&MavMessage::PARAM_REQUEST_LIST(PARAM_REQUEST_LIST_DATA {
            target_system: 1,
            target_component: 1,
        }));
        eventually("it keeps to its rate", || {
            let _ = station.all_for(Duration::from_millis(500));
            status.copy().is_some_and(|said| (1_000.0..2_200.0).contains(&said.tx_rate))
        });
        // It is not over, and the streams are there.
        station.until(|message| matches!(message, MavMessage::PARAM_VALUE(_)).then_some(()));
        station.until(attitude_ms);
    });
}

#[test]
fn a_list_of_parameters_ends_with_the_partner_who_asked_for_it() {
    let bus = Bus::start();
    let file = bus.system.base().join("many.params");
    fs::write(&file, (0..5_000).map(|n| format!("P{n} {n}\n")).collect::<String>()).unwrap();
    let options = ["--tcp-listen", "0", "-m", "custom", "--parameters", file.to_str().unwrap()];
    let mut bridge = bridge(&bus, &options);
    let port = port_of_next_link(&mut bridge);
    let mut first = connect(port);
    let list = PARAM_REQUEST_LIST_DATA { target_system: 1, target_component: 1 };
    let list = packet(MavHeader::default(), &MavMessage::PARAM_REQUEST_LIST(list));
    first.write_all(&list).unwrap();
    while !matches!(read_message(&mut first).1, MavMessage::PARAM_VALUE(_)) {}
    drop(first);

    let mut second = connect(port);

    for _ in 0..2 {
        let (_, message) = read_message(&mut second);
        assert!(matches!(message, MavMessage::HEARTBEAT(_)), "{message:?}");
    }
}

#[test]
fn words_of_modules_are_status_texts() {
    let mut bus = Bus::start();
    let (_bridge, mut station) = link(&bus, &["-m", "custom"]);
    let _ = station.next();
    let mut words = bus.advertise::<LogMessage>();
    let mut message = LogMessage { severity: 4, ..LogMessage::default() };
    let text = "Takeoff detected, and so many words that one message does not hold them";
    message.text[..text.len()].copy_from_slice(text.as_bytes());
    words.publish(&message).unwrap();

    let piece = |message: &MavMessage| match message {
        MavMessage::STATUSTEXT(piece) => Some(piece.clone()),
        _ => None,
    };
    let (first, second) = (station.until(piece), station.until(piece));
    assert_eq!((first.severity, first.chunk_seq, second.chunk_seq), (4, 0, 1));
    assert!(first.id == second.id && first.id != 0);
    assert_eq!([first.text.to_str().unwrap(), second.text.to_str().unwrap()].concat(), text);
}

#[test]
fn a_trajectory_that_is_published_reaches_the_partner_and_one_that_came_in_does_not_go_back() {
    let mut bus = Bus::start();
    let (_bridge, mut station) = link(&bus, &[]);
    let _ = station.next();
    let mut data = CA_TRAJECTORY_MSG_DATA { seq_id: 7, ..CA_TRAJECTORY_MSG_DATA::DEFAULT };
    data.coefficients = std::array::from_fn(|index| index as f32 + 0.25);
    let mut trajectory = bus.subscribe::<CaTrajectoryMsg>();
    station.send(&MavMessage::CA_TRAJECTORY_MSG(data.clone()));
    eventually("it arrives", || trajectory.copy().is_some());
    let copied = trajectory.copy().unwrap();
    assert_eq!((copied.coefficients, copied.seq_id), (data.coefficients, 7));
    assert!(copied.timestamp > 0, "the bridge stamps it");

    let published = bus.uorb(&["pub", "ca_trajectory_msg", "seq_id=8", "time_start_usec=5"]);
    assert_eq!(published.code, 0, "{}", published.words);
    let sent = station.until(|message| match message {
        MavMessage::CA_TRAJECTORY_MSG(sent) => Some(sent.clone()),
        _ => None,
    });
    assert_eq!((sent.seq_id, sent.time_start_usec), (8, 5));
}

topic! {
    /// As a flight log of 2017 has it: without angles.
    pub struct LoggedAttitude = "vehicle_attitude" {
        pub timestamp: u64,
        pub rollspeed: f32,
        pub pitchspeed: f32,
        pub yawspeed: f32,
        pub q: [f32; 4],
        pub _padding0: [u8; 4],
    }
}

#[test]
fn topics_of_another_year_are_read_by_the_names_of_their_fields() {
    let mut bus = Bus::start();
    let (_bridge, mut station) = link(&bus, &["-m", "onboard"]);
    let _ = station.next();
    let mut attitude = bus.advertise::<LoggedAttitude>();
    let half = (0.5_f32).sqrt();
    let q = [half, 0.0, 0.0, half];
    attitude.publish(&LoggedAttitude { yawspeed: 0.125, q, ..Default::default() }).unwrap();

    let message = station.until(|message| match message {
        MavMessage::ATTITUDE(attitude) => Some(attitude.clone()),
        _ => None,
    });
    assert!((message.yaw - std::f32::consts::FRAC_PI_2).abs() < 1e-5, "{message:?}");
    assert_eq!(message.yawspeed, 0.125);
}

#[test]
fn what_cannot_be_is_said_with_its_cure() {
    let bus = Bus::start();
    let mavlink = |arguments: &[&str]| bus.spawn_heard("mavlink", arguments).end();
    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    mavlink(&["-u", &port]).failed(&[&port, "in use"]);
    mavlink(&["-u", "0", "-t", "192.0.2.1"]).failed(&["--bind 0.0.0.0"]);
    mavlink(&["-d", "/dev/no-such-device"]).failed(&["/dev/no-such-device"]);
    for vehicle in ["250", "60000", "4294967295"] {
        mavlink(&["-u", "0", "-i", vehicle]).failed(&["0 to 249", "-i"]);
        mavlink(&["-i", vehicle]).failed(&["0 to 249", "-i"]);
    }
    mavlink(&["-m", "minimal"]).failed(&["-m", "-u"]);
    mavlink(&["-u", "0", "-t", "::1", "--bind", "127.0.0.1"]).failed(&["::1", "127.0.0.1"]);
    mavlink(&["-u", "0", "--signing-key", "/dev/null"]).failed(&["openssl rand -hex 32"]);
}

#[test]
fn a_bridge_ends_with_its_system() {
    let mut bus = Bus::start();
    let (mut bridge, mut station) = link(&bus, &["-m", "custom"]);
    let _ = station.next();
    bus.stop();
    let ended = bridge.end();
    assert_eq!(ended.code, 0, "{}", ended.words);
}
