//! The messages are those that PX4 had, and each describes itself rightly.

use std::collections::BTreeSet;

use uorb_core::{FieldType, Message, Topic, message_hash};
use uorb_msg::*;

fn topic(name: &str) -> &'static uorb_core::Metadata {
    OrbId::from_name(name).unwrap_or_else(|| panic!("no topic {name}")).metadata()
}

#[test]
fn every_layout_holds_together() {
    for topic in TOPICS {
        let layout = &topic.layout;
        assert_eq!(layout.check(), Ok(()), "{}", topic.name);
        assert_eq!(message_hash(&layout.fields), layout.message_hash, "{}", topic.name);
        assert_eq!(layout.size_bytes % 8, 0, "{}", topic.name);
        assert!(uorb_core::is_topic_name(&topic.name), "{}", topic.name);
    }
}

#[test]
fn a_struct_has_as_many_bytes_as_its_layout_says() {
    let mut checked = BTreeSet::new();
    macro_rules! check {
        ($($Message:ident)*) => {$(
            assert_eq!(size_of::<$Message>(), $Message::LAYOUT.size_bytes as usize);
            checked.insert(&*$Message::LAYOUT.name);
        )*};
    }
    check! {
        ActuatorArmed ActuatorControls Airspeed BatteryStatus CaTrajectoryMsg CommanderState
        ControlState Cpuload Ekf2Innovations Ekf2Timestamps EscReport EscStatus EstimatorStatus
        GpsInjectData HomePosition LogMessage LoggerStatus ManualControlSetpoint MavlinkStatus
        McAttCtrlStatus Mission OffboardControlMode OrbTest OrbTestLarge OrbTestMedium
        PositionSetpoint PositionSetpointTriplet ReachStatus Safety SensorAccel SensorBaro SensorCombined
        SensorGyro SensorMag
        VehicleAcceleration VehicleAttitude VehicleAttitudeSetpoint VehicleCommand
        VehicleCommandAck VehicleGlobalPosition VehicleGpsPosition VehicleLandDetected
        VehicleLocalPosition VehicleLocalPositionSetpoint VehicleRatesSetpoint VehicleStatus
    }
    let messages: BTreeSet<&str> = TOPICS.iter().map(|topic| &*topic.layout.name).collect();
    assert_eq!(checked, messages);
}

