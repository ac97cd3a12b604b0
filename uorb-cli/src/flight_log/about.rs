//! What a log says about the vehicle and about itself, collected.
//!
//! A note that makes no sense is no reason to stop: the first one is kept to be
//! told at the end, and all others are read.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde_json::{Value, json};
use uorb_ulog::{Fault, InfoValue, Message, Note, ParameterValue, RawNote};

#[derive(Debug, Default)]
pub(crate) struct About {
    pub(crate) infos: BTreeMap<String, Value>,
    /// Texts of several parts, the parts together.
    pub(crate) texts: BTreeMap<String, Vec<String>>,
    /// As they were at the beginning.
    pub(crate) parameters: BTreeMap<String, ParameterValue>,
    pub(crate) defaults: BTreeMap<String, ParameterValue>,
    /// Those that were changed in flight, and when.
    pub(crate) changes: Vec<(u64, String, ParameterValue)>,
    pub(crate) dropouts: Vec<Dropout>,
    pub(crate) lines: Vec<Line>,
    /// Where records begin that were appended after a crash.
    pub(crate) appended: Vec<u64>,
    /// The first note that makes no sense.
    pub(crate) odd: Option<Fault>,
    has_begun: bool,
    now_us: u64,
}

/// Messages were lost.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Dropout {
    pub(crate) at_us: u64,
    pub(crate) duration_ms: u16,
}

/// What somebody said in flight.
#[derive(Debug)]
pub(crate) struct Line {
    pub(crate) at_us: u64,
    pub(crate) level: u8,
    pub(crate) text: String,
}

impl About {
    /// A topic was announced: what is told of parameters from here on is told
    /// in flight.
    pub(crate) fn begin_data(&mut self) {
        self.has_begun = true;
    }

    /// What is told from here on is told after this message.
    pub(crate) fn pass(&mut self, message: &Message<'_>) {
        self.now_us = message.timestamp_us.unwrap_or(self.now_us);
    }

    pub(crate) fn add(&mut self, note: RawNote<'_>) {
        match note.read() {
            Ok(note) => self.take(note),
            Err(fault) => {
                self.odd.get_or_insert(fault);
            }
        }
    }

    fn take(&mut self, note: Note<'_>) {
        match note {
            Note::Flags { appended, .. } => {
                self.appended = appended.into_iter().filter(|&offset| offset != 0).collect();
            }
            Note::Info(info) => {
                self.infos.insert(info.name.into(), value_of(&info.value));
            }
            Note::MultiInfo { is_continued, info } => {
                let parts = self.texts.entry(info.name.into()).or_default();
                let part = match value_of(&info.value) {
                    Value::String(text) => text,
                    other => other.to_string(),
                };
                match parts.last_mut() {
                    Some(last) if is_continued => last.push_str(&part),
                    _ => parts.push(part),
                }
            }
            Note::Parameter { name, value } if self.has_begun => {
                self.changes.push((self.now_us, name.into(), value));
            }
            Note::Parameter { name, value } => {
                self.parameters.insert(name.into(), value);
            }
            Note::Default { name, value, .. } => {
                self.defaults.insert(name.into(), value);
            }
            Note::Text { level, timestamp_us, text, .. } => {
                self.lines.push(Line { at_us: timestamp_us, level, text });
            }
            Note::Dropout { duration_ms } => {
                self.dropouts.push(Dropout { at_us: self.now_us, duration_ms });
            }
            Note::Sync | Note::Other => {}
        }
    }

    pub(crate) fn lost_ms(&self) -> u64 {
        self.dropouts.iter().map(|dropout| u64::from(dropout.duration_ms)).sum()
    }

    pub(crate) fn longest_dropout_ms(&self) -> u16 {
        self.dropouts.iter().map(|dropout| dropout.duration_ms).max().unwrap_or(0)
    }
}

/// A value as JSON has it, and a text as it is.
fn value_of(value: &InfoValue<'_>) -> Value {
    match value {
        InfoValue::Text(text) => json!(text),
        InfoValue::Int(value) => json!(value),
        InfoValue::Uint(value) => json!(value),
        InfoValue::Float(value) => json!(value),
        InfoValue::Bool(value) => json!(value),
        InfoValue::Bytes(bytes) => json!(bytes.iter().fold(String::new(), |mut text, byte| {
            let _ = write!(text, "{byte:02x}");
            text
        })),
    }
}

/// A value for people: a text without quotes.
pub(crate) fn text_of(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_string)
}

/// A parameter's value: a float with a point, so that it stays one.
pub(crate) fn parameter_text(value: ParameterValue) -> String {
    match value {
        ParameterValue::Int32(value) => value.to_string(),
        ParameterValue::Float(value) => format!("{value:?}"),
    }
}

/// The same for JSON, whose numbers are no NaN.
pub(crate) fn parameter_json(value: ParameterValue) -> Value {
    match value {
        ParameterValue::Int32(value) => json!(value),
        // By its digits: as a double it would have more than it has.
        ParameterValue::Float(value) => {
            json!(format!("{value:?}").parse::<f64>().ok().filter(|value| value.is_finite()))
        }
    }
}
