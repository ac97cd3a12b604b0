//! What a topic is: a name, a layout and a queue length.
//!
//! A [`Message`] is the Rust struct, a [`Topic`] the name under which such
//! messages are exchanged. Most messages have one topic of their own name, and
//! then the struct is both; a .msg file with a `# TOPICS` line has several, and
//! each is a type without values beside the struct. The message compiler
//! writes both; [`crate::topic!`] does it for a struct that is defined in code.
//!
//! `Message` demands zerocopy's proofs (any bytes are a valid value, no hidden
//! padding), so copying one out of shared memory is sound whoever wrote it.

use std::borrow::Cow;
use std::fmt;

use serde::{Deserialize, Serialize};
use zerocopy::{FromBytes, Immutable, IntoBytes};

use crate::layout::{FieldType, Layout};

/// The instances a topic may have: PX4's `ORB_MULTI_MAX_INSTANCES`.
pub const INSTANCES_MAX: u8 = 10;

/// The bytes of the longest topic name: PX4's `orb_maxpath` is 64 with
/// `/obj/`, the instance digit and the terminating NUL.
pub const TOPIC_NAME_MAX_BYTES: usize = 64 - 5 - 1 - 1;

/// A plain struct that travels over the bus.
pub trait Message: FromBytes + IntoBytes + Immutable + Copy + Send + Sync + 'static {
    /// The struct's fields, as other programs see them.
    const LAYOUT: &'static Layout;
}

/// A kind of message with a name (PX4's `ORB_ID`).
pub trait Topic: 'static {
    /// The struct that is published on the topic.
    type Message: Message;
    /// Name, layout and queue length (PX4's `orb_metadata`).
    const METADATA: &'static Metadata;
}

/// Name, layout and queue length of a topic (PX4's `orb_metadata`).
#[doc(alias = "orb_metadata")]
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Metadata {
    /// The topic's name: `sensor_accel`.
    pub name: Cow<'static, str>,
    /// The fields and the size of its messages.
    pub layout: Cow<'static, Layout>,
    /// How many messages a node of this topic keeps (`ORB_QUEUE_LENGTH`).
    pub queue_length: QueueLength,
}

/// Whether a name can be a topic's: letters, digits and `_`, a letter first, at
/// most [`TOPIC_NAME_MAX_BYTES`] bytes. It becomes a file name, so nothing else
/// is let through.
pub const fn is_topic_name(name: &str) -> bool {
    let name = name.as_bytes();
    if name.is_empty() || name.len() > TOPIC_NAME_MAX_BYTES || !name[0].is_ascii_alphabetic() {
        return false;
    }
    let mut index = 1;
    while index < name.len() {
        if !name[index].is_ascii_alphanumeric() && name[index] != b'_' {
            return false;
        }
        index += 1;
    }
    true
}

/// Which of a topic's nodes: 0 to 9.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[serde(try_from = "u8", into = "u8")]
pub struct Instance(u8);

impl Instance {
    /// The instance that `advertise` and `subscribe` mean.
    pub const FIRST: Self = Self(0);

    /// The instance of this number, if there can be one.
    pub const fn new(number: u8) -> Option<Self> {
        if number < INSTANCES_MAX { Some(Self(number)) } else { None }
    }

    /// The instance's number.
    pub const fn number(self) -> u8 {
        self.0
    }

    /// All instances a topic may have, from 0 up.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..INSTANCES_MAX).map(Self)
    }
}

impl TryFrom<u8> for Instance {
    type Error = String;
    fn try_from(number: u8) -> Result<Self, String> {
        Self::new(number)
            .ok_or_else(|| format!("instance {number} is not in 0..{}", INSTANCES_MAX - 1))
    }
}

impl From<Instance> for u8 {
    fn from(instance: Instance) -> u8 {
        instance.0
    }
}

impl fmt::Display for Instance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// How many messages a node keeps: a power of two from 1 to 128.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "u32", into = "u32")]
pub struct QueueLength(u32);

impl QueueLength {
    /// One message: the latest. What a .msg without `ORB_QUEUE_LENGTH` has.
    pub const ONE: Self = Self(1);
    /// The longest queue, PX4's limit (2020 and later).
    pub const MAX: u32 = 128;

    /// The queue length of exactly this many messages, if it is a power of two
    /// up to [`QueueLength::MAX`].
    pub const fn new(length: u32) -> Option<Self> {
        if length.is_power_of_two() && length <= Self::MAX { Some(Self(length)) } else { None }
    }

