//! The MAVLink bridge, what comes in: commands and their answers, parameters, and
//! messages that become topics.

use std::fs;

use uorb_core::{Subscription, Topic, poll};
use uorb_mavlink::dialect::*;
use uorb_msg::{
    BatteryStatus, CaTrajectoryMsg, GpsInjectData, ManualControlSetpoint, OffboardControlMode,
    PositionSetpointTriplet, SensorAccel, SensorBaro, SensorGyro, SensorMag,
    VehicleAttitudeSetpoint, VehicleCommand, VehicleCommandAck, VehicleGpsPosition, VehicleStatus,
};
use uorb_tests::{Bus, PATIENCE, eventually};

use super::ground_station::GroundStation;

/// Values of MAV_RESULT.
const ACCEPTED: u8 = 0;
const TEMPORARILY_REJECTED: u8 = 1;
const DENIED: u8 = 2;
const UNSUPPORTED: u8 = 3;
const FAILED: u8 = 4;

const ARM: u16 = 400;

/// Waits for the next message of a topic.
#[track_caller]
fn next<T: Topic>(subscription: &mut Subscription<T>) -> T::Message {
    assert_eq!(poll(&mut [&mut *subscription], Some(PATIENCE)).unwrap(), 1, "nothing came");
    subscription.update().expect("it was updated")
}

#[test]
fn arming_is_obeyed_and_acknowledged_once_and_an_unknown_command_is_unsupported() {
    let mut bus = Bus::start();
    let mut commander = bus.spawn_heard("commander", &[]);
    let mut status = bus.subscribe::<VehicleStatus>();
    next(&mut status);
    let (mut station, mut bridge) = GroundStation::with_bridge(&bus, &["-m", "custom"]);

    station.command(ARM, 0, 1.0, 0.0);
    assert_eq!(station.result_of(ARM), ACCEPTED);
    assert_eq!(status.copy().unwrap().arming_state, VehicleStatus::ARMING_STATE_ARMED);
    station.command(31_999, 0, 0.0, 0.0);
    assert_eq!(station.result_of(31_999), UNSUPPORTED);
    assert_eq!(station.answers_so_far(), 0, "one answer each");

    // The older way to change the mode, to hold.
    station.send(&MavMessage::SET_MODE(SET_MODE_DATA {
        target_system: 1,
        base_mode: 1,
        custom_mode: 3 << 24 | 4 << 16,
    }));
    assert_eq!(station.result_of(176), ACCEPTED);
    assert_eq!(status.copy().unwrap().nav_state, VehicleStatus::NAVIGATION_STATE_AUTO_LOITER);
    // Degrees and metres.
    station.send(&MavMessage::COMMAND_INT(COMMAND_INT_DATA {
        target_system: 1,
        command: 179,
        frame: 5,
        x: 473_977_420,
        y: 85_455_940,
        z: 488.0,
        ..COMMAND_INT_DATA::DEFAULT
    }));
    assert_eq!(station.result_of(179), ACCEPTED);
    assert_eq!(bridge.interrupt().code, 0);
    assert_eq!(commander.interrupt().code, 0);
}

#[test]
fn where_nobody_answers_commands_they_are_unsupported_at_once() {
    let mut bus = Bus::start();
    let mut commands = bus.subscribe::<VehicleCommand>();
    let (mut station, _bridge) = GroundStation::with_bridge(&bus, &["-m", "custom"]);

    station.command(ARM, 0, 1.0, 0.0);

    assert_eq!(station.result_of(ARM), UNSUPPORTED);
    let command = next(&mut commands);
    assert_eq!((command.command, command.source_system, command.param1), (400, 255, 1.0));
    assert_eq!(station.answers_so_far(), 0);
}

