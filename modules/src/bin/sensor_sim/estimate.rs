//! What is known of the simulated vehicle besides its sensors' readings: what an
//! estimator makes of them, with noise and no bias, and the state of its battery.

use uorb_modules::random::Random;
use uorb_modules::rotation::quaternion;
use uorb_msg::{BatteryStatus, VehicleAttitude, VehicleGlobalPosition, VehicleLocalPosition};

use crate::vehicle::{ALTITUDE, LATITUDE, LONGITUDE, METRES_PER_DEGREE};

/// Where the vehicle is. It stands where it started, which is the origin of the local
/// frame, and looks to the north.
pub(crate) struct Estimate {
    random: Random,
    start_us: u64,
}

impl Estimate {
    /// In rad.
    pub(crate) const ATTITUDE_NOISE: f64 = 0.0005;
    /// [rad/s]
    const RATE_NOISE: f64 = 0.0005;
    /// In metres.
    pub(crate) const POSITION_NOISE: f64 = 0.02;
    /// [m/s]
    const VELOCITY_NOISE: f64 = 0.01;

    pub(crate) fn new(random: Random, start_us: u64) -> Self {
        Self { random, start_us }
    }

    fn around_zero(&mut self, noise: f64) -> [f32; 3] {
        [0; 3].map(|_| self.random.gauss(noise) as f32)
    }

    pub(crate) fn attitude(&mut self, now_us: u64) -> VehicleAttitude {
        let [roll, pitch, yaw] = self.around_zero(Self::ATTITUDE_NOISE);
        let [rollspeed, pitchspeed, yawspeed] = self.around_zero(Self::RATE_NOISE);
        VehicleAttitude {
            timestamp: now_us,
            roll,
            pitch,
            yaw,
            rollspeed,
            pitchspeed,
            yawspeed,
            q: quaternion([roll, pitch, yaw]),
        }
    }

    pub(crate) fn local_position(&mut self, now_us: u64) -> VehicleLocalPosition {
        let [x, y, z] = self.around_zero(Self::POSITION_NOISE);
        let [vx, vy, vz] = self.around_zero(Self::VELOCITY_NOISE);
        let yes = true.into();
        VehicleLocalPosition {
            timestamp: now_us,
            xy_valid: yes,
            z_valid: yes,
            v_xy_valid: yes,
            v_z_valid: yes,
            x,
            y,
            z,
            vx,
            vy,
            vz,
            z_deriv: vz,
            xy_global: yes,
            z_global: yes,
            ref_timestamp: self.start_us,
            ref_lat: LATITUDE,
            ref_lon: LONGITUDE,
            ref_alt: ALTITUDE as f32,
            eph: 0.2,
            epv: 0.3,
            evh: 0.05,
            evv: 0.05,
            ..Default::default()
        }
    }

    /// The place that a local position is.
    pub(crate) fn global_position(&mut self, now_us: u64, utc_us: u64) -> VehicleGlobalPosition {
        let local = self.local_position(now_us);
        let per_degree_east = METRES_PER_DEGREE * LATITUDE.to_radians().cos();
        VehicleGlobalPosition {
            timestamp: now_us,
            time_utc_usec: utc_us,
            lat: LATITUDE + f64::from(local.x) / METRES_PER_DEGREE,
            lon: LONGITUDE + f64::from(local.y) / per_degree_east,
            alt: ALTITUDE as f32 - local.z,
            vel_n: local.vx,
            vel_e: local.vy,
            vel_d: local.vz,
            pos_d_deriv: local.z_deriv,
            eph: local.eph,
            epv: local.epv,
            evh: local.evh,
            evv: local.evv,
            terrain_alt: ALTITUDE as f32,
            terrain_alt_valid: true.into(),
            pressure_alt: ALTITUDE as f32,
            ..Default::default()
        }
    }
}

/// A battery of four cells with 5 Ah, that feeds a computer on the ground.
pub(crate) struct Battery {
    random: Random,
    start_us: u64,
}

impl Battery {
    const CAPACITY_MAH: f64 = 5_000.0;
    const CURRENT_A: f64 = 1.2;
    const CELLS: i32 = 4;

    pub(crate) fn new(random: Random, start_us: u64) -> Self {
        Self { random, start_us }
    }

    pub(crate) fn read(&mut self, now_us: u64) -> BatteryStatus {
        let elapsed_hours = now_us.saturating_sub(self.start_us) as f64 / 3.6e9;
        let discharged_mah = (elapsed_hours * Self::CURRENT_A * 1e3).min(Self::CAPACITY_MAH);
        let remaining = 1.0 - discharged_mah / Self::CAPACITY_MAH;
        // A cell has 4.1 V when it is full and 3.5 V when it is empty.
        let voltage = (3.5 + 0.6 * remaining) * f64::from(Self::CELLS);
        let current = Self::CURRENT_A + self.random.gauss(0.02);
        let warning = match remaining {
            0.15.. => BatteryStatus::BATTERY_WARNING_NONE,
            0.07.. => BatteryStatus::BATTERY_WARNING_LOW,
            0.05.. => BatteryStatus::BATTERY_WARNING_CRITICAL,
            _ => BatteryStatus::BATTERY_WARNING_EMERGENCY,
        };
        BatteryStatus {
            timestamp: now_us,
            voltage_v: (voltage + self.random.gauss(0.01)) as f32,
            voltage_filtered_v: voltage as f32,
            current_a: current as f32,
            current_filtered_a: Self::CURRENT_A as f32,
            discharged_mah: discharged_mah as f32,
            remaining: remaining as f32,
            scale: 1.0,
            cell_count: Self::CELLS,
            connected: true.into(),
            warning,
            ..Default::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicle::tests::mean_and_deviation;

    #[test]
    fn the_estimate_is_level_at_the_origin_and_agrees_with_itself() {
        let mut estimate = Estimate::new(Random::new(1), 0);
        let attitude = estimate.attitude(1);
        let [w, x, y, z] = attitude.q;
        assert!((w * w + x * x + y * y + z * z - 1.0).abs() < 1e-6);
        let roll = (2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y));
        assert!((roll - attitude.roll).abs() < 1e-6, "{roll} {}", attitude.roll);
        let positions: Vec<_> = (1..=10_000).map(|now| estimate.local_position(now)).collect();
        let (mean, deviation) = mean_and_deviation(positions.iter().map(|position| position.x));
        assert!(mean.abs() < 0.001, "{mean}");
        assert!((deviation / Estimate::POSITION_NOISE - 1.0).abs() < 0.05, "{deviation}");
        let global = estimate.global_position(1, 2);
        assert!((global.lat - LATITUDE).abs() * METRES_PER_DEGREE < 0.2);
        assert_eq!(global.time_utc_usec, 2);
    }

    #[test]
    fn the_battery_is_full_at_the_start_and_empty_after_its_capacity() {
        let mut battery = Battery::new(Random::new(1), 0);
        let full = battery.read(0);
        assert_eq!((full.remaining, full.warning), (1.0, BatteryStatus::BATTERY_WARNING_NONE));
        let an_hour = battery.read(3_600_000_000);
        assert!((an_hour.discharged_mah - 1_200.0).abs() < 0.1);
        assert!((an_hour.remaining - 0.76).abs() < 1e-3);
        let empty = battery.read(36_000_000_000);
        assert_eq!(empty.remaining, 0.0);
        assert_eq!(empty.warning, BatteryStatus::BATTERY_WARNING_EMERGENCY);
    }
}
