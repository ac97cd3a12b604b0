//! What a log says besides topics and messages: about the vehicle, about its
//! parameters, and about itself.
//!
//! A replay has no use for any of it, so a note is told as it stands in the
//! file, and only who wants to know what it says has it read.

use crate::log::{Fault, RecordFault, at};
use crate::writer::ParameterValue;

/// A record that is neither a format nor a topic nor a message.
#[derive(Clone, Copy, Debug)]
pub struct RawNote<'a> {
    /// Where it begins.
    pub at_byte: u64,
    /// Its type, a capital letter.
    pub kind: u8,
    /// Without its length and its type.
    pub payload: &'a [u8],
}

/// What a note says.
#[derive(Clone, Debug, PartialEq)]
pub enum Note<'a> {
    /// The flags at the head of the file.
    Flags {
        /// What a reader may ignore.
        compat: [u8; 8],
        /// What it must know; the lowest bit of the first: records were appended.
        incompat: [u8; 8],
        /// Where the appended records begin; 0: nowhere.
        appended: [u64; 3],
    },
    /// Something about the vehicle or the log, under its name.
    Info(Info<'a>),
    /// A part of something longer.
    MultiInfo {
        /// It goes on from the part before of the same name.
        is_continued: bool,
        /// The part.
        info: Info<'a>,
    },
    /// A parameter, at the start or, between messages, when it was changed.
    Parameter {
        /// Its name.
        name: &'a str,
        /// Its value from here on.
        value: ParameterValue,
    },
    /// What a parameter would be if nobody had set it.
    Default {
        /// Bit 0: everywhere; bit 1: of this airframe.
        types: u8,
        /// Its name.
        name: &'a str,
        /// Its default.
        value: ParameterValue,
    },
    /// A line of text.
    Text {
        /// As syslog counts: '0' for an emergency, '7' for debugging.
        level: u8,
        /// Who said it, if the log tells.
        tag: Option<u16>,
        /// When, in microseconds since the start of the vehicle.
        timestamp_us: u64,
        /// What.
        text: String,
    },
    /// Messages were lost for so long.
    Dropout {
        /// In milliseconds.
        duration_ms: u16,
    },
    /// A place from which a damaged log can be read on.
    Sync,
    /// Of a type that nobody here knows, or that says nothing.
    Other,
}

/// A name and a value.
#[derive(Clone, Debug, PartialEq)]
pub struct Info<'a> {
    /// Under which it is known: `sys_name`.
    pub name: &'a str,
    /// What it is.
    pub value: InfoValue<'a>,
}

/// The value of an [`Info`].
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub enum InfoValue<'a> {
    Text(String),
    Int(i64),
    Uint(u64),
    Float(f64),
    Bool(bool),
    /// An array of anything but letters.
    Bytes(&'a [u8]),
}

