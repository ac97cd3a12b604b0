//! What a log says its messages look like, as layouts.
//!
//! A log describes each message once, in C types and in memory order:
//! `esc_status:uint64_t timestamp;esc_report[8] esc;uint8_t[7] _padding0;`. So an
//! offset is the sum of the sizes before it, padding is a field like any other
//! that a layout does not list, and a nested message is the name of another
//! format. The log does not hold the .msg text: the layout's hash is 0.

use std::borrow::Cow;
use std::collections::HashMap;

use uorb_core::{Field, FieldType, Layout, LayoutFault, NODE_MESSAGE_MAX_BYTES};

/// How deep the formats of a log may nest: as deep as a node takes it.
const NESTING_MAX: usize = 8;

/// The most formats that a log may have. PX4 has 250.
const FORMATS_MAX: usize = 4_096;

/// The formats of a log, by the names of their messages.
#[derive(Debug, Default)]
pub(crate) struct Formats {
    /// What comes after the colon.
    texts: HashMap<String, String>,
    /// The byte of the file at which each stands, in their order.
    bytes: Vec<(String, u64)>,
}

/// What is wrong with a format. Its words say it.
#[allow(missing_docs)]
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum FormatFault {
    #[error("the format {0:?} is not `NAME:TYPE FIELD;TYPE FIELD;`")]
    NoName(String),
    #[error("there are two formats of message {0}")]
    Twice(String),
    #[error("there are more than {FORMATS_MAX} formats")]
    TooMany,
    #[error("the log has no format of message {0}")]
    Unknown(String),
    #[error("{entry:?} in the format of message {message} is not `TYPE FIELD` or `TYPE[N] FIELD`")]
    Entry { message: String, entry: String },
    #[error(
        "field {field} of message {message} is of type {ty}, \
         which is no type of C's and of which the log has no format"
    )]
    UnknownType { message: String, field: String, ty: String },
    #[error("the formats go round in a circle: {0}")]
    Circle(String),
    #[error("the formats nest deeper than {NESTING_MAX}: {0}")]
    TooDeep(String),
    #[error(transparent)]
    Layout(#[from] LayoutFault),
}

impl FormatFault {
    /// The message whose format is at fault, where it is one alone.
    fn message(&self) -> Option<&str> {
        match self {
            Self::Entry { message, .. } | Self::UnknownType { message, .. } => Some(message),
            Self::Layout(
                LayoutFault::Size { name: message, .. }
                | LayoutFault::Field { message, .. }
                | LayoutFault::TooMany { message },
            ) => Some(message),
            Self::Unknown(_) | Self::NoName(_) | Self::Twice(_) | Self::TooMany => None,
            Self::Circle(_) | Self::TooDeep(_) => None,
        }
    }
}

impl Formats {
    /// Takes a format as it stands in the log.
    pub(crate) fn add(&mut self, at_byte: u64, text: &str) -> Result<(), FormatFault> {
        let (name, fields) = match text.split_once(':') {
            Some((name, fields)) if !name.is_empty() => (name, fields),
            _ => return Err(FormatFault::NoName(excerpt(text))),
        };
        if self.texts.len() == FORMATS_MAX {
            return Err(FormatFault::TooMany);
        }
        if self.texts.insert(name.to_string(), fields.to_string()).is_some() {
            return Err(FormatFault::Twice(name.to_string()));
        }
        self.bytes.push((name.to_string(), at_byte));
        Ok(())
    }

    /// Checks all of them, those that nobody uses too. Says at which byte the
    /// one stands that is at fault.
    pub(crate) fn check(&self) -> Result<(), (u64, FormatFault)> {
        for (message, at_byte) in &self.bytes {
            self.layout(message).map_err(|fault| {
                let culprit = fault.message().unwrap_or(message);
                let found = self.bytes.iter().find(|(message, _)| message == culprit);
                (found.map_or(*at_byte, |&(_, at_byte)| at_byte), fault)
            })?;
        }
        Ok(())
    }

    /// The layout of a message, nested ones included.
    pub(crate) fn layout(&self, message: &str) -> Result<Layout, FormatFault> {
        if !self.texts.contains_key(message) {
            return Err(FormatFault::Unknown(message.to_string()));
        }
        let layout = self.resolve(message, &mut Vec::new())?;
        layout.check()?;
        Ok(layout)
    }

