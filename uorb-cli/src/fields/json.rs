//! A message as one line of JSON, for programs.
//!
//! Numbers are exact. An integer is written with all its digits, also beyond
//! 2^53, where many readers round; a float in the shortest form that reads back
//! as the same float of its own type, and with a point or an exponent, so that
//! it stays a float. JSON has no NaN and no infinities: they are `null`. A char
//! array is a string up to its first NUL; bytes that are no UTF-8 become U+FFFD.

use std::io::{self, Write};

use super::path::Place;
use super::{Content, Part, Scalar, fields};

/// Prints the members of an object, `"x":1,"y":2`: what is at these places.
pub(crate) fn print_members(
    out: &mut dyn Write,
    places: &[Place<'_>],
    message: &[u8],
) -> io::Result<()> {
    let parts = places.iter().filter_map(|place| Some((&*place.path, place.part(message)?)));
    print_all(out, parts)
}

/// A string in JSON's quotes.
pub(crate) fn string(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

fn print_all<'m>(
    out: &mut dyn Write,
    parts: impl Iterator<Item = (&'m str, Part<'m>)>,
) -> io::Result<()> {
    let mut comma = "";
    for (name, part) in parts {
        write!(out, "{comma}{}:", string(name))?;
        print_part(out, part)?;
        comma = ",";
    }
    Ok(())
}

fn print_part(out: &mut dyn Write, part: Part<'_>) -> io::Result<()> {
    match part.content() {
        Some(Content::Scalar(scalar)) => write!(out, "{}", scalar_text(scalar)),
        Some(Content::Text(text)) => write!(out, "{}", string(&String::from_utf8_lossy(text))),
        Some(Content::Scalars(scalars)) => {
            let scalars: Vec<String> = scalars.into_iter().map(scalar_text).collect();
            write!(out, "[{}]", scalars.join(","))
        }
        Some(Content::Message(layout)) => {
            write!(out, "{{")?;
            let parts = fields(layout, part.bytes).map(|(field, part)| (&*field.name, part));
            print_all(out, parts)?;
            write!(out, "}}")
        }
        Some(Content::Messages) => {
            for (index, part) in part.elements().enumerate() {
                write!(out, "{}", if index == 0 { "[" } else { "," })?;
                print_part(out, part)?;
            }
            write!(out, "]")
        }
        None => write!(out, "null"),
    }
}

pub(super) fn scalar_text(scalar: Scalar) -> String {
    match scalar {
        Scalar::Int(value) => value.to_string(),
        Scalar::Uint(value) => value.to_string(),
        // Rust's debug form is the shortest that reads back the same, and valid
        // JSON where the number is finite.
        Scalar::Float32(value) if value.is_finite() => format!("{value:?}"),
        Scalar::Float64(value) if value.is_finite() => format!("{value:?}"),
        Scalar::Float32(_) | Scalar::Float64(_) => "null".into(),
        Scalar::Bool(value) => value.to_string(),
        Scalar::Char(value) => value.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::{path, samples};
    use super::*;

    fn printed(places: &[Place<'_>], message: &[u8]) -> String {
        let mut out = Vec::new();
        print_members(&mut out, places, message).unwrap();
        format!("{{{}}}", String::from_utf8(out).unwrap())
    }

    #[test]
    fn a_message_is_one_line_with_every_digit() {
        let (layout, message) = samples::one_of_each();
        let line = printed(&path::all(&layout), &message);
        assert_eq!(
            line,
            r#"{"timestamp":18446744073709551615,"i64":-9223372036854775808,"f64":0.3333333333333333,"#
                .to_owned()
                + r#""f32":-0.123456,"u32":4294967295,"i32":-2147483648,"u16":65535,"i16":-32768,"#
                + r#""u8":255,"i8":-128,"flag":true,"letter":65,"q":[1.0,0.0,null,null],"#
                + r#""flags":[true,false],"name":"a \"b\"","point":{"x":1,"y":2},"#
                + r#""points":[{"x":3,"y":4},{"x":5,"y":6}]}"#
        );
        serde_json::from_str::<serde_json::Value>(&line).unwrap();
    }

    #[test]
    fn picked_fields_are_members_by_their_paths() {
        let (layout, message) = samples::one_of_each();
        let places = [path::find(&layout, "points[1].y").unwrap()];
        assert_eq!(printed(&places, &message), r#"{"points[1].y":6}"#);
    }

    proptest! {
        #[test]
        fn floats_come_back_as_they_were(single: f32, double: f64) {
            prop_assume!(single.is_finite() && double.is_finite());
            let text = scalar_text(Scalar::Float32(single));
            prop_assert_eq!(text.parse::<f32>().unwrap().to_bits(), single.to_bits());
            prop_assert!(serde_json::from_str::<f64>(&text).is_ok());
            let text = scalar_text(Scalar::Float64(double));
            prop_assert_eq!(text.parse::<f64>().unwrap().to_bits(), double.to_bits());
            prop_assert!(serde_json::from_str::<f64>(&text).is_ok());
        }

        #[test]
        fn any_bytes_are_a_line_of_json(bytes: Vec<u8>) {
            let (layout, message) = samples::one_of_each();
            let mut any = bytes;
            any.resize(message.len(), 0);
            let line = printed(&path::all(&layout), &any);
            prop_assert!(serde_json::from_str::<serde_json::Value>(&line).is_ok());
            prop_assert!(!line.contains('\n'));
        }
    }
}
