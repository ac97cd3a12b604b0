//! HIL_SENSOR and HIL_GPS: a simulator's sensors, on the topics of real ones.
//!
//! A message says which of its sensors were read; only those are published. The
//! times are those of their arrival, as PX4 has it: a simulator's clock is its own.

use std::f32::consts::{PI, TAU};

use uorb_msg::{Airspeed, SensorAccel, SensorBaro, SensorGyro, SensorMag, VehicleGpsPosition};

use crate::dialect::{HIL_GPS_DATA, HIL_SENSOR_DATA};

/// Which axes of HIL_SENSOR belong together, as bits of `fields_updated`.
const ACCEL: u32 = 0b111;
const GYRO: u32 = 0b111 << 3;
const MAG: u32 = 0b111 << 6;
const ABSOLUTE_PRESSURE: u32 = 1 << 9;
const DIFFERENTIAL_PRESSURE: u32 = 1 << 10;

/// PX4's device ids of simulated sensors: the kind of device, its address, and a bus
/// of type 4, which is a simulation.
const fn device_id(kind: u32, address: u32) -> u32 {
    kind << 16 | address << 8 | 1 << 3 | 4
}

/// Density of air at sea level. [kg/m^3]
const AIR_DENSITY: f32 = 1.225;

/// What a simulator's sensors have measured.
#[derive(Clone, Copy, Debug, Default)]
pub struct Readings {
    /// The accelerometer.
    pub accel: Option<SensorAccel>,
    /// The magnetometer.
    pub mag: Option<SensorMag>,
    /// The barometer.
    pub baro: Option<SensorBaro>,
    /// The airspeed sensor.
    pub airspeed: Option<Airspeed>,
    /// The gyroscope, which is published last: it sets the pace of `sensors`.
    pub gyro: Option<SensorGyro>,
}

/// When its accelerometer and its gyroscope were read last.
#[derive(Clone, Copy, Debug, Default)]
pub struct Simulator {
    accel_us: Option<u64>,
    gyro_us: Option<u64>,
}

impl Simulator {
    /// Takes apart what came at `now_us`.
    pub fn read(&mut self, message: &HIL_SENSOR_DATA, now_us: u64) -> Readings {
        let has = |bits: u32| message.fields_updated & bits == bits;
        let mut readings = Readings::default();
        if has(ACCEL) {
            readings.accel = Some(accel(message, elapsed(&mut self.accel_us, now_us), now_us));
        }
        if has(GYRO) {
            readings.gyro = Some(gyro(message, elapsed(&mut self.gyro_us, now_us), now_us));
        }
        if has(MAG) {
            readings.mag = Some(SensorMag {
                timestamp: now_us,
                x: message.xmag,
                y: message.ymag,
                z: message.zmag,
                temperature: message.temperature,
                device_id: device_id(0x03, 3),
                ..Default::default()
            });
        }
        if has(ABSOLUTE_PRESSURE) {
            readings.baro = Some(SensorBaro {
                timestamp: now_us,
                // Hectopascal are millibar.
                pressure: message.abs_pressure,
                altitude: message.pressure_alt,
                temperature: message.temperature,
                device_id: device_id(0x65, 4),
                ..Default::default()
            });
        }
        if has(DIFFERENTIAL_PRESSURE) {
            readings.airspeed = Some(airspeed(message, now_us));
        }
        readings
    }
}

/// Since the last reading; nothing of the first.
fn elapsed(last_us: &mut Option<u64>, now_us: u64) -> u64 {
    now_us.saturating_sub(last_us.replace(now_us).unwrap_or(now_us))
}

fn accel(message: &HIL_SENSOR_DATA, integral_dt: u64, now_us: u64) -> SensorAccel {
    let [x, y, z] = [message.xacc, message.yacc, message.zacc];
    let [x_integral, y_integral, z_integral] =
        [x, y, z].map(|axis| axis * integral_dt as f32 * 1e-6);
    SensorAccel {
        timestamp: now_us,
        integral_dt,
        x,
        y,
        z,
        x_integral,
        y_integral,
        z_integral,
        temperature: message.temperature,
        device_id: device_id(0x14, 1),
        ..Default::default()
    }
}

fn gyro(message: &HIL_SENSOR_DATA, integral_dt: u64, now_us: u64) -> SensorGyro {
    let [x, y, z] = [message.xgyro, message.ygyro, message.zgyro];
    let [x_integral, y_integral, z_integral] =
        [x, y, z].map(|axis| axis * integral_dt as f32 * 1e-6);
    SensorGyro {
        timestamp: now_us,
        integral_dt,
        x,
        y,
        z,
        x_integral,
        y_integral,
        z_integral,
        temperature: message.temperature,
        device_id: device_id(0x14, 2),
        ..Default::default()
    }
}