impl<'a> RawNote<'a> {
    /// Reads what it says.
    ///
    /// # Errors
    ///
    /// It is too short for its type, or not what its type says.
    pub fn read(self) -> Result<Note<'a>, Fault> {
        let note = match self.kind {
            b'B' => self.flags(),
            b'I' => info(self.payload).map(Note::Info),
            b'M' => match self.payload {
                [continued, rest @ ..] => {
                    let is_continued = *continued != 0;
                    info(rest).map(|info| Note::MultiInfo { is_continued, info })
                }
                [] => Err(Odd::Short),
            },
            b'P' => parameter(self.payload).map(|(name, value)| Note::Parameter { name, value }),
            b'Q' => match self.payload {
                [types, rest @ ..] => parameter(rest).map(|(name, value)| Note::Default {
                    types: *types,
                    name,
                    value,
                }),
                [] => Err(Odd::Short),
            },
            b'L' => self.text(false),
            b'C' => self.text(true),
            b'O' => first(self.payload, 0)
                .map(|it| Note::Dropout { duration_ms: u16::from_le_bytes(it) }),
            b'S' => Ok(Note::Sync),
            _ => Ok(Note::Other),
        };
        let Self { at_byte, kind, payload } = self;
        note.map_err(|odd| {
            let kind = char::from(kind);
            at(
                at_byte,
                match odd {
                    Odd::Short => RecordFault::TooShort { kind, size_bytes: payload.len() },
                    Odd::NotText(what) => RecordFault::NotText(what),
                    Odd::Key(key) => RecordFault::Key { kind, key },
                },
            )
        })
    }

    fn flags(self) -> Result<Note<'a>, Odd> {
        let offset = |at_byte| first(self.payload, at_byte).map(u64::from_le_bytes);
        Ok(Note::Flags {
            compat: first(self.payload, 0)?,
            incompat: first(self.payload, 8)?,
            appended: [offset(16)?, offset(24)?, offset(32)?],
        })
    }

    fn text(self, is_tagged: bool) -> Result<Note<'a>, Odd> {
        let [level] = first(self.payload, 0)?;
        let tag = is_tagged.then(|| first(self.payload, 1).map(u16::from_le_bytes)).transpose()?;
        let head_bytes = if is_tagged { 3 } else { 1 };
        let timestamp_us = u64::from_le_bytes(first(self.payload, head_bytes)?);
        let text = String::from_utf8_lossy(&self.payload[head_bytes + 8..]).into_owned();
        Ok(Note::Text { level, tag, timestamp_us, text })
    }
}

/// What is wrong with a note.
enum Odd {
    Short,
    NotText(&'static str),
    Key(String),
}

fn first<const N: usize>(bytes: &[u8], from: usize) -> Result<[u8; N], Odd> {
    bytes.get(from..).and_then(|bytes| bytes.first_chunk()).copied().ok_or(Odd::Short)
}

/// `LENGTH TYPE NAME` and a value.
fn keyed(payload: &[u8]) -> Result<(&str, &str, &[u8]), Odd> {
    let [length, rest @ ..] = payload else { return Err(Odd::Short) };
    let (key, value) = rest.split_at_checked((*length).into()).ok_or(Odd::Short)?;
    let key = str::from_utf8(key).map_err(|_| Odd::NotText("name"))?;
    let (ty, name) = key.split_once(' ').ok_or_else(|| Odd::Key(key.to_string()))?;
    Ok((ty, name, value))
}

fn info(payload: &[u8]) -> Result<Info<'_>, Odd> {
    let (ty, name, value) = keyed(payload)?;
    let value = match ty {
        "int8_t" => InfoValue::Int(i8::from_le_bytes(first(value, 0)?).into()),
        "int16_t" => InfoValue::Int(i16::from_le_bytes(first(value, 0)?).into()),
        "int32_t" => InfoValue::Int(i32::from_le_bytes(first(value, 0)?).into()),
        "int64_t" => InfoValue::Int(i64::from_le_bytes(first(value, 0)?)),
        "uint8_t" => InfoValue::Uint(u8::from_le_bytes(first(value, 0)?).into()),
        "uint16_t" => InfoValue::Uint(u16::from_le_bytes(first(value, 0)?).into()),
        "uint32_t" => InfoValue::Uint(u32::from_le_bytes(first(value, 0)?).into()),
        "uint64_t" => InfoValue::Uint(u64::from_le_bytes(first(value, 0)?)),
        "float" => InfoValue::Float(f32::from_le_bytes(first(value, 0)?).into()),
        "double" => InfoValue::Float(f64::from_le_bytes(first(value, 0)?)),
        "bool" => InfoValue::Bool(first::<1>(value, 0)? != [0]),
        // Damage to a text is no reason not to show the rest of it.
        ty if ty == "char" || ty.starts_with("char[") => {
            InfoValue::Text(String::from_utf8_lossy(value).into_owned())
        }
        _ => InfoValue::Bytes(value),
    };
    Ok(Info { name, value })
}

