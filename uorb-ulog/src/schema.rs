//! How a topic's messages stand in a log.
//!
//! A log knows formats by name alone, topics and nested messages side by side,
//! and demands a timestamp of every topic. The bus is less strict. So a topic
//! without a `timestamp` gets one in front, the time at which the message was
//! published; a message of which only the size is known becomes an array of
//! bytes; and a nested message whose name a topic of other fields has gets
//! another name.

use std::borrow::Cow;
use std::collections::BTreeMap;

use uorb_core::{Field, FieldType, Layout};

/// The bytes of the longest record, without its length and type.
pub(crate) const RECORD_MAX_BYTES: usize = u16::MAX as usize;

/// Why no log can hold a topic.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unloggable {
    /// A record's length has 16 bits, with the message's number in it.
    #[error("its messages have {0} bytes; a log holds up to 65523")]
    TooLarge(u32),
    /// The text of its format fits into no record.
    #[error("its format is {0} bytes long; a log holds up to 65535")]
    FormatTooLong(usize),
    /// px4-ulog counts the elements of an array with 15 bits.
    #[error("it has an array of {0} elements, padding included; a log holds up to 32767")]
    ArrayTooLong(u32),
    /// A reader would take the name for something else.
    #[error("{0:?} is no name that a log can hold")]
    Name(String),
    /// The format of this name is another one already.
    #[error("the log has another format of this name")]
    OtherFormat,
    /// It has a field `timestamp` that is no time.
    #[error("its field timestamp is not a uint64")]
    Timestamp,
}

/// The formats of a log, by name.
#[derive(Clone, Debug, Default)]
pub(crate) struct Schema {
    /// What comes after the colon.
    texts: BTreeMap<String, String>,
    /// The topics that there will be. A nested message has the name of one only
    /// if it is the same.
    topics: BTreeMap<String, Layout>,
}

/// How the messages of one topic are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shape {
    /// The bytes of a message as it was published.
    pub(crate) size_bytes: usize,
    /// Those of them that are written.
    pub(crate) logged_bytes: usize,
    /// Where its timestamp is; None: it has none, and gets one in front.
    pub(crate) timestamp_at: Option<usize>,
}

impl Shape {
    pub(crate) fn of(layout: &Layout) -> Result<Self, Unloggable> {
        let field = layout.fields.iter().find(|field| field.name == "timestamp");
        if field.is_some_and(|it| it.ty != FieldType::Uint64 || it.array_length.is_some()) {
            return Err(Unloggable::Timestamp);
        }
        // The number of the message, and a timestamp in front.
        if layout.size_bytes as usize > RECORD_MAX_BYTES - 2 - 8 - 2 {
            return Err(Unloggable::TooLarge(layout.size_bytes));
        }
        Ok(Self {
            size_bytes: layout.size_bytes as usize,
            logged_bytes: layout.size_no_padding_bytes() as usize,
            timestamp_at: field.map(|field| field.offset_bytes as usize),
        })
    }
}

impl Schema {
    /// Keeps the names of topics for topics. Before any is added; the first of
    /// a name counts.
    pub(crate) fn reserve(&mut self, topics: &[(String, Layout)]) {
        for (topic, layout) in topics {
            self.topics.entry(topic.clone()).or_insert_with(|| layout.clone());
        }
    }

    /// Adds the format of a topic and those of the messages in it.
    pub(crate) fn add(&mut self, topic: &str, layout: &Layout) -> Result<Shape, Unloggable> {
        let (shape, texts) = self.with(topic, layout)?;
        self.texts = texts;
        Ok(shape)
    }

    /// Whether a topic can be announced with the formats that are there.
    pub(crate) fn has(&self, topic: &str, layout: &Layout) -> Result<Option<Shape>, Unloggable> {
        let (shape, texts) = self.with(topic, layout)?;
        Ok((texts == self.texts).then_some(shape))
    }

    /// Name and text of every format.
    pub(crate) fn formats(&self) -> impl Iterator<Item = (&str, &str)> {
        self.texts.iter().map(|(name, text)| (&**name, &**text))
    }