fn airspeed(message: &HIL_SENSOR_DATA, now_us: u64) -> Airspeed {
    let pascal = message.diff_pressure * 100.0;
    let indicated = (2.0 * pascal.abs() / AIR_DENSITY).sqrt().copysign(pascal);
    Airspeed {
        timestamp: now_us,
        indicated_airspeed_m_s: indicated,
        // At sea level they are the same.
        true_airspeed_m_s: indicated,
        true_airspeed_unfiltered_m_s: indicated,
        air_temperature_celsius: message.temperature,
        confidence: 1.0,
        differential_pressure_filtered_pa: pascal,
    }
}

/// What a simulator's GPS receiver says.
pub fn hil_gps(message: &HIL_GPS_DATA, now_us: u64) -> VehicleGpsPosition {
    /// Centimetres, of which 65,535 are none.
    fn metres(cm: u16) -> f32 {
        if cm == u16::MAX { f32::NAN } else { f32::from(cm) * 1e-2 }
    }
    let course = match message.cog {
        u16::MAX => f32::NAN,
        cog => f32::from(cog % 36_000) * 1e-2 / 360.0 * TAU,
    };
    VehicleGpsPosition {
        timestamp: now_us,
        lat: message.lat,
        lon: message.lon,
        alt: message.alt,
        alt_ellipsoid: message.alt,
        s_variance_m_s: 0.25,
        c_variance_rad: 0.5,
        fix_type: message.fix_type,
        eph: metres(message.eph),
        epv: metres(message.epv),
        vel_m_s: metres(message.vel),
        vel_n_m_s: f32::from(message.vn) * 1e-2,
        vel_e_m_s: f32::from(message.ve) * 1e-2,
        vel_d_m_s: f32::from(message.vd) * 1e-2,
        cog_rad: if course > PI { course - TAU } else { course },
        vel_ned_valid: true.into(),
        time_utc_usec: message.time_usec,
        satellites_used: message.satellites_visible,
        ..Default::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_read_is_published_and_integrals_span_the_time_between() {
        let mut simulator = Simulator::default();
        let message = HIL_SENSOR_DATA {
            zacc: -9.8,
            xgyro: 0.5,
            fields_updated: ACCEL | GYRO,
            ..HIL_SENSOR_DATA::DEFAULT
        };
        let first = simulator.read(&message, 1_000);
        assert_eq!(first.accel.unwrap().integral_dt, 0);
        assert!(first.mag.is_none() && first.baro.is_none() && first.airspeed.is_none());
        let second = simulator.read(&message, 5_000);
        let (accel, gyro) = (second.accel.unwrap(), second.gyro.unwrap());
        assert_eq!((accel.timestamp, accel.integral_dt, accel.z), (5_000, 4_000, -9.8));
        assert!((accel.z_integral + 9.8 * 0.004).abs() < 1e-6);
        assert!((gyro.x_integral - 0.002).abs() < 1e-6);

        let slow = HIL_SENSOR_DATA {
            xmag: 0.2,
            abs_pressure: 1_000.0,
            pressure_alt: 110.0,
            diff_pressure: 0.6125,
            fields_updated: MAG | ABSOLUTE_PRESSURE | DIFFERENTIAL_PRESSURE,
            ..HIL_SENSOR_DATA::DEFAULT
        };
        let readings = simulator.read(&slow, 6_000);
        assert!(readings.accel.is_none() && readings.gyro.is_none());
        assert_eq!(readings.mag.unwrap().x, 0.2);
        assert_eq!(readings.baro.unwrap().pressure, 1_000.0);
        assert!((readings.airspeed.unwrap().indicated_airspeed_m_s - 10.0).abs() < 1e-3);
    }

    #[test]
    fn one_axis_of_three_is_no_reading() {
        let message = HIL_SENSOR_DATA { fields_updated: 0b1, ..HIL_SENSOR_DATA::DEFAULT };
        assert!(Simulator::default().read(&message, 1).accel.is_none());
    }

    #[test]
    fn a_gps_speaks_in_centimetres_and_hundredths_of_degrees() {
        let message = HIL_GPS_DATA {
            time_usec: 1_700_000_000_000_000,
            fix_type: 3,
            lat: 473_977_420,
            eph: 90,
            epv: u16::MAX,
            vel: 500,
            vn: -500,
            cog: 18_100,
            satellites_visible: 14,
            ..HIL_GPS_DATA::DEFAULT
        };
        let gps = hil_gps(&message, 3);
        assert_eq!((gps.timestamp, gps.lat, gps.fix_type), (3, 473_977_420, 3));
        assert!((gps.eph - 0.9).abs() < 1e-6 && gps.epv.is_nan());
        assert!((gps.vel_m_s - 5.0).abs() < 1e-6 && (gps.vel_n_m_s + 5.0).abs() < 1e-6);
        assert!((gps.cog_rad.to_degrees() + 179.0).abs() < 1e-3, "{}", gps.cog_rad);
        let unknown = HIL_GPS_DATA { cog: u16::MAX, ..message };
        assert!(hil_gps(&unknown, 3).cog_rad.is_nan());
    }
}
