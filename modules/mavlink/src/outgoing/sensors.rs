//! What sensors measure: HIGHRES_IMU, GPS_RAW_INT.

use uorb_core::Session;
use uorb_msg::{SensorBaro, SensorCombined, VehicleGpsPosition};

use super::newer::{GpsDegrees, VehicleAirData, VehicleMagnetometer};
use super::position::{centidegrees, degrees_e7};
use super::source::{Source, on_update};
use crate::dialect::{GPS_RAW_INT_DATA, HIGHRES_IMU_DATA, HighresImuUpdatedFlags, MavMessage};
use crate::followed::Followed;

pub(super) fn highres_imu(session: &Session) -> Box<dyn Source> {
    let mut baro = Followed::<SensorBaro>::sampled(session);
    let mut air = Followed::<VehicleAirData>::sampled(session);
    let mut mag = Followed::<VehicleMagnetometer>::sampled(session);
    on_update(Followed::<SensorCombined>::new(session), move |sensors, send| {
        let mut message = imu_message(&sensors, baro.copy());
        if let Some(air) = air.copy() {
            message.abs_pressure = air.baro_pressure_pa / 100.0;
            message.pressure_alt = air.baro_alt_meter;
        }
        if let Some(mag) = mag.copy() {
            [message.xmag, message.ymag, message.zmag] = mag.magnetometer_ga;
        }
        send(MavMessage::HIGHRES_IMU(message));
    })
}

/// More millibars than this are no air: newer logs have pascals in the same
/// field.
const PRESSURE_MAX_MBAR: f32 = 2_000.0;

fn in_mbar(pressure: f32) -> f32 {
    if pressure > PRESSURE_MAX_MBAR { pressure / 100.0 } else { pressure }
}

fn imu_message(sensors: &SensorCombined, baro: Option<SensorBaro>) -> HIGHRES_IMU_DATA {
    type Flags = HighresImuUpdatedFlags;
    let is_there = |relative| relative != SensorCombined::RELATIVE_TIMESTAMP_INVALID;
    let mut updated = Flags::HIGHRES_IMU_UPDATED_XGYRO
        | Flags::HIGHRES_IMU_UPDATED_YGYRO
        | Flags::HIGHRES_IMU_UPDATED_ZGYRO;
    let accel = Flags::HIGHRES_IMU_UPDATED_XACC
        | Flags::HIGHRES_IMU_UPDATED_YACC
        | Flags::HIGHRES_IMU_UPDATED_ZACC;
    updated.set(accel, is_there(sensors.accelerometer_timestamp_relative));
    let mag = Flags::HIGHRES_IMU_UPDATED_XMAG
        | Flags::HIGHRES_IMU_UPDATED_YMAG
        | Flags::HIGHRES_IMU_UPDATED_ZMAG;
    updated.set(mag, is_there(sensors.magnetometer_timestamp_relative));
    let has_baro = is_there(sensors.baro_timestamp_relative);
    let altitude = Flags::HIGHRES_IMU_UPDATED_PRESSURE_ALT | Flags::HIGHRES_IMU_UPDATED_TEMPERATURE;
    updated.set(altitude, has_baro);
    updated.set(Flags::HIGHRES_IMU_UPDATED_ABS_PRESSURE, has_baro && baro.is_some());

    let [xacc, yacc, zacc] = sensors.accelerometer_m_s2;
    let [xgyro, ygyro, zgyro] = sensors.gyro_rad;
    let [xmag, ymag, zmag] = sensors.magnetometer_ga;
    HIGHRES_IMU_DATA {
        time_usec: sensors.timestamp,
        xacc,
        yacc,
        zacc,
        xgyro,
        ygyro,
        zgyro,
        xmag,
        ymag,
        zmag,
        // A millibar is a hectopascal.
        abs_pressure: baro.map_or(0.0, |baro| in_mbar(baro.pressure)),
        diff_pressure: 0.0,
        pressure_alt: sensors.baro_alt_meter,
        temperature: sensors.baro_temp_celcius,
        fields_updated: updated.bits(),
        id: 0,
    }
}

pub(super) fn gps_raw(session: &Session) -> Box<dyn Source> {
    let mut degrees = Followed::<GpsDegrees>::sampled(session);
    on_update(Followed::<VehicleGpsPosition>::new(session), move |gps, send| {
        let gps = in_integers(gps, degrees.copy());
        send(MavMessage::GPS_RAW_INT(gps_message(&gps)));
    })
}

