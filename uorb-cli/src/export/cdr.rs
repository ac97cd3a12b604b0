//! Messages as ROS 2 has them: their types as .msg text, their bytes as CDR.
//!
//! CDR puts every scalar at a multiple of its own size, counted from behind a
//! head of four bytes, and leaves no other gap: so the padding of a log's message
//! is not in it, and a nested message begins wherever the one before it ended.

use std::fmt::Write as _;

use uorb_core::{FieldType, Layout};

use crate::fields::{Part, fields};

/// The package that PX4's messages have in ROS 2.
const PACKAGE: &str = "px4_msgs";

/// Little-endian, without options.
const HEAD: [u8; 4] = [0, 1, 0, 0];

/// A message's type.
pub(super) struct Schema {
    /// `px4_msgs/msg/SensorAccel`
    pub(super) name: String,
    /// Its fields, and behind rules the types of the messages in it.
    pub(super) text: String,
}

impl Schema {
    pub(super) fn of(layout: &Layout) -> Self {
        let mut types = Types::default();
        let name = types.name(layout);
        let mut text = types.describe(layout);
        // A description adds the types that it names.
        let mut number = 1;
        while let Some((nested, name)) = types.known.get(number).cloned() {
            let described = types.describe(nested);
            let _ = write!(text, "{}\nMSG: {PACKAGE}/{name}\n{described}", "=".repeat(80));
            number += 1;
        }
        Self { name: format!("{PACKAGE}/msg/{name}"), text }
    }
}

/// The types of one schema, with the names that they have there.
#[derive(Default)]
struct Types<'l> {
    known: Vec<(&'l Layout, String)>,
}

impl<'l> Types<'l> {
    fn name(&mut self, layout: &'l Layout) -> String {
        if let Some((_, name)) = self.known.iter().find(|(known, _)| known.name == layout.name) {
            return name.clone();
        }
        let mut name = camel(&layout.name);
        // `a_b` and `aB` may both be there.
        while self.known.iter().any(|(_, known)| *known == name) {
            name.push('X');
        }
        self.known.push((layout, name.clone()));
        name
    }

    fn describe(&mut self, layout: &'l Layout) -> String {
        let mut text = String::new();
        let mut names = Vec::new();
        for field in layout.fields.iter() {
            let ty = match &field.ty {
                FieldType::Message(nested) => format!("{PACKAGE}/{}", self.name(nested)),
                scalar => scalar.msg_name().to_string(),
            };
            let length = field.array_length.map_or(String::new(), |length| format!("[{length}]"));
            let mut name = snake(&field.name);
            while names.contains(&name) {
                name.push('x');
            }
            let _ = writeln!(text, "{ty}{length} {name}");
            names.push(name);
        }
        text
    }
}

/// `sensor_accel` as `SensorAccel`, and nothing but letters and digits.
fn camel(name: &str) -> String {
    let words = name.split(|letter: char| !letter.is_ascii_alphanumeric());
    let mut camel: String = words
        .filter_map(|word| Some((word.get(..1)?, word.get(1..)?)))
        .map(|(first, rest)| first.to_ascii_uppercase() + rest)
        .collect();
    if !camel.starts_with(|letter: char| letter.is_ascii_uppercase()) {
        camel.insert(0, 'M');
    }
    camel
}

/// A field's name as ROS takes it, without capitals and without `__`. PX4's own
/// are such names, since it makes ROS messages of them; older ones were not.
fn snake(name: &str) -> String {
    let name = name.to_ascii_lowercase();
    let words: Vec<&str> = name.split('_').filter(|word| !word.is_empty()).collect();
    let mut snake = words.join("_");
    if !snake.starts_with(|letter: char| letter.is_ascii_lowercase()) {
        snake.insert_str(0, "x_");
    }
    snake.trim_end_matches('_').to_string()
}

/// A message in CDR, in the place of what is in `out`.
pub(super) fn encode(out: &mut Vec<u8>, layout: &Layout, message: &[u8]) {
    out.clear();
    out.extend(HEAD);
    fields(layout, message).for_each(|(_, part)| push(out, part));
}

fn push(out: &mut Vec<u8>, part: Part<'_>) {
    match (part.ty, part.array_length) {
        (FieldType::Message(_), Some(_)) => part.elements().for_each(|element| push(out, element)),
        (FieldType::Message(nested), None) => {
            fields(nested, part.bytes).for_each(|(_, part)| push(out, part));
        }
        (FieldType::Bool, _) => out.extend(part.bytes.iter().map(|byte| u8::from(*byte != 0))),
        (scalar, _) => {
            let body_bytes = out.len() - HEAD.len();
            let aligned = body_bytes.next_multiple_of(scalar.size_bytes() as usize);
            out.resize(HEAD.len() + aligned, 0);
            out.extend(part.bytes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fields::samples;

    #[test]
    fn a_schema_has_the_types_that_it_names() {
        let (layout, _) = samples::one_of_each();
        let Schema { name, text } = Schema::of(&layout);
        assert_eq!(name, format!("px4_msgs/msg/{}", camel(&layout.name)));
        assert!(text.starts_with("uint64 timestamp\nint64 i64\nfloat64 f64\n"), "{text}");
        let (first, nested) = text.split_once(&format!("{}\nMSG: ", "=".repeat(80))).unwrap();
        assert!(first.contains("float32[4] q\nbool[2] flags\nchar[8] name\n"), "{text}");
        let (ty, fields) = nested.split_once('\n').unwrap();
        assert!(first.ends_with(&format!("{ty} point\n{ty}[2] points\n")), "{text}");
        assert_eq!(fields, "int32 x\nuint8 y\n");
    }

    #[test]
    fn names_are_those_that_ros_takes() {
        for (name, expected) in [
            ("sensor_accel", "SensorAccel"),
            ("esc_report", "EscReport"),
            ("a/b", "AB"),
            ("_1st", "M1st"),
            ("__", "M"),
        ] {
            assert_eq!(camel(name), expected);
        }
        for (name, expected) in [
            ("timestamp", "timestamp"),
            ("voltage5V_v", "voltage5v_v"),
            ("_a__b_", "a_b"),
            ("3d", "x_3d"),
            ("__", "x"),
        ] {
            assert_eq!(snake(name), expected);
        }
    }

    #[test]
    fn every_scalar_stands_at_a_multiple_of_its_size() {
        let (layout, message) = samples::one_of_each();
        let mut out = vec![9; 3];
        encode(&mut out, &layout, &message);
        let body = &out[4..];
        assert_eq!(out[..4], HEAD);
        assert_eq!(body[..8], [255; 8]);
        // 8 + 8 + 8 + 4 + 4 + 4 + 2 + 2 + 1 + 1 + 1 + 1 come without a gap.
        assert_eq!(body[40..44], [255, 128, 1, b'A'], "a truth value is 1");
        assert_eq!(body[44..48], 1.0_f32.to_le_bytes());
        // The flags, the name, and a gap before the point's number.
        assert_eq!(body[60..62], [1, 0]);
        assert_eq!(body[62..70], *b"a \"b\"\0zz");
        assert_eq!(body[70..72], [0, 0]);
        assert_eq!(body[72..77], [1, 0, 0, 0, 2]);
        assert_eq!(body[77..85], [0, 0, 0, 3, 0, 0, 0, 4]);
        assert_eq!(body.len(), 93);
    }
}
