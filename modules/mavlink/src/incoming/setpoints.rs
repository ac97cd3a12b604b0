//! What a program outside wants flown: SET_POSITION_TARGET_LOCAL_NED and
//! SET_ATTITUDE_TARGET.
//!
//! Each says which of its parts it leaves open: that is `offboard_control_mode`.
//! The rest is a setpoint, on the topics of PX4's controllers.

use uorb_modules::rotation;
use uorb_msg::{
    OffboardControlMode, PositionSetpoint, PositionSetpointTriplet, VehicleAttitudeSetpoint,
    VehicleRatesSetpoint,
};

use crate::dialect::{SET_ATTITUDE_TARGET_DATA, SET_POSITION_TARGET_LOCAL_NED_DATA};

/// Values of MAV_FRAME.
const LOCAL_NED: u8 = 1;
const BODY_NED: u8 = 8;

/// Bits of the type mask of SET_POSITION_TARGET_LOCAL_NED.
const IGNORE_POSITION: u16 = 0b111;
const IGNORE_VELOCITY: u16 = 0b111 << 3;
const IGNORE_ACCELERATION: u16 = 0b111 << 6;
const IS_FORCE: u16 = 1 << 9;
const IGNORE_YAW: u16 = 1 << 10;
const IGNORE_YAW_RATE: u16 = 1 << 11;
/// PX4's own, above what MAVLink has: what kind of setpoint it is.
const KIND: u16 = 0b111 << 12;
const TAKEOFF: u16 = 1 << 12;
const LAND: u16 = 2 << 12;
const LOITER: u16 = 3 << 12;
const IDLE: u16 = 4 << 12;

/// Bits of the type mask of SET_ATTITUDE_TARGET.
const IGNORE_BODY_RATES: u8 = 0b111;
const IGNORE_THROTTLE: u8 = 1 << 6;
const IGNORE_ATTITUDE: u8 = 1 << 7;

/// Where to fly. None: it is seen from somewhere that nobody here knows.
pub fn position_target(
    message: &SET_POSITION_TARGET_LOCAL_NED_DATA,
    now_us: u64,
) -> Option<(OffboardControlMode, PositionSetpointTriplet)> {
    let (mask, frame) = (message.type_mask, message.coordinate_frame);
    if ![LOCAL_NED, BODY_NED].contains(&frame) {
        return None;
    }
    // Only velocities may be seen from the vehicle.
    let has_position = mask & IGNORE_POSITION == 0 && frame == LOCAL_NED;
    let has_velocity = mask & IGNORE_VELOCITY == 0;
    let has_acceleration = mask & IGNORE_ACCELERATION == 0;
    let mode = OffboardControlMode {
        timestamp: now_us,
        ignore_thrust: true.into(),
        ignore_attitude: true.into(),
        ignore_bodyrate: true.into(),
        ignore_position: (!has_position).into(),
        ignore_velocity: (!has_velocity).into(),
        ignore_acceleration_force: (!has_acceleration).into(),
        ignore_alt_hold: (mask & 0b100 != 0).into(),
        ..Default::default()
    };
    let current = PositionSetpoint {
        timestamp: now_us,
        valid: true.into(),
        r#type: match mask & KIND {
            TAKEOFF => PositionSetpoint::SETPOINT_TYPE_TAKEOFF,
            LAND => PositionSetpoint::SETPOINT_TYPE_LAND,
            LOITER => PositionSetpoint::SETPOINT_TYPE_LOITER,
            IDLE => PositionSetpoint::SETPOINT_TYPE_IDLE,
            _ => PositionSetpoint::SETPOINT_TYPE_OFFBOARD,
        },
        x: message.x,
        y: message.y,
        z: message.z,
        position_valid: has_position.into(),
        vx: message.vx,
        vy: message.vy,
        vz: message.vz,
        velocity_valid: has_velocity.into(),
        velocity_frame: frame,
        alt_valid: (mask & 0b100 == 0 && frame == LOCAL_NED).into(),
        yaw: message.yaw,
        yaw_valid: (mask & IGNORE_YAW == 0).into(),
        yawspeed: message.yaw_rate,
        yawspeed_valid: (mask & IGNORE_YAW_RATE == 0).into(),
        a_x: message.afx,
        a_y: message.afy,
        a_z: message.afz,
        acceleration_valid: has_acceleration.into(),
        acceleration_is_force: (has_acceleration && mask & IS_FORCE != 0).into(),
        ..Default::default()
    };
    let triplet = PositionSetpointTriplet { timestamp: now_us, current, ..Default::default() };
    Some((mode, triplet))
}

/// How to lie in the air and how to turn.
#[derive(Clone, Copy, Debug)]
pub struct AttitudeTarget {
    /// What is left open.
    pub mode: OffboardControlMode,
    /// How to lie in the air.
    pub attitude: Option<VehicleAttitudeSetpoint>,
    /// How to turn.
    pub rates: Option<VehicleRatesSetpoint>,
}