#[test]
fn a_command_that_is_sent_again_is_obeyed_once() {
    let mut bus = Bus::start();
    let mut commands = bus.subscribe::<VehicleCommand>();
    let mut ack = bus.advertise::<VehicleCommandAck>();
    let (mut station, _bridge) = GroundStation::with_bridge(&bus, &["-m", "custom"]);

    station.command(ARM, 0, 1.0, 0.0);
    assert_eq!(next(&mut commands).confirmation, 0);
    station.command(ARM, 1, 1.0, 0.0);
    assert_eq!(station.answers_so_far(), 0, "nobody has obeyed yet");
    let answer = VehicleCommandAck { command: ARM, result: DENIED, ..Default::default() };
    ack.publish(&answer).unwrap();
    assert_eq!(station.result_of(ARM), DENIED);
    assert_eq!(station.answers_so_far(), 0, "both were one");

    // Its answer was lost.
    station.command(ARM, 2, 1.0, 0.0);
    assert_eq!(station.result_of(ARM), DENIED);
    assert!(!commands.updated(), "it was obeyed before");
    // An answer to nobody's question.
    ack.publish(&answer).unwrap();
    assert_eq!(station.answers_so_far(), 0);

    // A command of its own, and an answer that does not come.
    station.command(ARM, 0, 0.0, 0.0);
    assert_eq!(next(&mut commands).param1, 0.0);
    assert_eq!(station.result_of(ARM), FAILED);
}

#[test]
fn another_command_of_the_same_number_has_an_answer_of_its_own() {
    let mut bus = Bus::start();
    let mut commands = bus.subscribe::<VehicleCommand>();
    let mut ack = bus.advertise::<VehicleCommandAck>();
    let (mut station, _bridge) = GroundStation::with_bridge(&bus, &["-m", "custom"]);

    station.command(ARM, 0, 1.0, 0.0);
    assert_eq!(next(&mut commands).param1, 1.0);
    // Disarm, whatever speaks against it, before the first is answered.
    station.command(ARM, 0, 0.0, 21_196.0);
    let forced = next(&mut commands);
    assert_eq!((forced.param1, forced.param2), (0.0, 21_196.0));

    for result in [DENIED, ACCEPTED] {
        ack.publish(&VehicleCommandAck { command: ARM, result, ..Default::default() }).unwrap();
        assert_eq!(station.result_of(ARM), result);
    }
    assert_eq!(station.answers_so_far(), 0);
}

#[test]
fn what_is_addressed_to_another_vehicle_is_not_ours() {
    let mut bus = Bus::start();
    let mut commands = bus.subscribe::<VehicleCommand>();
    let (mut station, _bridge) = GroundStation::with_bridge(&bus, &["-m", "custom"]);
    let command = COMMAND_LONG_DATA { command: ARM, ..COMMAND_LONG_DATA::DEFAULT };
    for (target_system, target_component) in [(2, 1), (1, 100)] {
        station.send(&MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            target_system,
            target_component,
            ..command.clone()
        }));
    }
    assert_eq!(station.answers_so_far(), 0);
    assert!(!commands.updated());
    // To all.
    station.send(&MavMessage::COMMAND_LONG(command));
    assert_eq!(station.result_of(ARM), UNSUPPORTED);
    assert_eq!(next(&mut commands).command, 400);
}

#[test]
fn a_partner_chooses_which_messages_it_gets_and_how_often() {
    const SET: u16 = 511;
    const GET: u16 = 510;
    const REQUEST: u16 = 512;
    const ATTITUDE: f32 = 30.0;
    let bus = Bus::start();
    let (mut station, _bridge) = GroundStation::with_bridge(&bus, &["-m", "custom"]);
    let interval = |station: &mut GroundStation| {
        station.command(GET, 0, ATTITUDE, 0.0);
        let interval = station.until(|message| match message {
            MavMessage::MESSAGE_INTERVAL(interval) => Some(interval.clone()),
            _ => None,
        });
        assert_eq!(interval.message_id, 30);
        assert_eq!(station.result_of(GET), ACCEPTED);
        interval.interval_us
    };

    assert_eq!(interval(&mut station), -1, "off");
    station.command(REQUEST, 0, ATTITUDE, 0.0);
    assert_eq!(station.result_of(REQUEST), TEMPORARILY_REJECTED, "there is no attitude yet");
    station.command(SET, 0, ATTITUDE, 20_000.0);
    assert_eq!(station.result_of(SET), ACCEPTED);
    assert_eq!(interval(&mut station), 20_000);
    let _sim = bus.spawn_heard("sensor_sim", &["--vehicle"]);
    station.until(|message| matches!(message, MavMessage::ATTITUDE(_)).then_some(()));
    station.command(SET, 0, ATTITUDE, -1.0);
    assert_eq!(station.result_of(SET), ACCEPTED);
    let after = station.said_so_far();
    assert!(!after.iter().any(|message| matches!(message, MavMessage::ATTITUDE(_))));
    station.command(REQUEST, 0, ATTITUDE, 0.0);
    station.until(|message| matches!(message, MavMessage::ATTITUDE(_)).then_some(()));
    assert_eq!(station.result_of(REQUEST), ACCEPTED);

    for (command, param1, result) in [
        (SET, 9_999.0, FAILED),
        (SET, f32::NAN, DENIED),
        (REQUEST, 9_999.0, UNSUPPORTED),
        (REQUEST, -1.0, DENIED),
    ] {
        station.command(command, 0, param1, 0.0);
        assert_eq!(station.result_of(command), result, "{command} {param1}");
    }
}

