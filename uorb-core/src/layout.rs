//! What a message is made of, so that a program can read one it never saw.
//!
//! A [`Layout`] lists the fields of a message with their offsets, nested
//! messages included. The message compiler writes it as a constant, a flight
//! log's format is turned into one, and the broker keeps it in the node file,
//! so that `listener` prints any topic and a process that was built from
//! another .msg text is told so instead of reading the wrong bytes.
//!
//! Fields stand in the order of the .msg text; padding is not listed, it is
//! what lies between the fields. Where a layout comes from another process it
//! is an allegation until [`Layout::check`] has passed.

use std::borrow::Cow;
use std::cell::Cell;
use std::fmt;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

use crate::message_hash::text;

/// The bytes of the largest message that a node keeps, PX4's limit: `o_size` is
/// 16 bits wide (uORB.h). A topic of larger ones is a large topic: its messages
/// are on its stream, and its nodes keep what there is to know of them.
pub const NODE_MESSAGE_MAX_BYTES: u32 = 65_535;

/// The bytes of the largest message of all: 256 MiB.
pub const MESSAGE_SIZE_MAX_BYTES: u32 = 256 << 20;

/// How deep messages may nest. PX4's deepest is 2; the rest is room.
pub(crate) const NESTING_MAX: usize = 8;

/// The most scalar fields and arrays a message may flatten to.
pub(crate) const FLAT_FIELDS_MAX: usize = 8_192;

/// The fields of one message, its size and its hash.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Layout {
    /// The message's name in snake case: `sensor_accel`.
    pub name: Cow<'static, str>,
    /// The bytes of a message with all its padding (PX4's `o_size`).
    pub size_bytes: u32,
    /// PX4's message hash; 0 where the .msg text is not known, as in a log.
    pub message_hash: u32,
    /// The fields in the order of the .msg text. Empty: untyped, the size is
    /// all that is known (C's two-argument `ORB_DEFINE`).
    pub fields: Cow<'static, [Field]>,
}

/// One field of a message.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Field {
    /// The field's name.
    pub name: Cow<'static, str>,
    /// What one element is.
    pub ty: FieldType,
    /// The number of elements, where the field is an array.
    pub array_length: Option<u32>,
    /// Where the field starts, in bytes from the start of its message.
    pub offset_bytes: u32,
    /// The unit in words of the .msg comment: `m/s^2`. Empty: none given.
    pub unit: Cow<'static, str>,
}

/// The type of a field: one of the twelve scalars of the .msg language, or
/// another message.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub enum FieldType {
    Int8,
    Int16,
    Int32,
    Int64,
    Uint8,
    Uint16,
    Uint32,
    Uint64,
    Float32,
    Float64,
    Bool,
    Char,
    Message(#[serde(deserialize_with = "nested_layout")] Cow<'static, Layout>),
}

/// A layout within a layout, to the depth that [`Layout::check`] allows: what
/// another process has packed deeper would overflow the stack first.
fn nested_layout<'de, D: Deserializer<'de>>(source: D) -> Result<Cow<'static, Layout>, D::Error> {
    thread_local!(static DEPTH: Cell<usize> = const { Cell::new(0) });
    let depth = DEPTH.get();
    if depth >= NESTING_MAX {
        return Err(D::Error::custom("messages nest too deep"));
    }
    DEPTH.set(depth + 1);
    let layout = Layout::deserialize(source);
    DEPTH.set(depth);
    layout.map(Cow::Owned)
}

impl FieldType {
    /// The scalar of this name in C, as `o_fields` and ULog write it.
    pub fn from_c_name(name: &str) -> Option<Self> {
        Some(match name {
            "int8_t" => Self::Int8,
            "int16_t" => Self::Int16,
            "int32_t" => Self::Int32,
            "int64_t" => Self::Int64,
            "uint8_t" => Self::Uint8,
            "uint16_t" => Self::Uint16,
            "uint32_t" => Self::Uint32,
            "uint64_t" => Self::Uint64,
            "float" => Self::Float32,
            "double" => Self::Float64,
            "bool" => Self::Bool,
            "char" => Self::Char,
            _ => return None,
        })
    }

    /// The type's name as `o_fields` and ULog write it: `float`, `esc_report`.
    pub const fn c_name(&self) -> &str {
        match self {
            Self::Int8 => "int8_t",
            Self::Int16 => "int16_t",
            Self::Int32 => "int32_t",
            Self::Int64 => "int64_t",
            Self::Uint8 => "uint8_t",
            Self::Uint16 => "uint16_t",
            Self::Uint32 => "uint32_t",
            Self::Uint64 => "uint64_t",
            Self::Float32 => "float",
            Self::Float64 => "double",
            Self::Bool => "bool",
            Self::Char => "char",
            Self::Message(Cow::Borrowed(layout)) => text(&layout.name),
            Self::Message(Cow::Owned(layout)) => text(&layout.name),
        }
    }