/// Formats as a flight log of July 2017 has them (PX4 f54a6c2999, between 1.6
/// and 1.7). All other topics of that log that are defined here were compared
/// once and are equal, but for `vehicle_attitude` and its two companions,
/// which have roll, pitch and yaw in addition.
const LOGGED: &[(&str, &str)] = &[
    (
        "actuator_armed",
        "uint64_t timestamp;bool armed;bool prearmed;bool ready_to_arm;bool lockdown;bool \
         manual_lockdown;bool force_failsafe;bool in_esc_calibration_mode;bool soft_stop;",
    ),
    ("actuator_controls_0", "uint64_t timestamp;uint64_t timestamp_sample;float[8] control;"),
    (
        "battery_status",
        "uint64_t timestamp;float voltage_v;float voltage_filtered_v;float current_a;float \
         current_filtered_a;float discharged_mah;float remaining;float scale;int32_t \
         cell_count;bool connected;uint8_t warning;uint8_t[6] _padding0;",
    ),
    (
        "esc_status",
        "uint64_t timestamp;uint16_t counter;uint8_t esc_count;uint8_t \
         esc_connectiontype;uint8_t[4] _padding0;esc_report[8] esc;",
    ),
    (
        "esc_report",
        "uint64_t timestamp;uint32_t esc_errorcount;int32_t esc_rpm;float esc_voltage;float \
         esc_current;float esc_temperature;float esc_setpoint;uint16_t esc_setpoint_raw;uint16_t \
         esc_address;uint16_t esc_version;uint16_t esc_state;uint8_t esc_vendor;uint8_t[7] \
         _padding0;",
    ),
    (
        "onboard_mission",
        "uint64_t timestamp;int32_t dataman_id;uint32_t count;int32_t current_seq;uint8_t[4] \
         _padding0;",
    ),
    (
        "safety",
        "uint64_t timestamp;bool safety_switch_available;bool safety_off;uint8_t[6] _padding0;",
    ),
    (
        "sensor_accel",
        "uint64_t timestamp;uint64_t integral_dt;uint64_t error_count;float x;float y;float \
         z;float x_integral;float y_integral;float z_integral;float temperature;float \
         range_m_s2;float scaling;uint32_t device_id;int16_t x_raw;int16_t y_raw;int16_t \
         z_raw;int16_t temperature_raw;",
    ),
    (
        "sensor_combined",
        "uint64_t timestamp;float[3] gyro_rad;float gyro_integral_dt;int32_t \
         accelerometer_timestamp_relative;float[3] accelerometer_m_s2;float \
         accelerometer_integral_dt;int32_t magnetometer_timestamp_relative;float[3] \
         magnetometer_ga;int32_t baro_timestamp_relative;float baro_alt_meter;float \
         baro_temp_celcius;",
    ),
    (
        "vehicle_command",
        "uint64_t timestamp;double param5;double param6;float param1;float param2;float \
         param3;float param4;float param7;uint32_t command;uint32_t target_system;uint32_t \
         target_component;uint32_t source_system;uint32_t source_component;uint8_t \
         confirmation;uint8_t[7] _padding0;",
    ),
    (
        "airspeed",
        "uint64_t timestamp;float indicated_airspeed_m_s;float true_airspeed_m_s;float \
         true_airspeed_unfiltered_m_s;float air_temperature_celsius;float confidence;float \
         differential_pressure_filtered_pa;",
    ),
    ("cpuload", "uint64_t timestamp;float load;float ram_usage;"),
    ("gps_inject_data", "uint64_t timestamp;uint8_t len;uint8_t flags;uint8_t[182] data;"),
    (
        "home_position",
        "uint64_t timestamp;double lat;double lon;float alt;float x;float y;float z;float \
         yaw;float direction_x;float direction_y;float direction_z;",
    ),
    (
        "manual_control_setpoint",
        "uint64_t timestamp;float x;float y;float z;float r;float flaps;float aux1;float \
         aux2;float aux3;float aux4;float aux5;uint8_t mode_switch;uint8_t return_switch;uint8_t \
         rattitude_switch;uint8_t posctl_switch;uint8_t loiter_switch;uint8_t acro_switch;uint8_t \
         offboard_switch;uint8_t kill_switch;uint8_t arm_switch;uint8_t transition_switch;uint8_t \
         gear_switch;int8_t mode_slot;uint8_t data_source;uint8_t stab_switch;uint8_t \
         man_switch;uint8_t[1] _padding0;",
    ),
    (
        "offboard_control_mode",
        "uint64_t timestamp;bool ignore_thrust;bool ignore_attitude;bool ignore_bodyrate;bool \
         ignore_position;bool ignore_velocity;bool ignore_acceleration_force;bool \
         ignore_alt_hold;uint8_t[1] _padding0;",
    ),
    (
        "position_setpoint",
        "uint64_t timestamp;double lat;double lon;float x;float y;float z;float vx;float vy;float \
         vz;float alt;float yaw;float yawspeed;float loiter_radius;float pitch_min;float \
         a_x;float a_y;float a_z;float acceptance_radius;float cruising_speed;float \
         cruising_throttle;bool valid;uint8_t type;bool position_valid;bool \
         velocity_valid;uint8_t velocity_frame;bool alt_valid;bool yaw_valid;bool \
         disable_mc_yaw_control;bool yawspeed_valid;int8_t loiter_direction;bool \
         acceleration_valid;bool acceleration_is_force;",
    ),
    (
        "position_setpoint_triplet",
        "uint64_t timestamp;position_setpoint previous;position_setpoint \
         current;position_setpoint next;",
    ),
    (
        "vehicle_attitude_setpoint",
        "uint64_t timestamp;float roll_body;float pitch_body;float yaw_body;float \
         yaw_sp_move_rate;float[4] q_d;float thrust;float landing_gear;bool q_d_valid;bool \
         roll_reset_integral;bool pitch_reset_integral;bool yaw_reset_integral;bool \
         fw_control_yaw;bool disable_mc_yaw_control;bool apply_flaps;uint8_t[1] _padding0;",
    ),
    (
        "vehicle_command_ack",
        "uint64_t timestamp;uint16_t command;uint8_t result;uint8_t[5] _padding0;",
    ),
    (
        "vehicle_global_position",
        "uint64_t timestamp;uint64_t time_utc_usec;double lat;double lon;double[2] \
         delta_lat_lon;float alt;float delta_alt;float vel_n;float vel_e;float vel_d;float \
         pos_d_deriv;float yaw;float eph;float epv;float evh;float evv;float terrain_alt;float \
         pressure_alt;uint8_t lat_lon_reset_counter;uint8_t alt_reset_counter;bool \
         terrain_alt_valid;bool dead_reckoning;",
    ),
    (
        "vehicle_land_detected",
        "uint64_t timestamp;float alt_max;bool landed;bool freefall;bool \
         ground_contact;uint8_t[1] _padding0;",
    ),
    (
        "vehicle_local_position",
        "uint64_t timestamp;uint64_t ref_timestamp;double ref_lat;double ref_lon;uint64_t \
         surface_bottom_timestamp;float x;float y;float z;float[2] delta_xy;float delta_z;float \
         vx;float vy;float vz;float z_deriv;float[2] delta_vxy;float delta_vz;float ax;float \
         ay;float az;float yaw;float ref_alt;float dist_bottom;float dist_bottom_rate;float \
         eph;float epv;float evh;float evv;uint8_t estimator_type;bool xy_valid;bool z_valid;bool \
         v_xy_valid;bool v_z_valid;uint8_t xy_reset_counter;uint8_t z_reset_counter;uint8_t \
         vxy_reset_counter;uint8_t vz_reset_counter;bool xy_global;bool z_global;bool \
         dist_bottom_valid;uint8_t[4] _padding0;",
    ),
    (
        "vehicle_local_position_setpoint",
        "uint64_t timestamp;float x;float y;float z;float yaw;float vx;float vy;float vz;float \
         acc_x;float acc_y;float acc_z;",
    ),
    ("vehicle_rates_setpoint", "uint64_t timestamp;float roll;float pitch;float yaw;float thrust;"),
    (
        "vehicle_status",
        "uint64_t timestamp;uint32_t system_id;uint32_t component_id;uint32_t \
         onboard_control_sensors_present;uint32_t onboard_control_sensors_enabled;uint32_t \
         onboard_control_sensors_health;uint8_t nav_state;uint8_t arming_state;uint8_t \
         hil_state;bool failsafe;uint8_t system_type;bool is_rotary_wing;bool is_vtol;bool \
         vtol_fw_permanent_stab;bool in_transition_mode;bool in_transition_to_fw;bool \
         rc_signal_lost;uint8_t rc_input_mode;bool data_link_lost;uint8_t \
         data_link_lost_counter;bool engine_failure;bool engine_failure_cmd;bool \
         mission_failure;uint8_t[3] _padding0;",
    ),
];

