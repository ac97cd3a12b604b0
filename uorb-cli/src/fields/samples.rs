//! A message with a field of every type, for the tests.

use std::borrow::Cow;

use uorb_core::{Field, FieldType, Layout, message_hash};

fn layout(name: &'static str, fields: Vec<(&'static str, FieldType, Option<u32>)>) -> Layout {
    let mut offset_bytes = 0;
    let mut listed = Vec::new();
    for (name, ty, array_length) in fields {
        let field =
            Field { name: name.into(), ty, array_length, offset_bytes, unit: Cow::Borrowed("") };
        offset_bytes += field.size_bytes() as u32;
        listed.push(field);
    }
    let message_hash = message_hash(&listed);
    let layout =
        Layout { name: name.into(), size_bytes: offset_bytes, message_hash, fields: listed.into() };
    layout.check().unwrap();
    layout
}

pub(crate) fn vehicle_acceleration() -> Layout {
    let mut layout = layout(
        "vehicle_acceleration",
        vec![
            ("timestamp", FieldType::Uint64, None),
            ("timestamp_sample", FieldType::Uint64, None),
            ("xyz", FieldType::Float32, Some(3)),
        ],
    );
    layout.size_bytes = 32;
    layout
}

/// A layout with every type, and a message of it with telling values.
pub(crate) fn one_of_each() -> (Layout, Vec<u8>) {
    let point = layout("point", vec![("x", FieldType::Int32, None), ("y", FieldType::Uint8, None)]);
    let nested = FieldType::Message(Cow::Owned(point));
    let layout = layout(
        "one_of_each",
        vec![
            ("timestamp", FieldType::Uint64, None),
            ("i64", FieldType::Int64, None),
            ("f64", FieldType::Float64, None),
            ("f32", FieldType::Float32, None),
            ("u32", FieldType::Uint32, None),
            ("i32", FieldType::Int32, None),
            ("u16", FieldType::Uint16, None),
            ("i16", FieldType::Int16, None),
            ("u8", FieldType::Uint8, None),
            ("i8", FieldType::Int8, None),
            ("flag", FieldType::Bool, None),
            ("letter", FieldType::Char, None),
            ("q", FieldType::Float32, Some(4)),
            ("flags", FieldType::Bool, Some(2)),
            ("name", FieldType::Char, Some(8)),
            ("point", nested.clone(), None),
            ("points", nested, Some(2)),
        ],
    );
    let mut message = Vec::new();
    message.extend(u64::MAX.to_ne_bytes());
    message.extend(i64::MIN.to_ne_bytes());
    message.extend((1.0_f64 / 3.0).to_ne_bytes());
    message.extend((-0.123456_f32).to_ne_bytes());
    message.extend(u32::MAX.to_ne_bytes());
    message.extend(i32::MIN.to_ne_bytes());
    message.extend(u16::MAX.to_ne_bytes());
    message.extend(i16::MIN.to_ne_bytes());
    message.extend([u8::MAX, i8::MIN as u8, 2, b'A']);
    for value in [1.0, 0.0, f32::NAN, f32::NEG_INFINITY] {
        message.extend(value.to_ne_bytes());
    }
    message.extend([1, 0]);
    message.extend(b"a \"b\"\0zz");
    for (x, y) in [(1_i32, 2_u8), (3, 4), (5, 6)] {
        message.extend(x.to_ne_bytes());
        message.push(y);
    }
    assert_eq!(message.len(), layout.size_bytes as usize);
    (layout, message)
}
