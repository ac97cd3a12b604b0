// Written by uorb-codegen from .msg files; edit those instead.

/// One arm of a dock.
///
/// Topic `dock_arm`: 16 bytes.
#[derive(
    Clone, Copy, Debug, PartialEq,
    ::uorb_core::zerocopy::FromBytes, ::uorb_core::zerocopy::IntoBytes,
    ::uorb_core::zerocopy::Immutable,
)]
#[zerocopy(crate = "uorb_core::zerocopy")]
#[repr(C)]
pub struct DockArm {
    /// Time since the system started.
    ///
    /// Unit: `us`.
    pub timestamp: u64,
    /// how hard it holds
    ///
    /// Unit: `N`.
    pub force: f32,
    /// `uint32 cycles`
    pub cycles: u32,
}

impl ::core::default::Default for DockArm {
    fn default() -> Self {
        ::uorb_core::zerocopy::FromZeros::new_zeroed()
    }
}

impl ::uorb_core::Message for DockArm {
    const LAYOUT: &'static ::uorb_core::Layout = {
        const FIELDS: &[::uorb_core::Field] = &[
            uorb_field(
                "timestamp",
                ::uorb_core::FieldType::Uint64,
                ::core::option::Option::None,
                ::core::mem::offset_of!(DockArm, timestamp),
                "us",
            ),
            uorb_field(
                "force",
                ::uorb_core::FieldType::Float32,
                ::core::option::Option::None,
                ::core::mem::offset_of!(DockArm, force),
                "N",
            ),
            uorb_field(
                "cycles",
                ::uorb_core::FieldType::Uint32,
                ::core::option::Option::None,
                ::core::mem::offset_of!(DockArm, cycles),
                "",
            ),
        ];
        assert!(::core::mem::size_of::<DockArm>() == 16);
        assert!(::uorb_core::message_hash(FIELDS) == 0xc639411f);
        &::uorb_core::Layout {
            name: ::std::borrow::Cow::Borrowed("dock_arm"),
            size_bytes: 16,
            message_hash: 0xc639411f,
            fields: ::std::borrow::Cow::Borrowed(FIELDS),
        }
    };
}

impl ::uorb_core::Topic for DockArm {
    type Message = DockArm;
    const METADATA: &'static ::uorb_core::Metadata = &::uorb_core::Metadata {
        name: ::std::borrow::Cow::Borrowed("dock_arm"),
        layout: ::std::borrow::Cow::Borrowed(<DockArm as ::uorb_core::Message>::LAYOUT),
        queue_length: ::uorb_core::QueueLength::at_least(1),
    };
}

/// What the dock's camera sees: too large for a node, so it lives on its stream.
///
/// Topic `dock_image`: 6220808 bytes.
#[derive(
    Clone, Copy, Debug, PartialEq,
    ::uorb_core::zerocopy::FromBytes, ::uorb_core::zerocopy::IntoBytes,
    ::uorb_core::zerocopy::Immutable,
)]
#[zerocopy(crate = "uorb_core::zerocopy")]
#[repr(C)]
pub struct DockImage {
    /// Time since the system started.
    ///
    /// Unit: `us`.
    pub timestamp: u64,
    /// 1920 x 1080 pixels of three bytes
    pub data: [u8; 6220800],
}

impl ::core::default::Default for DockImage {
    fn default() -> Self {
        ::uorb_core::zerocopy::FromZeros::new_zeroed()
    }
}

