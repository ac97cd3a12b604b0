//! How the vehicle lies in the air: ATTITUDE, ATTITUDE_QUATERNION.

use uorb_core::Session;
use uorb_modules::rotation;
use uorb_msg::VehicleAttitude;

use super::newer::VehicleAngularVelocity;
use super::source::{Source, on_update};
use crate::dialect::{ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, MavMessage};
use crate::followed::Followed;

pub(super) fn angles(session: &Session) -> Box<dyn Source> {
    let mut velocity = Followed::<VehicleAngularVelocity>::sampled(session);
    on_update(Followed::<VehicleAttitude>::new(session), move |attitude, send| {
        let attitude = with_rates(attitude, velocity.copy());
        send(MavMessage::ATTITUDE(attitude_message(&attitude)));
    })
}

pub(super) fn quaternion(session: &Session) -> Box<dyn Source> {
    let mut velocity = Followed::<VehicleAngularVelocity>::sampled(session);
    on_update(Followed::<VehicleAttitude>::new(session), move |attitude, send| {
        let attitude = with_rates(attitude, velocity.copy());
        send(MavMessage::ATTITUDE_QUATERNION(quaternion_message(&attitude)));
    })
}

/// The rates of the newer topic, where somebody publishes it.
fn with_rates(
    attitude: VehicleAttitude,
    velocity: Option<VehicleAngularVelocity>,
) -> VehicleAttitude {
    let Some(velocity) = velocity else { return attitude };
    let [rollspeed, pitchspeed, yawspeed] = velocity.xyz;
    VehicleAttitude { rollspeed, pitchspeed, yawspeed, ..attitude }
}

fn attitude_message(attitude: &VehicleAttitude) -> ATTITUDE_DATA {
    // Whoever publishes no quaternion means its angles.
    let [roll, pitch, yaw] = match attitude.q {
        [0.0, 0.0, 0.0, 0.0] => [attitude.roll, attitude.pitch, attitude.yaw],
        q => rotation::euler(q),
    };
    ATTITUDE_DATA {
        time_boot_ms: ms(attitude.timestamp),
        roll,
        pitch,
        yaw,
        rollspeed: attitude.rollspeed,
        pitchspeed: attitude.pitchspeed,
        yawspeed: attitude.yawspeed,
    }
}

fn quaternion_message(attitude: &VehicleAttitude) -> ATTITUDE_QUATERNION_DATA {
    let [q1, q2, q3, q4] = match attitude.q {
        [0.0, 0.0, 0.0, 0.0] => rotation::quaternion([attitude.roll, attitude.pitch, attitude.yaw]),
        q => q,
    };
    ATTITUDE_QUATERNION_DATA {
        time_boot_ms: ms(attitude.timestamp),
        q1,
        q2,
        q3,
        q4,
        rollspeed: attitude.rollspeed,
        pitchspeed: attitude.pitchspeed,
        yawspeed: attitude.yawspeed,
        ..ATTITUDE_QUATERNION_DATA::DEFAULT
    }
}

/// Milliseconds since the system started, as MAVLink counts them: 49 days.
pub(super) fn ms(timestamp_us: u64) -> u32 {
    (timestamp_us / 1000) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_those_of_the_quaternion() {
        let attitude = VehicleAttitude {
            timestamp: 5_999,
            q: rotation::quaternion([0.3, -0.7, 2.5]),
            roll: 9.0,
            yawspeed: 0.5,
            ..VehicleAttitude::default()
        };
        let message = attitude_message(&attitude);
        assert_eq!((message.time_boot_ms, message.yawspeed), (5, 0.5));
        assert!((message.roll - 0.3).abs() < 1e-5);
    }

    #[test]
    fn without_a_quaternion_the_angles_count() {
        let attitude = VehicleAttitude { roll: 0.1, yaw: -3.0, ..VehicleAttitude::default() };
        let message = attitude_message(&attitude);
        assert_eq!((message.roll, message.pitch, message.yaw), (0.1, 0.0, -3.0));
        let q = quaternion_message(&attitude);
        assert!((rotation::euler([q.q1, q.q2, q.q3, q.q4])[2] + 3.0).abs() < 1e-5);
    }
}
