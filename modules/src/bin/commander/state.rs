//! What the commander knows of the vehicle, and what a command makes of it.
//!
//! Nothing here reads or publishes: a command goes in, a result comes out. What it
//! does not know how to obey is unsupported, and what would not be true is denied.

use uorb_msg::{
    ActuatorArmed, HomePosition, VehicleCommand, VehicleCommandAck, VehicleLandDetected,
    VehicleStatus,
};

/// How long a take-off and a landing last.
pub(crate) const MANOEUVRE_US: u64 = 2_000_000;

/// Parameter 2 of arm and disarm: whatever speaks against it.
const FORCED: f32 = 21_196.0;

/// In the base mode of MAVLink: the mode is PX4's own.
const CUSTOM_MODE_ENABLED: u32 = 1;

/// A constant of the messages, as the topic `vehicle_command_ack` has it.
pub(crate) type CommandResult = u8;

const ACCEPTED: CommandResult = VehicleCommandAck::VEHICLE_RESULT_ACCEPTED;
const TEMPORARILY_REJECTED: CommandResult = VehicleCommandAck::VEHICLE_RESULT_TEMPORARILY_REJECTED;
const DENIED: CommandResult = VehicleCommandAck::VEHICLE_RESULT_DENIED;
const UNSUPPORTED: CommandResult = VehicleCommandAck::VEHICLE_RESULT_UNSUPPORTED;

/// What others have told the commander.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Senses {
    /// The newest position; none without a fix.
    pub(crate) position: Option<Place>,
    /// A program outside sends setpoints.
    pub(crate) has_offboard_setpoints: bool,
    /// Sensors that were heard of since the start, as MAVLink's SYS_STATUS.
    pub(crate) sensors_present: u32,
    /// Those that were heard of lately.
    pub(crate) sensors_healthy: u32,
}

/// Somewhere on earth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place {
    pub(crate) lat: f64,
    pub(crate) lon: f64,
    pub(crate) alt: f32,
}

/// The vehicle's state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct State {
    pub(crate) is_armed: bool,
    pub(crate) is_landed: bool,
    pub(crate) nav_state: u8,
    pub(crate) home: Option<Place>,
    /// When a take-off or a landing is over.
    manoeuvre_ends_us: Option<u64>,
}

impl State {
    pub(crate) const START: Self = Self {
        is_armed: false,
        is_landed: true,
        nav_state: VehicleStatus::NAVIGATION_STATE_MANUAL,
        home: None,
        manoeuvre_ends_us: None,
    };

    /// Obeys a command, or says why not.
    pub(crate) fn obey(
        &mut self,
        command: &VehicleCommand,
        senses: &Senses,
        now_us: u64,
    ) -> CommandResult {
        match command.command {
            VehicleCommand::VEHICLE_CMD_COMPONENT_ARM_DISARM => self.arm(command, senses),
            VehicleCommand::VEHICLE_CMD_DO_SET_MODE => self.set_mode(command, senses, now_us),
            VehicleCommand::VEHICLE_CMD_NAV_TAKEOFF => self.take_off(now_us),
            VehicleCommand::VEHICLE_CMD_NAV_LAND => self.land(now_us),
            VehicleCommand::VEHICLE_CMD_DO_SET_HOME => self.set_home(command, senses),
            _ => UNSUPPORTED,
        }
    }

    /// Goes on with what lasts: take-off becomes loiter, a landing ends disarmed.
    pub(crate) fn go_on(&mut self, senses: &Senses, now_us: u64) {
        self.home = self.home.or(senses.position);
        if self.manoeuvre_ends_us.is_none_or(|ends_us| now_us < ends_us) {
            return;
        }
        self.manoeuvre_ends_us = None;
        if self.nav_state == VehicleStatus::NAVIGATION_STATE_AUTO_LAND {
            self.is_landed = true;
            self.is_armed = false;
        }
        self.nav_state = VehicleStatus::NAVIGATION_STATE_AUTO_LOITER;
    }

