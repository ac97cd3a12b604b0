//! Where the vehicle is and how it moves: LOCAL_POSITION_NED,
//! GLOBAL_POSITION_INT, ALTITUDE, VFR_HUD, HOME_POSITION.

use std::f32::consts::TAU;

use uorb_core::{Session, now_us};
use uorb_modules::rotation::quaternion;
use uorb_msg::{
    ActuatorArmed, ActuatorControls, ActuatorControls0, Airspeed, HomePosition, SensorCombined,
    VehicleGlobalPosition, VehicleLocalPosition,
};

use super::attitude::ms;
use super::newer::VehicleAirData;
use super::source::{Source, on_clock, on_update};
use crate::dialect::{
    ALTITUDE_DATA, GLOBAL_POSITION_INT_DATA, HOME_POSITION_DATA, LOCAL_POSITION_NED_DATA,
    MavMessage, VFR_HUD_DATA,
};
use crate::followed::Followed;

/// Where a multicopter's throttle is among the actuator controls.
const THROTTLE: usize = 3;

pub(super) fn local(session: &Session) -> Box<dyn Source> {
    on_update(Followed::<VehicleLocalPosition>::new(session), |position, send| {
        send(MavMessage::LOCAL_POSITION_NED(local_message(&position)));
    })
}

fn local_message(position: &VehicleLocalPosition) -> LOCAL_POSITION_NED_DATA {
    let VehicleLocalPosition { x, y, z, vx, vy, vz, .. } = *position;
    LOCAL_POSITION_NED_DATA { time_boot_ms: ms(position.timestamp), x, y, z, vx, vy, vz }
}

pub(super) fn global(session: &Session) -> Box<dyn Source> {
    let mut home = Followed::<HomePosition>::sampled(session);
    let mut local = Followed::<VehicleLocalPosition>::sampled(session);
    on_update(Followed::<VehicleGlobalPosition>::new(session), move |position, send| {
        let message = global_message(&position, local.copy(), home.copy());
        send(MavMessage::GLOBAL_POSITION_INT(message));
    })
}

fn global_message(
    position: &VehicleGlobalPosition,
    local: Option<VehicleLocalPosition>,
    home: Option<HomePosition>,
) -> GLOBAL_POSITION_INT_DATA {
    // The global position of newer logs has neither velocity nor heading.
    let local = local.filter(|local| local.v_xy_valid.into());
    let ([north, east, down], yaw) = match local {
        Some(local) => ([local.vx, local.vy, local.vz], local.yaw),
        None => ([position.vel_n, position.vel_e, position.vel_d], position.yaw),
    };
    let relative_m = home.map_or(0.0, |home| position.alt - home.alt);
    GLOBAL_POSITION_INT_DATA {
        time_boot_ms: ms(position.timestamp),
        lat: degrees_e7(position.lat),
        lon: degrees_e7(position.lon),
        alt: mm(position.alt),
        relative_alt: mm(relative_m),
        vx: (north * 100.0).round() as i16,
        vy: (east * 100.0).round() as i16,
        vz: (down * 100.0).round() as i16,
        hdg: centidegrees(yaw).unwrap_or(u16::MAX),
    }
}

pub(super) fn altitude(session: &Session) -> Box<dyn Source> {
    let mut local = Followed::<VehicleLocalPosition>::sampled(session);
    let mut global = Followed::<VehicleGlobalPosition>::sampled(session);
    let mut home = Followed::<HomePosition>::sampled(session);
    let mut baro = BaroAltitude::new(session);
    on_clock(move |send| {
        let (local, baro) = (local.copy(), baro.newest());
        if local.is_some() || baro.is_some() {
            let message = altitude_message(local, global.copy(), home.copy(), baro);
            send(MavMessage::ALTITUDE(ALTITUDE_DATA { time_usec: now_us(), ..message }));
        }
    })
}

