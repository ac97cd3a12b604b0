//! The MAVLink bridge: how long a message takes through it, both ways, and what
//! it costs.
//!
//! A trajectory (CA_TRAJECTORY_MSG, 138 bytes) is published until its packet is in
//! the partner's hands, and sent until its copy is in a subscriber's. The floor is a
//! datagram of as many bytes from one socket to another, of the same thread: the
//! bridge has a thread to wake as well. The partner is beside the publisher, in this
//! process; each message has been followed to its end before the next.

use std::net::{SocketAddr, UdpSocket};
use std::thread::sleep;
use std::time::{Duration, Instant};

use mavlink_core::{MAVLinkV2MessageRaw, MavHeader};
use uorb_core::{Subscription, poll};
use uorb_mavlink::dialect::{CA_TRAJECTORY_MSG_DATA, HEARTBEAT_DATA, MavMessage};
use uorb_msg::CaTrajectoryMsg;
use uorb_tests::{Actor, Bus, PATIENCE};

use super::Run;
use super::scale::cpu;
use crate::figures::Contestant;
use crate::times::Times;

/// In which the bridge falls asleep again.
const BETWEEN: Duration = Duration::from_micros(500);

/// Longer than any packet of ours.
const PACKET_MAX: usize = 300;

/// The number of CA_TRAJECTORY_MSG, where a packet has it.
const TRAJECTORY: [u8; 3] = [0x66, 0x5e, 0];

pub fn measure(run: &mut Run, bus: &mut Bus) {
    latency(run, bus);
    cost(run, bus);
}

/// The partner at the other end of a link.
struct Partner {
    socket: UdpSocket,
    bridge: SocketAddr,
    sequence: u8,
}

impl Partner {
    /// Starts a bridge, and waits for its heartbeat.
    fn start(bus: &Bus, mode: &str) -> (Self, Actor) {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
        socket.set_read_timeout(Some(PATIENCE)).expect("a time");
        let port = socket.local_addr().expect("it has one").port().to_string();
        let actor = bus.spawn_heard("mavlink", &["-u", "0", "-o", &port, "-m", mode]);
        let (_, bridge) = socket.recv_from(&mut [0; PACKET_MAX]).expect("a heartbeat");
        let mut partner = Self { socket, bridge, sequence: 0 };
        partner.send(&MavMessage::HEARTBEAT(HEARTBEAT_DATA::DEFAULT));
        (partner, actor)
    }

    fn send(&mut self, message: &MavMessage) {
        let mut raw = MAVLinkV2MessageRaw::new();
        let header = MavHeader { system_id: 255, component_id: 190, sequence: self.sequence };
        self.sequence = self.sequence.wrapping_add(1);
        raw.serialize_message(header, message);
        self.socket.send_to(raw.raw_bytes(), self.bridge).expect("sent");
    }

    /// Waits for a trajectory; heartbeats are passed over.
    fn receive_trajectory(&self) {
        let mut packet = [0; PACKET_MAX];
        loop {
            let (len, _) = self.socket.recv_from(&mut packet).expect("it comes");
            if len > 10 && packet[7..10] == TRAJECTORY {
                return;
            }
        }
    }
}

fn latency(run: &mut Run, bus: &mut Bus) {
    let times = run.figures.effort.wakes / 5 + 10;
    let mut publication = bus.advertise::<CaTrajectoryMsg>();
    let mut subscription = bus.subscribe::<CaTrajectoryMsg>();
    let (mut partner, mut bridge) = Partner::start(bus, "onboard");
    // Those of other processes go out; the first says that the stream is there.
    publication.publish(&trajectory(0)).expect("published");
    partner.receive_trajectory();

    let [near, far] = [0; 2].map(|_| UdpSocket::bind("127.0.0.1:0").expect("a port"));
    let address = far.local_addr().expect("it has one");
    let mut floor = || {
        time(times, |_| {
            near.send_to(&[1; 150], address).expect("sent");
            far.recv_from(&mut [0; PACKET_MAX]).expect("it comes");
        })
    };
    let out = Contestant::new("mavlink", || {
        time(times, |seq_id| {
            publication.publish(&trajectory(seq_id)).expect("published");
            partner.receive_trajectory();
        })
    });
    let figures = &mut run.figures;
    figures.measure(("MAVLink, publish to packet", "138 B"), ("a datagram", &mut floor), vec![out]);
    subscription.skip();
    let come_in = Contestant::new("mavlink", || {
        time(times, |seq_id| {
            let message = CA_TRAJECTORY_MSG_DATA { seq_id, ..CA_TRAJECTORY_MSG_DATA::DEFAULT };
            partner.send(&MavMessage::CA_TRAJECTORY_MSG(message));
            wait(&mut subscription);
        })
    });
    figures.measure(
        ("MAVLink, packet to topic", "138 B"),
        ("a datagram", &mut floor),
        vec![come_in],
    );
    bridge.interrupt();
}

fn trajectory(seq_id: u16) -> CaTrajectoryMsg {
    CaTrajectoryMsg { seq_id, coefficients: [0.5; 28], ..Default::default() }
}

fn wait(subscription: &mut Subscription<CaTrajectoryMsg>) {
    poll(&mut [&mut *subscription], Some(PATIENCE)).expect("the bus goes on");
    subscription.copy().expect("it was published");
}

/// Times what ends when the message is there.
fn time(times: u32, mut pass: impl FnMut(u16)) -> Times {
    let mut took = Times::none();
    for count in 0..times {
        sleep(BETWEEN);
        let began = Instant::now();
        pass(count as u16);
        took.add_ns(began.elapsed().as_nanos() as f64);
    }
    took
}

/// The processor time of a bridge with one link, beside a whole vehicle.
fn cost(run: &mut Run, bus: &mut Bus) {
    let _sim = bus.spawn_heard("sensor_sim", &["--vehicle"]);
    let _sensors = bus.spawn_heard("sensors", &[]);
    for mode in ["normal", "onboard"] {
        let (partner, mut bridge) = Partner::start(bus, mode);
        let (before, began) = (cpu(bridge.pid()), Instant::now());
        let watched = Duration::from_millis(run.figures.effort.watch_ms);
        let mut packets = 0_u32;
        while began.elapsed() < watched {
            partner.socket.recv_from(&mut [0; PACKET_MAX]).expect("it comes");
            packets += 1;
        }
        let passed = began.elapsed();
        let share = (cpu(bridge.pid()) - before).as_secs_f64() / passed.as_secs_f64();
        let rate = f64::from(packets) / passed.as_secs_f64();
        let row = ("MAVLink, a link beside sensor_sim", mode);
        run.figures.note_value(row, "mavlink, CPU", share * 100.0, "%");
        run.figures.note_value(row, "mavlink, packets", rate, "Hz");
        bridge.interrupt();
    }
}