#[test]
fn the_formats_are_those_of_a_flight_log() {
    for (name, format) in LOGGED {
        assert_eq!(topic(name).layout.o_fields(), *format, "{name}");
    }
}

/// What PX4's own generator computes from these texts: size, size without the
/// padding at the end, and hash.
#[test]
fn sizes_and_hashes_are_those_of_px4() {
    let facts = [
        ("actuator_armed", 16, 16, 0x8bc3_6977),
        ("actuator_controls", 48, 48, 0xc5d5_9a9e),
        ("battery_status", 48, 42, 0xdfec_c95c),
        ("ca_trajectory_msg", 144, 138, 0x4561_3c6c),
        ("commander_state", 16, 9, 0x7660_5692),
        ("control_state", 136, 134, 0x8a73_e61a),
        ("ekf2_innovations", 144, 140, 0x192f_4bc1),
        ("ekf2_timestamps", 24, 20, 0x9636_e52a),
        ("esc_report", 48, 41, 0x54dd_ff61),
        ("esc_status", 400, 400, 0x0f2f_8806),
        ("estimator_status", 272, 267, 0xa0ae_214b),
        ("mc_att_ctrl_status", 24, 20, 0x5f16_e53d),
        ("mission", 24, 20, 0xc851_01f8),
        ("orb_test", 16, 12, 0x766b_aa60),
        ("orb_test_large", 528, 524, 0x930b_9fd6),
        ("orb_test_medium", 80, 76, 0x1cbb_8bca),
        ("safety", 16, 10, 0x5e19_a3d4),
        ("sensor_accel", 72, 72, 0x5b4d_b31c),
        ("sensor_baro", 32, 32, 0x992f_408c),
        ("sensor_combined", 72, 72, 0xc81a_c979),
        ("sensor_gyro", 72, 72, 0x1f02_c4fa),
        ("sensor_mag", 56, 51, 0x25d5_56f6),
        ("vehicle_acceleration", 32, 28, 0x6708_8e65),
        ("vehicle_attitude", 48, 48, 0x3962_8228),
        ("vehicle_command", 72, 65, 0x19e1_b2b0),
        ("vehicle_gps_position", 96, 91, 0x112b_8ba1),
    ];
    for (name, size_bytes, size_no_padding_bytes, message_hash) in facts {
        let layout = &topic(name).layout;
        assert_eq!(layout.size_bytes, size_bytes, "{name}");
        assert_eq!(layout.size_no_padding_bytes(), size_no_padding_bytes, "{name}");
        assert_eq!(layout.message_hash, message_hash, "{name}");
    }
}