impl ::uorb_core::Message for DockImage {
    const LAYOUT: &'static ::uorb_core::Layout = {
        const FIELDS: &[::uorb_core::Field] = &[
            uorb_field(
                "timestamp",
                ::uorb_core::FieldType::Uint64,
                ::core::option::Option::None,
                ::core::mem::offset_of!(DockImage, timestamp),
                "us",
            ),
            uorb_field(
                "data",
                ::uorb_core::FieldType::Uint8,
                ::core::option::Option::Some(6220800),
                ::core::mem::offset_of!(DockImage, data),
                "",
            ),
        ];
        assert!(::core::mem::size_of::<DockImage>() == 6220808);
        assert!(::uorb_core::message_hash(FIELDS) == 0x48d1c4ad);
        &::uorb_core::Layout {
            name: ::std::borrow::Cow::Borrowed("dock_image"),
            size_bytes: 6220808,
            message_hash: 0x48d1c4ad,
            fields: ::std::borrow::Cow::Borrowed(FIELDS),
        }
    };
}

impl ::uorb_core::Topic for DockImage {
    type Message = DockImage;
    const METADATA: &'static ::uorb_core::Metadata = &::uorb_core::Metadata {
        name: ::std::borrow::Cow::Borrowed("dock_image"),
        layout: ::std::borrow::Cow::Borrowed(<DockImage as ::uorb_core::Message>::LAYOUT),
        queue_length: ::uorb_core::QueueLength::at_least(1),
    };
}

/// A dock that charges vehicles. Every sort of declaration is in this file.
///
/// It has two arms \[left, right\], which hold a vehicle as \<vehicle_id> says.
///
/// Topics `dock_status`, `dock_status_spare`, `dock_status_simulated`: 120 bytes, queue length 4.
#[derive(
    Clone, Copy, Debug, PartialEq,
    ::uorb_core::zerocopy::FromBytes, ::uorb_core::zerocopy::IntoBytes,
    ::uorb_core::zerocopy::Immutable,
)]
#[zerocopy(crate = "uorb_core::zerocopy")]
#[repr(C)]
pub struct DockStatus {
    /// time since the system started
    ///
    /// Unit: `us`.
    pub timestamp: u64,
    /// letters of no source: turned, \[1mbold, marked parted
    ///
    /// Range: `0 1`.
    pub charged: f64,
    /// opening of the arms
    /// while they move
    ///
    /// Unit: `deg`. Range: `0, 90`.
    pub arm_angle: [f32; 2],
    /// `int16 offset`
    ///
    /// Unit: `mm`. Frame: `dock`. Invalid: `-32768`.
    pub offset: i16,
    /// the lock is closed
    pub locked: ::uorb_core::Bool,
    /// sort of dock
    pub r#type: u8,
    /// Shown at the gate.
    /// with a NUL at its end
    pub sign: [u8; 9],
    /// what is in it
    ///
    /// Values: `STATE`.
    pub state: u8,
    /// which lamps burn
    ///
    /// - 0 - red
    /// - 1 - green
    pub lamps: u8,
    /// Padding, required for the logger.
    pub _padding0: [u8; 1],
    /// `dock_arm[2] arms`
    pub arms: [DockArm; 2],
    /// the motor that pulls
    pub winch: EscReport,
}

#[allow(clippy::approx_constant, clippy::excessive_precision)]
impl DockStatus {
    /// `uint32 MESSAGE_VERSION`
    pub const MESSAGE_VERSION: u32 = 1;
    /// a dock is seldom asked
    pub const ORB_QUEUE_LENGTH: u8 = 4;
    /// `uint8 STATE_EMPTY`
    pub const STATE_EMPTY: u8 = 0;
    /// a vehicle is in
    pub const STATE_FULL: u8 = 1;
    /// `int16 OFFSET_MIN`
    pub const OFFSET_MIN: i16 = -16;
    /// `uint8 LAMPS_ALL`
    pub const LAMPS_ALL: u8 = 7;
    /// Unit: `V`.
    pub const VOLTAGE_MAX: f32 = 25.2;
    /// `float64 PI`
    pub const PI: f64 = 3.14159;
    /// `bool HAS_LAMPS`
    pub const HAS_LAMPS: bool = true;
    /// `char SIGN`
    pub const SIGN: u8 = 68;
}

impl ::core::default::Default for DockStatus {
    fn default() -> Self {
        ::uorb_core::zerocopy::FromZeros::new_zeroed()
    }
}