    /// The type's name in the .msg language: `float32`, `esc_report`.
    pub const fn msg_name(&self) -> &str {
        match self {
            Self::Int8 => "int8",
            Self::Int16 => "int16",
            Self::Int32 => "int32",
            Self::Int64 => "int64",
            Self::Uint8 => "uint8",
            Self::Uint16 => "uint16",
            Self::Uint32 => "uint32",
            Self::Uint64 => "uint64",
            Self::Float32 => "float32",
            Self::Float64 => "float64",
            other => other.c_name(),
        }
    }

    /// The bytes of one element.
    pub fn size_bytes(&self) -> u32 {
        match self {
            Self::Int8 | Self::Uint8 | Self::Bool | Self::Char => 1,
            Self::Int16 | Self::Uint16 => 2,
            Self::Int32 | Self::Uint32 | Self::Float32 => 4,
            Self::Int64 | Self::Uint64 | Self::Float64 => 8,
            Self::Message(layout) => layout.size_bytes,
        }
    }
}

impl Field {
    /// The bytes of the whole field, all elements of an array together.
    pub fn size_bytes(&self) -> u64 {
        u64::from(self.ty.size_bytes()) * u64::from(self.array_length.unwrap_or(1))
    }

    /// The byte after the field's last one.
    pub fn end_bytes(&self) -> u64 {
        u64::from(self.offset_bytes) + self.size_bytes()
    }

    /// The field's type as `o_fields` writes it: `float[3]`.
    pub fn c_type(&self) -> String {
        with_length(self.ty.c_name(), self.array_length)
    }

    /// The field's type as the .msg text writes it: `float32[3]`.
    pub fn msg_type(&self) -> String {
        with_length(self.ty.msg_name(), self.array_length)
    }
}

fn with_length(name: &str, array_length: Option<u32>) -> String {
    match array_length {
        Some(length) => format!("{name}[{length}]"),
        None => name.to_string(),
    }
}

/// A scalar, or an array of scalars, with the path that leads to it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlatField {
    /// The path from the message down: `esc[0].esc_rpm`.
    pub path: String,
    /// The element's type, never a message.
    pub ty: FieldType,
    /// The number of elements, where it is an array.
    pub array_length: Option<u32>,
    /// Where it starts, in bytes from the start of the outermost message.
    pub offset_bytes: u32,
}

impl Layout {
    /// A layout of which only the size is known.
    pub fn untyped(name: impl Into<Cow<'static, str>>, size_bytes: u32) -> Self {
        Self { name: name.into(), size_bytes, message_hash: 0, fields: Cow::Borrowed(&[]) }
    }

    /// Whether only the size is known.
    pub fn is_untyped(&self) -> bool {
        self.fields.is_empty()
    }

    /// Whether messages are too large for a node and live on the stream.
    #[inline]
    pub const fn is_large(&self) -> bool {
        self.size_bytes > NODE_MESSAGE_MAX_BYTES
    }

    /// The fields in the order in which they lie in memory.
    pub fn fields_in_memory_order(&self) -> Vec<&Field> {
        let mut fields: Vec<&Field> = self.fields.iter().collect();
        fields.sort_by_key(|field| field.offset_bytes);
        fields
    }

    /// The bytes of a message without the padding at its end: what a logger
    /// writes (PX4's `o_size_no_padding`).
    pub fn size_no_padding_bytes(&self) -> u32 {
        let end = self.fields.iter().map(Field::end_bytes).max();
        end.and_then(|end| u32::try_from(end).ok()).unwrap_or(self.size_bytes)
    }

    /// The field list as PX4's `o_fields` and ULog write it: C types in memory
    /// order, padding as `_padding0`, each entry ending in `;`.
    pub fn o_fields(&self) -> String {
        use fmt::Write;
        let mut text = String::new();
        let mut end = 0;
        let mut paddings = 0;
        let mut pad = |text: &mut String, from: u64, to: u64| {
            if to > from {
                let _ = write!(text, "uint8_t[{}] _padding{paddings};", to - from);
                paddings += 1;
            }
        };
        for field in self.fields_in_memory_order() {
            pad(&mut text, end, u64::from(field.offset_bytes));
            let _ = write!(text, "{} {};", field.c_type(), field.name);
            end = field.end_bytes();
        }
        if !self.is_untyped() {
            pad(&mut text, end, u64::from(self.size_bytes));
        }
        text
    }

    /// The messages that it contains, at any depth, each once.
    pub fn nested(&self) -> Vec<&Layout> {
        let mut all: Vec<&Layout> = Vec::new();
        for field in self.fields.iter() {
            let FieldType::Message(nested) = &field.ty else { continue };
            for layout in std::iter::once(&**nested).chain(nested.nested()) {
                if !all.iter().any(|known| known.name == layout.name) {
                    all.push(layout);
                }
            }
        }
        all
    }