fn parameter(payload: &[u8]) -> Result<(&str, ParameterValue), Odd> {
    let (ty, name, value) = keyed(payload)?;
    let value = match ty {
        "int32_t" => ParameterValue::Int32(i32::from_le_bytes(first(value, 0)?)),
        "float" => ParameterValue::Float(f32::from_le_bytes(first(value, 0)?)),
        _ => return Err(Odd::Key(format!("{ty} {name}"))),
    };
    Ok((name, value))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn note(kind: u8, payload: &[u8]) -> Result<Note<'_>, String> {
        RawNote { at_byte: 77, kind, payload }.read().map_err(|fault| fault.to_string())
    }

    fn keyed(before: &[u8], key: &str, value: &[u8]) -> Vec<u8> {
        [before, &[key.len() as u8], key.as_bytes(), value].concat()
    }

    #[test]
    fn notes_say_what_they_say() {
        let info = |name, value| Note::Info(Info { name, value });
        let payload = keyed(b"", "char[3] sys_name", b"PX4");
        assert_eq!(note(b'I', &payload), Ok(info("sys_name", InfoValue::Text("PX4".into()))));
        let payload = keyed(b"", "int16_t down", &(-3_i16).to_le_bytes());
        assert_eq!(note(b'I', &payload), Ok(info("down", InfoValue::Int(-3))));
        let payload = keyed(b"", "uint8_t[2] raw", &[7, 8]);
        assert_eq!(note(b'I', &payload), Ok(info("raw", InfoValue::Bytes(&[7, 8]))));
        let payload = keyed(&[1], "uint32_t n", &9_u32.to_le_bytes());
        let part = Info { name: "n", value: InfoValue::Uint(9) };
        assert_eq!(note(b'M', &payload), Ok(Note::MultiInfo { is_continued: true, info: part }));
        let payload = keyed(b"", "float MC_P", &1.5_f32.to_le_bytes());
        let value = ParameterValue::Float(1.5);
        assert_eq!(note(b'P', &payload), Ok(Note::Parameter { name: "MC_P", value }));
        let payload = keyed(&[3], "int32_t MC_I", &(-2_i32).to_le_bytes());
        let value = ParameterValue::Int32(-2);
        assert_eq!(note(b'Q', &payload), Ok(Note::Default { types: 3, name: "MC_I", value }));
        assert_eq!(note(b'O', &[1, 2]), Ok(Note::Dropout { duration_ms: 513 }));
        let time = 5_u64.to_le_bytes();
        let said = |tag| Note::Text { level: b'4', tag, timestamp_us: 5, text: "low".into() };
        assert_eq!(note(b'L', &[b"4", &time[..], b"low"].concat()), Ok(said(None)));
        assert_eq!(note(b'C', &[b"4\x02\x00", &time[..], b"low"].concat()), Ok(said(Some(2))));
        assert_eq!(note(b'S', b""), Ok(Note::Sync));
        assert_eq!(note(b'Z', b""), Ok(Note::Other));
    }

    #[test]
    fn a_note_that_is_none_is_told_with_its_byte() {
        let long_key = [200, b'a', b' '];
        for (kind, payload, expected) in [
            (b'I', &b""[..], "byte 77: a record of type I has 0 bytes, too few for one"),
            (b'I', &long_key, "byte 77: a record of type I has 3 bytes"),
            (b'M', b"", "byte 77: a record of type M has 0 bytes"),
            (b'Q', b"", "byte 77: a record of type Q has 0 bytes"),
            (b'P', b"\x07int32_t", "byte 77: \"int32_t\" in a record of type P is not `TYPE NAME`"),
            (b'P', b"\x08double X\0\0\0\0\0\0\0\0", "byte 77: \"double X\" in a record of type P"),
            (b'P', b"\x09int32_t X\0\0\0", "byte 77: a record of type P has 13 bytes"),
            (b'I', b"\x03a \xff\0", "byte 77: the name is not UTF-8"),
            (b'O', b"1", "byte 77: a record of type O has 1 bytes"),
            (b'L', b"41234567", "byte 77: a record of type L has 8 bytes"),
            (b'C', b"4", "byte 77: a record of type C has 1 bytes"),
            (b'B', b"1234", "byte 77: a record of type B has 4 bytes"),
        ] {
            let error = note(kind, payload).unwrap_err();
            assert!(error.starts_with(expected), "{error}");
        }
    }
}
