//! Topics that are defined in code, as the first uORB documents define theirs.

use uorb_core::{Message, Topic};

uorb_core::topic! {
    /// One random number.
    pub struct RandomInteger = "random_integer" {
        /// The number.
        pub r: i32,
    }
}

uorb_core::topic! {
    /// What is published on all color topics.
    pub struct ColorUpdate {
        /// How often the color was seen.
        pub number: i32,
    }
    pub topic ColorRed = "color_red";
    pub topic ColorTimeouts = "color_timeouts";
}

uorb_core::topic! {
    /// A battery that watches itself.
    pub struct OwnBattery = "own_battery" {
        /// What PX4's message has of it.
        pub battery: uorb_msg::BatteryStatus,
        /// How often it was charged.
        pub charges: [u16; 4],
    }
}

uorb_core::topic! {
    /// Fields that are keywords of Rust, and none of anybody else.
    pub struct Beacon = "beacon" {
        /// What sort of beacon.
        pub r#type: u32,
        /// The distance at which it matches.
        pub r#match: [f32; 2],
    }
}

#[test]
fn a_random_integer_is_exactly_four_bytes() {
    assert_eq!(size_of::<RandomInteger>(), 4);
    let layout = &RandomInteger::METADATA.layout;
    assert_eq!((layout.size_bytes, layout.o_fields()), (4, "int32_t r;".to_string()));
    assert_eq!(RandomInteger::METADATA.name, "random_integer");
}

#[test]
fn several_topics_of_code_can_share_a_struct() {
    assert_eq!(ColorRed::METADATA.name, "color_red");
    assert_eq!(ColorTimeouts::METADATA.name, "color_timeouts");
    assert_eq!(ColorRed::METADATA.layout, ColorTimeouts::METADATA.layout);
}

#[test]
fn a_struct_of_code_can_contain_a_message_of_a_file() {
    OwnBattery::LAYOUT.check().unwrap();
    let flat = OwnBattery::LAYOUT.flatten();
    assert!(flat.iter().any(|field| field.path == "battery.voltage_v"));
}

#[test]
fn a_field_that_is_a_keyword_of_rust_has_its_plain_name_for_others() {
    assert_eq!(Beacon::LAYOUT.o_fields(), "uint32_t type;float[2] match;");
    // PX4's hash of `uint32 type` and `float32[2] match`.
    assert_eq!(Beacon::LAYOUT.message_hash, 0xbf0f_97d0);
}

#[test]
fn a_topic_has_a_name_that_can_be_a_file() {
    for name in ["a", "sensor_accel", "Ekf2", "x_1", &"x".repeat(57)] {
        assert!(uorb_core::is_topic_name(name), "{name}");
    }
    for name in ["", "1a", "_a", "a b", "a/b", "a.b", "../a", "\u{e4}", "a\0", &"x".repeat(58)] {
        assert!(!uorb_core::is_topic_name(name), "{name}");
    }
}