    /// All scalars and arrays of scalars in memory order, those of nested
    /// messages included.
    pub fn flatten(&self) -> Vec<FlatField> {
        let mut flat = Vec::new();
        self.flatten_into("", 0, &mut flat);
        flat
    }

    fn flatten_into(&self, prefix: &str, base_bytes: u32, flat: &mut Vec<FlatField>) {
        for field in self.fields_in_memory_order() {
            let path = format!("{prefix}{}", field.name);
            let offset_bytes = base_bytes + field.offset_bytes;
            let FieldType::Message(nested) = &field.ty else {
                let (ty, array_length) = (field.ty.clone(), field.array_length);
                flat.push(FlatField { path, ty, array_length, offset_bytes });
                continue;
            };
            match field.array_length {
                None => nested.flatten_into(&format!("{path}."), offset_bytes, flat),
                Some(length) => {
                    for index in 0..length {
                        let offset_bytes = offset_bytes + index * nested.size_bytes;
                        nested.flatten_into(&format!("{path}[{index}]."), offset_bytes, flat);
                    }
                }
            }
        }
    }

    /// Whether messages of the two layouts are the same bytes with the same
    /// meaning: sizes and flattened field lists are equal. Equal hashes are the
    /// shortcut; where one side has no field list the size decides.
    pub fn matches(&self, other: &Self) -> bool {
        if self.size_bytes != other.size_bytes {
            return false;
        }
        let same_hash = self.message_hash != 0 && self.message_hash == other.message_hash;
        same_hash || self.is_untyped() || other.is_untyped() || self.flatten() == other.flatten()
    }

    /// Checks what another process, or a file, says a message looks like:
    /// every field lies inside its message, nothing nests or repeats without
    /// bound, and no two fields share a name.
    pub fn check(&self) -> Result<(), LayoutFault> {
        if self.size_bytes == 0 || self.size_bytes > MESSAGE_SIZE_MAX_BYTES {
            let (name, size_bytes) = (self.name.to_string(), self.size_bytes);
            let limit_bytes = MESSAGE_SIZE_MAX_BYTES;
            return Err(LayoutFault::Size { name, size_bytes, limit_bytes });
        }
        let mut budget = FLAT_FIELDS_MAX;
        self.check_level(1, 1, &mut budget)
    }

    fn check_level(
        &self,
        depth: usize,
        copies: usize,
        budget: &mut usize,
    ) -> Result<(), LayoutFault> {
        let fault = |field: &Field| LayoutFault::Field {
            message: self.name.to_string(),
            field: field.name.to_string(),
        };
        let mut end = 0;
        for field in self.fields_in_memory_order() {
            let named = !field.name.is_empty();
            let sized = field.array_length != Some(0) && field.ty.size_bytes() > 0;
            let inside = u64::from(field.offset_bytes) >= end
                && field.end_bytes() <= u64::from(self.size_bytes);
            if !named || !sized || !inside {
                return Err(fault(field));
            }
            end = field.end_bytes();
            let too_many = || LayoutFault::TooMany { message: self.name.to_string() };
            match &field.ty {
                FieldType::Message(nested) => {
                    if depth == NESTING_MAX || nested.is_untyped() {
                        return Err(fault(field));
                    }
                    let length = field.array_length.unwrap_or(1) as usize;
                    let copies = copies.checked_mul(length).ok_or_else(too_many)?;
                    nested.check_level(depth + 1, copies, budget)?;
                }
                _ => *budget = budget.checked_sub(copies).ok_or_else(too_many)?,
            }
        }
        let mut names: Vec<&str> = self.fields.iter().map(|field| &*field.name).collect();
        names.sort_unstable();
        match names.windows(2).find(|pair| pair[0] == pair[1]) {
            Some(pair) => Err(LayoutFault::Field {
                message: self.name.to_string(),
                field: pair[0].to_string(),
            }),
            None => Ok(()),
        }
    }
}

/// What is wrong with a layout that another process or a file gave.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum LayoutFault {
    /// The message is empty or too large.
    #[error("message {name} has {size_bytes} bytes; it may have 1 to {limit_bytes}")]
    Size {
        /// The message's name.
        name: String,
        /// The size it claims, in bytes.
        size_bytes: u32,
        /// The size it may have, in bytes.
        limit_bytes: u32,
    },
    /// A field lies outside its message, overlaps another, nests too deep, or
    /// shares its name with another.
    #[error("field {field:?} of message {message} overlaps, repeats, or lies outside the message")]
    Field {
        /// The message's name.
        message: String,
        /// The field's name.
        field: String,
    },
    /// Nested arrays multiply to more fields than anyone could print.
    #[error("message {message} has more than {FLAT_FIELDS_MAX} fields, nested ones counted")]
    TooMany {
        /// The message's name.
        message: String,
    },
}

#[cfg(test)]
mod tests;
