//! A partner of the MAVLink bridge, made of the mavlink crate and a socket.

use std::io::{ErrorKind, Read};
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use mavlink_core::{MAVLinkV2MessageRaw, MavHeader, MavlinkVersion, Message};
use uorb_mavlink::dialect::{HEARTBEAT_DATA, MavMessage};
use uorb_tests::{Actor, PATIENCE};

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
        let mut station = Self::new();
        station.bridge = Some(SocketAddr::from(([127, 0, 0, 1], port)));
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

/// The port of a UDP or TCP link: `[mavlink] udp 127.0.0.1:4711 -> ...`.
#[track_caller]
pub(crate) fn port_of_next_link(bridge: &mut Actor) -> u16 {
    let line = bridge.until(&["[mavlink] "]);
    let port = line.split_whitespace().nth(2).and_then(|address| address.rsplit(':').next());
    port.and_then(|port| port.parse().ok()).unwrap_or_else(|| panic!("no port in {line:?}"))
}
