//! From bytes to messages, with a count of all that was not one.
//!
//! Bytes of others are an allegation: a packet is one when its checksum holds,
//! and on a signed link its signature. What is refused is searched again from
//! its second byte on, since a packet may begin inside of what only looked like
//! one. A message that the dialect does not know has a checksum that nobody can
//! check; it is taken for one if another packet, or nothing, follows it.

use std::collections::HashMap;
use std::fmt;
use std::sync::Arc;

use mavlink_core::consts::{CHECKSUM_SIZE, MAX_FRAME_SIZE, STX_SIZE, v1, v2};
use mavlink_core::error::ParserError;
use mavlink_core::{
    MAV_STX, MAV_STX_V2, MAVLinkV1MessageRaw, MAVLinkV2MessageRaw, MavHeader, MavlinkVersion,
    Message, SigningData,
};

use crate::dialect::MavMessage;

/// A message, and who sent it.
#[derive(Clone, Debug, PartialEq)]
pub struct Packet {
    /// Its sender, and its place among that sender's.
    pub header: MavHeader,
    /// What it says.
    pub message: MavMessage,
}

/// What has come in, since the link began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Received {
    /// Bytes of any kind.
    pub bytes: u64,
    /// Messages that were taken.
    pub messages: u64,
    /// Packets whose checksum is wrong.
    pub bad_checksum: u64,
    /// Packets that are not signed, or wrongly, on a link that demands it.
    pub bad_signature: u64,
    /// Messages that the dialect does not know.
    pub unknown: u64,
    /// Messages that are missing in the senders' numbering.
    pub lost: u64,
    /// Bytes that belong to no packet.
    pub garbage_bytes: u64,
}

/// How bytes arrive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// In datagrams: a packet is whole in one, or it is truncated.
    Datagrams,
    /// In a stream: the rest of a packet may come later.
    Stream,
    /// On a line that may lose bytes: the rest of a packet comes soon, or never.
    Line,
}

/// For so long the rest of a packet is waited for on a line: the longest packet takes
/// 280 bytes x 10 bits / 9600 baud = 0.3 s.
const REST_TIMEOUT_US: u64 = 1_000_000;

/// Finds messages in bytes.
pub struct Parser {
    delivery: Delivery,
    signing: Option<Arc<SigningData>>,
    pending: Vec<u8>,
    /// How much of `pending` has been looked at.
    start: usize,
    /// Which byte of all that were received begins a packet whose rest is waited for,
    /// and since when.
    waiting: Option<(u64, u64)>,
    /// Each sender's newest number.
    sequences: HashMap<(u32, u8), u8>,
    received: Received,
}

impl fmt::Debug for Parser {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Parser").field("received", &self.received).finish_non_exhaustive()
    }
}

/// What begins at a marker.
enum Candidate {
    /// More bytes are needed to tell.
    Incomplete,
    /// No packet.
    None,
    /// A packet of this version and length.
    Whole(MavlinkVersion, usize),
}

impl Parser {
    /// With `signing`, only what is signed with its key is taken.
    pub fn new(delivery: Delivery, signing: Option<Arc<SigningData>>) -> Self {
        Self {
            delivery,
            signing,
            pending: Vec::new(),
            start: 0,
            waiting: None,
            sequences: HashMap::new(),
            received: Received::default(),
        }
    }

    /// What has come in so far.
    pub fn received(&self) -> &Received {
        &self.received
    }

    /// Takes bytes; [`Parser::next_packet`] has the messages in them.
    pub fn push(&mut self, bytes: &[u8]) {
        self.pending.drain(..self.start);
        self.start = 0;
        self.pending.extend_from_slice(bytes);
        self.received.bytes += bytes.len() as u64;
    }

    /// A stream begins: no rest of a packet of the last one will come.
    pub fn begin(&mut self) {
        self.received.garbage_bytes += (self.pending.len() - self.start) as u64;
        self.pending.clear();
        self.start = 0;
    }

    /// Gives up a packet whose rest was waited for long enough, as its length may be what
    /// the line has changed; another may begin within what there is of it. Called now and
    /// then, when there is no next packet.
    pub fn give_up(&mut self, now_us: u64) {
        let rest_bytes = (self.pending.len() - self.start) as u64;
        if self.delivery != Delivery::Line || rest_bytes == 0 {
            self.waiting = None;
            return;
        }
        let begins_at = self.received.bytes - rest_bytes;
        match self.waiting {
            Some((same, since_us)) if same == begins_at => {
                if now_us >= since_us + REST_TIMEOUT_US {
                    self.refuse();
                }
            }
            _ => self.waiting = Some((begins_at, now_us)),
        }
    }

