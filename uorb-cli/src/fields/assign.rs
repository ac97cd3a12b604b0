//! `field=value`, as `uorb pub` takes it.
//!
//! | field | value |
//! |---|---|
//! | a number | `5`, `-5`, `0x1f`, `0b101`; for a float also `1.5`, `1e-3`, `nan`, `inf` |
//! | a truth value | `True`, `False`, `true`, `false`, `1`, `0` |
//! | a char | its number |
//! | a char array | the text, with or without quotes |
//! | an array | `[1, 2, 3]`; elements that are not given stay as they are |
//! | a nested message | none: its fields are written one by one |

use std::num::IntErrorKind;

use anyhow::{Context as _, Result, bail};
use uorb_core::{FieldType, Layout};

use super::path::{self, Place};
use super::quote::unquote;

/// Bytes for one place of a message.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Assignment {
    pub(crate) path: String,
    offset_bytes: usize,
    bytes: Vec<u8>,
}

impl Assignment {
    /// Understands `field=value` for messages of this layout.
    ///
    /// # Errors
    ///
    /// There is no such field; the value is not of its type, or out of range.
    pub(crate) fn parse(layout: &Layout, text: &str) -> Result<Self> {
        let (path, value) = text
            .split_once('=')
            .with_context(|| format!("{text:?} is not of the form field=value"))?;
        let place = path::find(layout, path.trim())?;
        let bytes = bytes_of(&place, value.trim())?;
        Ok(Self { path: place.path, offset_bytes: place.offset_bytes, bytes })
    }

    /// Writes the bytes into a message of the layout.
    pub(crate) fn write(&self, message: &mut [u8]) {
        let into = message.get_mut(self.offset_bytes..).and_then(|rest| {
            // A message of another layout, which nobody gives, stays as it is.
            rest.get_mut(..self.bytes.len())
        });
        if let Some(into) = into {
            into.copy_from_slice(&self.bytes);
        }
    }
}

fn bytes_of(place: &Place<'_>, value: &str) -> Result<Vec<u8>> {
    let (path, ty) = (&place.path, place.type_name());
    match (place.ty, place.array_length) {
        (FieldType::Message(layout), None) => {
            let first = layout.fields.first().map_or("field", |field| &field.name);
            bail!("{path} is a {ty}: write its fields, as {path}.{first}=..");
        }
        (FieldType::Message(_), Some(_)) => {
            bail!("{path} is {ty}: write the fields of its elements, as {path}[0].field=..");
        }
        (FieldType::Char, Some(length)) => {
            let mut text = unquote(value)
                .with_context(|| format!("{path}: an escape in {value} is not understood"))?;
            if text.len() > length as usize {
                bail!("{path} is {ty}: a text of {} bytes is too long", text.len());
            }
            text.resize(length as usize, 0);
            Ok(text)
        }
        (_, None) => scalar_bytes(place, value),
        (_, Some(length)) => {
            let list = value.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
            let Some(list) = list else {
                bail!("{path} is {ty}: give [a, b, ..], or one element as {path}[0]=..");
            };
            let elements: Vec<&str> = match list.trim() {
                "" => Vec::new(),
                list => list.split(',').map(str::trim).collect(),
            };
            if elements.len() > length as usize {
                bail!("{path} is {ty}: {} elements are too many", elements.len());
            }
            let bytes = elements.into_iter().map(|element| scalar_bytes(place, element));
            Ok(bytes.collect::<Result<Vec<_>>>()?.concat())
        }
    }
}

/// The bytes of one number, truth value or character.
fn scalar_bytes(place: &Place<'_>, text: &str) -> Result<Vec<u8>> {
    Ok(match place.ty {
        FieldType::Int8 => (whole(place, text, i8::MIN, i8::MAX)? as i8).to_ne_bytes().into(),
        FieldType::Int16 => (whole(place, text, i16::MIN, i16::MAX)? as i16).to_ne_bytes().into(),
        FieldType::Int32 => (whole(place, text, i32::MIN, i32::MAX)? as i32).to_ne_bytes().into(),
        FieldType::Int64 => (whole(place, text, i64::MIN, i64::MAX)? as i64).to_ne_bytes().into(),
        FieldType::Uint8 | FieldType::Char => vec![whole(place, text, u8::MIN, u8::MAX)? as u8],
        FieldType::Uint16 => (whole(place, text, u16::MIN, u16::MAX)? as u16).to_ne_bytes().into(),
        FieldType::Uint32 => (whole(place, text, u32::MIN, u32::MAX)? as u32).to_ne_bytes().into(),
        FieldType::Uint64 => (whole(place, text, u64::MIN, u64::MAX)? as u64).to_ne_bytes().into(),
        FieldType::Float32 => {
            let value: f32 = text.parse().map_err(|_| no_number(place, text))?;
            check_finite(place, text, value.is_infinite(), format!("{:e}", f32::MAX))?;
            value.to_ne_bytes().into()
        }
        FieldType::Float64 => {
            let value: f64 = text.parse().map_err(|_| no_number(place, text))?;
            check_finite(place, text, value.is_infinite(), format!("{:e}", f64::MAX))?;
            value.to_ne_bytes().into()
        }
        FieldType::Bool => match text {
            "True" | "true" | "1" => vec![1],
            "False" | "false" | "0" => vec![0],
            _ => bail!("{} is {}: {text:?} is neither True nor False", place.path, "bool"),
        },
        FieldType::Message(_) => bail!("{} is {}", place.path, place.type_name()),
    })
}