    /// `above` are the messages that this one is nested in.
    fn resolve<'a>(
        &'a self,
        message: &'a str,
        above: &mut Vec<&'a str>,
    ) -> Result<Layout, FormatFault> {
        let is_circle = above.contains(&message);
        above.push(message);
        if is_circle {
            return Err(FormatFault::Circle(above.join(" in ")));
        }
        if above.len() > NESTING_MAX {
            return Err(FormatFault::TooDeep(above.join(" in ")));
        }
        let mut fields = Vec::new();
        let mut end_bytes = 0;
        for entry in self.texts[message].split(';').filter(|entry| !entry.is_empty()) {
            let Entry { ty, array_length, field } = Entry::parse(entry).ok_or_else(|| {
                FormatFault::Entry { message: message.to_string(), entry: excerpt(entry) }
            })?;
            let ty = match (FieldType::from_c_name(ty), self.texts.contains_key(ty)) {
                (Some(scalar), _) => scalar,
                (None, true) => FieldType::Message(Cow::Owned(self.resolve(ty, above)?)),
                (None, false) => {
                    let [message, field, ty] = [message, field, ty].map(str::to_string);
                    return Err(FormatFault::UnknownType { message, field, ty });
                }
            };
            let offset_bytes = end_bytes;
            let name = field.to_string().into();
            let field = Field { name, ty, array_length, offset_bytes, unit: Cow::Borrowed("") };
            // Here and not at the end: formats of a few bytes can multiply to
            // more than any memory holds.
            end_bytes = u32::try_from(field.end_bytes())
                .ok()
                .filter(|end| (offset_bytes + 1..=NODE_MESSAGE_MAX_BYTES).contains(end))
                .ok_or_else(|| {
                    let size = u32::try_from(field.end_bytes()).unwrap_or(u32::MAX);
                    LayoutFault::Size {
                        name: message.to_string(),
                        size_bytes: size,
                        limit_bytes: NODE_MESSAGE_MAX_BYTES,
                    }
                })?;
            if !field.name.starts_with("_padding") {
                fields.push(field);
            }
        }
        above.pop();
        let name = message.to_string().into();
        Ok(Layout { name, size_bytes: end_bytes, message_hash: 0, fields: fields.into() })
    }
}

/// One field as the log writes it: `float[3] xyz`.
struct Entry<'a> {
    ty: &'a str,
    array_length: Option<u32>,
    field: &'a str,
}

impl<'a> Entry<'a> {
    fn parse(text: &'a str) -> Option<Self> {
        let (ty, field) = text.split_once(' ')?;
        let (ty, array_length) = match ty.strip_suffix(']') {
            None => (ty, None),
            Some(ty) => {
                let (ty, length) = ty.split_once('[')?;
                (ty, Some(length.parse().ok().filter(|&length: &u32| length > 0)?))
            }
        };
        let is_name = |name: &str| {
            !name.is_empty()
                && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
        };
        // The name of a type may have more in it: old ones had a path.
        (is_name(field) && is_name(&ty.replace('/', "_"))).then_some(Self {
            ty,
            array_length,
            field,
        })
    }
}

