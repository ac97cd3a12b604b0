//! A ground station: the other end of a link of the MAVLink bridge.
//!
//! It is at a port of its own, and hears where the bridge is from the first
//! heartbeat. What it waits for it waits for by name; what else comes is passed over.

use std::net::{SocketAddr, UdpSocket};
use std::time::Instant;

use mavlink_core::{MAVLinkV2MessageRaw, MavHeader};
use uorb_mavlink::dialect::{COMMAND_LONG_DATA, MavMessage, PING_DATA};
use uorb_mavlink::frame::{Delivery, Parser};
use uorb_tests::{Actor, Bus, PATIENCE};

/// What QGroundControl calls itself.
pub(crate) const SYSTEM_ID: u8 = 255;
pub(crate) const COMPONENT_ID: u8 = 190;

pub(crate) struct GroundStation {
    socket: UdpSocket,
    bridge: SocketAddr,
    parser: Parser,
    sequence: u8,
    pings: u32,
}

impl GroundStation {
    /// Starts a bridge with one link, which goes here, and waits for its heartbeat.
    pub(crate) fn with_bridge(bus: &Bus, arguments: &[&str]) -> (Self, Actor) {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        let port = socket.local_addr().unwrap().port().to_string();
        let link = ["-u", "0", "-o", &port];
        let bridge = bus.spawn_heard("mavlink", &[&link[..], arguments].concat());
        let address = socket.peek_from(&mut [0; 1]).expect("a heartbeat").1;
        let parser = Parser::new(Delivery::Datagrams, None);
        (Self { socket, bridge: address, parser, sequence: 0, pings: 0 }, bridge)
    }

    /// Sends bytes, whatever they are.
    pub(crate) fn send_bytes(&mut self, bytes: &[u8]) {
        self.socket.send_to(bytes, self.bridge).unwrap();
    }

    pub(crate) fn send(&mut self, message: &MavMessage) {
        let mut raw = MAVLinkV2MessageRaw::new();
        let header = MavHeader {
            system_id: SYSTEM_ID.into(),
            component_id: COMPONENT_ID,
            sequence: self.sequence,
        };
        self.sequence = self.sequence.wrapping_add(1);
        raw.serialize_message(header, message);
        self.send_bytes(raw.raw_bytes());
    }

    /// The next message of the bridge.
    pub(crate) fn next(&mut self) -> MavMessage {
        let mut bytes = [0; 2_048];
        loop {
            if let Some(packet) = self.parser.next_packet() {
                return packet.message;
            }
            let (len, _) = self.socket.recv_from(&mut bytes).expect("the bridge says something");
            self.parser.push(&bytes[..len]);
        }
    }

    /// Waits for a message of which there is something to say.
    #[track_caller]
    pub(crate) fn until<R>(&mut self, mut look: impl FnMut(&MavMessage) -> Option<R>) -> R {
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            if let Some(found) = look(&self.next()) {
                return found;
            }
        }
        panic!("it did not come")
    }

    /// All that the bridge has said until it has taken what was sent so far.
    pub(crate) fn said_so_far(&mut self) -> Vec<MavMessage> {
        self.pings += 1;
        let seq = self.pings;
        self.send(&MavMessage::PING(PING_DATA { seq, ..PING_DATA::DEFAULT }));
        let mut said = Vec::new();
        self.until(|message| {
            let is_back = matches!(message, MavMessage::PING(ping) if ping.seq == seq);
            said.push(message.clone());
            is_back.then_some(())
        });
        said
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
        assert_eq!((ack.target_system, ack.target_component), (SYSTEM_ID, COMPONENT_ID));
        ack.result
    }

    /// So many answers to commands are on their way here.
    pub(crate) fn answers_so_far(&mut self) -> usize {
        let said = self.said_so_far();
        said.iter().filter(|message| matches!(message, MavMessage::COMMAND_ACK(_))).count()
    }
}