    fn arm(&mut self, command: &VehicleCommand, senses: &Senses) -> CommandResult {
        let is_forced = command.param2 == FORCED;
        if command.param1 == 1.0 {
            if !self.is_armed {
                self.home = senses.position.or(self.home);
            }
            self.is_armed = true;
            ACCEPTED
        } else if command.param1 != 0.0 {
            UNSUPPORTED
        } else if self.is_landed || is_forced {
            self.is_armed = false;
            self.is_landed = true;
            self.manoeuvre_ends_us = None;
            ACCEPTED
        } else {
            DENIED
        }
    }

    fn set_mode(
        &mut self,
        command: &VehicleCommand,
        senses: &Senses,
        now_us: u64,
    ) -> CommandResult {
        // MAVLink's floats carry small numbers here; `as` saturates.
        if command.param1 as u32 & CUSTOM_MODE_ENABLED == 0 {
            return UNSUPPORTED;
        }
        let Some(nav_state) = nav_state(command.param2 as u8, command.param3 as u8) else {
            return DENIED;
        };
        match nav_state {
            VehicleStatus::NAVIGATION_STATE_AUTO_TAKEOFF => return self.take_off(now_us),
            VehicleStatus::NAVIGATION_STATE_AUTO_LAND => return self.land(now_us),
            // There is no mission, and nobody to follow.
            VehicleStatus::NAVIGATION_STATE_AUTO_MISSION
            | VehicleStatus::NAVIGATION_STATE_AUTO_FOLLOW_TARGET => return DENIED,
            VehicleStatus::NAVIGATION_STATE_OFFBOARD if !senses.has_offboard_setpoints => {
                return TEMPORARILY_REJECTED;
            }
            _ => {}
        }
        self.nav_state = nav_state;
        self.manoeuvre_ends_us = None;
        ACCEPTED
    }

    fn take_off(&mut self, now_us: u64) -> CommandResult {
        if !self.is_armed {
            return TEMPORARILY_REJECTED;
        }
        // In the air it has taken off, and perhaps is about to land.
        if !self.is_landed {
            return DENIED;
        }
        self.is_landed = false;
        self.nav_state = VehicleStatus::NAVIGATION_STATE_AUTO_TAKEOFF;
        self.manoeuvre_ends_us = Some(now_us + MANOEUVRE_US);
        ACCEPTED
    }

    fn land(&mut self, now_us: u64) -> CommandResult {
        if !self.is_landed && self.nav_state != VehicleStatus::NAVIGATION_STATE_AUTO_LAND {
            self.nav_state = VehicleStatus::NAVIGATION_STATE_AUTO_LAND;
            self.manoeuvre_ends_us = Some(now_us + MANOEUVRE_US);
        }
        ACCEPTED
    }

    fn set_home(&mut self, command: &VehicleCommand, senses: &Senses) -> CommandResult {
        let there = Place { lat: command.param5, lon: command.param6, alt: command.param7 };
        let is_here = command.param1 == 1.0;
        let is_place = there.lat.abs() <= 90.0 && there.lon.abs() <= 180.0 && there.alt.is_finite();
        match (is_here, senses.position) {
            (true, Some(here)) => self.home = Some(here),
            (false, _) if is_place => self.home = Some(there),
            _ => return DENIED,
        }
        ACCEPTED
    }

    /// The message that says so. `system_id` is the vehicle's number in MAVLink.
    pub(crate) fn status(&self, senses: &Senses, system_id: u32, now_us: u64) -> VehicleStatus {
        /// MAV_TYPE_QUADROTOR and MAV_COMP_ID_AUTOPILOT1.
        const QUADROTOR: u8 = 2;
        const AUTOPILOT: u32 = 1;
        VehicleStatus {
            timestamp: now_us,
            nav_state: self.nav_state,
            arming_state: match self.is_armed {
                true => VehicleStatus::ARMING_STATE_ARMED,
                false => VehicleStatus::ARMING_STATE_STANDBY,
            },
            hil_state: VehicleStatus::HIL_STATE_OFF,
            system_type: QUADROTOR,
            system_id,
            component_id: AUTOPILOT,
            is_rotary_wing: true.into(),
            rc_signal_lost: true.into(),
            rc_input_mode: VehicleStatus::RC_IN_MODE_OFF,
            onboard_control_sensors_present: senses.sensors_present,
            onboard_control_sensors_enabled: senses.sensors_present,
            onboard_control_sensors_health: senses.sensors_healthy,
            ..Default::default()
        }
    }