fn altitude_message(
    local: Option<VehicleLocalPosition>,
    global: Option<VehicleGlobalPosition>,
    home: Option<HomePosition>,
    baro: Option<f32>,
) -> ALTITUDE_DATA {
    let unknown = f32::NAN;
    let local = local.filter(|local| local.z_valid.into());
    let baro = baro.unwrap_or(unknown);
    let above_sea = local.map(|local| match bool::from(local.z_global) {
        true => local.ref_alt - local.z,
        false => global.map_or(baro, |global| global.alt),
    });
    let bottom = local.filter(|local| local.dist_bottom_valid.into());
    ALTITUDE_DATA {
        time_usec: 0,
        altitude_monotonic: baro,
        altitude_amsl: above_sea.unwrap_or(unknown),
        altitude_local: local.map_or(unknown, |local| -local.z),
        altitude_relative: local.map_or(unknown, |local| home.map_or(0.0, |home| home.z) - local.z),
        altitude_terrain: bottom.map_or(unknown, |local| -local.z - local.dist_bottom),
        bottom_clearance: bottom.map_or(unknown, |local| local.dist_bottom),
    }
}

pub(super) fn hud(session: &Session) -> Box<dyn Source> {
    let mut armed = Followed::<ActuatorArmed>::sampled(session);
    let mut controls = Followed::<ActuatorControls0>::sampled(session);
    let mut airspeed = Followed::<Airspeed>::sampled(session);
    let mut baro = BaroAltitude::new(session);
    on_update(Followed::<VehicleLocalPosition>::new(session), move |local, send| {
        let is_armed = armed.copy().is_some_and(|armed| armed.armed.into());
        let controls = controls.copy().filter(|_| is_armed);
        let message = hud_message(&local, controls, airspeed.copy(), baro.newest());
        send(MavMessage::VFR_HUD(message));
    })
}

fn hud_message(
    local: &VehicleLocalPosition,
    controls: Option<ActuatorControls>,
    airspeed: Option<Airspeed>,
    baro: Option<f32>,
) -> VFR_HUD_DATA {
    let is_global = bool::from(local.z_valid) && bool::from(local.z_global);
    VFR_HUD_DATA {
        airspeed: airspeed.map_or(0.0, |airspeed| airspeed.indicated_airspeed_m_s),
        groundspeed: local.vx.hypot(local.vy),
        // The only angle here that has no word for an unknown one.
        heading: centidegrees(local.yaw).map_or(0, |heading| (heading / 100) as i16),
        throttle: controls
            .map_or(0, |controls| (controls.control[THROTTLE] * 100.0).clamp(0.0, 100.0) as u16),
        alt: match is_global {
            true => local.ref_alt - local.z,
            false => baro.unwrap_or(0.0),
        },
        climb: if local.v_z_valid.into() { -local.vz } else { 0.0 },
    }
}

pub(super) fn home(session: &Session) -> Box<dyn Source> {
    let mut home = Followed::<HomePosition>::sampled(session);
    on_clock(move |send| {
        if let Some(home) = home.copy() {
            send(MavMessage::HOME_POSITION(home_message(&home)));
        }
    })
}

fn home_message(home: &HomePosition) -> HOME_POSITION_DATA {
    HOME_POSITION_DATA {
        latitude: degrees_e7(home.lat),
        longitude: degrees_e7(home.lon),
        altitude: mm(home.alt),
        x: home.x,
        y: home.y,
        z: home.z,
        q: quaternion([0.0, 0.0, home.yaw]),
        time_usec: home.timestamp,
        ..HOME_POSITION_DATA::DEFAULT
    }
}

/// The altitude by air pressure, of whichever topic has it.
struct BaroAltitude {
    sensors: Followed<SensorCombined>,
    air: Followed<VehicleAirData>,
}

impl BaroAltitude {
    fn new(session: &Session) -> Self {
        Self { sensors: Followed::sampled(session), air: Followed::sampled(session) }
    }

