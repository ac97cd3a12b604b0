//! MANUAL_CONTROL: the pilot's sticks at a ground station, the topic
//! `manual_control_setpoint`.

use uorb_msg::ManualControlSetpoint;

use crate::dialect::MANUAL_CONTROL_DATA;

/// An axis that the pilot does not have is not a number. `link` counts from 0.
pub fn manual_control(
    message: &MANUAL_CONTROL_DATA,
    link: usize,
    now_us: u64,
) -> ManualControlSetpoint {
    let source = ManualControlSetpoint::SOURCE_MAVLINK_0 as usize + link;
    ManualControlSetpoint {
        timestamp: now_us,
        x: axis(message.x),
        y: axis(message.y),
        z: axis(message.z),
        r: axis(message.r),
        mode_slot: ManualControlSetpoint::MODE_SLOT_NONE,
        data_source: source.min(ManualControlSetpoint::SOURCE_MAVLINK_3.into()) as u8,
        ..Default::default()
    }
}

/// From thousandths.
fn axis(value: i16) -> f32 {
    match value {
        i16::MAX => f32::NAN,
        value => (f32::from(value) / 1_000.0).clamp(-1.0, 1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sticks_are_parts_of_one_and_say_whose_they_are() {
        let message = MANUAL_CONTROL_DATA {
            target: 1,
            x: 1_000,
            y: -500,
            z: 250,
            r: i16::MAX,
            ..MANUAL_CONTROL_DATA::DEFAULT
        };
        let sticks = manual_control(&message, 1, 9);
        assert_eq!((sticks.timestamp, sticks.x, sticks.y, sticks.z), (9, 1.0, -0.5, 0.25));
        assert!(sticks.r.is_nan());
        assert_eq!(sticks.data_source, ManualControlSetpoint::SOURCE_MAVLINK_1);
        let far = manual_control(&message, 100, 9);
        assert_eq!(far.data_source, ManualControlSetpoint::SOURCE_MAVLINK_3);
    }

    #[test]
    fn a_stick_is_never_out_of_its_range() {
        for value in [i16::MIN, -1_001, 1_001, i16::MAX - 1] {
            assert!((-1.0..=1.0).contains(&axis(value)), "{value}");
        }
    }
}
