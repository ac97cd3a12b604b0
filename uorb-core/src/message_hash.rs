//! PX4's message hash, of field lists that may be constants.

use std::borrow::Cow;

use crate::layout::{Field, FieldType};

/// PX4's message hash: FNV-1a, 32 bits, over one line a field, `float32[3] xyz`,
/// in the order of the .msg text, a nested message's line followed by its own.
/// Constants, comments and `# TOPICS` lines do not count.
pub const fn message_hash(fields: &[Field]) -> u32 {
    hash_fields(0x811c_9dc5, fields)
}

const fn hash_fields(mut hash: u32, fields: &[Field]) -> u32 {
    let mut index = 0;
    while index < fields.len() {
        let field = &fields[index];
        hash = hash_text(hash, field.ty.msg_name());
        if let Some(length) = field.array_length {
            hash = hash_byte(hash_number(hash_byte(hash, b'['), length), b']');
        }
        hash = hash_byte(hash_text(hash_byte(hash, b' '), text(&field.name)), b'\n');
        if let FieldType::Message(nested) = &field.ty {
            hash = match nested {
                Cow::Borrowed(nested) => hash_fields(hash, slice(&nested.fields)),
                Cow::Owned(nested) => hash_fields(hash, slice(&nested.fields)),
            };
        }
        index += 1;
    }
    hash
}

const fn hash_byte(hash: u32, byte: u8) -> u32 {
    (hash ^ byte as u32).wrapping_mul(0x0100_0193)
}

const fn hash_text(mut hash: u32, text: &str) -> u32 {
    let bytes = text.as_bytes();
    let mut index = 0;
    while index < bytes.len() {
        hash = hash_byte(hash, bytes[index]);
        index += 1;
    }
    hash
}

const fn hash_number(hash: u32, number: u32) -> u32 {
    let higher = if number >= 10 { hash_number(hash, number / 10) } else { hash };
    hash_byte(higher, b'0' + (number % 10) as u8)
}

// `Deref` is not const, so the constants of code-defined topics look inside.
// That is why these take the `Cow` itself.

#[allow(clippy::ptr_arg)]
pub(crate) const fn text<'a>(cow: &'a Cow<'static, str>) -> &'a str {
    match cow {
        Cow::Borrowed(text) => text,
        Cow::Owned(text) => text.as_str(),
    }
}

#[allow(clippy::ptr_arg)]
const fn slice<'a>(cow: &'a Cow<'static, [Field]>) -> &'a [Field] {
    match cow {
        Cow::Borrowed(fields) => fields,
        Cow::Owned(fields) => fields.as_slice(),
    }
}
