//! The simulated vehicle: what its sensors measure while it stands still.
//!
//! It stands in Zurich, level, its nose to the north, so the body frame is the
//! local north-east-down frame. What is known of the place is below as
//! constants; each device adds its own bias and noise, of the size that its
//! data sheet gives, from a random sequence of its own. A reading depends on
//! the seed and on how many came before it, and its timestamp on nothing but
//! the beat.

use std::f64::consts::TAU;

use uorb_modules::random::Random;
use uorb_msg::{SensorAccel, SensorBaro, SensorGyro, SensorMag, VehicleGpsPosition};

/// What an accelerometer at rest measures is the push of the ground, upwards:
/// minus this along the axis that points down. [m/s^2]
pub(crate) const GRAVITY: f64 = 9.80665;

/// The magnetic field in Zurich in 2017, to the north, the east and down:
/// inclination 63.3 degrees, declination 2.3; in Gauss.
pub(crate) const MAGNETIC_FIELD: [f64; 3] = [0.2150, 0.0086, 0.4274];

/// Where PX4's simulations start, too. [deg, deg, m above mean sea level]
pub(crate) const LATITUDE: f64 = 47.397_742;
pub(crate) const LONGITUDE: f64 = 8.545_594;
pub(crate) const ALTITUDE: f64 = 488.0;

/// How far mean sea level is above the ellipsoid there, in metres.
const GEOID: f64 = 47.6;

/// A circle of latitude is this many metres a degree from the next one.
pub(crate) const METRES_PER_DEGREE: f64 = 111_190.0;

/// PX4's device ids of simulated sensors: the kind of device, its address, and
/// the number of a bus of type 4, which is a simulation.
const fn device_id(kind: u32, address: u32, bus: u32) -> u32 {
    kind << 16 | address << 8 | bus << 3 | 4
}

/// The standard atmosphere below 11 km: pressure at sea level in
/// mbar, temperature there in K, lapse rate in K/m, gas constant of air in
/// J/(kg K).
const SEA_LEVEL_MBAR: f64 = 1013.25;
const SEA_LEVEL_KELVIN: f64 = 288.15;
const LAPSE_RATE: f64 = 0.0065;
const GAS_CONSTANT: f64 = 287.05;

pub(crate) fn pressure_at(altitude: f64) -> f64 {
    let exponent = GRAVITY / (LAPSE_RATE * GAS_CONSTANT);
    SEA_LEVEL_MBAR * (1.0 - LAPSE_RATE * altitude / SEA_LEVEL_KELVIN).powf(exponent)
}

pub(crate) fn altitude_at(pressure: f64) -> f64 {
    let exponent = LAPSE_RATE * GAS_CONSTANT / GRAVITY;
    (1.0 - (pressure / SEA_LEVEL_MBAR).powf(exponent)) * SEA_LEVEL_KELVIN / LAPSE_RATE
}

/// What the sensors with three axes have in common.
struct ThreeAxes {
    random: Random,
    truth_and_bias: [f64; 3],
    noise: f64,
    /// What one step of the raw values means. The sensor has 16 bits.
    scaling: f64,
    /// The time of the last reading, for the integrals.
    last_us: u64,
}

struct Sample {
    xyz: [f64; 3],
    raw: [i16; 3],
    elapsed_us: u64,
}

impl ThreeAxes {
    fn sample(&mut self, now_us: u64) -> Sample {
        let elapsed_us = now_us.saturating_sub(self.last_us);
        self.last_us = now_us;
        let xyz = self.truth_and_bias.map(|axis| axis + self.random.gauss(self.noise));
        // `as` saturates, and so does the sensor.
        let raw = xyz.map(|axis| (axis / self.scaling).round() as i16);
        Sample { xyz, raw, elapsed_us }
    }
}

fn add(truth: [f64; 3], bias: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| truth[axis] + bias[axis])
}