    /// The next message of the bytes so far.
    pub fn next_packet(&mut self) -> Option<Packet> {
        loop {
            self.skip_to_marker();
            let rest = &self.pending[self.start..];
            match look(rest) {
                Candidate::Incomplete if rest.is_empty() => return None,
                Candidate::Incomplete if self.delivery != Delivery::Datagrams => return None,
                Candidate::Incomplete | Candidate::None => self.refuse(),
                Candidate::Whole(version, len) => {
                    if let Some(packet) = self.take(version, len) {
                        return Some(packet);
                    }
                }
            }
        }
    }

    fn skip_to_marker(&mut self) {
        let rest = &self.pending[self.start..];
        let skipped = rest.iter().position(|byte| is_marker(*byte)).unwrap_or(rest.len());
        self.start += skipped;
        self.received.garbage_bytes += skipped as u64;
    }

    fn refuse(&mut self) {
        self.start += 1;
        self.received.garbage_bytes += 1;
    }

    /// Takes the packet at `start`, if it holds.
    fn take(&mut self, version: MavlinkVersion, len: usize) -> Option<Packet> {
        let frame = &self.pending[self.start..self.start + len];
        let (header, id, payload, holds, signed) = match version {
            MavlinkVersion::V1 => {
                let mut bytes = [0; v1::FRAME_SIZE];
                bytes[..len].copy_from_slice(frame);
                let raw = MAVLinkV1MessageRaw::from_bytes_unparsed(bytes);
                let header = MavHeader {
                    system_id: raw.system_id().into(),
                    component_id: raw.component_id(),
                    sequence: raw.sequence(),
                };
                let id = u32::from(raw.message_id());
                let holds = raw.has_valid_crc::<MavMessage>();
                (header, id, raw.payload().to_vec(), holds, self.signing.is_none())
            }
            MavlinkVersion::V2 => {
                let mut bytes = [0; MAX_FRAME_SIZE];
                bytes[..len].copy_from_slice(frame);
                let raw = MAVLinkV2MessageRaw::from_bytes_unparsed(bytes);
                let header = MavHeader {
                    system_id: raw.system_id(),
                    component_id: raw.component_id(),
                    sequence: raw.sequence(),
                };
                let holds = raw.has_valid_crc::<MavMessage>();
                // What has a wrong checksum is not worth the sum of a signature.
                let signing = self.signing.as_ref().filter(|_| holds);
                let signed = signing.is_none_or(|signing| signing.verify_signature(&raw));
                (header, raw.message_id(), raw.payload().to_vec(), holds, signed)
            }
        };
        if !holds {
            // No message of ours has 0 for its extra byte: the number is unknown.
            let is_unknown = MavMessage::extra_crc(id) == 0;
            let next = self.pending.get(self.start + len);
            if is_unknown && next.is_none_or(|byte| is_marker(*byte)) {
                self.start += len;
                self.received.unknown += 1;
                // It is unknown and not missing.
                self.count(header);
            } else {
                self.received.bad_checksum += u64::from(!is_unknown);
                self.refuse();
            }
            return None;
        }
        self.start += len;
        if !signed {
            self.received.bad_signature += 1;
            return None;
        }
        self.count(header);
        match MavMessage::parse(version, id, &payload) {
            Ok(message) => {
                self.received.messages += 1;
                Some(Packet { header, message })
            }
            Err(ParserError::UnknownMessage { .. } | ParserError::InvalidEnum { .. }) => {
                self.received.unknown += 1;
                None
            }
            Err(_) => {
                self.received.bad_checksum += 1;
                None
            }
        }
    }

    /// Counts what is missing between a sender's last message and this one.
    fn count(&mut self, header: MavHeader) {
        let sender = (header.system_id, header.component_id);
        if let Some(last) = self.sequences.insert(sender, header.sequence) {
            let missing = header.sequence.wrapping_sub(last).wrapping_sub(1);
            // More is a step back: a message that is late, or a sender that has
            // started again.
            if missing < 128 {
                self.received.lost += u64::from(missing);
            }
        }
    }
}

fn is_marker(byte: u8) -> bool {
    byte == MAV_STX || byte == MAV_STX_V2
}

