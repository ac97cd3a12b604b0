//! PX4's flight modes in MAVLink: base mode and custom mode.

use uorb_msg::VehicleStatus;

use crate::dialect::MavModeFlag;

/// The main mode, bits 16 to 23 of the custom mode.
mod main_mode {
    pub(super) const MANUAL: u32 = 1;
    pub(super) const ALTCTL: u32 = 2;
    pub(super) const POSCTL: u32 = 3;
    pub(super) const AUTO: u32 = 4;
    pub(super) const ACRO: u32 = 5;
    pub(super) const OFFBOARD: u32 = 6;
    pub(super) const STABILIZED: u32 = 7;
    pub(super) const RATTITUDE: u32 = 8;
}

/// What AUTO does, bits 24 to 31.
mod sub_mode {
    pub(super) const TAKEOFF: u32 = 2;
    pub(super) const LOITER: u32 = 3;
    pub(super) const MISSION: u32 = 4;
    pub(super) const RTL: u32 = 5;
    pub(super) const LAND: u32 = 6;
    pub(super) const RTGS: u32 = 7;
    pub(super) const FOLLOW_TARGET: u32 = 8;
}

fn mode(main: u32, sub: u32) -> u32 {
    main << 16 | sub << 24
}

/// What the vehicle does, as PX4's custom mode.
pub fn custom_mode(nav_state: u8) -> u32 {
    use VehicleStatus as S;
    match nav_state {
        S::NAVIGATION_STATE_ALTCTL => mode(main_mode::ALTCTL, 0),
        S::NAVIGATION_STATE_POSCTL => mode(main_mode::POSCTL, 0),
        S::NAVIGATION_STATE_AUTO_MISSION => mode(main_mode::AUTO, sub_mode::MISSION),
        S::NAVIGATION_STATE_AUTO_LOITER => mode(main_mode::AUTO, sub_mode::LOITER),
        S::NAVIGATION_STATE_AUTO_RTL | S::NAVIGATION_STATE_AUTO_RCRECOVER => {
            mode(main_mode::AUTO, sub_mode::RTL)
        }
        S::NAVIGATION_STATE_AUTO_RTGS => mode(main_mode::AUTO, sub_mode::RTGS),
        S::NAVIGATION_STATE_AUTO_LAND
        | S::NAVIGATION_STATE_AUTO_LANDENGFAIL
        | S::NAVIGATION_STATE_AUTO_LANDGPSFAIL
        | S::NAVIGATION_STATE_DESCEND => mode(main_mode::AUTO, sub_mode::LAND),
        S::NAVIGATION_STATE_AUTO_TAKEOFF => mode(main_mode::AUTO, sub_mode::TAKEOFF),
        S::NAVIGATION_STATE_AUTO_FOLLOW_TARGET => mode(main_mode::AUTO, sub_mode::FOLLOW_TARGET),
        S::NAVIGATION_STATE_ACRO => mode(main_mode::ACRO, 0),
        S::NAVIGATION_STATE_OFFBOARD => mode(main_mode::OFFBOARD, 0),
        S::NAVIGATION_STATE_STAB => mode(main_mode::STABILIZED, 0),
        S::NAVIGATION_STATE_RATTITUDE => mode(main_mode::RATTITUDE, 0),
        _ => mode(main_mode::MANUAL, 0),
    }
}

/// Who controls the vehicle in that mode, as MAVLink's flags.
pub(super) fn control_flags(nav_state: u8, is_rotary_wing: bool) -> MavModeFlag {
    use VehicleStatus as S;
    let manual = MavModeFlag::MAV_MODE_FLAG_MANUAL_INPUT_ENABLED;
    let stabilized = MavModeFlag::MAV_MODE_FLAG_STABILIZE_ENABLED;
    match nav_state {
        S::NAVIGATION_STATE_MANUAL if !is_rotary_wing => manual,
        S::NAVIGATION_STATE_ACRO
        | S::NAVIGATION_STATE_RATTITUDE
        | S::NAVIGATION_STATE_TERMINATION => manual,
        S::NAVIGATION_STATE_MANUAL
        | S::NAVIGATION_STATE_STAB
        | S::NAVIGATION_STATE_ALTCTL
        | S::NAVIGATION_STATE_POSCTL => manual | stabilized,
        _ => {
            MavModeFlag::MAV_MODE_FLAG_AUTO_ENABLED
                | MavModeFlag::MAV_MODE_FLAG_GUIDED_ENABLED
                | stabilized
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_are_what_ground_stations_know() {
        // Numbers as QGroundControl and MAVSDK read them.
        for (nav_state, number) in [
            (VehicleStatus::NAVIGATION_STATE_MANUAL, 0x0001_0000),
            (VehicleStatus::NAVIGATION_STATE_POSCTL, 0x0003_0000),
            (VehicleStatus::NAVIGATION_STATE_AUTO_MISSION, 0x0404_0000),
            (VehicleStatus::NAVIGATION_STATE_AUTO_LOITER, 0x0304_0000),
            (VehicleStatus::NAVIGATION_STATE_AUTO_TAKEOFF, 0x0204_0000),
            (VehicleStatus::NAVIGATION_STATE_AUTO_RTL, 0x0504_0000),
            (VehicleStatus::NAVIGATION_STATE_OFFBOARD, 0x0006_0000),
        ] {
            assert_eq!(custom_mode(nav_state), number, "{nav_state}");
        }
    }
}