impl ::uorb_core::Message for DockStatus {
    const LAYOUT: &'static ::uorb_core::Layout = {
        const FIELDS: &[::uorb_core::Field] = &[
            uorb_field(
                "timestamp",
                ::uorb_core::FieldType::Uint64,
                ::core::option::Option::None,
                ::core::mem::offset_of!(DockStatus, timestamp),
                "us",
            ),
            uorb_field(
                "locked",
                ::uorb_core::FieldType::Bool,
                ::core::option::Option::None,
                ::core::mem::offset_of!(DockStatus, locked),
                "",
            ),
            uorb_field(
                "type",
                ::uorb_core::FieldType::Uint8,
                ::core::option::Option::None,
                ::core::mem::offset_of!(DockStatus, r#type),
                "",
            ),
            uorb_field(
                "sign",
                ::uorb_core::FieldType::Char,
                ::core::option::Option::Some(9),
                ::core::mem::offset_of!(DockStatus, sign),
                "",
            ),
            uorb_field(
                "state",
                ::uorb_core::FieldType::Uint8,
                ::core::option::Option::None,
                ::core::mem::offset_of!(DockStatus, state),
                "",
            ),
            uorb_field(
                "lamps",
                ::uorb_core::FieldType::Uint8,
                ::core::option::Option::None,
                ::core::mem::offset_of!(DockStatus, lamps),
                "",
            ),
            uorb_field(
                "arm_angle",
                ::uorb_core::FieldType::Float32,
                ::core::option::Option::Some(2),
                ::core::mem::offset_of!(DockStatus, arm_angle),
                "deg",
            ),
            uorb_field(
                "charged",
                ::uorb_core::FieldType::Float64,
                ::core::option::Option::None,
                ::core::mem::offset_of!(DockStatus, charged),
                "",
            ),
            uorb_field(
                "offset",
                ::uorb_core::FieldType::Int16,
                ::core::option::Option::None,
                ::core::mem::offset_of!(DockStatus, offset),
                "mm",
            ),
            uorb_field(
                "arms",
                ::uorb_core::FieldType::Message(::std::borrow::Cow::Borrowed(<DockArm as ::uorb_core::Message>::LAYOUT)),
                ::core::option::Option::Some(2),
                ::core::mem::offset_of!(DockStatus, arms),
                "",
            ),
            uorb_field(
                "winch",
                ::uorb_core::FieldType::Message(::std::borrow::Cow::Borrowed(<EscReport as ::uorb_core::Message>::LAYOUT)),
                ::core::option::Option::None,
                ::core::mem::offset_of!(DockStatus, winch),
                "",
            ),
        ];
        assert!(::core::mem::size_of::<DockStatus>() == 120);
        &::uorb_core::Layout {
            name: ::std::borrow::Cow::Borrowed("dock_status"),
            size_bytes: 120,
            message_hash: 0x48f54b20,
            fields: ::std::borrow::Cow::Borrowed(FIELDS),
        }
    };
}

impl ::uorb_core::Topic for DockStatus {
    type Message = DockStatus;
    const METADATA: &'static ::uorb_core::Metadata = &::uorb_core::Metadata {
        name: ::std::borrow::Cow::Borrowed("dock_status"),
        layout: ::std::borrow::Cow::Borrowed(<DockStatus as ::uorb_core::Message>::LAYOUT),
        queue_length: ::uorb_core::QueueLength::at_least(4),
    };
}

/// Topic `dock_status_spare`, on which [`DockStatus`] is published.
#[derive(Clone, Copy, Debug)]
pub enum DockStatusSpare {}

impl ::uorb_core::Topic for DockStatusSpare {
    type Message = DockStatus;
    const METADATA: &'static ::uorb_core::Metadata = &::uorb_core::Metadata {
        name: ::std::borrow::Cow::Borrowed("dock_status_spare"),
        layout: ::std::borrow::Cow::Borrowed(<DockStatus as ::uorb_core::Message>::LAYOUT),
        queue_length: ::uorb_core::QueueLength::at_least(4),
    };
}

