//! Makes one message of what all the sensors measure, sensor_combined, and one of
//! how the vehicle accelerates, vehicle_acceleration.
//!
//! The gyroscope sets the pace: every reading of it is a message with its
//! timestamp, and the others' newest readings go along, with how much older
//! each is. A sensor that nothing was heard of lately is marked invalid.
//!
//! Of the accelerometers the one with the highest priority is used, and when
//! its process dies or falls silent, the next (`choice.rs`).

mod choice;

use std::error::Error;
use std::io::{self, Write};
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use uorb_core::{Instance, Publication, Session, Subscription, Topic, now_us, poll};
use uorb_modules::search::Search;
use uorb_modules::{Outcome, Stop, run};
use uorb_msg::{
    SensorAccel, SensorBaro, SensorCombined, SensorGyro, SensorMag, VehicleAcceleration,
};

use choice::{Candidate, choose, usable_since_us};

/// How long the magnetometer and the barometer may be silent: PX4 gives its
/// slow sensors some such time, too.
const SLOW_TIMEOUT_US: u64 = 500_000;

const EXAMPLES: &str = "\
Examples:
  sensors                    until Ctrl-C
  sensors --timeout-ms 1000  with sensor_sim --rate-scale 0.1

See it choose, with one accelerometer in a process of its own:
  sensor_sim --only accel0 &
  sensor_sim --only accel1,gyro,mag,baro &
  sensors &
  kill -9 %1

UORB_DIR and UORB_SYSTEM name the system, as for uorb.";

/// Combines the sensors' readings and chooses among the accelerometers.
#[derive(Parser)]
#[command(name = "sensors", version, after_help = EXAMPLES)]
struct Arguments {
    /// An accelerometer that is silent for so long is lost
    #[arg(long, value_name = "MS", default_value_t = 100)]
    timeout_ms: u32,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    run(|stop, out| combine(&arguments, stop, out))
}

fn combine(arguments: &Arguments, stop: &Stop, out: &mut impl Write) -> Outcome {
    let session = Session::connect()?;
    let mut gyro_sub = Subscription::<SensorGyro>::subscribe(&session)?;
    let mut mag_sub = Subscription::<SensorMag>::subscribe(&session)?;
    let mut baro_sub = Subscription::<SensorBaro>::subscribe(&session)?;
    let mut accels = Accelerometers::new(u64::from(arguments.timeout_ms) * 1_000);
    let mut combined_pub = Publication::<SensorCombined>::advertise(&session)?;
    let mut acceleration_pub = Publication::<VehicleAcceleration>::advertise(&session)?;

    let mut last_sample = 0;
    let mut has_gyro = true;
    while !stop.requested() {
        let updated = poll(&mut [&mut gyro_sub], Some(Duration::from_secs(1)))?;
        if updated == 0 {
            if has_gyro && !stop.requested() {
                writeln!(out, "[sensors] no gyroscope for a second: sensor_combined has to wait")?;
                has_gyro = false;
            }
            continue;
        }
        if !has_gyro {
            writeln!(out, "[sensors] the gyroscope is there")?;
            has_gyro = true;
        }
        if let Some(gyro) = gyro_sub.update() {
            let accel = accels.choose(&session, out)?;
            let mag = recent(&mut mag_sub, SLOW_TIMEOUT_US);
            let baro = recent(&mut baro_sub, SLOW_TIMEOUT_US);
            combined_pub.publish(&combined(&gyro, accel.as_ref(), mag.as_ref(), baro.as_ref()))?;
            let accel = accel.filter(|accel| accel.timestamp != last_sample);
            if let Some(accel) = accel {
                last_sample = accel.timestamp;
                acceleration_pub.publish(&acceleration(&accel))?;
            }
        }
    }
    Ok(())
}

/// The message, as old as the gyroscope's reading.
fn combined(
    gyro: &SensorGyro,
    accel: Option<&SensorAccel>,
    mag: Option<&SensorMag>,
    baro: Option<&SensorBaro>,
) -> SensorCombined {
    let relative = |timestamp: Option<u64>| {
        timestamp
            .and_then(|timestamp| i32::try_from(timestamp.wrapping_sub(gyro.timestamp) as i64).ok())
            .unwrap_or(SensorCombined::RELATIVE_TIMESTAMP_INVALID)
    };
    let integrated = [gyro.x_integral, gyro.y_integral, gyro.z_integral];
    let (gyro_rad, gyro_integral_dt) = mean([gyro.x, gyro.y, gyro.z], integrated, gyro.integral_dt);
    let mut combined = SensorCombined {
        timestamp: gyro.timestamp,
        gyro_rad,
        gyro_integral_dt,
        accelerometer_timestamp_relative: relative(accel.map(|accel| accel.timestamp)),
        magnetometer_timestamp_relative: relative(mag.map(|mag| mag.timestamp)),
        baro_timestamp_relative: relative(baro.map(|baro| baro.timestamp)),
        ..Default::default()
    };
    if let Some(accel) = accel {
        let integrated = [accel.x_integral, accel.y_integral, accel.z_integral];
        (combined.accelerometer_m_s2, combined.accelerometer_integral_dt) =
            mean([accel.x, accel.y, accel.z], integrated, accel.integral_dt);
    }
    if let Some(mag) = mag {
        combined.magnetometer_ga = [mag.x, mag.y, mag.z];
    }
    if let Some(baro) = baro {
        combined.baro_alt_meter = baro.altitude;
        combined.baro_temp_celcius = baro.temperature;
    }
    combined
}