/// What begins with `bytes`: the lengths alone, no checksum.
fn look(bytes: &[u8]) -> Candidate {
    let (version, len) = match *bytes {
        [MAV_STX, payload, ..] => {
            (MavlinkVersion::V1, STX_SIZE + v1::HEADER_SIZE + usize::from(payload) + CHECKSUM_SIZE)
        }
        [MAV_STX_V2, payload, flags, ..] => {
            // Whoever does not know a flag must not read the packet.
            if flags & !v2::IFLAG_SIGNED != 0 {
                return Candidate::None;
            }
            let signature = if flags == 0 { 0 } else { v2::SIGNATURE_SIZE };
            let unsigned = STX_SIZE + v2::MIN_HEADER_SIZE + usize::from(payload) + CHECKSUM_SIZE;
            (MavlinkVersion::V2, unsigned + signature)
        }
        _ => return Candidate::Incomplete,
    };
    if bytes.len() < len { Candidate::Incomplete } else { Candidate::Whole(version, len) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::{CA_TRAJECTORY_MSG_DATA, HEARTBEAT_DATA};
    use mavlink_core::SigningConfig;

    fn packet(sequence: u8, message: &MavMessage) -> Vec<u8> {
        let mut raw = MAVLinkV2MessageRaw::new();
        let header = MavHeader { system_id: 255, component_id: 190, sequence };
        raw.serialize_message(header, message);
        raw.raw_bytes().to_vec()
    }

    fn heartbeat(custom_mode: u32) -> MavMessage {
        MavMessage::HEARTBEAT(HEARTBEAT_DATA { custom_mode, ..HEARTBEAT_DATA::DEFAULT })
    }

    fn all(parser: &mut Parser) -> Vec<MavMessage> {
        std::iter::from_fn(|| parser.next_packet()).map(|packet| packet.message).collect()
    }

    #[test]
    fn every_message_has_an_extra_byte() {
        for id in MavMessage::all_ids() {
            assert_ne!(MavMessage::extra_crc(*id), 0, "message {id}");
        }
    }

    #[test]
    fn checksums_are_those_of_everybody_else() {
        // As pymavlink has them: the names, types and order of the fields are right.
        for (id, extra) in [(0, 50), (24, 24), (30, 39), (76, 152), (77, 143), (105, 93)] {
            assert_eq!(MavMessage::extra_crc(id), extra, "message {id}");
        }
        for (id, extra) in [(147, 154), (148, 178), (242, 104), (245, 130), (253, 83), (33, 104)] {
            assert_eq!(MavMessage::extra_crc(id), extra, "message {id}");
        }
    }

    #[test]
    fn a_stream_may_come_byte_by_byte() {
        let bytes = [packet(0, &heartbeat(1)), packet(1, &heartbeat(2))].concat();
        let mut parser = Parser::new(Delivery::Stream, None);
        let mut messages = Vec::new();
        for byte in bytes {
            parser.push(&[byte]);
            messages.extend(all(&mut parser));
        }
        assert_eq!(messages, [heartbeat(1), heartbeat(2)]);
        assert_eq!(parser.received().garbage_bytes, 0);
    }

    #[test]
    fn what_a_stream_broke_off_is_no_part_of_the_next() {
        let mut parser = Parser::new(Delivery::Stream, None);
        parser.push(&[0xfd, 255, 0]);
        assert_eq!(all(&mut parser), []);
        parser.begin();
        parser.push(&packet(0, &heartbeat(1)));
        assert_eq!(all(&mut parser), [heartbeat(1)]);
        assert_eq!(parser.received().garbage_bytes, 3);
    }

    #[test]
    fn a_line_waits_a_second_for_the_rest_of_a_packet_and_a_stream_for_ever() {
        let bytes = [&[0xfd, 255, 0][..], &packet(0, &heartbeat(1))].concat();
        let heard = |delivery, pieces: [&[u8]; 2], waited_us| {
            let mut parser = Parser::new(delivery, None);
            parser.push(pieces[0]);
            assert_eq!(all(&mut parser), []);
            parser.give_up(7);
            parser.push(pieces[1]);
            assert_eq!(all(&mut parser), []);
            parser.give_up(7 + waited_us);
            all(&mut parser)
        };
        let halves = [&bytes[..1], &bytes[1..]];
        assert_eq!(heard(Delivery::Line, halves, REST_TIMEOUT_US), [heartbeat(1)]);
        assert_eq!(heard(Delivery::Line, halves, REST_TIMEOUT_US - 1), []);
        assert_eq!(heard(Delivery::Stream, halves, REST_TIMEOUT_US), []);
        // Of what came later, the rest may still come.
        let later = [&bytes[..1], &bytes[1..20]];
        assert_eq!(heard(Delivery::Line, later, REST_TIMEOUT_US), []);
    }

    #[test]
    fn a_packet_is_found_behind_a_broken_one() {
        let mut broken = packet(0, &heartbeat(1));
        broken[10] ^= 1;
        let mut parser = Parser::new(Delivery::Datagrams, None);
        parser.push(&[&broken[..], &packet(1, &heartbeat(2))].concat());
        assert_eq!(all(&mut parser), [heartbeat(2)]);
        assert_eq!(parser.received().bad_checksum, 1);
        assert_eq!(parser.received().garbage_bytes, broken.len() as u64);
    }

    #[test]
    fn a_truncated_datagram_does_not_eat_the_next() {
        let whole = packet(0, &heartbeat(1));
        let mut parser = Parser::new(Delivery::Datagrams, None);
        parser.push(&whole[..whole.len() - 1]);
        assert_eq!(all(&mut parser), []);
        parser.push(&packet(1, &heartbeat(2)));
        assert_eq!(all(&mut parser), [heartbeat(2)]);
        assert_eq!(parser.received().garbage_bytes, whole.len() as u64 - 1);
    }

    #[test]
    fn an_unknown_message_is_counted() {
        let mut unknown = packet(0, &heartbeat(1));
        unknown[7..10].copy_from_slice(&[0x11, 0x22, 0x01]);
        let mut parser = Parser::new(Delivery::Stream, None);
        parser.push(&[&unknown[..], &packet(1, &heartbeat(2))].concat());
        assert_eq!(all(&mut parser), [heartbeat(2)]);
        assert_eq!((parser.received().unknown, parser.received().garbage_bytes), (1, 0));
    }

    #[test]
    fn an_unknown_message_is_not_lost() {
        let mut unknown = packet(1, &heartbeat(1));
        unknown[7..10].copy_from_slice(&[0x11, 0x22, 0x01]);
        let mut parser = Parser::new(Delivery::Stream, None);
        parser.push(&[packet(0, &heartbeat(1)), unknown, packet(2, &heartbeat(2))].concat());
        assert_eq!(all(&mut parser), [heartbeat(1), heartbeat(2)]);
        assert_eq!((parser.received().unknown, parser.received().lost), (1, 0));
    }

    #[test]
    fn what_is_missing_is_counted_for_each_sender() {
        let mut parser = Parser::new(Delivery::Stream, None);
        for sequence in [254, 255, 0, 3] {
            parser.push(&packet(sequence, &heartbeat(1)));
        }
        assert_eq!(all(&mut parser).len(), 4);
        assert_eq!(parser.received().lost, 2);
        // One that was late, and one that was sent twice.
        parser.push(&[packet(2, &heartbeat(1)), packet(2, &heartbeat(1))].concat());
        assert_eq!(all(&mut parser).len(), 2);
        assert_eq!(parser.received().lost, 2);
    }

    #[test]
    fn a_signed_link_takes_what_its_key_has_signed_and_once() {
        let key = |byte| SigningConfig::new([byte; 32], 0, true, false);
        let ours = SigningData::from_config(key(1));
        let theirs = SigningData::from_config(key(2));
        let sign = |signing: &SigningData| {
            let mut raw = MAVLinkV2MessageRaw::new();
            raw.serialize_message_for_signing(MavHeader::default(), &heartbeat(1));
            signing.sign_message(&mut raw);
            raw.raw_bytes().to_vec()
        };
        let signing = Some(Arc::new(SigningData::from_config(key(1))));
        let mut parser = Parser::new(Delivery::Datagrams, signing);
        let good = sign(&ours);
        for bytes in [&good, &good, &sign(&theirs), &packet(0, &heartbeat(1))] {
            parser.push(bytes);
        }
        assert_eq!(all(&mut parser), [heartbeat(1)]);
        // A second time, with another key, and without any.
        assert_eq!(parser.received().bad_signature, 3);
    }

    #[test]
    fn a_trajectory_survives_with_zeros_at_its_end() {
        let mut trajectory = CA_TRAJECTORY_MSG_DATA::DEFAULT;
        trajectory.time_start_usec = 1;
        trajectory.coefficients[3] = 0.1;
        let message = MavMessage::CA_TRAJECTORY_MSG(trajectory);
        let mut parser = Parser::new(Delivery::Datagrams, None);
        parser.push(&packet(0, &message));
        assert_eq!(all(&mut parser), [message]);
    }
}
