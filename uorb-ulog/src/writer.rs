//! Writes a log, record by record, in PX4's order.
//!
//! All definitions stand at the head: readers take formats from there and from
//! nowhere else. px4-ulog and yule_log end at a topic that is announced later
//! without a format at the head, pyulog does too, with an exception. So
//! [`Writer::begin`] is given all formats there will be, and a topic of another
//! layout is refused with [`Announced::NeedsNewFile`]. Instances of known formats
//! may be announced at any time.
//!
//! The timestamps of a series are those of its publisher, byte for byte, in the
//! order in which they were published. No reader demands that they rise.

use std::collections::HashMap;
use std::io::{self, Write};
use std::time::Duration;

use uorb_core::Layout;

use crate::schema::{RECORD_MAX_BYTES, Schema, Shape, Unloggable};

/// What a log says before its first message.
#[derive(Clone, Debug, Default)]
pub struct Head {
    /// When the log begins, in microseconds since the start of the machine.
    pub timestamp_us: u64,
    /// What is known of the vehicle: `sys_name` and the like.
    pub infos: Vec<(String, Value)>,
    /// Name and layout of all topics that may be announced.
    pub topics: Vec<(String, Layout)>,
    /// The parameters of the vehicle.
    pub parameters: Vec<Parameter>,
    /// Texts of several lines, each under its name.
    pub texts: Vec<(String, Vec<String>)>,
}

/// A value of an information record.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Value {
    Text(String),
    Int32(i32),
    Uint32(u32),
}

/// A parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Up to 16 letters, in PX4.
    pub name: String,
    /// What it is now.
    pub value: ParameterValue,
    /// What the firmware has it at, if that is known.
    pub default: Option<ParameterValue>,
}

/// A parameter's value.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs)]
pub enum ParameterValue {
    Int32(i32),
    Float(f32),
}

/// The number of a series in one log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SeriesId(u16);

/// What came of announcing an instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Announced {
    /// Its messages can be written.
    As(SeriesId),
    /// Its format is not at the head of this log.
    NeedsNewFile,
}

/// How grave a logged text is, as the Linux kernel counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[allow(missing_docs)]
pub enum Level {
    Emergency = b'0',
    Alert = b'1',
    Critical = b'2',
    Error = b'3',
    Warning = b'4',
    Notice = b'5',
    Info = b'6',
    Debug = b'7',
}

impl Level {
    /// From 0, the gravest, to 7; what is beyond is as 7.
    pub fn of(severity: u8) -> Self {
        match severity {
            0 => Self::Emergency,
            1 => Self::Alert,
            2 => Self::Critical,
            3 => Self::Error,
            4 => Self::Warning,
            5 => Self::Notice,
            6 => Self::Info,
            _ => Self::Debug,
        }
    }
}

/// A log that is being written.
#[derive(Debug)]
pub struct Writer<W> {
    out: W,
    schema: Schema,
    series: HashMap<(String, u8), SeriesId>,
    shapes: Vec<Shape>,
    written_bytes: u64,
    record: Vec<u8>,
}

const MAGIC: &[u8] = b"ULog\x01\x12\x35\x01";
const SYNC: [u8; 8] = [0x2f, 0x73, 0x13, 0x20, 0x25, 0x0c, 0xbb, 0x12];
/// Of `compat_flags[0]`: there are records of type Q.
const HAS_DEFAULTS: u8 = 1;
/// Of a default: the system's own, and the one of this airframe.
const OF_SYSTEM_AND_SETUP: u8 = 3;

impl<W: Write> Writer<W> {
    /// Writes the head. Topics that no log can hold are left out of it.
    ///
    /// # Errors
    ///
    /// As `out`.
    pub fn begin(out: W, head: &Head) -> io::Result<Self> {
        let mut schema = Schema::default();
        schema.reserve(&head.topics);
        for (topic, layout) in &head.topics {
            // Whoever announces it is told.
            let _ = schema.add(topic, layout);
        }
        let mut writer = Self {
            out,
            schema,
            series: HashMap::new(),
            shapes: Vec::new(),
            written_bytes: 0,
            record: Vec::new(),
        };
        writer.write_head(head)?;
        Ok(writer)
    }