/// A whole number within these limits.
fn whole<T: Into<i128>>(place: &Place<'_>, text: &str, min: T, max: T) -> Result<i128> {
    let (min, max) = (min.into(), max.into());
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text.strip_prefix('+').unwrap_or(text)),
    };
    let parsed = match digits.split_at_checked(2) {
        // Another sign here would be taken by the parser.
        _ if digits.starts_with(['+', '-']) => return Err(no_number(place, text)),
        Some(("0x", digits)) => i128::from_str_radix(digits, 16),
        Some(("0b", digits)) => i128::from_str_radix(digits, 2),
        _ => digits.parse(),
    };
    let value = match parsed {
        Ok(value) => Some(sign * value),
        Err(error) if matches!(error.kind(), IntErrorKind::PosOverflow) => None,
        Err(_) => return Err(no_number(place, text)),
    };
    match value {
        Some(value) if (min..=max).contains(&value) => Ok(value),
        _ => bail!("{} is {}: {text} is not in {min} to {max}", place.path, place.ty.msg_name()),
    }
}

fn no_number(place: &Place<'_>, text: &str) -> anyhow::Error {
    let kind = match place.ty {
        FieldType::Float32 | FieldType::Float64 => "number",
        _ => "whole number",
    };
    anyhow::anyhow!("{} is {}: {text:?} is no {kind}", place.path, place.ty.msg_name())
}

