//! What the commander hears of the rest of the vehicle.
//!
//! A sensor is present from its first message on, and healthy while its messages
//! come. How long ago the last one came is taken from the node, not from its
//! timestamp: a flight that is replayed has the timestamps of that day.

use std::ops::Deref;

use uorb_core::{RawSubscription, Session, Subscription, Topic, now_us};
use uorb_msg::{
    BatteryStatus, OffboardControlMode, SensorAccel, SensorBaro, SensorGyro, SensorMag,
    VehicleAttitude, VehicleGpsPosition,
};

use crate::state::{Place, Senses};

/// After so long a sensor is silent.
const SILENT_US: u64 = 2_000_000;

/// After so long a program outside has stopped sending setpoints, as in PX4.
const OFFBOARD_LOST_US: u64 = 500_000;

/// Bits of MAVLink's SYS_STATUS.
const GYRO: u32 = 1 << 0;
const ACCEL: u32 = 1 << 1;
const MAG: u32 = 1 << 2;
const ABSOLUTE_PRESSURE: u32 = 1 << 3;
const GPS: u32 = 1 << 5;
const AHRS: u32 = 1 << 21;
const BATTERY: u32 = 1 << 25;
const PREARM_CHECK: u32 = 1 << 28;

/// The subscriptions.
pub(crate) struct Ears {
    gyro_sub: Subscription<SensorGyro>,
    accel_sub: Subscription<SensorAccel>,
    mag_sub: Subscription<SensorMag>,
    baro_sub: Subscription<SensorBaro>,
    gps_sub: Subscription<VehicleGpsPosition>,
    attitude_sub: Subscription<VehicleAttitude>,
    battery_sub: Subscription<BatteryStatus>,
    offboard_sub: Subscription<OffboardControlMode>,
}

impl Ears {
    pub(crate) fn open(session: &Session) -> Result<Self, uorb_core::Error> {
        Ok(Self {
            gyro_sub: Subscription::subscribe(session)?,
            accel_sub: Subscription::subscribe(session)?,
            mag_sub: Subscription::subscribe(session)?,
            baro_sub: Subscription::subscribe(session)?,
            gps_sub: Subscription::subscribe(session)?,
            attitude_sub: Subscription::subscribe(session)?,
            battery_sub: Subscription::subscribe(session)?,
            offboard_sub: Subscription::subscribe(session)?,
        })
    }

    /// What there is to know now.
    pub(crate) fn listen(&mut self) -> Senses {
        let now_us = now_us();
        let heard = [
            (GYRO, silence_us(&self.gyro_sub, now_us)),
            (ACCEL, silence_us(&self.accel_sub, now_us)),
            (MAG, silence_us(&self.mag_sub, now_us)),
            (ABSOLUTE_PRESSURE, silence_us(&self.baro_sub, now_us)),
            (GPS, silence_us(&self.gps_sub, now_us)),
            (AHRS, silence_us(&self.attitude_sub, now_us)),
            (BATTERY, silence_us(&self.battery_sub, now_us)),
            // Nothing speaks against arming.
            (PREARM_CHECK, Some(0)),
        ];
        let bits = |is_counted: fn(u64) -> bool| {
            let counted = heard.iter().filter(|(_, silence_us)| silence_us.is_some_and(is_counted));
            counted.fold(0, |bits, (bit, _)| bits | bit)
        };
        Senses {
            position: self.position(now_us),
            has_offboard_setpoints: silence_us(&self.offboard_sub, now_us)
                .is_some_and(|silence_us| silence_us < OFFBOARD_LOST_US),
            sensors_present: bits(|_| true),
            sensors_healthy: bits(|silence_us| silence_us < SILENT_US),
        }
    }

    fn position(&mut self, now_us: u64) -> Option<Place> {
        const FIX_3D: u8 = 3;
        let is_recent = silence_us(&self.gps_sub, now_us)? < SILENT_US;
        let gps = self.gps_sub.copy().filter(|gps| is_recent && gps.fix_type >= FIX_3D)?;
        Some(Place {
            lat: f64::from(gps.lat) * 1e-7,
            lon: f64::from(gps.lon) * 1e-7,
            alt: (f64::from(gps.alt) * 1e-3) as f32,
        })
    }
}

/// How long ago the last message was published; none if none ever was.
fn silence_us<T: Topic>(subscription: &Subscription<T>, now_us: u64) -> Option<u64> {
    let raw: &RawSubscription = subscription.deref();
    Some(now_us.saturating_sub(raw.last_publish_time_us()?))
}
