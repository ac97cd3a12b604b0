//! What the vehicle is and does: HEARTBEAT, EXTENDED_SYS_STATE, SYSTEM_TIME,
//! AUTOPILOT_VERSION.

use std::time::{SystemTime, UNIX_EPOCH};

use uorb_core::{Session, now_us};
use uorb_msg::{
    ActuatorArmed, PositionSetpoint, PositionSetpointTriplet, VehicleLandDetected, VehicleStatus,
};

use super::attitude::ms;
use super::modes::{control_flags, custom_mode};
use super::source::{Source, on_clock};
use crate::dialect::{
    AUTOPILOT_VERSION_DATA, EXTENDED_SYS_STATE_DATA, HEARTBEAT_DATA, MavAutopilot, MavLandedState,
    MavMessage, MavModeFlag, MavProtocolCapability, MavState, MavType, MavVtolState,
    SYSTEM_TIME_DATA,
};
use crate::followed::Followed;

/// Version 3 of the protocol is what all heartbeats say.
const MAVLINK_VERSION: u8 = 3;

pub(super) fn heartbeat(session: &Session) -> Box<dyn Source> {
    let mut status = Followed::<VehicleStatus>::sampled(session);
    let mut armed = Followed::<ActuatorArmed>::sampled(session);
    on_clock(move |send| {
        send(MavMessage::HEARTBEAT(heartbeat_message(status.copy(), armed.copy())));
    })
}

fn heartbeat_message(
    status: Option<VehicleStatus>,
    armed: Option<ActuatorArmed>,
) -> HEARTBEAT_DATA {
    // A vehicle of which nothing is known yet is said to be there all the same.
    let is_known = status.is_some();
    let status = status.unwrap_or_default();
    let armed = armed.unwrap_or_default();
    let mut base_mode = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED;
    if is_known {
        base_mode |= control_flags(status.nav_state, status.is_rotary_wing.into());
    }
    let is_armed = [VehicleStatus::ARMING_STATE_ARMED, VehicleStatus::ARMING_STATE_ARMED_ERROR]
        .contains(&status.arming_state)
        || bool::from(armed.armed);
    base_mode.set(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED, is_armed);
    let is_hil = status.hil_state == VehicleStatus::HIL_STATE_ON;
    base_mode.set(MavModeFlag::MAV_MODE_FLAG_HIL_ENABLED, is_hil);

    HEARTBEAT_DATA {
        custom_mode: custom_mode(status.nav_state),
        mavtype: match status.system_type {
            0 => MavType::MAV_TYPE_QUADROTOR as u8,
            known => known,
        },
        autopilot: MavAutopilot::MAV_AUTOPILOT_PX4 as u8,
        base_mode: base_mode.bits() as u8,
        system_status: system_status(is_known, &status, &armed) as u8,
        mavlink_version: MAVLINK_VERSION,
    }
}

fn system_status(is_known: bool, status: &VehicleStatus, armed: &ActuatorArmed) -> MavState {
    use VehicleStatus as S;
    let is_terminated = [armed.force_failsafe, armed.lockdown, armed.manual_lockdown]
        .iter()
        .any(|cause| bool::from(*cause))
        || status.nav_state == S::NAVIGATION_STATE_TERMINATION;
    match status.arming_state {
        _ if is_terminated => MavState::MAV_STATE_FLIGHT_TERMINATION,
        _ if status.nav_state == S::NAVIGATION_STATE_AUTO_LANDENGFAIL => {
            MavState::MAV_STATE_EMERGENCY
        }
        S::ARMING_STATE_INIT if !is_known && bool::from(armed.armed) => MavState::MAV_STATE_ACTIVE,
        S::ARMING_STATE_INIT => MavState::MAV_STATE_UNINIT,
        S::ARMING_STATE_ARMED if bool::from(status.failsafe) => MavState::MAV_STATE_CRITICAL,
        S::ARMING_STATE_ARMED => MavState::MAV_STATE_ACTIVE,
        S::ARMING_STATE_STANDBY => MavState::MAV_STATE_STANDBY,
        S::ARMING_STATE_REBOOT => MavState::MAV_STATE_POWEROFF,
        _ => MavState::MAV_STATE_CRITICAL,
    }
}

pub(super) fn extended(session: &Session) -> Box<dyn Source> {
    let mut status = Followed::<VehicleStatus>::sampled(session);
    let mut landed = Followed::<VehicleLandDetected>::sampled(session);
    let mut triplet = Followed::<PositionSetpointTriplet>::sampled(session);
    on_clock(move |send| {
        let (status, landed) = (status.copy(), landed.copy());
        if status.is_some() || landed.is_some() {
            let message = extended_message(status, landed, triplet.copy());
            send(MavMessage::EXTENDED_SYS_STATE(message));
        }
    })
}