    fn with(
        &self,
        topic: &str,
        layout: &Layout,
    ) -> Result<(Shape, BTreeMap<String, String>), Unloggable> {
        let shape = Shape::of(layout)?;
        check_name(topic)?;
        let mut all = self.clone();
        all.topics.insert(topic.to_string(), layout.clone());
        let renamed = all.rename(layout)?;
        let mut text = renamed.o_fields();
        if layout.is_untyped() {
            text = untyped(layout.size_bytes);
        }
        if shape.timestamp_at.is_none() {
            text.insert_str(0, "uint64_t timestamp;");
        }
        check_text(topic, &text)?;
        match all.texts.insert(topic.to_string(), text.clone()) {
            Some(before) if before != text => Err(Unloggable::OtherFormat),
            _ => Ok((shape, all.texts)),
        }
    }

    /// The layout with the names that its nested messages have in the log, whose
    /// formats are added.
    fn rename(&mut self, layout: &Layout) -> Result<Layout, Unloggable> {
        let mut fields = Vec::new();
        for field in layout.fields.iter() {
            check_name(&field.name)?;
            let ty = match &field.ty {
                FieldType::Message(nested) => {
                    FieldType::Message(Cow::Owned(self.add_nested(nested)?))
                }
                scalar => scalar.clone(),
            };
            fields.push(Field { ty, ..field.clone() });
        }
        Ok(Layout { fields: fields.into(), ..layout.clone() })
    }

    fn add_nested(&mut self, layout: &Layout) -> Result<Layout, Unloggable> {
        check_name(&layout.name)?;
        let renamed = self.rename(layout)?;
        let text = renamed.o_fields();
        check_text(&layout.name, &text)?;
        let names = std::iter::once(layout.name.to_string())
            .chain((1..).map(|number| format!("{}_{number}", layout.name)));
        for name in names {
            let is_free = match self.texts.get(&name) {
                Some(before) => *before == text,
                None => {
                    let is_same = |topic: &Layout| {
                        let has_timestamp = topic.fields.iter().any(|it| it.name == "timestamp");
                        has_timestamp && topic.o_fields() == layout.o_fields()
                    };
                    self.topics.get(&name).is_none_or(is_same)
                        && FieldType::from_c_name(&name).is_none()
                }
            };
            if is_free {
                self.texts.insert(name.clone(), text);
                return Ok(Layout { name: name.into(), ..renamed });
            }
        }
        unreachable!("there is always one more number")
    }
}

fn check_name(name: &str) -> Result<(), Unloggable> {
    let is_letter = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_';
    let is_name = !name.is_empty()
        && name.bytes().all(is_letter)
        && !name.as_bytes()[0].is_ascii_digit()
        // Readers skip it.
        && !name.starts_with("_padding");
    if is_name { Ok(()) } else { Err(Unloggable::Name(name.chars().take(60).collect())) }
}

/// The elements of the longest array.
const ARRAY_MAX: u32 = i16::MAX as u32;

/// The fields of a message of which only the size is known.
fn untyped(size_bytes: u32) -> String {
    let firsts = (0..size_bytes).step_by(ARRAY_MAX as usize);
    let arrays = firsts.enumerate().map(|(number, first)| {
        format!("uint8_t[{}] bytes{number};", (size_bytes - first).min(ARRAY_MAX))
    });
    arrays.collect()
}

fn check_text(name: &str, text: &str) -> Result<(), Unloggable> {
    let lengths = text.split('[').skip(1).filter_map(|rest| rest.split(']').next()?.parse().ok());
    if let Some(length) = lengths.into_iter().find(|&length: &u32| length > ARRAY_MAX) {
        return Err(Unloggable::ArrayTooLong(length));
    }
    match name.len() + 1 + text.len() {
        length if length <= RECORD_MAX_BYTES => Ok(()),
        length => Err(Unloggable::FormatTooLong(length)),
    }
}