/// Topic `dock_status_simulated`, on which [`DockStatus`] is published.
#[derive(Clone, Copy, Debug)]
pub enum DockStatusSimulated {}

impl ::uorb_core::Topic for DockStatusSimulated {
    type Message = DockStatus;
    const METADATA: &'static ::uorb_core::Metadata = &::uorb_core::Metadata {
        name: ::std::borrow::Cow::Borrowed("dock_status_simulated"),
        layout: ::std::borrow::Cow::Borrowed(<DockStatus as ::uorb_core::Message>::LAYOUT),
        queue_length: ::uorb_core::QueueLength::at_least(4),
    };
}

/// What one electronic speed controller says. Part of esc_status.
///
/// 48 bytes, no topic of its own.
#[derive(
    Clone, Copy, Debug, PartialEq,
    ::uorb_core::zerocopy::FromBytes, ::uorb_core::zerocopy::IntoBytes,
    ::uorb_core::zerocopy::Immutable,
)]
#[zerocopy(crate = "uorb_core::zerocopy")]
#[repr(C)]
pub struct EscReport {
    /// Time since the system started.
    ///
    /// Unit: `us`.
    pub timestamp: u64,
    /// errors that it counted, if it counts them
    pub esc_errorcount: u32,
    /// speed of the motor, negative if it turns backwards
    ///
    /// Unit: `rpm`.
    pub esc_rpm: i32,
    /// voltage, if it is measured
    ///
    /// Unit: `V`.
    pub esc_voltage: f32,
    /// current, if it is measured
    ///
    /// Unit: `A`.
    pub esc_current: f32,
    /// temperature, if it is measured
    ///
    /// Unit: `degC`.
    pub esc_temperature: f32,
    /// setpoint
    pub esc_setpoint: f32,
    /// setpoint as it was sent to the controller
    pub esc_setpoint_raw: u16,
    /// its address, mostly 1 to 8
    pub esc_address: u16,
    /// its version, if it tells
    pub esc_version: u16,
    /// its state, in the vendor's own words
    pub esc_state: u16,
    /// who made it
    ///
    /// Values: `esc_status.ESC_VENDOR`.
    pub esc_vendor: u8,
    /// Padding, required for the logger.
    pub _padding0: [u8; 7],
}

impl ::core::default::Default for EscReport {
    fn default() -> Self {
        ::uorb_core::zerocopy::FromZeros::new_zeroed()
    }
}