    /// The shortest queue that keeps this many messages, as
    /// `orb_advertise_queue` rounds: 0 to 1, 10 to 16, all above 64 to 128.
    pub const fn at_least(length: u32) -> Self {
        if length >= Self::MAX { Self(Self::MAX) } else { Self(length.next_power_of_two()) }
    }

    /// The number of messages.
    pub const fn get(self) -> u32 {
        self.0
    }
}

const _: () = assert!(QueueLength::MAX.is_power_of_two());

impl TryFrom<u32> for QueueLength {
    type Error = String;
    fn try_from(length: u32) -> Result<Self, String> {
        Self::new(length)
            .ok_or_else(|| format!("queue length {length} is not a power of two up to 128"))
    }
}

impl From<QueueLength> for u32 {
    fn from(length: QueueLength) -> u32 {
        length.0
    }
}

/// How much a publisher's instance is to be preferred over others of its topic
/// (PX4's `ORB_PRIO`, 2016 to 2019). uORB carries it and does not use it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Priority(pub u8);

#[allow(missing_docs)]
impl Priority {
    pub const MIN: Self = Self(1);
    pub const VERY_LOW: Self = Self(25);
    pub const LOW: Self = Self(50);
    pub const DEFAULT: Self = Self(75);
    pub const HIGH: Self = Self(100);
    pub const VERY_HIGH: Self = Self(125);
    pub const MAX: Self = Self(255);
}

impl Default for Priority {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// A truth value in a message: one byte, true if it is not 0, as in C.
///
/// Rust's own `bool` may hold nothing but 0 and 1, which nobody can promise of
/// bytes that another process wrote.
#[derive(Clone, Copy, Default, FromBytes, IntoBytes, Immutable)]
#[repr(transparent)]
pub struct Bool(u8);

impl Bool {
    /// False.
    pub const FALSE: Self = Self(0);
    /// True.
    pub const TRUE: Self = Self(1);

    /// The truth value as Rust has it.
    pub const fn get(self) -> bool {
        self.0 != 0
    }
}

impl From<bool> for Bool {
    fn from(value: bool) -> Self {
        Self(value.into())
    }
}

impl From<Bool> for bool {
    fn from(value: Bool) -> bool {
        value.get()
    }
}

impl PartialEq for Bool {
    fn eq(&self, other: &Self) -> bool {
        self.get() == other.get()
    }
}

impl Eq for Bool {}

impl PartialEq<bool> for Bool {
    fn eq(&self, other: &bool) -> bool {
        self.get() == *other
    }
}

impl fmt::Debug for Bool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.get().fmt(f)
    }
}

/// A Rust type that a field of a message can have.
///
/// For [`crate::topic!`]: numbers, [`Bool`], messages, and arrays of these.
pub trait FieldKind {
    /// What one element is.
    const TYPE: FieldType;
    /// The number of elements, for an array.
    const ARRAY_LENGTH: Option<u32> = None;
}

macro_rules! scalar_kinds {
    ($($rust:ty => $kind:ident,)*) => {
        $(impl FieldKind for $rust { const TYPE: FieldType = FieldType::$kind; })*
    };
}

scalar_kinds! {
    i8 => Int8, i16 => Int16, i32 => Int32, i64 => Int64,
    u8 => Uint8, u16 => Uint16, u32 => Uint32, u64 => Uint64,
    f32 => Float32, f64 => Float64, Bool => Bool,
}

impl<M: Message> FieldKind for M {
    const TYPE: FieldType = FieldType::Message(Cow::Borrowed(M::LAYOUT));
}

impl<K: FieldKind, const N: usize> FieldKind for [K; N] {
    const TYPE: FieldType = match K::ARRAY_LENGTH {
        None => K::TYPE,
        Some(_) => panic!("a message's arrays have one dimension"),
    };
    const ARRAY_LENGTH: Option<u32> = Some(N as u32);
}

