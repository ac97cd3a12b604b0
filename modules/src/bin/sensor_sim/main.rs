//! The sensors of a vehicle that stands still, for whoever has none at hand.
//!
//! One process stands for all drivers, or several for some of them each
//! (`--only`). Every device ticks by itself at its real rate, counted from the
//! start, so nothing drifts; a reading's timestamp is its tick. Where several
//! are due at once the gyroscope is the last, as in PX4's drivers: whoever
//! takes it as time base finds the others' readings there.
//!
//! Devices claim instances as drivers do, the lowest that is free. So accel0
//! becomes instance 0 if it is started first, and gets it again when it was
//! killed and is the only one missing.

mod estimate;
mod vehicle;

use std::error::Error;
use std::io::{self, Write};
use std::process::ExitCode;
use std::time::{SystemTime, UNIX_EPOCH};

use clap::{CommandFactory, Parser, ValueEnum, error::ErrorKind};
use uorb_core::{Priority, Publication, Session, Topic, now_us};
use uorb_modules::random::Random;
use uorb_modules::{Outcome, Stop, Ticks, parse_rate, run};
use uorb_msg::{
    BatteryStatus, SensorAccel, SensorBaro, SensorGyro, SensorMag, VehicleAttitude,
    VehicleGlobalPosition, VehicleGpsPosition, VehicleLocalPosition,
};

use estimate::{Battery, Estimate};
use vehicle::{Accelerometer, Barometer, Gps, Gyroscope, Magnetometer};

const EXAMPLES: &str = "\
Devices:
  accel0, accel1, accel2   250 Hz  sensor_accel, priorities 100, 75 and 50
  mag                      100 Hz  sensor_mag
  baro                      50 Hz  sensor_baro
  gps                        5 Hz  vehicle_gps_position
  gyro                     250 Hz  sensor_gyro

And with --vehicle:
  battery                   10 Hz  battery_status
  attitude                 100 Hz  vehicle_attitude
  local position            50 Hz  vehicle_local_position
  global position           50 Hz  vehicle_global_position

Examples:
  sensor_sim                           all devices, until Ctrl-C
  sensor_sim --duration 10 --seed 42   the same ten seconds every time
  sensor_sim --fail-accel 0@5          the best accelerometer fails after 5 s
  sensor_sim --only accel0             one device as a process of its own,
                                       that can be killed without the others
  sensor_sim --vehicle                 a whole vehicle, as a ground station wants it

UORB_DIR and UORB_SYSTEM name the system, as for uorb.";

/// Simulates the sensors of a vehicle that stands still.
#[derive(Parser)]
#[command(name = "sensor_sim", version, after_help = EXAMPLES)]
struct Arguments {
    /// End after so many seconds
    #[arg(long, value_name = "SECONDS", value_parser = parse_seconds, allow_negative_numbers = true)]
    duration: Option<f64>,

    /// Multiply all rates
    #[arg(long, value_name = "X", value_parser = parse_rate, allow_negative_numbers = true, default_value = "1")]
    rate_scale: f64,

    /// What all noise comes from: the same seed, the same flight
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Only these devices; accel means all three accelerometers
    #[arg(long, value_name = "DEVICE,..", value_delimiter = ',')]
    only: Vec<Device>,

    /// Also publish what the rest of a vehicle would: how it lies and where it is, as
    /// estimated, and its battery
    #[arg(long)]
    vehicle: bool,

    /// Unadvertise accelerometer N after so many seconds; may be repeated
    #[arg(long, value_name = "N@SECONDS", value_parser = parse_failure)]
    fail_accel: Vec<Failure>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Device {
    Accel,
    Accel0,
    Accel1,
    Accel2,
    Mag,
    Baro,
    Gps,
    Gyro,
    #[value(skip)]
    Battery,
    #[value(skip)]
    Attitude,
    #[value(skip)]
    LocalPosition,
    #[value(skip)]
    GlobalPosition,
}

const ACCELS: [Device; 3] = [Device::Accel0, Device::Accel1, Device::Accel2];

/// An accelerometer that is to fail.
#[derive(Clone, Copy)]
struct Failure {
    accel: usize,
    after_us: u64,
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        // A billion seconds are thirty years.
        Ok(seconds) if (0.0..=1e9).contains(&seconds) => Ok(seconds),
        _ => Err("not a number of seconds".into()),
    }
}

