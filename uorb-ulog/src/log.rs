//! What the records of a log say: which topics there are, and their messages.
//!
//! px4-ulog reads the records. What replay needs besides comes from the same
//! records here, because px4-ulog keeps it to itself: the text of the formats,
//! the topics that were announced, and where in the file a mistake is. It is
//! given only the records that matter to replay, and only after their sizes
//! were checked: some that are too short would end the process.

use std::cell::Cell;
use std::collections::HashMap;
use std::io;

use px4_ulog::stream_parser::model::UlogParseError;
use px4_ulog::stream_parser::{DataMessage, LogParser};
use uorb_core::{Field, FieldType, Layout};

use crate::format::{FormatFault, Formats};
use crate::note::RawNote;
use crate::record::{Next, NoLog, Record, Records, Source};

/// A topic instance as the log has it.
#[derive(Debug)]
pub struct Series {
    /// The topic's name, as the file says: not checked.
    pub topic: String,
    /// As the file says: not checked.
    pub instance: u8,
    /// What its messages look like.
    pub layout: Layout,
}

/// One thing that a log tells, in the order of the file.
#[derive(Debug)]
pub enum Told<'a> {
    /// When the logger was started, as the header has it.
    Began {
        /// In microseconds since the start of the vehicle.
        timestamp_us: u64,
    },
    /// A topic instance. They are numbered as they come, from 0 up.
    Series(Series),
    /// A message of one of them.
    Message(Message<'a>),
}

/// One thing that stands in a log, notes among them.
#[derive(Debug)]
pub enum Said<'a> {
    /// What [`read`] tells.
    Told(Told<'a>),
    /// What else there is.
    Noted(RawNote<'a>),
}

/// A message as it was logged.
#[derive(Clone, Copy, Debug)]
pub struct Message<'a> {
    /// The number of its series.
    pub series: usize,
    /// When it was recorded; None where it has no timestamp, or 0.
    pub timestamp_us: Option<u64>,
    /// Without the padding at its end.
    pub bytes: &'a [u8],
}

/// How a log ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// Behind a record.
    Whole,
    /// Somewhere in a record that begins at this byte.
    CutOff {
        /// Where the record begins that is not whole.
        at_byte: u64,
    },
}

/// Why a log cannot be read, or not any further.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// The file cannot be read.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// It is another kind of file.
    #[error(transparent)]
    NoLog(#[from] NoLog),
    /// A log in which nobody says anything.
    #[error("it ends at byte {0}, and there is no message in it")]
    NoMessage(u64),
    /// The log is damaged, or its author was mistaken.
    #[error("byte {at_byte}: {what}")]
    Record {
        /// Where the record begins.
        at_byte: u64,
        /// What is wrong with it.
        what: RecordFault,
    },
}

/// What is wrong with a record. Its words say it.
#[allow(missing_docs)]
#[derive(Debug, thiserror::Error)]
pub enum RecordFault {
    #[error("{0:#04x} is no type of record: the log is damaged here")]
    Kind(u8),
    #[error("a record of type {kind} has {size_bytes} bytes, too few for one")]
    TooShort { kind: char, size_bytes: usize },
    #[error("{key:?} in a record of type {kind} is not `TYPE NAME` of a type that it may have")]
    Key { kind: char, key: String },
    #[error("the {0} is not UTF-8")]
    NotText(&'static str),
    #[error(transparent)]
    Format(#[from] FormatFault),
    #[error("number {id} is {now}, and was {before}")]
    Announced { id: u16, before: String, now: String },
    #[error("a message of number {0}, under which no topic was announced")]
    NotAnnounced(u16),
    #[error(
        "a message of {topic} has {found_bytes} bytes; its format has {size_bytes}, \
         {logged_bytes} without the padding at its end"
    )]
    Size { topic: String, found_bytes: usize, size_bytes: usize, logged_bytes: usize },
    #[error("the flags say that records were appended at byte {0}, where they cannot be")]
    Appended(u64),
    #[error("the file ends here or soon, before the records that were appended to it")]
    LacksAppended,
    #[error("{0}")]
    Parser(String),
}