/// Takes the message apart.
pub fn attitude_target(message: &SET_ATTITUDE_TARGET_DATA, now_us: u64) -> AttitudeTarget {
    let has = |ignored: u8| message.type_mask & ignored == 0;
    let thrust = if has(IGNORE_THROTTLE) { message.thrust } else { 0.0 };
    let mode = OffboardControlMode {
        timestamp: now_us,
        ignore_thrust: (!has(IGNORE_THROTTLE)).into(),
        ignore_attitude: (!has(IGNORE_ATTITUDE)).into(),
        ignore_bodyrate: (!has(IGNORE_BODY_RATES)).into(),
        ignore_position: true.into(),
        ignore_velocity: true.into(),
        ignore_acceleration_force: true.into(),
        ignore_alt_hold: true.into(),
        ..Default::default()
    };
    let attitude = has(IGNORE_ATTITUDE).then(|| {
        let [roll_body, pitch_body, yaw_body] = rotation::euler(message.q);
        VehicleAttitudeSetpoint {
            timestamp: now_us,
            roll_body,
            pitch_body,
            yaw_body,
            yaw_sp_move_rate: if has(IGNORE_BODY_RATES) { message.body_yaw_rate } else { 0.0 },
            q_d: message.q,
            q_d_valid: true.into(),
            thrust,
            ..Default::default()
        }
    });
    let rates = has(IGNORE_BODY_RATES).then_some(VehicleRatesSetpoint {
        timestamp: now_us,
        roll: message.body_roll_rate,
        pitch: message.body_pitch_rate,
        yaw: message.body_yaw_rate,
        thrust,
    });
    AttitudeTarget { mode, attitude, rates }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::FRAC_PI_2;

    fn target(coordinate_frame: u8, type_mask: u16) -> SET_POSITION_TARGET_LOCAL_NED_DATA {
        SET_POSITION_TARGET_LOCAL_NED_DATA {
            coordinate_frame,
            type_mask,
            x: 1.0,
            vy: 2.0,
            afz: 3.0,
            yaw: 0.5,
            ..SET_POSITION_TARGET_LOCAL_NED_DATA::DEFAULT
        }
    }

    #[test]
    fn a_position_leaves_velocity_and_acceleration_open() {
        let mask = IGNORE_VELOCITY | IGNORE_ACCELERATION | IGNORE_YAW_RATE;
        let (mode, triplet) = position_target(&target(LOCAL_NED, mask), 8).unwrap();
        assert!(!bool::from(mode.ignore_position) && bool::from(mode.ignore_velocity));
        let current = triplet.current;
        assert_eq!((current.timestamp, current.x, current.yaw), (8, 1.0, 0.5));
        assert!(bool::from(current.position_valid) && bool::from(current.yaw_valid));
        assert!(!bool::from(current.velocity_valid) && !bool::from(current.yawspeed_valid));
        assert!(!bool::from(current.acceleration_valid));
        assert_eq!(current.r#type, PositionSetpoint::SETPOINT_TYPE_OFFBOARD);
    }

    #[test]
    fn from_the_vehicle_only_velocities_are_seen() {
        let (mode, triplet) = position_target(&target(BODY_NED, 0), 0).unwrap();
        assert!(bool::from(mode.ignore_position) && !bool::from(mode.ignore_velocity));
        assert_eq!(triplet.current.velocity_frame, PositionSetpoint::VELOCITY_FRAME_BODY_NED);
        assert!(position_target(&target(0, 0), 0).is_none(), "of the whole earth");
    }

    #[test]
    fn kinds_of_setpoints_are_px4s() {
        let kind = |mask| position_target(&target(LOCAL_NED, mask), 0).unwrap().1.current.r#type;
        assert_eq!(kind(TAKEOFF), PositionSetpoint::SETPOINT_TYPE_TAKEOFF);
        assert_eq!(kind(LAND), PositionSetpoint::SETPOINT_TYPE_LAND);
        assert_eq!(kind(LOITER), PositionSetpoint::SETPOINT_TYPE_LOITER);
        assert_eq!(kind(IDLE), PositionSetpoint::SETPOINT_TYPE_IDLE);
    }

    #[test]
    fn attitude_and_rates_are_setpoints_of_their_own() {
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let message = SET_ATTITUDE_TARGET_DATA {
            type_mask: IGNORE_BODY_RATES,
            q: [half, 0.0, 0.0, half],
            thrust: 0.6,
            ..SET_ATTITUDE_TARGET_DATA::DEFAULT
        };
        let target = attitude_target(&message, 4);
        let attitude = target.attitude.unwrap();
        assert!((attitude.yaw_body - FRAC_PI_2).abs() < 1e-6 && attitude.roll_body.abs() < 1e-6);
        assert_eq!((attitude.thrust, attitude.q_d), (0.6, message.q));
        assert!(target.rates.is_none() && bool::from(target.mode.ignore_bodyrate));

        let message = SET_ATTITUDE_TARGET_DATA {
            type_mask: IGNORE_ATTITUDE | IGNORE_THROTTLE,
            body_roll_rate: 0.3,
            thrust: 0.6,
            ..SET_ATTITUDE_TARGET_DATA::DEFAULT
        };
        let target = attitude_target(&message, 4);
        let rates = target.rates.unwrap();
        assert_eq!((rates.roll, rates.thrust), (0.3, 0.0));
        assert!(target.attitude.is_none() && bool::from(target.mode.ignore_thrust));
    }
}