fn extended_message(
    status: Option<VehicleStatus>,
    landed: Option<VehicleLandDetected>,
    triplet: Option<PositionSetpointTriplet>,
) -> EXTENDED_SYS_STATE_DATA {
    let status = status.unwrap_or_default();
    let vtol_state = match status {
        _ if !bool::from(status.is_vtol) => MavVtolState::MAV_VTOL_STATE_UNDEFINED,
        _ if bool::from(status.in_transition_mode) => {
            match bool::from(status.in_transition_to_fw) {
                true => MavVtolState::MAV_VTOL_STATE_TRANSITION_TO_FW,
                false => MavVtolState::MAV_VTOL_STATE_TRANSITION_TO_MC,
            }
        }
        _ if bool::from(status.is_rotary_wing) => MavVtolState::MAV_VTOL_STATE_MC,
        _ => MavVtolState::MAV_VTOL_STATE_FW,
    };
    // Where the autopilot flies by itself, and to take off or to land.
    let is_auto =
        control_flags(status.nav_state, true).contains(MavModeFlag::MAV_MODE_FLAG_AUTO_ENABLED);
    let setpoint = triplet.filter(|_| is_auto).map(|triplet| triplet.current);
    let setpoint = setpoint.filter(|setpoint| bool::from(setpoint.valid)).map(|it| it.r#type);
    let landed_state = match (landed, setpoint) {
        (Some(landed), _) if landed.landed.into() => MavLandedState::MAV_LANDED_STATE_ON_GROUND,
        (Some(_), Some(PositionSetpoint::SETPOINT_TYPE_TAKEOFF)) => {
            MavLandedState::MAV_LANDED_STATE_TAKEOFF
        }
        (Some(_), Some(PositionSetpoint::SETPOINT_TYPE_LAND)) => {
            MavLandedState::MAV_LANDED_STATE_LANDING
        }
        (Some(_), _) => MavLandedState::MAV_LANDED_STATE_IN_AIR,
        (None, _) => MavLandedState::MAV_LANDED_STATE_UNDEFINED,
    };
    EXTENDED_SYS_STATE_DATA { vtol_state: vtol_state as u8, landed_state: landed_state as u8 }
}

pub(super) fn system_time(_: &Session) -> Box<dyn Source> {
    on_clock(|send| {
        let utc = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        send(MavMessage::SYSTEM_TIME(SYSTEM_TIME_DATA {
            time_unix_usec: utc.as_micros() as u64,
            time_boot_ms: ms(now_us()),
        }));
    })
}

pub(super) fn autopilot_version(_: &Session) -> Box<dyn Source> {
    on_clock(|send| send(MavMessage::AUTOPILOT_VERSION(version_message())))
}

fn version_message() -> AUTOPILOT_VERSION_DATA {
    let part = |text: &str| text.parse::<u32>().unwrap_or(0);
    let [major, minor, patch] = [
        part(env!("CARGO_PKG_VERSION_MAJOR")),
        part(env!("CARGO_PKG_VERSION_MINOR")),
        part(env!("CARGO_PKG_VERSION_PATCH")),
    ];
    // What the bridge can do, no more: a partner does not ask for the rest.
    let capabilities = MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
        | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED;
    AUTOPILOT_VERSION_DATA {
        capabilities: capabilities.bits().into(),
        // The lowest byte is the kind of release; 0 is under development.
        flight_sw_version: major << 24 | minor << 16 | patch << 8,
        ..AUTOPILOT_VERSION_DATA::DEFAULT
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_armed_quadrotor_in_hold() {
        let status = VehicleStatus {
            arming_state: VehicleStatus::ARMING_STATE_ARMED,
            nav_state: VehicleStatus::NAVIGATION_STATE_AUTO_LOITER,
            system_type: 2,
            is_rotary_wing: true.into(),
            ..VehicleStatus::default()
        };
        let message = heartbeat_message(Some(status), None);
        assert_eq!(message.base_mode, 1 | 128 | 4 | 8 | 16);
        assert_eq!((message.custom_mode, message.system_status), (0x0304_0000, 4));
        assert_eq!((message.autopilot, message.mavtype), (12, 2));
    }

    #[test]
    fn before_anything_is_known_it_is_there() {
        let message = heartbeat_message(None, None);
        assert_eq!((message.base_mode, message.system_status), (1, 0));
    }

    #[test]
    fn a_kill_switch_is_a_termination() {
        let armed = ActuatorArmed { manual_lockdown: true.into(), ..ActuatorArmed::default() };
        let message = heartbeat_message(Some(VehicleStatus::default()), Some(armed));
        assert_eq!(message.system_status, MavState::MAV_STATE_FLIGHT_TERMINATION as u8);
    }

    #[test]
    fn landed_states_follow_the_setpoint_in_the_air_only() {
        let status = VehicleStatus {
            nav_state: VehicleStatus::NAVIGATION_STATE_AUTO_LAND,
            ..VehicleStatus::default()
        };
        let mut triplet = PositionSetpointTriplet::default();
        triplet.current.valid = true.into();
        triplet.current.r#type = PositionSetpoint::SETPOINT_TYPE_LAND;
        let state = |landed: bool, triplet| {
            let landed =
                VehicleLandDetected { landed: landed.into(), ..VehicleLandDetected::default() };
            extended_message(Some(status), Some(landed), triplet).landed_state
        };
        assert_eq!(state(true, Some(triplet)), 1);
        assert_eq!(state(false, Some(triplet)), 4);
        assert_eq!(state(false, None), 2);
    }
}