/// The position of newer logs, where the integers are not there.
fn in_integers(gps: VehicleGpsPosition, degrees: Option<GpsDegrees>) -> VehicleGpsPosition {
    match degrees {
        Some(degrees) if (gps.lat, gps.lon, gps.alt) == (0, 0, 0) => VehicleGpsPosition {
            lat: degrees_e7(degrees.latitude_deg),
            lon: degrees_e7(degrees.longitude_deg),
            alt: (degrees.altitude_msl_m * 1e3).round() as i32,
            alt_ellipsoid: (degrees.altitude_ellipsoid_m * 1e3).round() as i32,
            ..gps
        },
        _ => gps,
    }
}

fn gps_message(gps: &VehicleGpsPosition) -> GPS_RAW_INT_DATA {
    GPS_RAW_INT_DATA {
        time_usec: gps.timestamp,
        fix_type: gps.fix_type,
        lat: gps.lat,
        lon: gps.lon,
        alt: gps.alt,
        eph: hundredths(gps.hdop),
        epv: hundredths(gps.vdop),
        vel: hundredths(gps.vel_m_s),
        cog: centidegrees(gps.cog_rad).unwrap_or(u16::MAX),
        satellites_visible: gps.satellites_used,
        alt_ellipsoid: gps.alt_ellipsoid,
        h_acc: thousandths(gps.eph),
        v_acc: thousandths(gps.epv),
        vel_acc: thousandths(gps.s_variance_m_s),
        hdg_acc: 0,
        yaw: 0,
    }
}

/// In hundredths; 65,535 says that nobody knows.
fn hundredths(value: f32) -> u16 {
    if value.is_finite() { (value * 100.0).round() as u16 } else { u16::MAX }
}

fn thousandths(value: f32) -> u32 {
    (value * 1e3).round() as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_imu_without_magnetometer_says_so() {
        let sensors = SensorCombined {
            timestamp: 77,
            gyro_rad: [0.1, 0.2, 0.3],
            accelerometer_m_s2: [1.0, 2.0, -9.8],
            magnetometer_timestamp_relative: SensorCombined::RELATIVE_TIMESTAMP_INVALID,
            baro_alt_meter: 488.0,
            ..SensorCombined::default()
        };
        let baro = SensorBaro { pressure: 955.5, ..SensorBaro::default() };
        let message = imu_message(&sensors, Some(baro));
        assert_eq!(message.fields_updated, 0b1_1010_0011_1111);
        assert_eq!((message.zacc, message.ygyro, message.time_usec), (-9.8, 0.2, 77));
        assert_eq!((message.abs_pressure, message.pressure_alt), (955.5, 488.0));
    }

    #[test]
    fn a_gps_in_the_units_of_mavlink() {
        let gps = VehicleGpsPosition {
            lat: 473_977_421,
            alt: 488_000,
            hdop: 0.71,
            vel_m_s: 2.5,
            cog_rad: -std::f32::consts::FRAC_PI_2,
            eph: 0.9,
            fix_type: 3,
            satellites_used: 12,
            ..VehicleGpsPosition::default()
        };
        let message = gps_message(&gps);
        assert_eq!((message.lat, message.alt), (473_977_421, 488_000));
        assert_eq!((message.eph, message.vel, message.cog), (71, 250, 27_000));
        assert_eq!((message.h_acc, message.satellites_visible), (900, 12));
        assert_eq!(hundredths(f32::NAN), u16::MAX);
        let unknown = VehicleGpsPosition { cog_rad: f32::NAN, ..gps };
        assert_eq!(gps_message(&unknown).cog, u16::MAX);

        let degrees =
            GpsDegrees { latitude_deg: -33.5, altitude_msl_m: 12.345, ..GpsDegrees::default() };
        assert_eq!(in_integers(gps, Some(degrees)), gps);
        let newer = in_integers(VehicleGpsPosition::default(), Some(degrees));
        assert_eq!((newer.lat, newer.alt), (-335_000_000, 12_345));
        assert_eq!((in_mbar(955.5), in_mbar(95_550.0)), (955.5, 955.5));
    }
}
