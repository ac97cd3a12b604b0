//! What comes in over MAVLink: any bytes, and any message with a right checksum.

use std::sync::Arc;

use mavlink_core::{
    MAVLinkV2MessageRaw, MavHeader, MavlinkVersion, Message, SigningConfig, SigningData,
};
use uorb_mavlink::dialect::MavMessage;
use uorb_mavlink::frame::{Delivery, Parser};
use uorb_mavlink::incoming::{
    clocks, commands, corrections, mission, parameters, setpoints, simulator, sticks,
};
use uorb_ulog::ParameterValue;

/// Bytes of a link, in pieces. The first byte says how they arrive.
pub(crate) fn bytes(bytes: &[u8]) {
    let Some((how, bytes)) = bytes.split_first() else { return };
    let delivery = if how & 1 == 0 { Delivery::Datagrams } else { Delivery::Stream };
    let key = SigningConfig::new([7; 32], 0, true, false);
    let signing = (how & 2 != 0).then(|| Arc::new(SigningData::from_config(key)));
    let mut parser = Parser::new(delivery, signing);
    for piece in bytes.chunks(usize::from(how >> 2) * 8 + 1) {
        parser.push(piece);
        while let Some(packet) = parser.next_packet() {
            handle(&packet.header, &packet.message);
        }
    }
    let received = parser.received();
    assert_eq!(received.bytes, bytes.len() as u64);
    assert!(received.garbage_bytes <= received.bytes, "{received:?}");
    // The shortest packet has eight bytes.
    assert!((received.messages + received.unknown) * 8 <= received.bytes, "{received:?}");
}

/// A message: which one, then what is in it.
pub(crate) fn messages(bytes: &[u8]) {
    let Some((which, payload)) = bytes.split_first() else { return };
    let ids = MavMessage::all_ids();
    let id = ids[usize::from(*which) % ids.len()];
    let payload = &payload[..payload.len().min(255)];
    let Ok(message) = MavMessage::parse(MavlinkVersion::V2, id, payload) else { return };
    handle(&MavHeader { system_id: 255, component_id: 190, sequence: 0 }, &message);

    // What it is does not change on the way out and in again.
    let mut raw = MAVLinkV2MessageRaw::new();
    raw.serialize_message(MavHeader::default(), &message);
    let again = MavMessage::parse(MavlinkVersion::V2, id, raw.payload()).expect("ours is whole");
    let mut second = MAVLinkV2MessageRaw::new();
    second.serialize_message(MavHeader::default(), &again);
    assert_eq!(raw.raw_bytes(), second.raw_bytes());
}

/// What a link does with a message before it touches the bus.
fn handle(from: &MavHeader, message: &MavMessage) {
    const NOW_US: u64 = 1_000_000;
    let _ = mission::answer(message, from);
    match message {
        MavMessage::COMMAND_LONG(message) => {
            let command = commands::command_long(message, from, NOW_US);
            assert_eq!(command.command, u32::from(message.command));
        }
        MavMessage::COMMAND_INT(message) => {
            let command = commands::command_int(message, from, NOW_US);
            assert!(command.param5.abs() <= 214_748.4 || command.param5.is_nan());
        }
        MavMessage::SET_MODE(message) => {
            let _ = commands::set_mode(message, from, NOW_US);
        }
        MavMessage::PARAM_REQUEST_READ(message) => {
            let _ = message.param_id.to_str();
        }
        MavMessage::PARAM_SET(message) => {
            let _ = message.param_id.to_str();
            for old in [ParameterValue::Int32(1), ParameterValue::Float(1.0)] {
                let new = parameters::decode(old, message.param_type, message.param_value);
                assert!(!matches!(new, Some(ParameterValue::Float(it)) if !it.is_finite()));
            }
        }
        MavMessage::PING(message) => {
            let answer = clocks::ping(message, from);
            // Two bridges on one cable would send it to and fro for ever.
            assert!(
                answer.is_none_or(
                    |answer| from.system_id == 0 || clocks::ping(&answer, from).is_none()
                )
            );
        }
        MavMessage::TIMESYNC(message) => {
            let answer = clocks::timesync(message, from, NOW_US);
            assert!(answer.is_none_or(|it| clocks::timesync(&it, from, NOW_US).is_none()));
        }
        MavMessage::MANUAL_CONTROL(message) => {
            let sticks = sticks::manual_control(message, 0, NOW_US);
            for axis in [sticks.x, sticks.y, sticks.z, sticks.r] {
                assert!(axis.is_nan() || (-1.0..=1.0).contains(&axis));
            }
        }
        MavMessage::SET_POSITION_TARGET_LOCAL_NED(message) => {
            let _ = setpoints::position_target(message, NOW_US);
        }
        MavMessage::SET_ATTITUDE_TARGET(message) => {
            let _ = setpoints::attitude_target(message, NOW_US);
        }
        MavMessage::GPS_RTCM_DATA(message) => {
            assert!(corrections::gps_rtcm_data(message, NOW_US).len <= 180);
        }
        MavMessage::GPS_INJECT_DATA(message) => {
            assert!(corrections::gps_inject_data(message, NOW_US).len <= 110);
        }
        MavMessage::HIL_SENSOR(message) => {
            let _ = simulator::Simulator::default().read(message, NOW_US);
        }
        MavMessage::HIL_GPS(message) => {
            let gps = simulator::hil_gps(message, NOW_US);
            assert!(gps.cog_rad.abs() < 3.15, "{}", gps.cog_rad);
        }
        _ => {}
    }
}