    fn write_head(&mut self, head: &Head) -> io::Result<()> {
        let start = [MAGIC, &head.timestamp_us.to_le_bytes()].concat();
        self.out.write_all(&start)?;
        self.written_bytes += start.len() as u64;
        let mut flags = [0; 40];
        if head.parameters.iter().any(Parameter::has_default) {
            flags[0] = HAS_DEFAULTS;
        }
        self.record(b'B', &[&flags])?;
        for (key, value) in &head.infos {
            let (key, value) = pair(key, value);
            self.record(b'I', &[&[key.len() as u8], key.as_bytes(), &value])?;
        }
        let formats: Vec<_> =
            self.schema.formats().map(|(name, text)| format!("{name}:{text}")).collect();
        for format in formats {
            self.record(b'F', &[format.as_bytes()])?;
        }
        for Parameter { name, value, .. } in &head.parameters {
            self.parameter(name, *value)?;
        }
        for parameter in head.parameters.iter().filter(|one| one.has_default()) {
            let Some(default) = parameter.default else { continue };
            let (key, value) = default.pair(&parameter.name);
            let key_bytes = key.len() as u8;
            self.record(b'Q', &[&[OF_SYSTEM_AND_SETUP, key_bytes], key.as_bytes(), &value])?;
        }
        for (name, lines) in &head.texts {
            for (number, line) in lines.iter().enumerate() {
                let (key, line) = pair(name, &Value::Text(line.clone()));
                let is_continued = u8::from(number > 0);
                let start = [is_continued, key.len() as u8];
                self.record(b'M', &[&start, key.as_bytes(), &line])?;
            }
        }
        Ok(())
    }

    /// Announces an instance, if it is new.
    ///
    /// # Errors
    ///
    /// As `out`. [`Unloggable`] where no log can hold it.
    pub fn announce(
        &mut self,
        topic: &str,
        instance: u8,
        layout: &Layout,
    ) -> io::Result<Result<Announced, Unloggable>> {
        let shape = match self.schema.has(topic, layout) {
            Ok(Some(shape)) => shape,
            Ok(None) | Err(Unloggable::OtherFormat) => return Ok(Ok(Announced::NeedsNewFile)),
            Err(why) => return Ok(Err(why)),
        };
        if let Some(&known) = self.series.get(&(topic.to_string(), instance)) {
            return Ok(Ok(Announced::As(known)));
        }
        // Ten instances each of 6,553 topics.
        let Ok(number) = u16::try_from(self.shapes.len()) else {
            return Ok(Ok(Announced::NeedsNewFile));
        };
        let [low, high] = number.to_le_bytes();
        self.record(b'A', &[&[instance, low, high], topic.as_bytes()])?;
        let id = SeriesId(number);
        self.shapes.push(shape);
        self.series.insert((topic.to_string(), instance), id);
        Ok(Ok(Announced::As(id)))
    }

    /// Writes a message, with or without the padding at its end.
    ///
    /// # Errors
    ///
    /// As `out`.
    ///
    /// # Panics
    ///
    /// If it is not of the size of its layout, or the series is another log's.
    pub fn message(&mut self, id: SeriesId, published_us: u64, message: &[u8]) -> io::Result<()> {
        let shape = self.shapes[usize::from(id.0)];
        let is_whole = [shape.size_bytes, shape.logged_bytes].contains(&message.len());
        assert!(is_whole, "{} bytes are no message of {shape:?}", message.len());
        let message = &message[..shape.logged_bytes];
        let published = published_us.to_le_bytes();
        let stamp: &[u8] = if shape.timestamp_at.is_some() { &[] } else { &published };
        self.record(b'D', &[&id.0.to_le_bytes(), stamp, message])
    }