    fn newest(&mut self) -> Option<f32> {
        let air = self.air.copy().map(|air| air.baro_alt_meter);
        let sensors = || self.sensors.copy().map(|sensors| sensors.baro_alt_meter);
        // What a topic does not have is 0 and not an altitude.
        air.or_else(sensors).filter(|altitude| *altitude != 0.0)
    }
}

pub(super) fn degrees_e7(degrees: f64) -> i32 {
    (degrees * 1e7).round() as i32
}

fn mm(meters: f32) -> i32 {
    (f64::from(meters) * 1e3).round() as i32
}

/// A heading from 0 to 359.99 degrees. None: it is not known.
pub(super) fn centidegrees(radians: f32) -> Option<u16> {
    let degrees = radians.rem_euclid(TAU).to_degrees();
    degrees.is_finite().then_some((degrees * 100.0).round() as u16 % 36_000)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headings_are_never_negative_and_never_full() {
        assert_eq!(centidegrees(-std::f32::consts::FRAC_PI_2), Some(27_000));
        assert_eq!(centidegrees(0.0), Some(0));
        assert_eq!(centidegrees(-1e-6), Some(0));
        assert_eq!(centidegrees(std::f32::consts::PI), Some(18_000));
        assert_eq!(centidegrees(f32::NAN), None);
    }

    #[test]
    fn a_global_position_in_integers() {
        let position = VehicleGlobalPosition {
            timestamp: 1_234_567,
            lat: 47.397_742_1,
            lon: -8.545_593_8,
            alt: 488.123,
            vel_n: 1.234,
            vel_d: -0.5,
            yaw: -1.0,
            ..VehicleGlobalPosition::default()
        };
        let home = HomePosition { alt: 480.0, ..HomePosition::default() };
        let message = global_message(&position, None, Some(home));
        assert_eq!((message.lat, message.lon), (473_977_421, -85_455_938));
        assert_eq!((message.alt, message.relative_alt), (488_123, 8_123));
        assert_eq!((message.vx, message.vy, message.vz), (123, 0, -50));
        assert_eq!((message.hdg, message.time_boot_ms), (30_270, 1_234));

        let local = VehicleLocalPosition {
            vx: 5.0,
            yaw: 1.0,
            v_xy_valid: true.into(),
            ..VehicleLocalPosition::default()
        };
        let message = global_message(&position, Some(local), Some(home));
        assert_eq!((message.vx, message.hdg), (500, 5_730));
        let unknown = VehicleGlobalPosition { yaw: f32::NAN, ..position };
        assert_eq!(global_message(&unknown, None, None).hdg, u16::MAX);
    }

    #[test]
    fn altitudes_that_nobody_knows_are_no_numbers() {
        let local = VehicleLocalPosition {
            z: -10.0,
            z_valid: true.into(),
            z_global: true.into(),
            ref_alt: 400.0,
            ..VehicleLocalPosition::default()
        };
        let message = altitude_message(Some(local), None, None, None);
        assert_eq!((message.altitude_amsl, message.altitude_relative), (410.0, 10.0));
        assert!(message.altitude_monotonic.is_nan() && message.bottom_clearance.is_nan());
        let home = HomePosition { z: -4.0, ..HomePosition::default() };
        let message = altitude_message(Some(local), None, Some(home), None);
        assert_eq!(message.altitude_relative, 6.0);
    }

    #[test]
    fn a_hud_climbs_when_down_is_negative() {
        let local = VehicleLocalPosition {
            vx: 3.0,
            vy: 4.0,
            vz: -2.0,
            v_z_valid: true.into(),
            yaw: 3.2,
            ..VehicleLocalPosition::default()
        };
        let mut controls = ActuatorControls::default();
        controls.control[THROTTLE] = 0.47;
        let message = hud_message(&local, Some(controls), None, None);
        assert_eq!((message.groundspeed, message.climb), (5.0, 2.0));
        assert_eq!((message.heading, message.throttle), (183, 47));
    }
}
