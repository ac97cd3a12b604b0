//! A partner of the MAVLink bridge, made of the mavlink crate and a socket.

use std::io::{ErrorKind, Read};
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use mavlink_core::{MAVLinkV2MessageRaw, MavHeader, MavlinkVersion, Message};
use uorb_mavlink::dialect::{COMMAND_LONG_DATA, HEARTBEAT_DATA, MavMessage, PING_DATA};
use uorb_tests::{Actor, Bus, PATIENCE};

/// Our number: that of ground stations.
const GROUND_STATION: MavHeader = MavHeader { system_id: 255, component_id: 190, sequence: 0 };

/// A ground station at the other end of a UDP link.
pub(crate) struct GroundStation {
    socket: UdpSocket,
    /// Where the bridge is.
    bridge: Option<SocketAddr>,
    sequence: u8,
}

impl GroundStation {
    /// One that has a port, and that nobody knows yet.
    pub(crate) fn new() -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
        socket.set_read_timeout(Some(PATIENCE)).expect("a time");
        Self { socket, bridge: None, sequence: 0 }
    }

    /// One that speaks to the bridge at this port.
    pub(crate) fn of(port: u16) -> Self {
        Self::at(([127, 0, 0, 1], port).into())
    }

    /// One that speaks to the bridge at this address.
    pub(crate) fn at(bridge: SocketAddr) -> Self {
        let mut station = Self::new();
        station.bridge = Some(bridge);
        station.hello();
        station
    }

    /// Its port.
    pub(crate) fn port(&self) -> u16 {
        self.socket.local_addr().expect("it has one").port()
    }

    /// The bridge's port.
    pub(crate) fn bridge_port(&self) -> u16 {
        self.bridge.expect("it is known").port()
    }

    /// Says that it is there.
    pub(crate) fn hello(&mut self) {
        self.send(&MavMessage::HEARTBEAT(HEARTBEAT_DATA { mavtype: 6, ..HEARTBEAT_DATA::DEFAULT }));
    }

    /// Sends a message.
    pub(crate) fn send(&mut self, message: &MavMessage) {
        let header = MavHeader { sequence: self.sequence, ..GROUND_STATION };
        self.sequence = self.sequence.wrapping_add(1);
        self.send_bytes(&packet(header, message));
    }

    /// Sends what may be no message at all.
    pub(crate) fn send_bytes(&self, bytes: &[u8]) {
        self.socket.send_to(bytes, self.bridge.expect("it is known")).expect("sent");
    }

    /// The next packet, as it came.
    #[track_caller]
    pub(crate) fn next_raw(&mut self) -> MAVLinkV2MessageRaw {
        let mut bytes = MAVLinkV2MessageRaw::new();
        let (_, bridge) = self.socket.recv_from(bytes.as_mut_slice()).expect("it says something");
        self.bridge = Some(bridge);
        bytes
    }

    /// The next message, and who sent it.
    #[track_caller]
    pub(crate) fn next(&mut self) -> (MavHeader, MavMessage) {
        decode(&self.next_raw())
    }

    /// Reads on until `pick` has found what it looks for.
    #[track_caller]
    pub(crate) fn until<R>(&mut self, pick: impl Fn(&MavMessage) -> Option<R>) -> R {
        let deadline = Instant::now() + PATIENCE;
        loop {
            assert!(Instant::now() < deadline, "it says other things only");
            if let Some(found) = pick(&self.next().1) {
                return found;
            }
        }
    }

    /// Reads on for a while, and returns all.
    pub(crate) fn all_for(&mut self, time: Duration) -> Vec<(MavHeader, MavMessage)> {
        let deadline = Instant::now() + time;
        let mut all = Vec::new();
        while let Some(rest) = deadline.checked_duration_since(Instant::now()) {
            self.socket.set_read_timeout(Some(rest.max(Duration::from_millis(1)))).expect("a time");
            let mut raw = MAVLinkV2MessageRaw::new();
            match self.socket.recv_from(raw.as_mut_slice()) {
                Ok(_) => all.push(decode(&raw)),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => panic!("{error}"),
            }
        }
        self.socket.set_read_timeout(Some(PATIENCE)).expect("a time");
        all
    }
}

/// Commands, and what else is asked.
impl GroundStation {
    /// Starts a bridge with one link, and speaks to it.
    pub(crate) fn with_bridge(bus: &Bus, arguments: &[&str]) -> (Self, Actor) {
        let mut bridge = bus.spawn_heard("mavlink", &[&["-u", "0"], arguments].concat());
        let station = Self::of(port_of_next_link(&mut bridge));
        (station, bridge)
    }