#[test]
fn a_battery_can_be_asked_for_again_and_again() {
    let mut bus = Bus::start();
    let (mut station, _bridge) = GroundStation::with_bridge(&bus, &["-m", "custom"]);
    let mut battery = bus.advertise::<BatteryStatus>();
    let message = BatteryStatus { connected: true.into(), remaining: 0.5, ..Default::default() };
    battery.publish(&message).unwrap();
    for _ in 0..2 {
        station.command(512, 0, 147.0, 0.0);
        assert_eq!(station.result_of(512), ACCEPTED);
    }
}

#[test]
fn a_partner_asks_what_it_speaks_with() {
    let bus = Bus::start();
    let (mut station, _bridge) = GroundStation::with_bridge(&bus, &["-m", "custom"]);
    station.command(520, 0, 1.0, 0.0);
    station.until(|message| matches!(message, MavMessage::AUTOPILOT_VERSION(_)).then_some(()));
    assert_eq!(station.result_of(520), ACCEPTED);
    station.command(519, 0, 1.0, 0.0);
    let version = station.until(|message| match message {
        MavMessage::PROTOCOL_VERSION(version) => Some(version.version),
        _ => None,
    });
    assert_eq!(version, 200);
    assert_eq!(station.result_of(519), ACCEPTED);

    let before_us = uorb_core::now_us() as i64;
    station.send(&MavMessage::TIMESYNC(TIMESYNC_DATA { ts1: 7, ..TIMESYNC_DATA::DEFAULT }));
    let time = station.until(|message| match message {
        MavMessage::TIMESYNC(time) => Some(time.clone()),
        _ => None,
    });
    assert_eq!(time.ts1, 7);
    assert!((before_us..=uorb_core::now_us() as i64).contains(&(time.tc1 / 1_000)));

    station.send(&MavMessage::MISSION_REQUEST_LIST(MISSION_REQUEST_LIST_DATA {
        target_system: 1,
        target_component: 1,
        ..MISSION_REQUEST_LIST_DATA::DEFAULT
    }));
    let count = station.until(|message| match message {
        MavMessage::MISSION_COUNT(count) => Some(count.count),
        _ => None,
    });
    assert_eq!(count, 0);
}

fn parameter(station: &mut GroundStation) -> PARAM_VALUE_DATA {
    station.until(|message| match message {
        MavMessage::PARAM_VALUE(value) => Some(value.clone()),
        _ => None,
    })
}

fn read(station: &mut GroundStation, name: &str, param_index: i16) -> PARAM_VALUE_DATA {
    station.send(&MavMessage::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA {
        target_system: 1,
        target_component: 1,
        param_id: name.into(),
        param_index,
    }));
    parameter(station)
}

fn set(name: &str, param_type: u8, param_value: f32) -> MavMessage {
    MavMessage::PARAM_SET(PARAM_SET_DATA {
        target_system: 1,
        target_component: 1,
        param_id: name.into(),
        param_value,
        param_type,
    })
}

