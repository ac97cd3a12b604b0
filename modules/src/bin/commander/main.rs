//! Says what state the vehicle is in, and answers commands, for whoever has no
//! autopilot at hand.
//!
//! Every `vehicle_command` to this vehicle has exactly one `vehicle_command_ack`.
//! It arms and disarms, changes the mode, takes off and lands; nothing moves, but the
//! state is what a ground station sees of it. What it does not know is unsupported.
//!
//! `state.rs` decides; here is where it hears from the bus and publishes.

mod senses;
mod state;

use std::io::Write;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use uorb_core::{Publication, Session, Subscription, now_us, poll};
use uorb_modules::{Outcome, Stop, run, system_id};
use uorb_msg::{
    ActuatorArmed, HomePosition, VehicleCommand, VehicleCommandAck, VehicleLandDetected,
    VehicleStatus,
};

use senses::Ears;
use state::{Senses, State};

/// What has not changed is published again after so long, as PX4's commander does.
const REPEAT_US: u64 = 500_000;

const EXAMPLES: &str = "\
Examples:
  commander                           until Ctrl-C
  uorb listener vehicle_status        what it says
  uorb pub vehicle_command command=400 param1=1 target_system=1
                                      arms

The commands that it obeys: arm and disarm (400), change the mode (176), take off (22),
land (21), set the home position (179).

UORB_DIR and UORB_SYSTEM name the system, as for uorb.";

/// Keeps the vehicle's state and answers commands.
#[derive(Parser)]
#[command(name = "commander", version, after_help = EXAMPLES)]
struct Arguments {
    /// Number of the vehicle, 0 to 249, as for mavlink: it is 1 more in MAVLink
    /// [default: the system's number]
    #[arg(short = 'i', value_name = "N")]
    vehicle: Option<u32>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    run(|stop, out| command(&arguments, stop, out))
}

fn command(arguments: &Arguments, stop: &Stop, out: &mut impl Write) -> Outcome {
    let session = Session::connect()?;
    let mut command_sub = Subscription::<VehicleCommand>::subscribe(&session)?;
    let mut ack_pub = Publication::<VehicleCommandAck>::advertise(&session)?;
    let mut ears = Ears::open(&session)?;
    let mut news = News::open(&session)?;
    let mut state = State::START;
    let vehicle = arguments.vehicle.unwrap_or(session.system().number());
    let system_id = system_id(vehicle)?.into();

    while !stop.requested() {
        let senses = ears.listen();
        while let Some(command) = command_sub.update() {
            if !is_for(&command, system_id) {
                continue;
            }
            let result = state.obey(&command, &senses, now_us());
            let (number, source) = (command.command, command.source_system);
            writeln!(out, "[commander] command {number} of system {source}: {}", word(result))?;
            // What does not fit in the answer is no command of MAVLink.
            let Ok(command) = u16::try_from(number) else { continue };
            news.publish_changes(&state, &senses, system_id)?;
            let timestamp = now_us();
            ack_pub.publish(&VehicleCommandAck {
                timestamp,
                command,
                result,
                ..Default::default()
            })?;
        }
        state.go_on(&senses, now_us());
        news.publish_changes(&state, &senses, system_id)?;
        poll(&mut [&mut command_sub], Some(Duration::from_millis(100)))?;
    }
    Ok(())
}

/// Whether a command is meant for this autopilot. 0 is everybody.
fn is_for(command: &VehicleCommand, system_id: u32) -> bool {
    const AUTOPILOT: u32 = 1;
    [0, system_id].contains(&command.target_system)
        && [0, AUTOPILOT].contains(&command.target_component)
}

fn word(result: u8) -> &'static str {
    match result {
        VehicleCommandAck::VEHICLE_RESULT_ACCEPTED => "accepted",
        VehicleCommandAck::VEHICLE_RESULT_TEMPORARILY_REJECTED => "not now",
        VehicleCommandAck::VEHICLE_RESULT_DENIED => "denied",
        VehicleCommandAck::VEHICLE_RESULT_UNSUPPORTED => "unsupported",
        _ => "failed",
    }
}

/// What the commander publishes of the state.
struct News {
    status_pub: Publication<VehicleStatus>,
    armed_pub: Publication<ActuatorArmed>,
    landed_pub: Publication<VehicleLandDetected>,
    home_pub: Publication<HomePosition>,
    published: Option<State>,
    repeat_us: u64,
}

impl News {
    fn open(session: &Session) -> Result<Self, uorb_core::Error> {
        Ok(Self {
            status_pub: Publication::advertise(session)?,
            armed_pub: Publication::advertise(session)?,
            landed_pub: Publication::advertise(session)?,
            home_pub: Publication::advertise(session)?,
            published: None,
            repeat_us: 0,
        })
    }

    /// Publishes the state if it has changed, or was published too long ago.
    fn publish_changes(
        &mut self,
        state: &State,
        senses: &Senses,
        system_id: u32,
    ) -> Result<(), uorb_core::Error> {
        let now_us = now_us();
        if self.published == Some(*state) && now_us < self.repeat_us {
            return Ok(());
        }
        self.armed_pub.publish(&state.actuator_armed(now_us))?;
        self.landed_pub.publish(&state.land_detected(now_us))?;
        if let Some(home) = state.home_position(now_us) {
            self.home_pub.publish(&home)?;
        }
        self.status_pub.publish(&state.status(senses, system_id, now_us))?;
        self.published = Some(*state);
        self.repeat_us = now_us + REPEAT_US;
        Ok(())
    }
}
