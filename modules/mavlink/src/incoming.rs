//! What comes in: each message goes to the function that knows it.
//!
//! A message of ours that the dialect knows and nobody here does is ignored, as
//! PX4 does. What is addressed to another system, or to another component of
//! this one, is not ours.

pub mod clocks;
pub mod commands;
pub mod corrections;
pub mod mission;
pub mod parameters;
pub mod setpoints;
pub mod simulator;
pub mod sticks;

use mavlink_core::Message;
use uorb_core::{RawSubscription, now_us};
use uorb_msg::{
    Airspeed, GpsInjectData, ManualControlSetpoint, OffboardControlMode, PositionSetpointTriplet,
    SensorAccel, SensorBaro, SensorGyro, SensorMag, VehicleAttitudeSetpoint, VehicleGpsPosition,
    VehicleRatesSetpoint,
};

use crate::dialect::MavMessage;
use crate::frame::Packet;
use crate::link::Link;
use crate::ours;
use crate::parameter_file::ParameterFile;

use commands::Commands;
use parameters::Parameters;
use simulator::Simulator;

/// What the incoming half of a link remembers.
#[derive(Debug)]
pub struct Incoming {
    /// Which link of its process it is.
    number: usize,
    commands: Commands,
    parameters: Parameters,
    simulator: Simulator,
}

impl Incoming {
    /// For a link that begins, the one of its process with this number.
    pub fn new(link: &Link, number: usize, file: ParameterFile) -> Self {
        Self {
            number,
            commands: Commands::new(&link.session),
            parameters: Parameters::new(file),
            simulator: Simulator::default(),
        }
    }

    /// Does what a message asks for.
    pub fn receive(&mut self, link: &mut Link, packet: &Packet) {
        if !is_for(link, &packet.message) {
            return;
        }
        let (from, now_us) = (&packet.header, now_us());
        match &packet.message {
            MavMessage::COMMAND_LONG(message) => {
                self.commands.receive(link, &commands::command_long(message, from, now_us));
            }
            MavMessage::COMMAND_INT(message) => {
                self.commands.receive(link, &commands::command_int(message, from, now_us));
            }
            MavMessage::SET_MODE(message) => {
                self.commands.receive(link, &commands::set_mode(message, from, now_us));
            }
            MavMessage::PARAM_REQUEST_LIST(_) => self.parameters.list(),
            MavMessage::PARAM_REQUEST_READ(message) => self.parameters.read_one(link, message),
            MavMessage::PARAM_SET(message) => self.parameters.set(link, message),
            MavMessage::PING(message) => {
                if let Some(answer) = clocks::ping(message, from) {
                    link.send(&MavMessage::PING(answer));
                }
            }
            MavMessage::TIMESYNC(message) => {
                if let Some(answer) = clocks::timesync(message, from, now_us) {
                    link.send(&MavMessage::TIMESYNC(answer));
                }
            }
            MavMessage::HIL_SENSOR(message) => {
                publish_readings(link, &self.simulator.read(message, now_us));
            }
            MavMessage::MANUAL_CONTROL(message) => {
                let sticks = sticks::manual_control(message, self.number, now_us);
                link.publications.publish::<ManualControlSetpoint>(&sticks);
            }
            message => match mission::answer(message, from) {
                Some(answer) => link.send(&answer),
                None => publish(link, message, now_us),
            },
        }
    }

    /// A partner may have come in another's place.
    pub fn begin(&mut self) {
        self.parameters.forget_list();
    }

    /// Does what is due, and takes what came in on `subscriptions`. Called
    /// whenever the link wakes.
    pub fn step(&mut self, link: &mut Link, now_us: u64) {
        self.commands.step(link, now_us);
        self.parameters.step(link, now_us);
    }

    /// What wakes the link.
    pub fn subscriptions(&mut self) -> Vec<&mut RawSubscription> {
        self.commands.subscription().into_iter().collect()
    }

    /// When `step` is due even if nothing comes.
    pub fn due_us(&self) -> u64 {
        self.commands.due_us().min(self.parameters.due_us())
    }
}

/// Messages that become a topic, and nothing else: a line of mapping each.
fn publish(link: &mut Link, message: &MavMessage, now_us: u64) {
    let topics = &mut link.publications;
    match message {
        MavMessage::SET_POSITION_TARGET_LOCAL_NED(message) => {
            if let Some((mode, triplet)) = setpoints::position_target(message, now_us) {
                topics.publish::<OffboardControlMode>(&mode);
                topics.publish::<PositionSetpointTriplet>(&triplet);
            }
        }
        MavMessage::SET_ATTITUDE_TARGET(message) => {
            let target = setpoints::attitude_target(message, now_us);
            topics.publish::<OffboardControlMode>(&target.mode);
            if let Some(attitude) = target.attitude {
                topics.publish::<VehicleAttitudeSetpoint>(&attitude);
            }
            if let Some(rates) = target.rates {
                topics.publish::<VehicleRatesSetpoint>(&rates);
            }
        }
        MavMessage::GPS_RTCM_DATA(message) => {
            topics.publish::<GpsInjectData>(&corrections::gps_rtcm_data(message, now_us));
        }
        MavMessage::GPS_INJECT_DATA(message) => {
            topics.publish::<GpsInjectData>(&corrections::gps_inject_data(message, now_us));
        }
        MavMessage::HIL_GPS(message) => {
            topics.publish_multi::<VehicleGpsPosition>(&simulator::hil_gps(message, now_us));
        }
        message => ours::receive(link, message, now_us),
    }
}

/// A simulator's sensors are instances of their own, as a driver's.
fn publish_readings(link: &mut Link, readings: &simulator::Readings) {
    let topics = &mut link.publications;
    if let Some(accel) = &readings.accel {
        topics.publish_multi::<SensorAccel>(accel);
    }
    if let Some(mag) = &readings.mag {
        topics.publish_multi::<SensorMag>(mag);
    }
    if let Some(baro) = &readings.baro {
        topics.publish_multi::<SensorBaro>(baro);
    }
    if let Some(airspeed) = &readings.airspeed {
        topics.publish_multi::<Airspeed>(airspeed);
    }
    if let Some(gyro) = &readings.gyro {
        topics.publish_multi::<SensorGyro>(gyro);
    }
}

/// Whether a message is addressed to us; one that is addressed to nobody is for all.
fn is_for(link: &Link, message: &MavMessage) -> bool {
    let is = |target: Option<u8>, ours: u8| target.is_none_or(|it| it == 0 || it == ours);
    is(message.target_system_id(), link.port.system_id())
        && is(message.target_component_id(), link.port.component_id())
}