    pub(crate) fn actuator_armed(&self, now_us: u64) -> ActuatorArmed {
        ActuatorArmed {
            timestamp: now_us,
            armed: self.is_armed.into(),
            ready_to_arm: true.into(),
            ..Default::default()
        }
    }

    pub(crate) fn land_detected(&self, now_us: u64) -> VehicleLandDetected {
        VehicleLandDetected {
            timestamp: now_us,
            alt_max: f32::INFINITY,
            landed: self.is_landed.into(),
            ground_contact: self.is_landed.into(),
            ..Default::default()
        }
    }

    pub(crate) fn home_position(&self, now_us: u64) -> Option<HomePosition> {
        let Place { lat, lon, alt } = self.home?;
        Some(HomePosition { timestamp: now_us, lat, lon, alt, ..Default::default() })
    }
}

/// PX4's custom mode, main and sub, as a constant of `vehicle_status`.
fn nav_state(main: u8, sub: u8) -> Option<u8> {
    Some(match (main, sub) {
        (1, _) => VehicleStatus::NAVIGATION_STATE_MANUAL,
        (2, _) => VehicleStatus::NAVIGATION_STATE_ALTCTL,
        (3, _) => VehicleStatus::NAVIGATION_STATE_POSCTL,
        (4, 2) => VehicleStatus::NAVIGATION_STATE_AUTO_TAKEOFF,
        (4, 3) => VehicleStatus::NAVIGATION_STATE_AUTO_LOITER,
        (4, 4) => VehicleStatus::NAVIGATION_STATE_AUTO_MISSION,
        (4, 5) => VehicleStatus::NAVIGATION_STATE_AUTO_RTL,
        (4, 6) => VehicleStatus::NAVIGATION_STATE_AUTO_LAND,
        (4, 8) => VehicleStatus::NAVIGATION_STATE_AUTO_FOLLOW_TARGET,
        (5, _) => VehicleStatus::NAVIGATION_STATE_ACRO,
        (6, _) => VehicleStatus::NAVIGATION_STATE_OFFBOARD,
        (7, _) => VehicleStatus::NAVIGATION_STATE_STAB,
        (8, _) => VehicleStatus::NAVIGATION_STATE_RATTITUDE,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: Place = Place { lat: 47.4, lon: 8.5, alt: 488.0 };

    fn command(command: u32, param1: f32, param2: f32, param3: f32) -> VehicleCommand {
        VehicleCommand { command, param1, param2, param3, ..Default::default() }
    }

    fn arm(is_armed: bool) -> VehicleCommand {
        command(VehicleCommand::VEHICLE_CMD_COMPONENT_ARM_DISARM, is_armed.into(), 0.0, 0.0)
    }

    fn take_off() -> VehicleCommand {
        command(VehicleCommand::VEHICLE_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0)
    }

    fn land() -> VehicleCommand {
        command(VehicleCommand::VEHICLE_CMD_NAV_LAND, 0.0, 0.0, 0.0)
    }

    fn mode(main: u8, sub: u8) -> VehicleCommand {
        command(VehicleCommand::VEHICLE_CMD_DO_SET_MODE, 1.0, main.into(), sub.into())
    }

    #[test]
    fn a_flight_from_arming_to_the_end_of_the_landing() {
        let senses = Senses { position: Some(HERE), ..Default::default() };
        let mut state = State::START;
        assert_eq!(state.obey(&take_off(), &senses, 0), TEMPORARILY_REJECTED, "it is disarmed");
        assert_eq!(state.obey(&arm(true), &senses, 0), ACCEPTED);
        assert_eq!(state.home, Some(HERE));
        assert_eq!(state.obey(&take_off(), &senses, 0), ACCEPTED);
        assert_eq!(state.nav_state, VehicleStatus::NAVIGATION_STATE_AUTO_TAKEOFF);
        assert_eq!(state.obey(&arm(false), &senses, 0), DENIED, "it flies");
        assert_eq!(state.obey(&take_off(), &senses, 0), DENIED, "it has taken off");

        state.go_on(&senses, MANOEUVRE_US - 1);
        assert_eq!(state.nav_state, VehicleStatus::NAVIGATION_STATE_AUTO_TAKEOFF);
        state.go_on(&senses, MANOEUVRE_US);
        assert_eq!(state.nav_state, VehicleStatus::NAVIGATION_STATE_AUTO_LOITER);
        assert!(state.is_armed && !state.is_landed);

        assert_eq!(state.obey(&land(), &senses, MANOEUVRE_US), ACCEPTED);
        assert_eq!(state.nav_state, VehicleStatus::NAVIGATION_STATE_AUTO_LAND);
        assert_eq!(state.obey(&take_off(), &senses, MANOEUVRE_US), DENIED, "it lands");
        assert_eq!(state.obey(&mode(4, 2), &senses, MANOEUVRE_US), DENIED, "it lands");
        state.go_on(&senses, 2 * MANOEUVRE_US);
        assert!(!state.is_armed && state.is_landed);
    }

    #[test]
    fn whoever_insists_disarms_in_the_air() {
        let mut state = State { is_armed: true, is_landed: false, ..State::START };
        let insists = command(VehicleCommand::VEHICLE_CMD_COMPONENT_ARM_DISARM, 0.0, FORCED, 0.0);
        assert_eq!(state.obey(&insists, &Senses::default(), 0), ACCEPTED);
        assert!(!state.is_armed);
    }

    #[test]
    fn modes_are_px4s_and_some_need_more_than_a_word() {
        let mut state = State::START;
        let mut senses = Senses::default();
        assert_eq!(state.obey(&mode(3, 0), &senses, 0), ACCEPTED);
        assert_eq!(state.nav_state, VehicleStatus::NAVIGATION_STATE_POSCTL);
        assert_eq!(state.obey(&mode(9, 0), &senses, 0), DENIED, "no such mode");
        assert_eq!(state.obey(&mode(4, 4), &senses, 0), DENIED, "no mission");
        assert_eq!(state.obey(&mode(6, 0), &senses, 0), TEMPORARILY_REJECTED, "no setpoints");
        senses.has_offboard_setpoints = true;
        assert_eq!(state.obey(&mode(6, 0), &senses, 0), ACCEPTED);
        assert_eq!(state.nav_state, VehicleStatus::NAVIGATION_STATE_OFFBOARD);
    }

    #[test]
    fn home_is_the_first_place_and_can_be_another() {
        let mut state = State::START;
        assert_eq!(state.home_position(0), None);
        let senses = Senses { position: Some(HERE), ..Default::default() };
        state.go_on(&senses, 0);
        assert_eq!(state.home, Some(HERE));
        let elsewhere = VehicleCommand {
            command: VehicleCommand::VEHICLE_CMD_DO_SET_HOME,
            param5: 1.0,
            param6: 2.0,
            param7: 3.0,
            ..Default::default()
        };
        assert_eq!(state.obey(&elsewhere, &senses, 0), ACCEPTED);
        assert_eq!(state.home, Some(Place { lat: 1.0, lon: 2.0, alt: 3.0 }));
        let nowhere = VehicleCommand { param5: f64::NAN, ..elsewhere };
        assert_eq!(state.obey(&nowhere, &senses, 0), DENIED);
    }

    #[test]
    fn what_it_cannot_do_is_unsupported_and_changes_nothing() {
        let mut state = State::START;
        for unknown in [VehicleCommand::VEHICLE_CMD_MISSION_START, 31_000, 0] {
            let result = state.obey(&command(unknown, 1.0, 1.0, 1.0), &Senses::default(), 0);
            assert_eq!(result, UNSUPPORTED);
        }
        assert_eq!(state, State::START);
    }
}
