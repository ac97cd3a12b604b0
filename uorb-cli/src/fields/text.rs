//! A message as people read it, in the form of PX4's first listener.
//!
//! ```text
//! timestamp: 84978861
//! x: -0.12345
//! q: [1.00000, 0.00000, 0.00000, 0.00000]
//! name: "a text"
//! previous (position_setpoint):
//!   valid: True
//! esc[0] (esc_report):
//!   esc_rpm: 5
//! ```

use std::io::{self, Write};

use uorb_core::FieldType;

use super::path::Place;
use super::quote::quote;
use super::{Content, Part, Scalar, fields};

/// What is needed to say how old a message is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Age {
    pub(crate) now_us: u64,
    pub(crate) publish_time_us: u64,
}

/// A timestamp that is further than this from when its message was published
/// was not taken from this machine's clock: the message is from a log.
const OWN_CLOCK_US: u64 = 10_000_000;

/// Prints what is at these places of a message; with ages, if `age` is given.
pub(crate) fn print(
    out: &mut dyn Write,
    places: &[Place<'_>],
    message: &[u8],
    age: Option<Age>,
) -> io::Result<()> {
    for place in places {
        let Some(part) = place.part(message) else { continue };
        let timestamp = age.and_then(|age| age_words(age, places, place, message));
        print_part(out, &place.path, part, 0, &timestamp.unwrap_or_default())?;
    }
    Ok(())
}

/// Bytes as hexadecimal digits.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn print_part(
    out: &mut dyn Write,
    name: &str,
    part: Part<'_>,
    indent: usize,
    remark: &str,
) -> io::Result<()> {
    match part.content() {
        Some(Content::Scalar(scalar)) => {
            writeln!(out, "{:indent$}{name}: {}{remark}", "", scalar_text(scalar))
        }
        Some(Content::Text(text)) => writeln!(out, "{:indent$}{name}: {}", "", quote(text)),
        Some(Content::Scalars(scalars)) => {
            let scalars: Vec<String> = scalars.into_iter().map(scalar_text).collect();
            writeln!(out, "{:indent$}{name}: [{}]", "", scalars.join(", "))
        }
        Some(Content::Message(layout)) => {
            writeln!(out, "{:indent$}{name} ({}):", "", layout.name)?;
            for (field, part) in fields(layout, part.bytes) {
                print_part(out, &field.name, part, indent + 2, "")?;
            }
            Ok(())
        }
        Some(Content::Messages) => {
            for (index, part) in part.elements().enumerate() {
                print_part(out, &format!("{name}[{index}]"), part, indent, "")?;
            }
            Ok(())
        }
        None => Ok(()),
    }
}

/// A scalar in PX4's form: five decimals for a float, six for a double.
pub(super) fn scalar_text(scalar: Scalar) -> String {
    match scalar {
        Scalar::Int(value) => value.to_string(),
        Scalar::Uint(value) => value.to_string(),
        // C's printf writes it in small letters, Rust does not.
        Scalar::Float32(value) if value.is_nan() => "nan".into(),
        Scalar::Float64(value) if value.is_nan() => "nan".into(),
        Scalar::Float32(value) => format!("{value:.5}"),
        Scalar::Float64(value) => format!("{value:.6}"),
        Scalar::Bool(value) => if value { "True" } else { "False" }.into(),
        Scalar::Char(value) => value.to_string(),
    }
}

/// What stands behind a timestamp: how long ago it was, or, behind that of the
/// measurement, how long before the message's own.
fn age_words(age: Age, places: &[Place<'_>], place: &Place<'_>, message: &[u8]) -> Option<String> {
    let timestamp_us = time_us(place, message)?;
    match &*place.path {
        "timestamp" => {
            let ago = |from_us| age.now_us.saturating_sub(from_us) as f64 / 1e6;
            if age.publish_time_us.abs_diff(timestamp_us) > OWN_CLOCK_US {
                let published = ago(age.publish_time_us);
                return Some(format!(" (not of this clock; published {published:.6} seconds ago)"));
            }
            Some(format!(" ({:.6} seconds ago)", ago(timestamp_us)))
        }
        "timestamp_sample" => {
            let own = places.iter().find(|place| place.path == "timestamp")?;
            let before_us = time_us(own, message)?.checked_sub(timestamp_us)?;
            Some(format!(" ({before_us} us before timestamp)"))
        }
        _ => None,
    }
}

/// A time in a message; 0 is none.
fn time_us(place: &Place<'_>, message: &[u8]) -> Option<u64> {
    let is_time = matches!((place.ty, place.array_length), (FieldType::Uint64, None));
    match place.part(message)?.content()? {
        Content::Scalar(Scalar::Uint(time_us)) if is_time && time_us > 0 => Some(time_us),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::{path, samples};
    use super::*;

    fn printed(places: &[Place<'_>], message: &[u8], age: Option<Age>) -> String {
        let mut out = Vec::new();
        print(&mut out, places, message, age).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn a_message_is_printed_as_the_first_listener_did() {
        let (layout, message) = samples::one_of_each();
        assert_eq!(
            printed(&path::all(&layout), &message, None),
            "\
timestamp: 18446744073709551615
i64: -9223372036854775808
f64: 0.333333
f32: -0.12346
u32: 4294967295
i32: -2147483648
u16: 65535
i16: -32768
u8: 255
i8: -128
flag: True
letter: 65
q: [1.00000, 0.00000, nan, -inf]
flags: [True, False]
name: \"a \\\"b\\\"\"
point (point):
  x: 1
  y: 2
points[0] (point):
  x: 3
  y: 4
points[1] (point):
  x: 5
  y: 6
"
        );
    }

    #[test]
    fn picked_fields_are_printed_under_their_paths() {
        let (layout, message) = samples::one_of_each();
        let places: Vec<_> = ["points[1].y", "q[0]", "point", "points[0]"]
            .iter()
            .map(|path| path::find(&layout, path).unwrap())
            .collect();
        assert_eq!(
            printed(&places, &message, None),
            "points[1].y: 6\nq[0]: 1.00000\npoint (point):\n  x: 1\n  y: 2\n\
             points[0] (point):\n  x: 3\n  y: 4\n"
        );
    }

    #[test]
    fn the_age_of_a_message_stands_behind_its_timestamp() {
        let layout = samples::vehicle_acceleration();
        let mut message = vec![0; 32];
        message[..8].copy_from_slice(&5_000_000_u64.to_ne_bytes());
        message[8..16].copy_from_slice(&4_999_700_u64.to_ne_bytes());
        let places = path::all(&layout);
        let age = Age { now_us: 5_004_361, publish_time_us: 5_000_001 };
        assert_eq!(
            printed(&places[..2], &message, Some(age)),
            "timestamp: 5000000 (0.004361 seconds ago)\n\
             timestamp_sample: 4999700 (300 us before timestamp)\n"
        );
        let recorded = Age { now_us: 95_000_000, publish_time_us: 94_500_000 };
        assert_eq!(
            printed(&places[..1], &message, Some(recorded)),
            "timestamp: 5000000 (not of this clock; published 0.500000 seconds ago)\n"
        );
        message[..8].fill(0);
        assert_eq!(printed(&places[..1], &message, Some(age)), "timestamp: 0\n");
    }

    #[test]
    fn a_message_that_is_cut_off_is_printed_as_far_as_it_goes() {
        let (layout, message) = samples::one_of_each();
        assert_eq!(
            printed(&path::all(&layout), &message[..8], None),
            "timestamp: 18446744073709551615\n"
        );
    }
}