fn parse_failure(text: &str) -> Result<Failure, String> {
    let failure = text.split_once('@').and_then(|(accel, seconds)| {
        let accel = accel.parse().ok().filter(|accel| *accel < ACCELS.len())?;
        Some(Failure { accel, after_us: in_us(parse_seconds(seconds).ok()?) })
    });
    failure.ok_or_else(|| "not an accelerometer (0, 1 or 2) and seconds, as in 0@5".into())
}

fn in_us(seconds: f64) -> u64 {
    (seconds * 1e6) as u64
}

impl Arguments {
    fn has(&self, device: Device) -> bool {
        self.only.is_empty()
            || self.only.contains(&device)
            || (ACCELS.contains(&device) && self.only.contains(&Device::Accel))
    }

    /// A device's noise is the same whichever others there are.
    fn random(&self, device: Device) -> Random {
        Random::of_source(self.seed, device as u32)
    }
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    for Failure { accel, .. } in &arguments.fail_accel {
        if !arguments.has(ACCELS[*accel]) {
            let message = format!("--fail-accel {accel}: --only leaves accel{accel} out");
            Arguments::command().error(ErrorKind::ArgumentConflict, message).exit();
        }
    }
    run(|stop, out| simulate(&arguments, stop, out))
}

fn simulate(arguments: &Arguments, stop: &Stop, out: &mut impl Write) -> Outcome {
    let session = Session::connect()?;
    let start_us = now_us();
    let end_us = arguments.duration.map_or(u64::MAX, |seconds| start_us + in_us(seconds));
    let mut drivers = install(&session, arguments, start_us, out)?;

    // Of those that are due at the same time, the first of the list.
    while let Some(next) = (0..drivers.len()).min_by_key(|next| drivers[*next].ticks.due_us()) {
        let driver = &mut drivers[next];
        let due_us = driver.ticks.due_us();
        if due_us > end_us || !stop.sleep_until(due_us) {
            break;
        }
        if driver.fails_at_us.is_some_and(|fails_at_us| due_us >= fails_at_us) {
            // Its publication unadvertises as it is dropped.
            let failed = drivers.remove(next);
            writeln!(out, "[sensor_sim] {} fails", failed.name)?;
            failed.report(out)?;
            continue;
        }
        (driver.publish)(due_us)?;
        driver.published += 1;
        driver.left_out += driver.ticks.advance(now_us());
    }
    for driver in &drivers {
        driver.report(out)?;
    }
    Ok(())
}

/// One simulated driver: a device, and the publication of what it measures.
struct Driver {
    name: &'static str,
    ticks: Ticks,
    publish: Box<dyn FnMut(u64) -> Result<(), uorb_core::Error>>,
    fails_at_us: Option<u64>,
    published: u64,
    left_out: u64,
}

impl Driver {
    fn report(&self, out: &mut impl Write) -> io::Result<()> {
        let Self { name, published, left_out, .. } = self;
        write!(out, "[sensor_sim] {name} has published {published} readings")?;
        if *left_out > 0 {
            write!(out, "; there was no time for {left_out} more")?;
        }
        writeln!(out)
    }
}

/// Where drivers are installed.
struct Board<'a> {
    session: &'a Session,
    start_us: u64,
    rate_scale: f64,
    drivers: Vec<Driver>,
    out: &'a mut dyn Write,
}

impl Board<'_> {
    /// Advertises the device `name`, and from now on publishes on topic `T`
    /// what it reads. Its first reading is there when its first period is over.
    fn install<T: Topic>(
        &mut self,
        name: &'static str,
        rate_hz: f64,
        priority: Priority,
        mut read: impl FnMut(u64) -> T::Message + 'static,
    ) -> Result<&mut Driver, Box<dyn Error>> {
        let mut publication = Publication::<T>::advertise_multi(self.session, priority)?;
        let (topic, instance) = (&T::METADATA.name, publication.instance());
        let Priority(number) = priority;
        writeln!(
            self.out,
            "[sensor_sim] {name} is {topic} instance {instance}, priority {number}"
        )?;

        let rate_hz = rate_hz * self.rate_scale;
        let ticks = Ticks::new(self.start_us.saturating_add(in_us(1.0 / rate_hz)), rate_hz);
        let publish = Box::new(move |now_us| publication.publish(&read(now_us)).map(drop));
        let driver = Driver { name, ticks, publish, fails_at_us: None, published: 0, left_out: 0 };
        Ok(self.drivers.push_mut(driver))
    }
}