/// A field's name, given as `stringify!` spells it. What Rust has to write as
/// `r#type` is `type` to every other program.
#[doc(hidden)]
pub const fn field_name(spelled: &'static str) -> &'static str {
    match spelled.as_bytes() {
        [b'r', b'#', ..] => spelled.split_at(2).1,
        _ => spelled,
    }
}

/// Defines a topic in code, without a .msg file: exactly the struct's bytes,
/// no timestamp added, as C's `ORB_DEFINE` with a struct.
///
/// ```
/// uorb_core::topic! {
///     /// One random number.
///     pub struct RandomInteger = "random_integer" {
///         pub r: i32,
///     }
/// }
/// ```
///
/// Several topics of one struct are named after it:
///
/// ```
/// uorb_core::topic! {
///     /// What is published on all color topics.
///     pub struct ColorUpdate {
///         pub number: i32,
///     }
///     pub topic ColorRed = "color_red";
///     pub topic ColorGreen = "color_green";
/// }
/// ```
///
/// The struct is `repr(C)`, and zerocopy refuses one with padding between or
/// behind its fields, so this does not compile:
///
/// ```compile_fail
/// uorb_core::topic! {
///     /// Three bytes before `large` belong to no field.
///     pub struct Gap = "gap" { pub small: u8, pub large: u32 }
/// }
/// ```
///
/// Name the padding as a field of its own:
///
/// ```
/// uorb_core::topic! {
///     /// Every byte belongs to a field.
///     pub struct NoGap = "no_gap" { pub small: u8, pub _padding0: [u8; 3], pub large: u32 }
/// }
/// ```
///
/// A topic is named as [`is_topic_name`] says; no other name compiles:
///
/// ```compile_fail,E0080
/// uorb_core::topic! {
///     /// A blank cannot be part of a file's name here.
///     pub struct Blank = "left wheel" { pub rpm: i32 }
/// }
/// ```
#[macro_export]
macro_rules! topic {
    (
        $(#[$attribute:meta])*
        $vis:vis struct $Message:ident = $name:literal { $($fields:tt)* }
    ) => {
        $crate::topic!(@message $name; $(#[$attribute])* $vis struct $Message { $($fields)* });
        $crate::topic!(@topic $Message, $Message, $name);
    };
    (
        $(#[$attribute:meta])*
        $vis:vis struct $Message:ident { $($fields:tt)* }
        $($(#[$topic_attribute:meta])* $topic_vis:vis topic $Topic:ident = $name:literal;)+
    ) => {
        $crate::topic!(
            @message stringify!($Message); $(#[$attribute])* $vis struct $Message { $($fields)* }
        );
        $(
            $(#[$topic_attribute])*
            #[derive(Debug)]
            $topic_vis enum $Topic {}
            $crate::topic!(@topic $Topic, $Message, $name);
        )+
    };
    (
        @message $message_name:expr;
        $(#[$attribute:meta])*
        $vis:vis struct $Message:ident {
            $($(#[$field_attribute:meta])* $field_vis:vis $field:ident: $ty:ty),* $(,)?
        }
    ) => {
        $(#[$attribute])*
        #[derive(
            Clone, Copy, Debug, PartialEq,
            $crate::zerocopy::FromBytes, $crate::zerocopy::IntoBytes,
            $crate::zerocopy::Immutable,
        )]
        #[zerocopy(crate = "uorb_core::zerocopy")]
        #[repr(C)]
        $vis struct $Message {
            $($(#[$field_attribute])* $field_vis $field: $ty,)*
        }

        impl Default for $Message {
            fn default() -> Self {
                $crate::zerocopy::FromZeros::new_zeroed()
            }
        }

        impl $crate::Message for $Message {
            const LAYOUT: &'static $crate::Layout = {
                const FIELDS: &[$crate::Field] = &[$($crate::Field {
                    name: ::std::borrow::Cow::Borrowed($crate::field_name(stringify!($field))),
                    ty: <$ty as $crate::FieldKind>::TYPE,
                    array_length: <$ty as $crate::FieldKind>::ARRAY_LENGTH,
                    offset_bytes: ::std::mem::offset_of!($Message, $field) as u32,
                    unit: ::std::borrow::Cow::Borrowed(""),
                }),*];
                &$crate::Layout {
                    name: ::std::borrow::Cow::Borrowed($message_name),
                    size_bytes: ::std::mem::size_of::<$Message>() as u32,
                    message_hash: $crate::message_hash(FIELDS),
                    fields: ::std::borrow::Cow::Borrowed(FIELDS),
                }
            };
        }
    };
    (@topic $Topic:ident, $Message:ident, $name:literal) => {
        const _: () =
            assert!($crate::is_topic_name($name), concat!("no name for a topic: ", $name));

        impl $crate::Topic for $Topic {
            type Message = $Message;
            const METADATA: &'static $crate::Metadata = &$crate::Metadata {
                name: ::std::borrow::Cow::Borrowed($name),
                layout: ::std::borrow::Cow::Borrowed(<$Message as $crate::Message>::LAYOUT),
                queue_length: $crate::QueueLength::ONE,
            };
        }
    };
}