    /// All that the bridge says until it has taken what was sent so far.
    #[track_caller]
    pub(crate) fn said_so_far(&mut self) -> Vec<MavMessage> {
        // Links answer in order.
        let seq = u32::from(self.sequence);
        self.send(&MavMessage::PING(PING_DATA { seq, ..PING_DATA::DEFAULT }));
        let mut said = Vec::new();
        let deadline = Instant::now() + PATIENCE;
        loop {
            assert!(Instant::now() < deadline, "it does not answer: {said:?}");
            match self.next().1 {
                MavMessage::PING(ping) if ping.seq == seq => return said,
                message => said.push(message),
            }
        }
    }

    /// Sends a command to vehicle 1.
    pub(crate) fn command(&mut self, command: u16, confirmation: u8, param1: f32, param2: f32) {
        self.send(&MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            target_system: 1,
            target_component: 1,
            command,
            confirmation,
            param1,
            param2,
            ..COMMAND_LONG_DATA::DEFAULT
        }));
    }

    /// How a command was answered; the answer is addressed to us.
    #[track_caller]
    pub(crate) fn result_of(&mut self, command: u16) -> u8 {
        let ack = self.until(|message| match message {
            MavMessage::COMMAND_ACK(ack) => Some(ack.clone()),
            _ => None,
        });
        assert_eq!(ack.command, command);
        assert_eq!((u32::from(ack.target_system), ack.target_component), (255, 190));
        ack.result
    }

    /// How many answers to commands are on their way here.
    #[track_caller]
    pub(crate) fn answers_so_far(&mut self) -> usize {
        let said = self.said_so_far();
        said.iter().filter(|message| matches!(message, MavMessage::COMMAND_ACK(_))).count()
    }
}

/// A message as bytes.
pub(crate) fn packet(header: MavHeader, message: &MavMessage) -> Vec<u8> {
    let mut raw = MAVLinkV2MessageRaw::new();
    raw.serialize_message(header, message);
    raw.raw_bytes().to_vec()
}

/// A message of a packet that must be whole.
#[track_caller]
pub(crate) fn decode(raw: &MAVLinkV2MessageRaw) -> (MavHeader, MavMessage) {
    assert!(raw.has_valid_crc::<MavMessage>(), "a whole packet: {:?}", raw.raw_bytes());
    let header = MavHeader {
        system_id: raw.system_id(),
        component_id: raw.component_id(),
        sequence: raw.sequence(),
    };
    let message = MavMessage::parse(MavlinkVersion::V2, raw.message_id(), raw.payload());
    (header, message.expect("a message of ours"))
}

/// The next message of a stream of bytes.
#[track_caller]
pub(crate) fn read_message(stream: &mut impl Read) -> (MavHeader, MavMessage) {
    let mut raw = MAVLinkV2MessageRaw::new();
    let bytes = raw.as_mut_slice();
    stream.read_exact(&mut bytes[..10]).expect("a header");
    assert_eq!((bytes[0], bytes[2]), (0xfd, 0), "MAVLink 2, unsigned");
    let end = 12 + usize::from(bytes[1]);
    stream.read_exact(&mut bytes[10..end]).expect("the rest of it");
    decode(&raw)
}

/// A question that every bridge answers.
pub(crate) fn question(seq: u32) -> Vec<u8> {
    packet(GROUND_STATION, &MavMessage::PING(PING_DATA { seq, ..PING_DATA::DEFAULT }))
}

/// Reads on until the question of this number is answered.
#[track_caller]
pub(crate) fn until_answer(stream: &mut impl Read, seq: u32) {
    let deadline = Instant::now() + PATIENCE;
    loop {
        assert!(Instant::now() < deadline, "it does not answer");
        if let (_, MavMessage::PING(ping)) = read_message(stream)
            && ping.seq == seq
        {
            return;
        }
    }
}

/// The port of a UDP or TCP link: `[mavlink] udp 127.0.0.1:4711 -> ...`.
#[track_caller]
pub(crate) fn port_of_next_link(bridge: &mut Actor) -> u16 {
    let line = bridge.until(&["[mavlink] "]);
    let port = line.split_whitespace().nth(2).and_then(|address| address.rsplit(':').next());
    port.and_then(|port| port.parse().ok()).unwrap_or_else(|| panic!("no port in {line:?}"))
}