/// Installs the devices that were asked for, the gyroscope last. The rates are
/// what `uorb top` showed on a vehicle of 2017.
fn install(
    session: &Session,
    arguments: &Arguments,
    start_us: u64,
    out: &mut dyn Write,
) -> Result<Vec<Driver>, Box<dyn Error>> {
    let rate_scale = arguments.rate_scale;
    let mut board = Board { session, start_us, rate_scale, drivers: Vec::new(), out };

    let names = ["accel0", "accel1", "accel2"];
    let priorities = [Priority::HIGH, Priority::DEFAULT, Priority::LOW];
    for (number, device) in ACCELS.into_iter().enumerate() {
        if arguments.has(device) {
            let mut accel = Accelerometer::new(number, arguments.random(device), start_us);
            let read = move |now_us| accel.read(now_us);
            let (name, priority) = (names[number], priorities[number]);
            let driver = board.install::<SensorAccel>(name, 250.0, priority, read)?;
            let failure = arguments.fail_accel.iter().find(|failure| failure.accel == number);
            driver.fails_at_us = failure.map(|failure| start_us + failure.after_us);
        }
    }
    if arguments.has(Device::Mag) {
        let mut mag = Magnetometer::new(arguments.random(Device::Mag), start_us);
        let read = move |now_us| mag.read(now_us);
        board.install::<SensorMag>("mag", 100.0, Priority::DEFAULT, read)?;
    }
    if arguments.has(Device::Baro) {
        let mut baro = Barometer::new(arguments.random(Device::Baro));
        let read = move |now_us| baro.read(now_us);
        board.install::<SensorBaro>("baro", 50.0, Priority::DEFAULT, read)?;
    }
    if arguments.has(Device::Gps) {
        let mut gps = Gps::new(arguments.random(Device::Gps), start_us);
        let read = move |now_us| gps.read(now_us, utc_us());
        board.install::<VehicleGpsPosition>("gps", 5.0, Priority::DEFAULT, read)?;
    }
    if arguments.vehicle {
        install_vehicle(&mut board, arguments)?;
    }
    if arguments.has(Device::Gyro) {
        let mut gyro = Gyroscope::new(arguments.random(Device::Gyro), start_us);
        let read = move |now_us| gyro.read(now_us);
        board.install::<SensorGyro>("gyro", 250.0, Priority::DEFAULT, read)?;
    }
    Ok(board.drivers)
}

/// Installs what is not a sensor.
fn install_vehicle(board: &mut Board, arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    let start_us = board.start_us;
    let estimate = |device| Estimate::new(arguments.random(device), start_us);

    let mut battery = Battery::new(arguments.random(Device::Battery), start_us);
    let read = move |now_us| battery.read(now_us);
    board.install::<BatteryStatus>("battery", 10.0, Priority::DEFAULT, read)?;

    let mut attitude = estimate(Device::Attitude);
    let read = move |now_us| attitude.attitude(now_us);
    board.install::<VehicleAttitude>("attitude", 100.0, Priority::DEFAULT, read)?;

    let mut local = estimate(Device::LocalPosition);
    let read = move |now_us| local.local_position(now_us);
    board.install::<VehicleLocalPosition>("local position", 50.0, Priority::DEFAULT, read)?;

    let mut global = estimate(Device::GlobalPosition);
    let read = move |now_us| global.global_position(now_us, utc_us());
    board.install::<VehicleGlobalPosition>("global position", 50.0, Priority::DEFAULT, read)?;
    Ok(())
}

/// The time of day, as the receiver has it from the satellites.
fn utc_us() -> u64 {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    since_1970.as_micros() as u64
}
