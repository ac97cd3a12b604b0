//! The messages of uORB: a struct and a topic for every .msg file beside this
//! crate's `Cargo.toml`.
//!
//! A struct is what is published, and where a message has one topic, the
//! struct is that topic, too: `Publication::<SensorAccel>`. Where it has
//! several, each of the others is a type without values:
//! `Publication::<ActuatorControls1>` publishes an [`ActuatorControls`].
//! [`TOPICS`] has all of them, [`OrbId`] numbers them.
//!
//! What PX4 had in the summer of 2017 is the same byte for byte; only the
//! attitude has its three angles beside the quaternion.
//!
//! | | topics |
//! |---|---|
//! | sensors | `sensor_accel`, `sensor_baro`, `sensor_combined`, `sensor_gyro`, `sensor_mag`, `airspeed`, `vehicle_gps_position`, `gps_inject_data` |
//! | estimation | `control_state`, `ekf2_innovations`, `ekf2_timestamps`, `estimator_status`, `vehicle_acceleration`, `vehicle_attitude`, `vehicle_attitude_groundtruth`, `vehicle_global_position`, `vehicle_global_position_groundtruth`, `vehicle_local_position`, `vehicle_local_position_groundtruth`, `vehicle_vision_attitude`, `vehicle_vision_position` |
//! | control | `actuator_armed`, `actuator_controls`, `actuator_controls_0`, `actuator_controls_1`, `actuator_controls_2`, `actuator_controls_3`, `actuator_controls_virtual_fw`, `actuator_controls_virtual_mc`, `ca_trajectory_msg`, `manual_control_setpoint`, `mc_att_ctrl_status`, `offboard_control_mode` |
//! | setpoints | `position_setpoint`, `position_setpoint_triplet`, `vehicle_local_position_setpoint`, `vehicle_attitude_setpoint`, `mc_virtual_attitude_setpoint`, `fw_virtual_attitude_setpoint`, `vehicle_rates_setpoint`, `mc_virtual_rates_setpoint`, `fw_virtual_rates_setpoint` |
//! | vehicle | `battery_status`, `commander_state`, `cpuload`, `esc_report`, `esc_status`, `home_position`, `mission`, `offboard_mission`, `onboard_mission`, `safety`, `vehicle_command`, `vehicle_command_ack`, `vehicle_land_detected`, `vehicle_status` |
//! | logging and links | `log_message`, `logger_status`, `mavlink_status` |
//! | other machines | `reach_status` |
//! | uORB's own tests | `orb_multitest`, `orb_test`, `orb_test_large`, `orb_test_medium`, `orb_test_medium_multi`, `orb_test_medium_queue`, `orb_test_medium_queue_poll`, `orb_test_medium_wrap_around` |
//!
//! # A topic of your own
//!
//! - Here: put `my_topic.msg` beside the others and build. There is now a
//!   struct `MyTopic`; its topic goes into the table above.
//! - In a crate of yours: give it a folder of .msg files and a build script of
//!   one line, as `uorb_codegen` shows.
//! - In code, without a file: [`uorb_core::topic!`].
//!
//! In a .msg file a line is a field or a constant. `timestamp` comes by itself:
//!
//! ```text
//! # What the message is about.
//!
//! float32[3] position     # [m] [@frame NED] where it is
//! uint8 state             # what it does [@enum STATE]
//! uint8 STATE_IDLE = 0    # nothing
//! uint8 STATE_BUSY = 1    # something
//!
//! uint8 ORB_QUEUE_LENGTH = 4
//! # TOPICS my_topic my_other_topic
//! ```
#![deny(missing_docs)]

include!(concat!(env!("OUT_DIR"), "/uorb_msg.rs"));