/// As much of a text from the log as fits into a line.
fn excerpt(text: &str) -> String {
    const MAX_BYTES: usize = 60;
    match text.len() > MAX_BYTES {
        false => text.to_string(),
        true => format!("{}...", &text[..text.floor_char_boundary(MAX_BYTES)]),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use uorb_core::FlatField;

    use super::*;

    fn formats(texts: &[&str]) -> Result<Formats, FormatFault> {
        let mut formats = Formats::default();
        for (at_byte, text) in (0..).zip(texts) {
            formats.add(at_byte, text)?;
        }
        Ok(formats)
    }

    fn layout(texts: &[&str]) -> Result<Layout, FormatFault> {
        let name = texts[0].split(':').next().unwrap();
        formats(texts)?.layout(name)
    }

    /// A layout in a line: its size, that without the padding at its end, and
    /// its fields with their offsets.
    fn line(layout: &Layout) -> String {
        let mut line = format!("{} {}:", layout.size_bytes, layout.size_no_padding_bytes());
        for FlatField { path, ty, array_length, offset_bytes } in layout.flatten() {
            let length = array_length.map_or(String::new(), |length| format!("[{length}]"));
            line += &format!(" {offset_bytes} {}{length} {path};", ty.msg_name());
        }
        line
    }

    #[test]
    fn formats_become_layouts() {
        let cases: &[(&[&str], &str)] = &[
            (
                &["a:uint64_t timestamp;float[3] xyz;uint8_t[4] _padding0;"],
                "24 20: 0 uint64 timestamp; 8 float32[3] xyz;",
            ),
            (
                &["a:uint64_t timestamp;char[5] Name;bool ok;int8_t i"],
                "15 15: 0 uint64 timestamp; 8 char[5] Name; 13 bool ok; 14 int8 i;",
            ),
            (
                &["a:uint8_t x;uint8_t[3] _padding0;b[2] n;", "b:float y;uint8_t[4] _padding0;"],
                "20 20: 0 uint8 x; 4 float32 n[0].y; 12 float32 n[1].y;",
            ),
            (
                &["a:b one;", "b:c two;", "c:double z;uint16_t w;uint8_t[6] _padding0;"],
                "16 16: 0 float64 one.two.z; 8 uint16 one.two.w;",
            ),
        ];
        for (texts, expected) in cases {
            let layout = layout(texts).unwrap();
            assert_eq!((&*layout.name, layout.message_hash), ("a", 0));
            assert_eq!(line(&layout), *expected, "{texts:?}");
        }
    }

    fn some_layout(name: &'static str, nested: Option<Layout>) -> impl Strategy<Value = Layout> {
        const SCALARS: &[&str] = &[
            "int8_t", "uint8_t", "int16_t", "uint16_t", "int32_t", "uint32_t", "int64_t",
            "uint64_t", "float", "double", "bool", "char",
        ];
        let scalar = prop::sample::select(SCALARS).prop_map(FieldType::from_c_name);
        let ty = (scalar, any::<bool>()).prop_map(move |(scalar, is_nested)| match &nested {
            Some(nested) if is_nested => FieldType::Message(Cow::Owned(nested.clone())),
            _ => scalar.unwrap(),
        });
        let field = (ty, prop::option::of(1..5_u32), 0..8_u32);
        (prop::collection::vec(field, 1..8), 0..8_u32).prop_map(move |(described, end)| {
            let mut size_bytes = 0;
            let mut fields = Vec::new();
            for (number, (ty, array_length, padding_bytes)) in described.into_iter().enumerate() {
                let (name, unit) = (format!("Field_{number}").into(), "".into());
                let offset_bytes = size_bytes + padding_bytes;
                let field = Field { name, ty, array_length, offset_bytes, unit };
                size_bytes = field.end_bytes() as u32;
                fields.push(field);
            }
            let (name, fields) = (name.into(), fields.into());
            Layout { name, size_bytes: size_bytes + end, message_hash: 0, fields }
        })
    }

    proptest! {
        #[test]
        fn a_layout_survives_the_way_through_a_log(
            (inner, outer) in some_layout("inner", None)
                .prop_flat_map(|inner| (Just(inner.clone()), some_layout("outer", Some(inner))))
        ) {
            let mut formats = Formats::default();
            for layout in [&outer, &inner] {
                formats.add(0, &format!("{}:{}", layout.name, layout.o_fields())).unwrap();
            }
            prop_assert_eq!(formats.layout("outer"), Ok(outer));
        }
    }

    #[test]
    fn a_format_that_makes_no_sense_is_named() {
        let cases: &[(&[&str], &str)] = &[
            (&["uint64_t timestamp;"], "the format \"uint64_t timestamp;\" is not `NAME:"),
            (&[":uint64_t timestamp;"], "is not `NAME:"),
            (&["a:float x;", "a:float x;"], "two formats of message a"),
            (&["a:float;"], "\"float\" in the format of message a is not"),
            (&["a:float  x;"], "\"float  x\" in the format of message a is not"),
            (&["a:float[x] y;"], "\"float[x] y\" in the format of message a is not"),
            (&["a:float[0] y;"], "\"float[0] y\" in the format of message a is not"),
            (&["a:float[-1] y;"], "\"float[-1] y\" in the format of message a is not"),
            (&["a:float[2][2] y;"], "\"float[2][2] y\" in the format of message a is not"),
            (&["a:float128 x;"], "field x of message a is of type float128, which is no type"),
            (&["a:b x;", "b:a y;"], "go round in a circle: a in b in a"),
            (&["a:a x;"], "go round in a circle: a in a"),
            (&["a:float x;float x;"], "field \"x\" of message a"),
            (&["a:"], "message a has 0 bytes"),
            (&["a:b x;", "b:"], "message a has 0 bytes"),
            (&["a:double[8192] x;"], "message a has 65536 bytes"),
            (&["a:double[4294967295] x;"], "message a has 4294967295 bytes"),
        ];
        for (texts, expected) in cases {
            let error = layout(texts).unwrap_err().to_string();
            assert!(error.contains(expected), "{texts:?}: {error}");
        }
        assert_eq!(formats(&[]).unwrap().layout("a"), Err(FormatFault::Unknown("a".to_string())));
    }

    #[test]
    fn the_place_of_a_mistake_is_that_of_the_format_at_fault() {
        let formats = formats(&["a:float x;", "b:c y;", "c:d z;", "e:float x;"]).unwrap();
        let (at_byte, fault) = formats.check().unwrap_err();
        assert_eq!(at_byte, 2);
        assert!(matches!(fault, FormatFault::UnknownType { message, .. } if message == "c"));
    }

    #[test]
    fn formats_that_multiply_are_refused_before_they_fill_the_memory() {
        let wide = |inner: char| format!("{inner} x;").repeat(9_000).replace(" x", " _padding");
        let texts: Vec<String> = ('a'..='g')
            .map(|name| match name {
                'g' => "g:uint8_t x;".to_string(),
                _ => format!("{name}:{}", wide((name as u8 + 1) as char)),
            })
            .collect();
        let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
        assert!(matches!(layout(&texts), Err(FormatFault::Layout(LayoutFault::Size { .. }))));

        let chain: Vec<String> = (0..4_000).map(|n| format!("n{n}:n{} x;", n + 1)).collect();
        let chain: Vec<&str> = chain.iter().map(String::as_str).collect();
        assert!(matches!(layout(&chain), Err(FormatFault::TooDeep(_))));
    }
}