impl ::uorb_core::Message for EscReport {
    const LAYOUT: &'static ::uorb_core::Layout = {
        const FIELDS: &[::uorb_core::Field] = &[
            uorb_field(
                "timestamp",
                ::uorb_core::FieldType::Uint64,
                ::core::option::Option::None,
                ::core::mem::offset_of!(EscReport, timestamp),
                "us",
            ),
            uorb_field(
                "esc_vendor",
                ::uorb_core::FieldType::Uint8,
                ::core::option::Option::None,
                ::core::mem::offset_of!(EscReport, esc_vendor),
                "",
            ),
            uorb_field(
                "esc_errorcount",
                ::uorb_core::FieldType::Uint32,
                ::core::option::Option::None,
                ::core::mem::offset_of!(EscReport, esc_errorcount),
                "",
            ),
            uorb_field(
                "esc_rpm",
                ::uorb_core::FieldType::Int32,
                ::core::option::Option::None,
                ::core::mem::offset_of!(EscReport, esc_rpm),
                "rpm",
            ),
            uorb_field(
                "esc_voltage",
                ::uorb_core::FieldType::Float32,
                ::core::option::Option::None,
                ::core::mem::offset_of!(EscReport, esc_voltage),
                "V",
            ),
            uorb_field(
                "esc_current",
                ::uorb_core::FieldType::Float32,
                ::core::option::Option::None,
                ::core::mem::offset_of!(EscReport, esc_current),
                "A",
            ),
            uorb_field(
                "esc_temperature",
                ::uorb_core::FieldType::Float32,
                ::core::option::Option::None,
                ::core::mem::offset_of!(EscReport, esc_temperature),
                "degC",
            ),
            uorb_field(
                "esc_setpoint",
                ::uorb_core::FieldType::Float32,
                ::core::option::Option::None,
                ::core::mem::offset_of!(EscReport, esc_setpoint),
                "",
            ),
            uorb_field(
                "esc_setpoint_raw",
                ::uorb_core::FieldType::Uint16,
                ::core::option::Option::None,
                ::core::mem::offset_of!(EscReport, esc_setpoint_raw),
                "",
            ),
            uorb_field(
                "esc_address",
                ::uorb_core::FieldType::Uint16,
                ::core::option::Option::None,
                ::core::mem::offset_of!(EscReport, esc_address),
                "",
            ),
            uorb_field(
                "esc_version",
                ::uorb_core::FieldType::Uint16,
                ::core::option::Option::None,
                ::core::mem::offset_of!(EscReport, esc_version),
                "",
            ),
            uorb_field(
                "esc_state",
                ::uorb_core::FieldType::Uint16,
                ::core::option::Option::None,
                ::core::mem::offset_of!(EscReport, esc_state),
                "",
            ),
        ];
        assert!(::core::mem::size_of::<EscReport>() == 48);
        assert!(::uorb_core::message_hash(FIELDS) == 0x54ddff61);
        &::uorb_core::Layout {
            name: ::std::borrow::Cow::Borrowed("esc_report"),
            size_bytes: 48,
            message_hash: 0x54ddff61,
            fields: ::std::borrow::Cow::Borrowed(FIELDS),
        }
    };
}

const fn uorb_field(
    name: &'static str,
    ty: ::uorb_core::FieldType,
    array_length: ::core::option::Option<u32>,
    offset_bytes: usize,
    unit: &'static str,
) -> ::uorb_core::Field {
    ::uorb_core::Field {
        name: ::std::borrow::Cow::Borrowed(name),
        ty,
        array_length,
        offset_bytes: offset_bytes as u32,
        unit: ::std::borrow::Cow::Borrowed(unit),
    }
}

/// All topics that are defined here, sorted by name.
pub static TOPICS: &[&::uorb_core::Metadata] = &[
    <DockArm as ::uorb_core::Topic>::METADATA,
    <DockImage as ::uorb_core::Topic>::METADATA,
    <DockStatus as ::uorb_core::Topic>::METADATA,
    <DockStatusSimulated as ::uorb_core::Topic>::METADATA,
    <DockStatusSpare as ::uorb_core::Topic>::METADATA,
];

/// A topic by number: its place in [`TOPICS`]. Another set of messages has
/// other numbers; what lasts is the name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u16)]
pub enum OrbId {
    /// `dock_arm`
    DockArm,
    /// `dock_image`
    DockImage,
    /// `dock_status`
    DockStatus,
    /// `dock_status_simulated`
    DockStatusSimulated,
    /// `dock_status_spare`
    DockStatusSpare,
}

impl OrbId {
    /// All of them, in order.
    pub const ALL: &'static [Self] = &[
        Self::DockArm,
        Self::DockImage,
        Self::DockStatus,
        Self::DockStatusSimulated,
        Self::DockStatusSpare,
    ];

    /// The topic's name, layout and queue length.
    pub fn metadata(self) -> &'static ::uorb_core::Metadata {
        TOPICS[self as usize]
    }

    /// The topic of this name, if it is defined here.
    pub fn from_name(name: &str) -> ::core::option::Option<Self> {
        let place = TOPICS.binary_search_by(|topic| (*topic.name).cmp(name)).ok()?;
        ::core::option::Option::Some(Self::ALL[place])
    }
}
