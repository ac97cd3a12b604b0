//! Missions: there are none, and whoever asks is told so.

use mavlink_core::MavHeader;

use crate::dialect::{MISSION_ACK_DATA, MISSION_COUNT_DATA, MavMessage};

/// Values of MAV_MISSION_RESULT.
const ACCEPTED: u8 = 0;
const UNSUPPORTED: u8 = 3;
const INVALID_SEQUENCE: u8 = 13;

/// The answer to a message about missions; none to all others.
pub fn answer(message: &MavMessage, from: &MavHeader) -> Option<MavMessage> {
    let target_system = u8::try_from(from.system_id).ok()?;
    let target_component = from.component_id;
    let ack = |result, mission_type| {
        Some(MavMessage::MISSION_ACK(MISSION_ACK_DATA {
            target_system,
            target_component,
            mavtype: result,
            mission_type,
            ..MISSION_ACK_DATA::DEFAULT
        }))
    };
    match message {
        MavMessage::MISSION_REQUEST_LIST(list) => {
            Some(MavMessage::MISSION_COUNT(MISSION_COUNT_DATA {
                target_system,
                target_component,
                count: 0,
                mission_type: list.mission_type,
                ..MISSION_COUNT_DATA::DEFAULT
            }))
        }
        MavMessage::MISSION_CLEAR_ALL(clear) => ack(ACCEPTED, clear.mission_type),
        MavMessage::MISSION_REQUEST(request) => ack(INVALID_SEQUENCE, request.mission_type),
        MavMessage::MISSION_REQUEST_INT(request) => ack(INVALID_SEQUENCE, request.mission_type),
        // Somebody wants to send one.
        MavMessage::MISSION_COUNT(count) => ack(UNSUPPORTED, count.mission_type),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::{HEARTBEAT_DATA, MISSION_REQUEST_LIST_DATA};

    const FROM: MavHeader = MavHeader { system_id: 255, component_id: 190, sequence: 0 };

    #[test]
    fn the_mission_the_fence_and_the_rally_points_are_empty() {
        for mission_type in [0, 1, 2] {
            let list =
                MISSION_REQUEST_LIST_DATA { mission_type, ..MISSION_REQUEST_LIST_DATA::DEFAULT };
            let Some(MavMessage::MISSION_COUNT(count)) =
                answer(&MavMessage::MISSION_REQUEST_LIST(list), &FROM)
            else {
                panic!("no count")
            };
            assert_eq!(
                (count.count, count.mission_type, count.target_system),
                (0, mission_type, 255)
            );
        }
    }

    #[test]
    fn an_upload_is_refused_and_other_messages_are_none_of_its_business() {
        let upload = MavMessage::MISSION_COUNT(MISSION_COUNT_DATA::DEFAULT);
        let Some(MavMessage::MISSION_ACK(ack)) = answer(&upload, &FROM) else { panic!("no ack") };
        assert_eq!(ack.mavtype, UNSUPPORTED);
        assert_eq!(answer(&MavMessage::HEARTBEAT(HEARTBEAT_DATA::DEFAULT), &FROM), None);
    }
}