/// Tells the topics and the messages of a log, up to the record that begins at
/// `until_byte`.
///
/// # Errors
///
/// [`Fault`] where the log cannot be read, or not any further; what `tell` returns.
pub fn read<E: From<Fault>>(
    source: &mut dyn Source,
    until_byte: u64,
    mut tell: impl FnMut(Told<'_>) -> Result<(), E>,
) -> Result<Ending, E> {
    read_all(source, until_byte, |said| match said {
        Said::Told(told) => tell(told),
        Said::Noted(_) => Ok(()),
    })
}

/// As [`read`], and tells the notes too, as they stand in the file.
///
/// # Errors
///
/// As [`read`].
pub fn read_all<E: From<Fault>>(
    source: &mut dyn Source,
    until_byte: u64,
    mut say: impl FnMut(Said<'_>) -> Result<(), E>,
) -> Result<Ending, E> {
    let decoded = Cell::new(None);
    let mut on_message = |message: &DataMessage<'_>| decoded.set(Some(message.msg_id));
    let mut parser = LogParser::default();
    parser.set_data_message_callback(&mut on_message);

    let (mut records, header) =
        Records::begin(source).map_err(Fault::from)?.map_err(Fault::from)?;
    let mut parse = |at_byte, bytes: &[u8]| {
        let what = |error: UlogParseError| RecordFault::Parser(first_line(&error.description));
        parser.consume_bytes(bytes).map_err(|error| at(at_byte, what(error)))
    };
    parse(0, &header)?;
    say(Said::Told(Told::Began { timestamp_us: number(&header[8..]) }))?;
    let mut topics = Topics::default();
    let mut is_first = true;

    while records.at_byte() < until_byte {
        let at_byte = records.at_byte();
        let mut record = match records.next().map_err(Fault::from)? {
            Next::Record(record) => record,
            // A length that is damaged looks like an end, too.
            Next::CutOff(Some(kind)) if !kind.is_ascii_uppercase() => {
                return Err(at(at_byte, RecordFault::Kind(kind)).into());
            }
            Next::CutOff(_) => return Ok(Ending::CutOff { at_byte }),
            Next::LacksAppended => return Err(at(at_byte, RecordFault::LacksAppended).into()),
            Next::End => return Ok(Ending::Whole),
        };
        // Where records were appended, it is not the byte that we stood at.
        let at_byte = record.at_byte;
        if std::mem::take(&mut is_first) && record.kind != b'B' {
            // Logs of before 2017 have no flags; px4-ulog waits for some.
            parse(at_byte, &NO_FLAGS)?;
        }
        let fault = |what: RecordFault| at(at_byte, what);
        match record.kind {
            b'B' => {
                parse(at_byte, record.bytes)?;
                let offsets = appended_offsets(record.payload());
                say(Said::Noted(RawNote { at_byte, kind: b'B', payload: record.payload() }))?;
                records.append(&offsets).map_err(RecordFault::Appended).map_err(fault)?;
            }
            b'F' => {
                topics.add_format(&record).map_err(fault)?;
                parse(at_byte, record.bytes)?;
            }
            b'A' => {
                if topics.series.is_empty() {
                    // px4-ulog resolves all of them now; of some it would not
                    // come to an end.
                    let fault = |(at_byte, fault)| at(at_byte, RecordFault::Format(fault));
                    topics.formats.check().map_err(fault)?;
                }
                match topics.announce(record.payload()).map_err(fault)? {
                    Announced::Again => {}
                    Announced::OtherNumber => parse(at_byte, record.bytes)?,
                    Announced::New(series) => {
                        parse(at_byte, record.bytes)?;
                        say(Said::Told(Told::Series(series)))?;
                    }
                }
            }
            b'D' => {
                topics.fit(&mut record).map_err(fault)?;
                parse(at_byte, record.bytes)?;
                if let Some(id) = decoded.take() {
                    let message = topics.message(id, &record.payload()[2..]);
                    say(Said::Told(Told::Message(message)))?;
                }
            }
            // Parameters, log lines and the like, and what a later version of
            // the format may add.
            kind if kind.is_ascii_uppercase() => {
                say(Said::Noted(RawNote { at_byte, kind, payload: record.payload() }))?;
            }
            kind => return Err(fault(RecordFault::Kind(kind)).into()),
        }
    }
    Ok(Ending::Whole)
}

pub(crate) fn at(at_byte: u64, what: RecordFault) -> Fault {
    Fault::Record { at_byte, what }
}

/// A record of flags of which none is set.
const NO_FLAGS: [u8; 43] = {
    let mut record = [0; 43];
    record[0] = 40;
    record[2] = b'B';
    record
};

/// The three offsets at the end of the flags, which are 40 bytes long: px4-ulog
/// has seen to that.
fn appended_offsets(flags: &[u8]) -> [u64; 3] {
    [16, 24, 32].map(|at| number(&flags[at..]))
}

fn number(bytes: &[u8]) -> u64 {
    u64::from_le_bytes(bytes[..8].try_into().expect("8 bytes"))
}

/// px4-ulog adds pages of its own state to some errors.
fn first_line(description: &str) -> String {
    description.lines().next().unwrap_or_default().to_string()
}

/// The topics that a log has announced so far.
#[derive(Default)]
struct Topics {
    formats: Formats,
    series: HashMap<(String, u8), usize>,
    /// By the number that stands in a message.
    by_id: HashMap<u16, Announcement>,
}

struct Announcement {
    topic: String,
    instance: u8,
    series: usize,
    size_bytes: usize,
    logged_bytes: usize,
    timestamp_at: Option<usize>,
}

enum Announced {
    /// Nothing new.
    Again,
    /// A series that we have, under one more number.
    OtherNumber,
    New(Series),
}

impl Topics {
    fn add_format(&mut self, record: &Record<'_>) -> Result<(), RecordFault> {
        let text = str::from_utf8(record.payload());
        let text = text.map_err(|_| RecordFault::NotText("format"))?;
        Ok(self.formats.add(record.at_byte, text)?)
    }

    fn announce(&mut self, payload: &[u8]) -> Result<Announced, RecordFault> {
        let &[instance, low, high, ref topic @ ..] = payload else {
            return Err(RecordFault::TooShort { kind: 'A', size_bytes: payload.len() });
        };
        let id = u16::from_le_bytes([low, high]);
        let topic = str::from_utf8(topic).map_err(|_| RecordFault::NotText("topic"))?;
        if let Some(before) = self.by_id.get(&id) {
            if (before.topic.as_str(), before.instance) == (topic, instance) {
                return Ok(Announced::Again);
            }
            let before = format!("{}{}", before.topic, before.instance);
            let now = format!("{topic}{instance}");
            return Err(RecordFault::Announced { id, before, now });
        }
        let layout = self.formats.layout(topic)?;
        let next = self.series.len();
        let series = *self.series.entry((topic.to_string(), instance)).or_insert(next);
        let timestamp = |field: &&Field| {
            field.name == "timestamp"
                && field.ty == FieldType::Uint64
                && field.array_length.is_none()
        };
        let announcement = Announcement {
            topic: topic.to_string(),
            instance,
            series,
            size_bytes: layout.size_bytes as usize,
            logged_bytes: layout.size_no_padding_bytes() as usize,
            timestamp_at: layout
                .fields
                .iter()
                .find(timestamp)
                .map(|field| field.offset_bytes as usize),
        };
        self.by_id.insert(id, announcement);
        if series < next {
            return Ok(Announced::OtherNumber);
        }
        Ok(Announced::New(Series { topic: topic.to_string(), instance, layout }))
    }

    /// Checks the size of a message, and leaves off the padding at its end: most
    /// logs do not have it, all may.
    fn fit(&self, record: &mut Record<'_>) -> Result<(), RecordFault> {
        let &[low, high, ref message @ ..] = record.payload() else {
            let size_bytes = record.payload().len();
            return Err(RecordFault::TooShort { kind: 'D', size_bytes });
        };
        let id = u16::from_le_bytes([low, high]);
        let announced = self.by_id.get(&id).ok_or(RecordFault::NotAnnounced(id))?;
        let Announcement { size_bytes, logged_bytes, .. } = *announced;
        match message.len() {
            found if found == logged_bytes => {}
            found if found == size_bytes => record.shorten(2 + logged_bytes),
            found_bytes => {
                let topic = announced.topic.clone();
                return Err(RecordFault::Size { topic, found_bytes, size_bytes, logged_bytes });
            }
        }
        Ok(())
    }

    /// A message that fits.
    fn message<'a>(&self, id: u16, bytes: &'a [u8]) -> Message<'a> {
        let announced = &self.by_id[&id];
        let timestamp_us = announced.timestamp_at.map(|at| number(&bytes[at..]));
        // 0 is what nobody has stamped.
        let timestamp_us = timestamp_us.filter(|&timestamp_us| timestamp_us != 0);
        Message { series: announced.series, timestamp_us, bytes }
    }
}