/// A number that is too large is read as infinity; only who says so means it.
fn check_finite(place: &Place<'_>, text: &str, is_infinite: bool, max: String) -> Result<()> {
    if is_infinite && !text.to_ascii_lowercase().contains("inf") {
        let ty = place.ty.msg_name();
        bail!("{} is {ty}: {text} is not in -{max} to {max}", place.path);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::{Content, Scalar, csv, json, samples, text};
    use super::*;

    fn written(texts: &[&str]) -> (Layout, Vec<u8>) {
        let (layout, message) = samples::one_of_each();
        let mut message = vec![0; message.len()];
        for text in texts {
            Assignment::parse(&layout, text).unwrap().write(&mut message);
        }
        (layout, message)
    }

    fn refused(text: &str) -> String {
        let (layout, _) = samples::one_of_each();
        Assignment::parse(&layout, text).unwrap_err().to_string()
    }

    #[test]
    fn a_message_is_written_field_by_field() {
        let (_, expected) = samples::one_of_each();
        let (_, mut message) = written(&[
            "timestamp=18446744073709551615",
            "i64=-9223372036854775808",
            "f64=0.3333333333333333",
            "f32=-0.123456",
            "u32=0xffffffff",
            "i32=-2147483648",
            "u16=0b1111111111111111",
            "i16=-32768",
            "u8=255",
            "i8=-0x80",
            "flag=True",
            "letter=65",
            "q=[1.0, 0, nan, -inf]",
            "flags[0]=1",
            r#"name=a "b""#,
            "point.x=1",
            "point.y=2",
            "points[0].x=3",
            "points[0].y=4",
            "points[1].x=5",
            "points[1].y=6",
        ]);
        // What the sample has behind the NUL, and its truth value of 2.
        let (layout, _) = samples::one_of_each();
        let name = path::find(&layout, "name").unwrap().offset_bytes;
        message[name + 6..name + 8].copy_from_slice(b"zz");
        let flag = path::find(&layout, "flag").unwrap().offset_bytes;
        message[flag] = 2;
        assert_eq!(message, expected);
    }

    #[test]
    fn what_is_wrong_is_said_with_type_and_range() {
        assert_eq!(refused("u8=256"), "u8 is uint8: 256 is not in 0 to 255");
        assert_eq!(refused("i8=-129"), "i8 is int8: -129 is not in -128 to 127");
        assert_eq!(
            refused("timestamp=99999999999999999999999999999999999999999999"),
            "timestamp is uint64: 99999999999999999999999999999999999999999999 is not in 0 to \
             18446744073709551615"
        );
        assert_eq!(refused("u8=1.5"), "u8 is uint8: \"1.5\" is no whole number");
        assert_eq!(refused("u8=--5"), "u8 is uint8: \"--5\" is no whole number");
        assert_eq!(refused("u8="), "u8 is uint8: \"\" is no whole number");
        assert_eq!(
            refused("f32=1e39"),
            "f32 is float32: 1e39 is not in -3.4028235e38 to 3.4028235e38"
        );
        assert_eq!(refused("f32=much"), "f32 is float32: \"much\" is no number");
        assert_eq!(refused("flag=2"), "flag is bool: \"2\" is neither True nor False");
        assert_eq!(refused("q=1"), "q is float32[4]: give [a, b, ..], or one element as q[0]=..");
        assert_eq!(refused("q=[1,2,3,4,5]"), "q is float32[4]: 5 elements are too many");
        assert_eq!(
            refused("name=much too long"),
            "name is char[8]: a text of 13 bytes is too long"
        );
        assert_eq!(refused("point=1"), "point is a point: write its fields, as point.x=..");
        assert_eq!(refused("u8"), "\"u8\" is not of the form field=value");
    }

    #[test]
    fn a_path_that_leads_nowhere_is_said_with_the_nearest() {
        assert_eq!(
            refused("letr=1"),
            "message one_of_each has no field \"letr\"; did you mean letter?"
        );
        assert_eq!(
            refused("q[4]=1"),
            "q[4] is out of range: q is float32[4], its elements are q[0] to q[3]"
        );
        assert_eq!(refused("u8[0]=1"), "u8 is uint8, not an array");
        assert_eq!(refused("u8.x=1"), "u8 is uint8: it has no fields");
        assert_eq!(refused("points.x=1"), "points is point[2]: say which, as points[0]");
        assert_eq!(
            refused("point.z.z=1"),
            "message point has no field \"z\"; did you mean x or y?"
        );
        assert!(refused("=1").starts_with("message one_of_each has no field \"\"; it has "));
    }

    #[test]
    fn elements_that_are_not_given_stay() {
        let (_, message) = written(&["q=[1,2,3,4]", "q=[9]"]);
        let (_, expected) = written(&["q=[9,2,3,4]"]);
        assert_eq!(message, expected);
    }

    /// What any of the printers writes for a scalar is understood, and is the
    /// same scalar again.
    fn comes_back(path: &str, ty: &FieldType, bytes: &[u8]) {
        let (layout, _) = samples::one_of_each();
        let scalar = Scalar::read(ty, bytes).unwrap();
        let mut printed = vec![json::scalar_text(scalar)];
        if !matches!(scalar, Scalar::Float32(_) | Scalar::Float64(_)) {
            // Floats lose digits there.
            printed.push(text::scalar_text(scalar));
        }
        for text in printed.into_iter().filter(|text| text != "null") {
            let assignment = Assignment::parse(&layout, &format!("{path}={text}")).unwrap();
            assert_eq!(Scalar::read(ty, &assignment.bytes).unwrap(), scalar, "{path}={text}");
        }
    }

    proptest! {
        #[test]
        fn what_is_printed_can_be_published(bytes: [u8; 8]) {
            let (layout, _) = samples::one_of_each();
            let scalars = layout.fields.iter().filter(|field| field.array_length.is_none());
            for field in scalars.filter(|field| field.name != "point") {
                comes_back(&field.name, &field.ty, &bytes);
            }
        }

        #[test]
        fn a_whole_message_can_be_published_as_it_is_printed(
            bytes in prop::collection::vec(any::<u8>(), 85),
        ) {
            let (layout, message) = samples::one_of_each();
            prop_assert_eq!(bytes.len(), message.len());
            let mut again = vec![0; bytes.len()];
            let flat = layout.flatten();
            let places: Vec<Place<'_>> =
                flat.iter().map(|flat| path::find(&layout, &flat.path).unwrap()).collect();
            for place in &places {
                let part = place.part(&bytes).unwrap();
                let printed = match part.content().unwrap() {
                    Content::Text(text) => super::super::quote::quote(text),
                    Content::Scalar(scalar) => csv::scalar_text(scalar),
                    Content::Scalars(scalars) => {
                        let scalars: Vec<_> = scalars.into_iter().map(csv::scalar_text).collect();
                        format!("[{}]", scalars.join(","))
                    }
                    _ => unreachable!("flat fields are scalars and arrays of them"),
                };
                let text = format!("{}={printed}", place.path);
                Assignment::parse(&layout, &text).unwrap().write(&mut again);
            }
            prop_assert_eq!(csv::row(&places, &again), csv::row(&places, &bytes));
        }

        #[test]
        fn a_text_can_be_published_as_it_is_printed(bytes in prop::collection::vec(1_u8.., 0..9)) {
            let (layout, _) = samples::one_of_each();
            let text = super::super::quote::quote(&bytes);
            let assignment = Assignment::parse(&layout, &format!("name={text}")).unwrap();
            let mut expected = bytes;
            expected.resize(8, 0);
            prop_assert_eq!(assignment.bytes, expected);
        }

        #[test]
        fn nonsense_is_refused_without_a_panic(text: String) {
            let (layout, _) = samples::one_of_each();
            let _ = Assignment::parse(&layout, &text);
            for field in layout.fields.iter() {
                let _ = Assignment::parse(&layout, &format!("{}={text}", field.name));
            }
        }
    }
}
