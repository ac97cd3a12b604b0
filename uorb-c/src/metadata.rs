//! A topic as C describes it, in words of the library.
//!
//! The message compiler writes an `orb_layout`: the fields as the .msg has them.
//! Where there is none, the fields are read from `o_fields`, which PX4's own
//! generator writes too; where there are none either, or a message is nested of
//! which `o_fields` tells but the name, the size is all that is known.

use std::borrow::Cow;
use std::ffi::{CStr, c_char};

use uorb_core::{Field, FieldType, Layout, Metadata, QueueLength};

/// `struct orb_metadata` of uORB.h.
#[repr(C)]
#[derive(Debug)]
pub(crate) struct OrbMetadata {
    o_name: *const c_char,
    o_size: u16,
    o_size_no_padding: u16,
    o_fields: *const c_char,
    message_hash: u32,
    o_id: u16,
    o_queue: u8,
    o_layout: *const OrbLayout,
}

/// `struct orb_layout` of uORB.h.
#[repr(C)]
#[derive(Debug)]
struct OrbLayout {
    name: *const c_char,
    message_hash: u32,
    size: u16,
    field_count: u16,
    fields: *const OrbField,
}

/// `struct orb_field` of uORB.h.
#[repr(C)]
#[derive(Debug)]
struct OrbField {
    name: *const c_char,
    ty: *const c_char,
    array_length: u16,
    offset: u16,
    unit: *const c_char,
    nested: *const OrbLayout,
}

// SAFETY: a constant of the program, as all that it points to: nobody writes it.
unsafe impl Sync for OrbMetadata {}

impl OrbMetadata {
    /// The metadata that C points to.
    ///
    /// # Safety
    ///
    /// The pointer is NULL or `ORB_ID` of a topic: a constant of the program.
    pub(crate) unsafe fn from_c(meta: *const Self) -> Option<&'static Self> {
        // SAFETY: the caller's word; a constant is never written, and there as
        // long as the program.
        unsafe { meta.as_ref() }
    }

    pub(crate) fn name(&self) -> Cow<'static, str> {
        text(self.o_name)
    }

    /// The bytes of a message.
    pub(crate) fn size_bytes(&self) -> usize {
        usize::from(self.o_size)
    }

    /// Whether it is subscribed only where somebody else has described it.
    pub(crate) fn is_optional(&self) -> bool {
        self.o_queue == 0
    }

    /// Whether both mean the same topic. Two libraries of one program may each
    /// have metadata of it.
    pub(crate) fn is_same_topic(&self, other: &Self) -> bool {
        std::ptr::eq(self, other)
            || (self.o_size == other.o_size && text(self.o_name) == text(other.o_name))
    }

    /// The topic, in words of the library.
    pub(crate) fn describe(&self) -> Metadata {
        // SAFETY: NULL or a constant of the program.
        let layout = match unsafe { self.o_layout.as_ref() } {
            Some(layout) => layout.describe(),
            None => self.layout_of_fields(),
        };
        Metadata {
            name: self.name(),
            layout: Cow::Owned(layout),
            queue_length: QueueLength::at_least(u32::from(self.o_queue)),
        }
    }

    fn layout_of_fields(&self) -> Layout {
        let fields = parse_fields(&text(self.o_fields), u32::from(self.o_size));
        Layout {
            name: self.name(),
            size_bytes: u32::from(self.o_size),
            message_hash: self.message_hash,
            fields: fields.unwrap_or_default().into(),
        }
    }
}

impl OrbLayout {
    fn describe(&self) -> Layout {
        let count = usize::from(self.field_count);
        // SAFETY: a constant of the program, which the message compiler wrote:
        // so many fields are there.
        let fields = unsafe { std::slice::from_raw_parts(self.fields, count) };
        Layout {
            name: text(self.name),
            size_bytes: u32::from(self.size),
            message_hash: self.message_hash,
            fields: fields.iter().map(OrbField::describe).collect::<Vec<_>>().into(),
        }
    }
}

impl OrbField {
    fn describe(&self) -> Field {
        // SAFETY: NULL or a constant of the program.
        let ty = match unsafe { self.nested.as_ref() } {
            Some(nested) => FieldType::Message(Cow::Owned(nested.describe())),
            // What the message compiler writes is one of them.
            None => FieldType::from_c_name(&text(self.ty)).unwrap_or(FieldType::Uint8),
        };
        Field {
            name: text(self.name),
            ty,
            array_length: (self.array_length > 0).then_some(u32::from(self.array_length)),
            offset_bytes: u32::from(self.offset),
            unit: text(self.unit),
        }
    }
}

/// A constant string of the program; empty for NULL.
fn text(string: *const c_char) -> Cow<'static, str> {
    if string.is_null() {
        return Cow::Borrowed("");
    }
    // SAFETY: a string constant of the program.
    unsafe { CStr::from_ptr(string) }.to_string_lossy()
}

/// The fields that "float[3] xyz;uint8_t[4] _padding0;" names, each where the
/// one before it ends. None where a type is not a scalar, or where the sum is
/// not the message's size.
fn parse_fields(text: &str, size_bytes: u32) -> Option<Vec<Field>> {
    let mut fields = Vec::new();
    let mut end_bytes = 0_u64;
    for declaration in text.split(';').map(str::trim).filter(|declaration| !declaration.is_empty())
    {
        let (ty, name) = declaration.split_once(' ')?;
        let (element, array_length) = match ty.split_once('[') {
            Some((element, length)) => (element, Some(length.strip_suffix(']')?.parse().ok()?)),
            None => (ty, None),
        };
        let field = Field {
            name: Cow::Owned(name.to_string()),
            ty: FieldType::from_c_name(element)?,
            array_length,
            offset_bytes: u32::try_from(end_bytes).ok()?,
            unit: Cow::Borrowed(""),
        };
        end_bytes = field.end_bytes();
        if !name.starts_with("_padding") {
            fields.push(field);
        }
    }
    (end_bytes == u64::from(size_bytes)).then_some(fields)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_lie_where_those_before_them_end() {
        let text =
            "uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;uint8_t[4] _padding0;";
        let fields = parse_fields(text, 32).unwrap();
        let found: Vec<_> = fields
            .iter()
            .map(|field| (&*field.name, field.offset_bytes, field.array_length))
            .collect();
        assert_eq!(
            found,
            [("timestamp", 0, None), ("timestamp_sample", 8, None), ("xyz", 16, Some(3))]
        );
    }

    #[test]
    fn what_is_not_known_whole_is_not_known() {
        assert!(parse_fields("uint64_t timestamp;esc_report[8] esc;", 300).is_none(), "nested");
        assert!(parse_fields("uint64_t timestamp;", 16).is_none(), "too short");
        for odd in ["float", "float[x] a;", "float[3 a;", "float[4294967295] a;float[9] b;"] {
            assert!(parse_fields(odd, 12).is_none(), "{odd}");
        }
        assert!(parse_fields("", 0).unwrap().is_empty());
    }
}
