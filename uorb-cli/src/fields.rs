//! Any message, from its layout: printed field by field, and written so.
//!
//! Nothing here knows a message type. A [`Layout`] says where the fields are,
//! and a [`Part`] is one of them with its bytes: a scalar, an array, or a
//! nested message that has parts itself. All of it is pure: layouts and bytes
//! in, text or bytes out.
//!
//! Layout and bytes come from other processes. Every slice is checked, and a
//! field that lies outside its message is left out; [`Layout::check`] has said
//! that there is none.

pub(crate) mod assign;
pub(crate) mod csv;
pub(crate) mod json;
pub(crate) mod path;
mod quote;
#[cfg(test)]
pub(crate) mod samples;
pub(crate) mod text;

use std::ops::Range;

use uorb_core::{Field, FieldType, Layout};

/// A field, an element of one, or what a path leads to: its type and its bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Part<'m> {
    pub(crate) ty: &'m FieldType,
    /// Some: an array of so many, and the bytes are those of all elements.
    pub(crate) array_length: Option<u32>,
    pub(crate) bytes: &'m [u8],
}

/// What a part is made of.
#[derive(Debug)]
pub(crate) enum Content<'m> {
    Scalar(Scalar),
    /// A char array, up to its first NUL.
    Text(&'m [u8]),
    /// An array of scalars.
    Scalars(Vec<Scalar>),
    Message(&'m Layout),
    /// An array of messages.
    Messages,
}

/// One number, truth value or character.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Scalar {
    Int(i64),
    Uint(u64),
    Float32(f32),
    Float64(f64),
    Bool(bool),
    Char(u8),
}

/// The fields of a message, in the order of the .msg text.
pub(crate) fn fields<'m>(
    layout: &'m Layout,
    bytes: &'m [u8],
) -> impl Iterator<Item = (&'m Field, Part<'m>)> {
    layout.fields.iter().filter_map(move |field| {
        let bytes = bytes.get(bytes_of(field)?)?;
        Some((field, Part { ty: &field.ty, array_length: field.array_length, bytes }))
    })
}

/// Where a field's bytes are, in its message.
fn bytes_of(field: &Field) -> Option<Range<usize>> {
    let end = usize::try_from(field.end_bytes()).ok()?;
    Some(field.offset_bytes as usize..end)
}

impl<'m> Part<'m> {
    /// What it is made of; None where its bytes are too few.
    pub(crate) fn content(self) -> Option<Content<'m>> {
        Some(match (self.ty, self.array_length) {
            (FieldType::Message(layout), None) => Content::Message(layout),
            (FieldType::Message(_), Some(_)) => Content::Messages,
            (FieldType::Char, Some(_)) => {
                let end = self.bytes.iter().position(|byte| *byte == 0);
                Content::Text(&self.bytes[..end.unwrap_or(self.bytes.len())])
            }
            (ty, None) => Content::Scalar(Scalar::read(ty, self.bytes)?),
            (ty, Some(_)) => {
                let scalars = self.elements().map(|part| Scalar::read(ty, part.bytes));
                Content::Scalars(scalars.collect::<Option<_>>()?)
            }
        })
    }

    /// The elements of an array.
    pub(crate) fn elements(self) -> impl Iterator<Item = Part<'m>> {
        // A message of no bytes is refused where layouts are checked; here it
        // only must not be a panic.
        let size_bytes = self.ty.size_bytes().max(1) as usize;
        let Self { ty, bytes, .. } = self;
        bytes.chunks_exact(size_bytes).map(move |bytes| Part { ty, array_length: None, bytes })
    }
}

impl Scalar {
    /// The scalar of this type that the bytes begin with.
    pub(crate) fn read(ty: &FieldType, bytes: &[u8]) -> Option<Self> {
        fn first<const N: usize>(bytes: &[u8]) -> Option<[u8; N]> {
            bytes.first_chunk().copied()
        }
        Some(match ty {
            FieldType::Int8 => Self::Int(i8::from_ne_bytes(first(bytes)?).into()),
            FieldType::Int16 => Self::Int(i16::from_ne_bytes(first(bytes)?).into()),
            FieldType::Int32 => Self::Int(i32::from_ne_bytes(first(bytes)?).into()),
            FieldType::Int64 => Self::Int(i64::from_ne_bytes(first(bytes)?)),
            FieldType::Uint8 => Self::Uint(u8::from_ne_bytes(first(bytes)?).into()),
            FieldType::Uint16 => Self::Uint(u16::from_ne_bytes(first(bytes)?).into()),
            FieldType::Uint32 => Self::Uint(u32::from_ne_bytes(first(bytes)?).into()),
            FieldType::Uint64 => Self::Uint(u64::from_ne_bytes(first(bytes)?)),
            FieldType::Float32 => Self::Float32(f32::from_ne_bytes(first(bytes)?)),
            FieldType::Float64 => Self::Float64(f64::from_ne_bytes(first(bytes)?)),
            FieldType::Bool => Self::Bool(*bytes.first()? != 0),
            FieldType::Char => Self::Char(*bytes.first()?),
            FieldType::Message(_) => return None,
        })
    }
}