#[test]
fn parameters_are_listed_read_and_set_and_the_file_has_them() {
    const INT32: u8 = 6;
    const REAL32: u8 = 9;
    let bus = Bus::start();
    let file = bus.system.dir().join("mine.params");
    fs::write(&file, "# mine\nSYS_AUTOSTART 4001\nMPC_XY_CRUISE 5.0 5.0\n").unwrap();
    let arguments = ["-m", "custom", "--parameters", file.to_str().unwrap()];
    let (mut station, _bridge) = GroundStation::with_bridge(&bus, &arguments);

    station.send(&MavMessage::PARAM_REQUEST_LIST(PARAM_REQUEST_LIST_DATA {
        target_system: 1,
        target_component: 1,
    }));
    let all = [parameter(&mut station), parameter(&mut station)];
    assert!(all.iter().all(|value| value.param_count == 2));
    assert_eq!(all[0].param_value.to_bits(), 4_001, "an integer goes as bits");
    assert_eq!((all[1].param_value, all[1].param_index), (5.0, 1));

    assert_eq!(read(&mut station, "SYS_AUTOSTART", -1), all[0]);
    assert_eq!(read(&mut station, "", 1), all[1]);

    station.send(&set("SYS_AUTOSTART", INT32, f32::from_bits(4_011)));
    assert_eq!(parameter(&mut station).param_value.to_bits(), 4_011);
    station.send(&set("MPC_XY_CRUISE", REAL32, 7.25));
    assert_eq!(parameter(&mut station).param_value, 7.25);
    let text = fs::read_to_string(&file).unwrap();
    assert_eq!(text, "# mine\nSYS_AUTOSTART 4011\nMPC_XY_CRUISE 7.25 5.0\n");

    // What it cannot be it does not become, and the sender sees what it is.
    station.send(&set("MPC_XY_CRUISE", REAL32, f32::NAN));
    assert_eq!(parameter(&mut station).param_value, 7.25);
    station.send(&set("NO_SUCH_THING", REAL32, 1.0));
    station.until(|message| match message {
        MavMessage::STATUSTEXT(text) => {
            (text.text.to_str() == Ok("unknown parameter: NO_SUCH_THING")).then_some(())
        }
        _ => None,
    });

    // Another process sees the same.
    let (mut other, _bridge) = GroundStation::with_bridge(&bus, &arguments);
    assert_eq!(read(&mut other, "MPC_XY_CRUISE", -1).param_value, 7.25);
}

#[test]
fn a_file_of_parameters_that_makes_no_sense_is_named_at_the_start() {
    let bus = Bus::start();
    let file = bus.system.dir().join("mine.params");
    fs::write(&file, "A 1\nnonsense\n").unwrap();
    let path = file.to_str().unwrap();
    let ended = bus.spawn_heard("mavlink", &["-u", "0", "--parameters", path]).end();
    ended.failed(&["mine.params", "line 2", "nonsense"]);
}

#[test]
fn setpoints_sticks_and_corrections_become_topics() {
    let mut bus = Bus::start();
    let (mut station, _bridge) = GroundStation::with_bridge(&bus, &["-m", "custom"]);
    let mut mode = bus.subscribe::<OffboardControlMode>();
    let mut triplet = bus.subscribe::<PositionSetpointTriplet>();
    let mut attitude = bus.subscribe::<VehicleAttitudeSetpoint>();
    let mut sticks = bus.subscribe::<ManualControlSetpoint>();
    let mut corrections = bus.subscribe::<GpsInjectData>();

    station.send(&MavMessage::SET_POSITION_TARGET_LOCAL_NED(SET_POSITION_TARGET_LOCAL_NED_DATA {
        target_system: 1,
        coordinate_frame: 1,
        type_mask: 0b1101_1111_1000,
        z: -2.5,
        ..SET_POSITION_TARGET_LOCAL_NED_DATA::DEFAULT
    }));
    let setpoint = next(&mut triplet).current;
    assert_eq!(setpoint.z, -2.5);
    assert!(bool::from(setpoint.position_valid) && !bool::from(setpoint.velocity_valid));
    assert!(!bool::from(next(&mut mode).ignore_position));

    station.send(&MavMessage::SET_ATTITUDE_TARGET(SET_ATTITUDE_TARGET_DATA {
        target_system: 1,
        type_mask: 0b111,
        q: [1.0, 0.0, 0.0, 0.0],
        thrust: 0.5,
        ..SET_ATTITUDE_TARGET_DATA::DEFAULT
    }));
    assert_eq!(next(&mut attitude).thrust, 0.5);
    assert!(!bool::from(next(&mut mode).ignore_attitude));

    station.send(&MavMessage::MANUAL_CONTROL(MANUAL_CONTROL_DATA {
        target: 1,
        x: 500,
        z: 1_000,
        ..MANUAL_CONTROL_DATA::DEFAULT
    }));
    let sticks = next(&mut sticks);
    assert_eq!((sticks.x, sticks.y, sticks.z), (0.5, 0.0, 1.0));

    let mut rtcm = GPS_RTCM_DATA_DATA { flags: 0, len: 180, ..GPS_RTCM_DATA_DATA::DEFAULT };
    rtcm.data = std::array::from_fn(|index| index as u8);
    station.send(&MavMessage::GPS_RTCM_DATA(rtcm.clone()));
    let injected = next(&mut corrections);
    assert_eq!(injected.len, 180);
    assert_eq!(injected.data[..180], rtcm.data);
}