/// One of three accelerometers, with the noise of an MPU-6000 in its range of
/// 8 g.
pub(crate) struct Accelerometer {
    axes: ThreeAxes,
    device_id: u32,
}

impl Accelerometer {
    /// What calibration has left over: each device has its own. [m/s^2]
    pub(crate) const BIAS: [[f64; 3]; 3] =
        [[0.02, -0.03, 0.05], [-0.06, 0.04, -0.09], [0.11, 0.08, 0.14]];
    /// 0.4 mg per root Hz over 60 Hz. [m/s^2]
    pub(crate) const NOISE: f64 = 0.03;
    const RANGE: f64 = 8.0 * GRAVITY;

    /// Device 0, 1 or 2, which starts to measure at `start_us`.
    pub(crate) fn new(device: usize, random: Random, start_us: u64) -> Self {
        let axes = ThreeAxes {
            random,
            truth_and_bias: add([0.0, 0.0, -GRAVITY], Self::BIAS[device]),
            noise: Self::NOISE,
            scaling: Self::RANGE / 32_768.0,
            last_us: start_us,
        };
        Self { axes, device_id: device_id(0x14, 1, device as u32 + 1) }
    }

    pub(crate) fn read(&mut self, now_us: u64) -> SensorAccel {
        let Sample { xyz, raw, elapsed_us } = self.axes.sample(now_us);
        let [x, y, z] = xyz.map(|axis| axis as f32);
        let [x_integral, y_integral, z_integral] =
            xyz.map(|axis| (axis * elapsed_us as f64 * 1e-6) as f32);
        let [x_raw, y_raw, z_raw] = raw;
        SensorAccel {
            timestamp: now_us,
            integral_dt: elapsed_us,
            x,
            y,
            z,
            x_integral,
            y_integral,
            z_integral,
            temperature: 46.0,
            range_m_s2: Self::RANGE as f32,
            scaling: self.axes.scaling as f32,
            x_raw,
            y_raw,
            z_raw,
            temperature_raw: mpu_6000_raw(46.0),
            device_id: self.device_id,
            ..Default::default()
        }
    }
}

/// The MPU-6000's temperature register.
fn mpu_6000_raw(celsius: f64) -> i16 {
    ((celsius - 36.53) * 340.0).round() as i16
}

/// The gyroscope, of an MPU-6000 in its range of 2000 degrees a second.
pub(crate) struct Gyroscope {
    axes: ThreeAxes,
}

impl Gyroscope {
    const BIAS: [f64; 3] = [0.002, -0.001, 0.0015];
    /// 0.005 degrees a second per root Hz over 125 Hz. [rad/s]
    pub(crate) const NOISE: f64 = 0.001;
    const RANGE: f64 = 2000.0 / 360.0 * TAU;

    pub(crate) fn new(random: Random, start_us: u64) -> Self {
        let axes = ThreeAxes {
            random,
            truth_and_bias: Self::BIAS,
            noise: Self::NOISE,
            scaling: Self::RANGE / 32_768.0,
            last_us: start_us,
        };
        Self { axes }
    }

    pub(crate) fn read(&mut self, now_us: u64) -> SensorGyro {
        let Sample { xyz, raw, elapsed_us } = self.axes.sample(now_us);
        let [x, y, z] = xyz.map(|axis| axis as f32);
        let [x_integral, y_integral, z_integral] =
            xyz.map(|axis| (axis * elapsed_us as f64 * 1e-6) as f32);
        let [x_raw, y_raw, z_raw] = raw;
        SensorGyro {
            timestamp: now_us,
            integral_dt: elapsed_us,
            x,
            y,
            z,
            x_integral,
            y_integral,
            z_integral,
            temperature: 46.0,
            range_rad_s: Self::RANGE as f32,
            scaling: self.axes.scaling as f32,
            x_raw,
            y_raw,
            z_raw,
            temperature_raw: mpu_6000_raw(46.0),
            device_id: device_id(0x14, 1, 1),
            ..Default::default()
        }
    }
}