/// How the vehicle accelerates. PX4 corrects it for the sensor's bias, of which
/// nothing is known here.
fn acceleration(accel: &SensorAccel) -> VehicleAcceleration {
    let integrated = [accel.x_integral, accel.y_integral, accel.z_integral];
    let (xyz, _) = mean([accel.x, accel.y, accel.z], integrated, accel.integral_dt);
    let timestamp = now_us();
    VehicleAcceleration { timestamp, timestamp_sample: accel.timestamp, xyz, ..Default::default() }
}

/// The mean over the sampling period, and its length in seconds. A sensor that
/// does not integrate has only the reading itself.
fn mean(reading: [f32; 3], integrated: [f32; 3], integral_dt_us: u64) -> ([f32; 3], f32) {
    if integral_dt_us == 0 {
        return (reading, 0.0);
    }
    let dt = integral_dt_us as f32 * 1e-6;
    (integrated.map(|axis| axis / dt), dt)
}

/// The newest message, if it was published lately.
///
/// Its age is taken from the node, not from its timestamp: a flight that is
/// replayed has the timestamps of that day.
fn recent<T: Topic>(subscription: &mut Subscription<T>, timeout_us: u64) -> Option<T::Message> {
    let last_us = subscription.last_publish_time_us()?;
    let is_recent = now_us().saturating_sub(last_us) <= timeout_us;
    subscription.copy().filter(|_| is_recent)
}

struct Accelerometers {
    timeout_us: u64,
    found: Vec<Accelerometer>,
    search: Search,
    chosen: Option<Instance>,
}

struct Accelerometer {
    subscription: Subscription<SensorAccel>,
    reading: Option<SensorAccel>,
    usable_since_us: Option<u64>,
}

impl Accelerometers {
    fn new(timeout_us: u64) -> Self {
        Self { timeout_us, found: Vec::new(), search: Search::default(), chosen: None }
    }

    /// The newest reading of the accelerometer to use now.
    fn choose(
        &mut self,
        session: &Session,
        out: &mut impl Write,
    ) -> Result<Option<SensorAccel>, Box<dyn Error>> {
        let is_known = |instance| self.found.iter().any(|accel| accel.instance() == instance);
        for subscription in self.search.subscribe_new(session, is_known)? {
            self.found.push(Accelerometer { subscription, reading: None, usable_since_us: None });
        }
        let now_us = now_us();
        let candidates: Vec<_> =
            self.found.iter_mut().map(|accel| accel.look(now_us, self.timeout_us)).collect();
        let chosen = choose(&candidates, self.chosen, now_us);
        if chosen != self.chosen {
            report_switch(self.chosen, chosen, &candidates, out)?;
            self.chosen = chosen;
        }
        let used = self.found.iter().find(|accel| Some(accel.instance()) == chosen);
        Ok(used.and_then(|accel| accel.reading))
    }
}

impl Accelerometer {
    fn instance(&self) -> Instance {
        self.subscription.instance()
    }

    /// Copies what is new, whether it is the chosen one or not: what nobody
    /// copies would count as lost.
    fn look(&mut self, now_us: u64, timeout_us: u64) -> Candidate {
        self.reading = self.subscription.update().or(self.reading);
        let subscription = &mut self.subscription;
        self.usable_since_us = usable_since_us(
            self.usable_since_us,
            subscription.advertised(),
            subscription.last_publish_time_us(),
            now_us,
            timeout_us,
        );
        Candidate {
            instance: subscription.instance(),
            priority: subscription.priority(),
            usable_since_us: self.usable_since_us,
        }
    }
}

fn report_switch(
    from: Option<Instance>,
    to: Option<Instance>,
    candidates: &[Candidate],
    out: &mut impl Write,
) -> io::Result<()> {
    let chosen = candidates.iter().find(|candidate| Some(candidate.instance) == to);
    match (from, chosen) {
        (_, None) => writeln!(out, "[sensors] no accelerometer is left"),
        (None, Some(Candidate { instance, priority, .. })) => {
            writeln!(out, "[sensors] uses accelerometer {instance}, priority {}", priority.0)
        }
        (Some(from), Some(Candidate { instance, priority, .. })) => writeln!(
            out,
            "[sensors] switched from accelerometer {from} to {instance}, priority {}",
            priority.0
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_message_is_as_old_as_the_gyroscope_s_reading() {
        let gyro = SensorGyro {
            timestamp: 1_000_000,
            integral_dt: 4_000,
            x_integral: 0.004,
            ..Default::default()
        };
        let accel = SensorAccel {
            timestamp: 998_000,
            integral_dt: 4_000,
            z: -10.0,
            z_integral: -0.039,
            ..Default::default()
        };
        let baro = SensorBaro { timestamp: 1_000_500, altitude: 488.0, ..Default::default() };

        let combined = combined(&gyro, Some(&accel), None, Some(&baro));

        assert_eq!(combined.timestamp, 1_000_000);
        assert!((combined.gyro_rad[0] - 1.0).abs() < 1e-6, "the mean, not the reading");
        assert_eq!(combined.accelerometer_timestamp_relative, -2_000);
        assert!((combined.accelerometer_m_s2[2] + 9.75).abs() < 1e-5);
        assert!((combined.accelerometer_integral_dt - 0.004).abs() < 1e-9);
        assert_eq!(combined.baro_timestamp_relative, 500);
        assert_eq!(combined.baro_alt_meter, 488.0);
        assert_eq!(
            combined.magnetometer_timestamp_relative,
            SensorCombined::RELATIVE_TIMESTAMP_INVALID
        );
        assert_eq!(combined.magnetometer_ga, [0.0; 3]);
    }

    #[test]
    fn a_sensor_that_does_not_integrate_has_its_reading_used() {
        assert_eq!(mean([1.0, 2.0, 3.0], [0.0; 3], 0), ([1.0, 2.0, 3.0], 0.0));
    }
}