#[test]
fn a_simulator_feeds_the_bus() {
    let mut bus = Bus::start();
    let (mut station, _bridge) = GroundStation::with_bridge(&bus, &["-m", "custom"]);
    let mut accel = bus.subscribe::<SensorAccel>();
    let mut gyro = bus.subscribe::<SensorGyro>();
    let mut mag = bus.subscribe::<SensorMag>();
    let mut baro = bus.subscribe::<SensorBaro>();
    let mut gps = bus.subscribe::<VehicleGpsPosition>();
    station.send(&MavMessage::HIL_SENSOR(HIL_SENSOR_DATA {
        zacc: -9.81,
        xgyro: 0.25,
        ymag: 0.5,
        abs_pressure: 950.0,
        fields_updated: 0x1fff,
        ..HIL_SENSOR_DATA::DEFAULT
    }));
    assert_eq!(next(&mut accel).z, -9.81);
    assert_eq!(next(&mut gyro).x, 0.25);
    assert_eq!(next(&mut mag).y, 0.5);
    assert_eq!(next(&mut baro).pressure, 950.0);
    station.send(&MavMessage::HIL_GPS(HIL_GPS_DATA {
        fix_type: 3,
        lat: 473_977_420,
        eph: 100,
        ..HIL_GPS_DATA::DEFAULT
    }));
    let fix = next(&mut gps);
    assert_eq!((fix.lat, fix.fix_type, fix.eph), (473_977_420, 3, 1.0));
}

#[test]
fn a_trajectory_comes_in_and_goes_out_with_all_its_coefficients() {
    let mut bus = Bus::start();
    let (mut station, _bridge) = GroundStation::with_bridge(&bus, &["-m", "normal"]);
    let mut trajectories = bus.subscribe::<CaTrajectoryMsg>();
    let coefficients: [f32; 28] = std::array::from_fn(|index| 1.5 - index as f32 * 0.1);
    let sent = CA_TRAJECTORY_MSG_DATA {
        time_start_usec: 1_000_000,
        time_stop_usec: 3_000_000,
        coefficients,
        seq_id: 7,
    };
    let before_us = uorb_core::now_us();
    station.send(&MavMessage::CA_TRAJECTORY_MSG(sent));
    let came = next(&mut trajectories);
    assert_eq!((came.time_start_usec, came.time_stop_usec), (1_000_000, 3_000_000));
    assert_eq!((came.coefficients, came.seq_id), (coefficients, 7));
    assert!((before_us..=uorb_core::now_us()).contains(&came.timestamp), "stamped on arrival");
    let heard = bus.uorb(&["listener", "ca_trajectory_msg"]).fine();
    assert!(heard.contains("seq_id: 7") && heard.contains("coefficients: [1.5"), "{heard}");

    // And the way back.
    let values: Vec<String> = coefficients.iter().map(|one| format!("{}", one * 2.0)).collect();
    let list = format!("coefficients=[{}]", values.join(","));
    let fields = ["pub", "ca_trajectory_msg", "seq_id=8", "time_start_usec=5", &list];
    assert_eq!(bus.uorb(&fields).code, 0);
    let back = station.until(|message| match message {
        MavMessage::CA_TRAJECTORY_MSG(message) => Some(message.clone()),
        _ => None,
    });
    assert_eq!((back.seq_id, back.time_start_usec), (8, 5));
    assert_eq!(back.coefficients, coefficients.map(|one| one * 2.0));
}

#[test]
fn a_message_that_the_dialect_does_not_know_is_counted() {
    let bus = Bus::start();
    let (mut station, _bridge) = GroundStation::with_bridge(&bus, &["-m", "custom"]);
    // Number 0x012211 is nobody's.
    station.send_bytes(&[0xfd, 1, 0, 0, 0, 255, 190, 0x11, 0x22, 0x01, 7, 0xaa, 0xbb]);
    station.said_so_far();
    eventually("the status says so", || {
        let status = bus.uorb(&["listener", "mavlink_status", "--field", "rx_unknown"]);
        status.fine().contains("rx_unknown: 1")
    });
}