#[test]
fn fields_stand_in_the_order_of_the_text_with_their_units() {
    let fields: Vec<_> = topic("sensor_baro")
        .layout
        .fields
        .iter()
        .map(|field| (&*field.name, field.msg_type(), &*field.unit))
        .collect();
    assert_eq!(
        fields,
        [
            ("timestamp", "uint64".to_string(), "us"),
            ("pressure", "float32".to_string(), "mbar"),
            ("altitude", "float32".to_string(), "m"),
            ("temperature", "float32".to_string(), "degC"),
            ("error_count", "uint64".to_string(), ""),
            ("device_id", "uint32".to_string(), ""),
        ]
    );
}

#[test]
fn a_message_can_be_part_of_another() {
    let esc = topic("esc_status").layout.fields.last().unwrap();
    let FieldType::Message(report) = &esc.ty else { panic!("esc is no message") };
    assert_eq!(**report, *EscReport::LAYOUT);
    let mut status = EscStatus::default();
    status.esc[7].esc_rpm = -4_000;
    assert_eq!(status.esc[7].esc_rpm, -4_000);
    assert_eq!(status.esc.len(), EscStatus::CONNECTED_ESC_MAX.into());
}

#[test]
fn several_topics_can_share_a_message() {
    fn layout_of<T: Topic<Message = ActuatorControls>>() -> &'static str {
        assert_eq!(*T::METADATA.layout, *ActuatorControls::LAYOUT);
        &T::METADATA.name
    }
    assert_eq!(layout_of::<ActuatorControls>(), "actuator_controls");
    assert_eq!(layout_of::<ActuatorControls0>(), "actuator_controls_0");
    assert_eq!(layout_of::<ActuatorControlsVirtualMc>(), "actuator_controls_virtual_mc");
}

#[test]
fn constants_and_queue_lengths_come_from_the_text() {
    assert_eq!(SensorCombined::RELATIVE_TIMESTAMP_INVALID, 0x7fff_ffff);
    assert_eq!(topic("sensor_accel").queue_length.get(), 1);
    assert_eq!(topic("vehicle_command").queue_length.get(), 4);
    assert_eq!(topic("orb_test_medium_queue_poll").queue_length.get(), 16);
}

#[test]
fn topics_are_numbered_by_their_names() {
    assert!(TOPICS.is_sorted_by(|one, other| one.name < other.name));
    assert_eq!(OrbId::ALL.len(), TOPICS.len());
    for (place, topic) in TOPICS.iter().enumerate() {
        let id = OrbId::from_name(&topic.name).unwrap();
        assert_eq!(id as usize, place);
        assert_eq!(id.metadata().name, topic.name);
    }
    assert_eq!(OrbId::ActuatorArmed as u16, 0);
    assert_eq!(OrbId::from_name("vehicle_roi"), None);
}

#[test]
fn the_documentation_lists_every_topic() {
    let documentation = include_str!("../src/lib.rs");
    for topic in TOPICS {
        assert!(documentation.contains(&format!("`{}`", topic.name)), "{}", topic.name);
    }
}