    /// How many bytes a message of this size takes at most.
    pub const fn message_bytes(size_bytes: usize) -> usize {
        3 + 2 + 8 + size_bytes
    }

    /// Writes a parameter that has changed.
    ///
    /// # Errors
    ///
    /// As `out`.
    pub fn parameter(&mut self, name: &str, value: ParameterValue) -> io::Result<()> {
        let (key, value) = value.pair(name);
        self.record(b'P', &[&[key.len() as u8], key.as_bytes(), &value])
    }

    /// Writes a line of words.
    ///
    /// # Errors
    ///
    /// As `out`.
    pub fn text(&mut self, level: Level, timestamp_us: u64, text: &str) -> io::Result<()> {
        let text = cut(text, RECORD_MAX_BYTES - 9);
        self.record(b'L', &[&[level as u8], &timestamp_us.to_le_bytes(), text.as_bytes()])
    }

    /// Notes that messages are missing here. What is longer than a record can
    /// say, 65.5 seconds, is several.
    ///
    /// # Errors
    ///
    /// As `out`.
    pub fn dropout(&mut self, length: Duration) -> io::Result<()> {
        // One that is too short to count is one all the same.
        let mut left_ms = length.as_millis().max(1);
        while left_ms > 0 {
            let ms = u16::try_from(left_ms).unwrap_or(u16::MAX);
            self.record(b'O', &[&ms.to_le_bytes()])?;
            left_ms -= u128::from(ms);
        }
        Ok(())
    }

    /// Writes a mark by which readers find their way back into a damaged log.
    ///
    /// # Errors
    ///
    /// As `out`.
    pub fn sync(&mut self) -> io::Result<()> {
        self.record(b'S', &[&SYNC])
    }

    /// How long the log is by now.
    pub fn written_bytes(&self) -> u64 {
        self.written_bytes
    }

    /// Where it is written to.
    pub fn get_mut(&mut self) -> &mut W {
        &mut self.out
    }

    /// In one write, so that whoever is killed leaves a whole record, or a part
    /// that the kernel decides on.
    fn record(&mut self, kind: u8, payload: &[&[u8]]) -> io::Result<()> {
        self.record.clear();
        self.record.extend_from_slice(&[0, 0, kind]);
        payload.iter().for_each(|part| self.record.extend_from_slice(part));
        let length = self.record.len() - 3;
        let length = u16::try_from(length).map_err(|_| {
            let what = format!("a record of type {} has {length} bytes", char::from(kind));
            io::Error::new(io::ErrorKind::InvalidInput, what)
        })?;
        self.record[..2].copy_from_slice(&length.to_le_bytes());
        self.out.write_all(&self.record)?;
        self.written_bytes += self.record.len() as u64;
        Ok(())
    }
}

impl Parameter {
    /// PX4 notes a default only where the value is another.
    fn has_default(&self) -> bool {
        self.default.is_some_and(|default| default != self.value)
    }
}

impl ParameterValue {
    fn pair(self, name: &str) -> (String, [u8; 4]) {
        let name = cut(name, 200);
        match self {
            Self::Int32(value) => (format!("int32_t {name}"), value.to_le_bytes()),
            Self::Float(value) => (format!("float {name}"), value.to_le_bytes()),
        }
    }
}

/// Key, with its type, and value of an information.
fn pair(key: &str, value: &Value) -> (String, Vec<u8>) {
    let key = cut(key, 200);
    match value {
        Value::Int32(value) => (format!("int32_t {key}"), value.to_le_bytes().into()),
        Value::Uint32(value) => (format!("uint32_t {key}"), value.to_le_bytes().into()),
        Value::Text(text) => {
            let text = cut(text, RECORD_MAX_BYTES - 2 - 255);
            (format!("char[{}] {key}", text.len()), text.as_bytes().into())
        }
    }
}

/// As much of a text as fits.
fn cut(text: &str, max_bytes: usize) -> &str {
    &text[..text.floor_char_boundary(max_bytes)]
}

#[cfg(test)]
mod tests;