/// The magnetometer, an HMC5883 beside the GPS receiver.
pub(crate) struct Magnetometer {
    axes: ThreeAxes,
}

impl Magnetometer {
    /// In Gauss.
    pub(crate) const NOISE: f64 = 0.002;
    const RANGE: f64 = 1.3;

    pub(crate) fn new(random: Random, start_us: u64) -> Self {
        let axes = ThreeAxes {
            random,
            truth_and_bias: MAGNETIC_FIELD,
            noise: Self::NOISE,
            scaling: 1.0 / 1090.0,
            last_us: start_us,
        };
        Self { axes }
    }

    pub(crate) fn read(&mut self, now_us: u64) -> SensorMag {
        let Sample { xyz, raw, .. } = self.axes.sample(now_us);
        let [x, y, z] = xyz.map(|axis| axis as f32);
        let [x_raw, y_raw, z_raw] = raw;
        SensorMag {
            timestamp: now_us,
            x,
            y,
            z,
            range_ga: Self::RANGE as f32,
            scaling: self.axes.scaling as f32,
            temperature: 31.0,
            x_raw,
            y_raw,
            z_raw,
            device_id: device_id(0x03, 3, 1),
            is_external: 1,
            ..Default::default()
        }
    }
}

/// The barometer, an MS5611.
pub(crate) struct Barometer {
    random: Random,
}

impl Barometer {
    /// 0.012 mbar are 10 cm.
    pub(crate) const NOISE: f64 = 0.012;

    pub(crate) fn new(random: Random) -> Self {
        Self { random }
    }

    pub(crate) fn read(&mut self, now_us: u64) -> SensorBaro {
        let pressure = pressure_at(ALTITUDE) + self.random.gauss(Self::NOISE);
        SensorBaro {
            timestamp: now_us,
            pressure: pressure as f32,
            altitude: altitude_at(pressure) as f32,
            temperature: 38.0,
            device_id: device_id(0x65, 4, 1),
            ..Default::default()
        }
    }
}

/// The GPS receiver, with a fix of 14 satellites.
///
/// Its error is not new with every reading: it wanders, and is another one
/// after about half a minute (a Gauss-Markov process).
pub(crate) struct Gps {
    random: Random,
    /// To the north, the east and up, in metres.
    error: [f64; 3],
    last_us: u64,
}

impl Gps {
    pub(crate) const ERROR_HORIZONTAL: f64 = 0.8;
    pub(crate) const ERROR_VERTICAL: f64 = 1.5;
    const ERRORS: [f64; 3] = [Self::ERROR_HORIZONTAL, Self::ERROR_HORIZONTAL, Self::ERROR_VERTICAL];
    const WANDERS_IN_SECONDS: f64 = 30.0;
    /// [m/s]
    const VELOCITY_NOISE: f64 = 0.05;

    pub(crate) fn new(mut random: Random, start_us: u64) -> Self {
        let error = Self::ERRORS.map(|error| random.gauss(error));
        Self { random, error, last_us: start_us }
    }

