//! Messages as a table with a column for every number, named as pyulog names
//! them: `q[0]`, `esc[0].esc_rpm`.
//!
//! A char array is one column. Truth values are 1 and 0, as ulog2csv writes
//! them; a float has the shortest form that reads back the same, `nan` and
//! `inf` among them.

use uorb_core::{FieldType, Layout};

use super::path::Place;
use super::{Content, Part, Scalar, fields, json};

/// The names of the columns that these places take.
pub(crate) fn columns(places: &[Place<'_>]) -> Vec<String> {
    let mut columns = Vec::new();
    for place in places {
        push_columns(&mut columns, &place.path, place.ty, place.array_length);
    }
    columns
}

fn push_columns(columns: &mut Vec<String>, path: &str, ty: &FieldType, length: Option<u32>) {
    match (ty, length) {
        (FieldType::Char, Some(_)) => columns.push(path.to_string()),
        (_, Some(length)) => {
            for index in 0..length {
                push_columns(columns, &format!("{path}[{index}]"), ty, None);
            }
        }
        (FieldType::Message(layout), None) => push_fields(columns, path, layout),
        (_, None) => columns.push(path.to_string()),
    }
}

fn push_fields(columns: &mut Vec<String>, path: &str, layout: &Layout) {
    for field in layout.fields.iter() {
        push_columns(columns, &format!("{path}.{}", field.name), &field.ty, field.array_length);
    }
}

/// What a message has in these columns.
pub(crate) fn row(places: &[Place<'_>], message: &[u8]) -> Vec<String> {
    let mut row = Vec::new();
    for part in places.iter().filter_map(|place| place.part(message)) {
        push_cells(&mut row, part);
    }
    row
}

fn push_cells(row: &mut Vec<String>, part: Part<'_>) {
    match part.content() {
        Some(Content::Scalar(scalar)) => row.push(scalar_text(scalar)),
        Some(Content::Text(text)) => row.push(cell(&String::from_utf8_lossy(text))),
        Some(Content::Scalars(scalars)) => row.extend(scalars.into_iter().map(scalar_text)),
        Some(Content::Message(layout)) => {
            fields(layout, part.bytes).for_each(|(_, part)| push_cells(row, part));
        }
        Some(Content::Messages) => part.elements().for_each(|part| push_cells(row, part)),
        None => row.push(String::new()),
    }
}

pub(super) fn scalar_text(scalar: Scalar) -> String {
    match scalar {
        Scalar::Bool(value) => u8::from(value).to_string(),
        Scalar::Float32(value) if !value.is_finite() => value.to_string().to_lowercase(),
        Scalar::Float64(value) if !value.is_finite() => value.to_string().to_lowercase(),
        other => json::scalar_text(other),
    }
}

/// A text as one cell: in quotes where it would be taken for more (RFC 4180).
fn cell(text: &str) -> String {
    if text.contains(['"', ',', '\n', '\r']) {
        return format!("\"{}\"", text.replace('"', "\"\""));
    }
    text.to_string()
}

#[cfg(test)]
mod tests {
    use super::super::{path, samples};
    use super::*;

    #[test]
    fn columns_are_named_as_pyulog_names_them() {
        let (layout, message) = samples::one_of_each();
        let places = path::all(&layout);
        assert_eq!(
            columns(&places).join(","),
            "timestamp,i64,f64,f32,u32,i32,u16,i16,u8,i8,flag,letter,q[0],q[1],q[2],q[3],\
             flags[0],flags[1],name,point.x,point.y,points[0].x,points[0].y,points[1].x,\
             points[1].y"
        );
        assert_eq!(
            row(&places, &message).join(","),
            "18446744073709551615,-9223372036854775808,0.3333333333333333,-0.123456,4294967295,\
             -2147483648,65535,-32768,255,-128,1,65,1.0,0.0,nan,-inf,1,0,\"a \"\"b\"\"\",\
             1,2,3,4,5,6"
        );
    }

    #[test]
    fn there_are_as_many_cells_as_columns_whatever_is_picked() {
        let (layout, message) = samples::one_of_each();
        for flat in layout.flatten() {
            let places = [path::find(&layout, &flat.path).unwrap()];
            assert_eq!(columns(&places).len(), row(&places, &message).len(), "{}", flat.path);
        }
    }
}
