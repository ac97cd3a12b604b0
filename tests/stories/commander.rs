//! The module `commander`, which keeps the vehicle's state and answers commands.

use uorb_core::{Publication, Subscription, Topic, poll};
use uorb_msg::{
    ActuatorArmed, HomePosition, VehicleCommand, VehicleCommandAck, VehicleLandDetected,
    VehicleStatus,
};
use uorb_tests::{Actor, Bus, PATIENCE};

const ARM: u32 = VehicleCommand::VEHICLE_CMD_COMPONENT_ARM_DISARM;

/// A commander that hears commands.
fn commander(bus: &mut Bus, arguments: &[&str]) -> Actor {
    let commander = bus.spawn_heard("commander", arguments);
    let mut status = bus.subscribe::<VehicleStatus>();
    until(&mut status, |_| true);
    commander
}

/// Waits for a message of which this is true.
fn until<T: Topic>(
    subscription: &mut Subscription<T>,
    is_it: impl Fn(&T::Message) -> bool,
) -> T::Message {
    loop {
        assert_eq!(poll(&mut [subscription], Some(PATIENCE)).unwrap(), 1, "nothing came");
        if let Some(message) = subscription.update().filter(&is_it) {
            return message;
        }
    }
}

fn command(number: u32, param1: f32) -> VehicleCommand {
    VehicleCommand { command: number, param1, target_system: 1, ..Default::default() }
}

/// Sends a command; how it was answered.
fn answer(
    command_pub: &mut Publication<VehicleCommand>,
    ack_sub: &mut Subscription<VehicleCommandAck>,
    command: VehicleCommand,
) -> u8 {
    command_pub.publish(&command).unwrap();
    let ack = until(ack_sub, |_| true);
    assert_eq!(u32::from(ack.command), command.command);
    ack.result
}

#[test]
fn a_command_is_obeyed_published_and_answered() {
    let mut bus = Bus::start();
    let mut commander = commander(&mut bus, &[]);
    let mut command_pub = bus.advertise::<VehicleCommand>();
    let mut ack_sub = bus.subscribe::<VehicleCommandAck>();
    let mut status_sub = bus.subscribe::<VehicleStatus>();
    let mut armed_sub = bus.subscribe::<ActuatorArmed>();
    let mut landed_sub = bus.subscribe::<VehicleLandDetected>();
    assert!(!bool::from(until(&mut armed_sub, |_| true).armed));

    let result = answer(&mut command_pub, &mut ack_sub, command(ARM, 1.0));
    assert_eq!(result, VehicleCommandAck::VEHICLE_RESULT_ACCEPTED);
    // The answer comes when the state is there to be seen.
    let status = status_sub.copy().unwrap();
    assert_eq!(status.arming_state, VehicleStatus::ARMING_STATE_ARMED);
    assert_eq!(status.system_id, 1);
    assert!(bool::from(armed_sub.copy().unwrap().armed));

    let take_off = command(VehicleCommand::VEHICLE_CMD_NAV_TAKEOFF, 0.0);
    let result = answer(&mut command_pub, &mut ack_sub, take_off);
    assert_eq!(result, VehicleCommandAck::VEHICLE_RESULT_ACCEPTED);
    assert!(!bool::from(landed_sub.copy().unwrap().landed));
    until(&mut status_sub, |status| {
        status.nav_state == VehicleStatus::NAVIGATION_STATE_AUTO_LOITER
    });

    let land = command(VehicleCommand::VEHICLE_CMD_NAV_LAND, 0.0);
    let result = answer(&mut command_pub, &mut ack_sub, land);
    assert_eq!(result, VehicleCommandAck::VEHICLE_RESULT_ACCEPTED);
    until(&mut landed_sub, |land| land.landed.into());
    until(&mut armed_sub, |armed| !bool::from(armed.armed));

    let unknown = command(31_999, 0.0);
    let result = answer(&mut command_pub, &mut ack_sub, unknown);
    assert_eq!(result, VehicleCommandAck::VEHICLE_RESULT_UNSUPPORTED);
    commander.until(&["command 31999 of system 0: unsupported"]);
    assert_eq!(commander.interrupt().code, 0);
}

#[test]
fn a_command_to_another_vehicle_is_not_answered() {
    let mut bus = Bus::start();
    let mut commander = commander(&mut bus, &[]);
    let mut command_pub = bus.advertise::<VehicleCommand>();
    let mut ack_sub = bus.subscribe::<VehicleCommandAck>();
    let other = VehicleCommand { target_system: 2, ..command(ARM, 1.0) };
    command_pub.publish(&other).unwrap();

    // The one after it is the first to be answered.
    let result = answer(&mut command_pub, &mut ack_sub, command(176, 0.0));
    assert_eq!(result, VehicleCommandAck::VEHICLE_RESULT_UNSUPPORTED);
    let status = bus.subscribe::<VehicleStatus>().copy().unwrap();
    assert_eq!(status.arming_state, VehicleStatus::ARMING_STATE_STANDBY);
    assert_eq!(commander.interrupt().code, 0);
}

#[test]
fn a_vehicle_can_have_another_number_than_its_system() {
    let mut bus = Bus::start();
    let _commander = commander(&mut bus, &["-i", "41"]);
    let mut command_pub = bus.advertise::<VehicleCommand>();
    let mut ack_sub = bus.subscribe::<VehicleCommandAck>();
    let arm = VehicleCommand { target_system: 42, ..command(ARM, 1.0) };
    let result = answer(&mut command_pub, &mut ack_sub, arm);
    assert_eq!(result, VehicleCommandAck::VEHICLE_RESULT_ACCEPTED);
    assert_eq!(bus.subscribe::<VehicleStatus>().copy().unwrap().system_id, 42);
}

#[test]
fn home_is_where_the_gps_was_heard_first_and_sensors_that_are_heard_are_healthy() {
    let mut bus = Bus::start();
    let _sim = bus.spawn_heard("sensor_sim", &["--vehicle"]);
    let _commander = commander(&mut bus, &[]);
    let home = until(&mut bus.subscribe::<HomePosition>(), |_| true);
    assert!((home.lat - 47.397_742).abs() < 1e-3, "{home:?}");
    let status = until(&mut bus.subscribe::<VehicleStatus>(), |status| {
        status.onboard_control_sensors_health.count_ones() == 8
    });
    assert_eq!(status.onboard_control_sensors_present, status.onboard_control_sensors_health);
}