    /// `utc_us` is what the receiver's clock says at `now_us`.
    pub(crate) fn read(&mut self, now_us: u64, utc_us: u64) -> VehicleGpsPosition {
        let elapsed = now_us.saturating_sub(self.last_us) as f64 * 1e-6;
        self.last_us = now_us;
        let kept = (-elapsed / Self::WANDERS_IN_SECONDS).exp();
        let renewed = (1.0 - kept * kept).sqrt();
        for (error, size) in self.error.iter_mut().zip(Self::ERRORS) {
            *error = *error * kept + self.random.gauss(size * renewed);
        }
        let [north, east, up] = self.error;
        let latitude = LATITUDE + north / METRES_PER_DEGREE;
        let longitude = LONGITUDE + east / (METRES_PER_DEGREE * LATITUDE.to_radians().cos());
        let altitude = ALTITUDE + up;
        let [v_north, v_east, v_down] =
            [0; 3].map(|_| self.random.gauss(Self::VELOCITY_NOISE) as f32);
        VehicleGpsPosition {
            timestamp: now_us,
            lat: (latitude * 1e7).round() as i32,
            lon: (longitude * 1e7).round() as i32,
            alt: (altitude * 1e3).round() as i32,
            alt_ellipsoid: ((altitude + GEOID) * 1e3).round() as i32,
            s_variance_m_s: 0.3,
            c_variance_rad: 0.4,
            fix_type: 3,
            eph: 0.9,
            epv: 1.7,
            hdop: 0.8,
            vdop: 1.2,
            noise_per_ms: 90,
            jamming_indicator: 15,
            vel_m_s: v_north.hypot(v_east),
            vel_n_m_s: v_north,
            vel_e_m_s: v_east,
            vel_d_m_s: v_down,
            cog_rad: v_east.atan2(v_north),
            vel_ned_valid: true.into(),
            // The two times are taken at the same instant.
            timestamp_time_relative: 0,
            time_utc_usec: utc_us,
            satellites_used: 14,
            ..Default::default()
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    const PERIOD_US: u64 = 4_000;

    fn accelerations(device: usize, seed: u64) -> Vec<SensorAccel> {
        let mut accel = Accelerometer::new(device, Random::of_source(seed, device as u32), 0);
        (1..=20_000).map(|reading| accel.read(reading * PERIOD_US)).collect()
    }

    pub(crate) fn mean_and_deviation(values: impl Iterator<Item = f32> + Clone) -> (f64, f64) {
        let count = values.clone().count() as f64;
        let mean = values.clone().map(f64::from).sum::<f64>() / count;
        let variance = values.map(|value| (f64::from(value) - mean).powi(2)).sum::<f64>() / count;
        (mean, variance.sqrt())
    }

    #[test]
    fn each_accelerometer_feels_gravity_its_own_bias_and_noise() {
        for device in 0..3 {
            let readings = accelerations(device, 1);
            let [bias_x, bias_y, bias_z] = Accelerometer::BIAS[device];
            let axes = [
                (mean_and_deviation(readings.iter().map(|accel| accel.x)), bias_x),
                (mean_and_deviation(readings.iter().map(|accel| accel.y)), bias_y),
                (mean_and_deviation(readings.iter().map(|accel| accel.z)), bias_z - GRAVITY),
            ];
            for ((mean, deviation), expected) in axes {
                // Five standard errors: 5 * 0.03 / sqrt(20,000) = 0.001.
                assert!((mean - expected).abs() < 0.001, "device {device}: {mean} {expected}");
                assert!((deviation / Accelerometer::NOISE - 1.0).abs() < 0.03, "{deviation}");
            }
        }
    }

    #[test]
    fn a_seed_is_a_flight() {
        assert_eq!(accelerations(0, 1), accelerations(0, 1));
        assert_ne!(accelerations(0, 1)[0], accelerations(0, 2)[0]);
        let noise = |device| accelerations(device, 1)[0].x as f64 - Accelerometer::BIAS[device][0];
        assert_ne!(noise(0), noise(1), "devices do not share their noise");
    }

    #[test]
    fn integrals_raw_values_and_ids_agree_with_the_readings() {
        let readings = accelerations(1, 1);
        assert_eq!(readings[0].device_id, 1_310_996, "as PX4 numbers its second simulated one");
        for accel in readings {
            assert_eq!(accel.integral_dt, PERIOD_US);
            assert!((accel.z_integral - accel.z * 0.004).abs() < 1e-6);
            assert!((f32::from(accel.z_raw) * accel.scaling - accel.z).abs() <= accel.scaling);
            assert!(accel.z.abs() < accel.range_m_s2);
        }
    }

    #[test]
    fn a_gyroscope_at_rest_measures_its_bias() {
        let mut gyro = Gyroscope::new(Random::new(1), 0);
        let readings: Vec<_> = (1..=20_000).map(|count| gyro.read(count * PERIOD_US)).collect();
        let (mean, deviation) = mean_and_deviation(readings.iter().map(|gyro| gyro.x));
        assert!((mean - Gyroscope::BIAS[0]).abs() < 5e-5, "{mean}");
        assert!((deviation / Gyroscope::NOISE - 1.0).abs() < 0.03, "{deviation}");
        assert!((readings[0].range_rad_s - 34.9066).abs() < 1e-3);
    }

    #[test]
    fn the_magnetic_field_is_that_of_zurich() {
        let mut mag = Magnetometer::new(Random::new(1), 0);
        let readings: Vec<_> = (1..=10_000).map(|count| mag.read(count * 10_000)).collect();
        let (north, _) = mean_and_deviation(readings.iter().map(|mag| mag.x));
        let (east, _) = mean_and_deviation(readings.iter().map(|mag| mag.y));
        let (down, deviation) = mean_and_deviation(readings.iter().map(|mag| mag.z));
        let horizontal = north.hypot(east);
        assert!((horizontal.hypot(down) - 0.4785).abs() < 0.001, "in Gauss");
        assert!((down.atan2(horizontal).to_degrees() - 63.3).abs() < 0.3, "inclination");
        assert!((east.atan2(north).to_degrees() - 2.3).abs() < 0.3, "declination");
        assert!((deviation / Magnetometer::NOISE - 1.0).abs() < 0.05, "{deviation}");
    }

    #[test]
    fn pressure_and_altitude_are_two_names_of_one_thing() {
        assert!((pressure_at(0.0) - 1013.25).abs() < 1e-9);
        // The table of the standard atmosphere: 954.61 mbar at 500 m.
        assert!((pressure_at(500.0) - 954.61).abs() < 0.01, "{}", pressure_at(500.0));
        let mut baro = Barometer::new(Random::new(1));
        let readings: Vec<_> = (1..=10_000).map(|count| baro.read(count * 20_000)).collect();
        let (altitude, deviation) = mean_and_deviation(readings.iter().map(|baro| baro.altitude));
        assert!((altitude - ALTITUDE).abs() < 0.01, "{altitude}");
        assert!((0.08..0.13).contains(&deviation), "{deviation} m");
        for baro in readings {
            assert!((altitude_at(baro.pressure.into()) - f64::from(baro.altitude)).abs() < 0.001);
        }
    }

    #[test]
    fn the_gps_wanders_about_the_place() {
        let mut gps = Gps::new(Random::new(1), 0);
        let readings: Vec<_> = (1..=50_000).map(|count| gps.read(count * 200_000, count)).collect();
        let metres = |fix: &VehicleGpsPosition| {
            ((f64::from(fix.lat) * 1e-7 - LATITUDE) * METRES_PER_DEGREE) as f32
        };
        let (mean, deviation) = mean_and_deviation(readings.iter().map(metres));
        assert!(mean.abs() < 0.3, "{mean} m");
        assert!((deviation / Gps::ERROR_HORIZONTAL - 1.0).abs() < 0.2, "{deviation} m");
        // One reading is near the next one: 0.8 m * sqrt(2 * 0.2 s / 30 s) = 9 cm.
        let steps = readings.windows(2).map(|pair| metres(&pair[1]) - metres(&pair[0]));
        let (_, step) = mean_and_deviation(steps);
        assert!((0.07..0.12).contains(&step), "{step} m");
        let last = readings[49_999];
        assert_eq!((last.alt_ellipsoid - last.alt, last.time_utc_usec), (47_600, 50_000));
        assert!((last.vel_m_s - last.vel_n_m_s.hypot(last.vel_e_m_s)).abs() < 1e-6);
    }
}
