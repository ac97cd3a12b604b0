//! Where one record of a log ends and the next begins.
//!
//! A ULog is a header of 16 bytes and then records: a length (2 bytes), a type
//! (1 byte), and as many bytes as the length says. After a crash PX4 appends
//! records at the end of the file and notes in its flags where they begin; the
//! record that the crash had cut short stands before them, and is no message.

use std::collections::VecDeque;
use std::io::{self, Read, Seek, SeekFrom};

pub(crate) const HEADER_BYTES: usize = 16;
const MAGIC: &[u8] = b"ULog\x01\x12\x35";

/// A file, or the bytes of one.
pub trait Source: Read + Seek {}
impl<S: Read + Seek> Source for S {}

/// The records of one log, in the order of the file.
pub(crate) struct Records<'s> {
    source: &'s mut dyn Source,
    /// Where the next record begins.
    at_byte: u64,
    file_bytes: u64,
    /// Where what was appended begins.
    appended: VecDeque<u64>,
    /// It was cut off before what was appended.
    lacks_appended: bool,
    buffer: Vec<u8>,
}

/// What comes next in a log.
#[derive(Debug)]
pub(crate) enum Next<'a> {
    Record(Record<'a>),
    /// The file ends inside a record: of this kind, if that much is left.
    CutOff(Option<u8>),
    /// The file ends before what should be appended to it.
    LacksAppended,
    End,
}

/// One record.
#[derive(Debug)]
pub(crate) struct Record<'a> {
    /// Where it begins, in bytes from the start of the file.
    pub(crate) at_byte: u64,
    pub(crate) kind: u8,
    /// With its length and its type.
    pub(crate) bytes: &'a mut Vec<u8>,
}

impl Record<'_> {
    pub(crate) fn payload(&self) -> &[u8] {
        &self.bytes[3..]
    }

    /// Leaves off the end of the payload.
    pub(crate) fn shorten(&mut self, payload_bytes: usize) {
        self.bytes.truncate(3 + payload_bytes);
        let length = u16::try_from(payload_bytes).expect("it was shorter than 2^16 before");
        self.bytes[..2].copy_from_slice(&length.to_le_bytes());
    }
}

/// Why a file is no log at all.
#[derive(Debug, thiserror::Error)]
pub enum NoLog {
    /// Not a byte is in it.
    #[error("it is empty")]
    Empty,
    /// It begins with other bytes than a ULog.
    #[error("it is not a ULog: it does not begin as one")]
    OtherFile,
    /// It has not even a header.
    #[error("it ends at byte {0}, inside the header of {HEADER_BYTES} bytes")]
    HeaderCutOff(u64),
}

impl<'s> Records<'s> {
    /// Begins with the header, which is returned.
    pub(crate) fn begin(
        source: &'s mut dyn Source,
    ) -> io::Result<Result<(Self, [u8; HEADER_BYTES]), NoLog>> {
        let file_bytes = source.seek(SeekFrom::End(0))?;
        source.rewind()?;
        let mut start = Vec::new();
        source.take(HEADER_BYTES as u64).read_to_end(&mut start)?;
        let magic_bytes = start.len().min(MAGIC.len());
        if start.is_empty() {
            return Ok(Err(NoLog::Empty));
        }
        if start[..magic_bytes] != MAGIC[..magic_bytes] {
            return Ok(Err(NoLog::OtherFile));
        }
        let Ok(header) = start.try_into() else {
            return Ok(Err(NoLog::HeaderCutOff(file_bytes)));
        };
        let at_byte = HEADER_BYTES as u64;
        let records = Self {
            source,
            at_byte,
            file_bytes,
            appended: VecDeque::new(),
            lacks_appended: false,
            buffer: Vec::new(),
        };
        Ok(Ok((records, header)))
    }

    /// Where the next record begins.
    pub(crate) fn at_byte(&self) -> u64 {
        self.at_byte
    }

    /// Takes note of where records were appended: rising, and not where we have
    /// been already. Otherwise returns the offset that makes no sense.
    pub(crate) fn append(&mut self, offsets: &[u64]) -> Result<(), u64> {
        let mut before = self.at_byte;
        for &offset in offsets.iter().filter(|&&offset| offset != 0) {
            if offset <= before {
                return Err(offset);
            }
            before = offset;
            self.lacks_appended |= offset >= self.file_bytes;
            if !self.lacks_appended {
                self.appended.push_back(offset);
            }
        }
        Ok(())
    }

    pub(crate) fn next(&mut self) -> io::Result<Next<'_>> {
        loop {
            let end_byte = self.appended.front().copied().unwrap_or(u64::MAX);
            let record_bytes = self.record_bytes(end_byte)?;
            let left_bytes = end_byte.min(self.file_bytes).saturating_sub(self.at_byte);
            if record_bytes <= left_bytes {
                let at_byte = self.at_byte;
                self.source.take(record_bytes - 3).read_to_end(&mut self.buffer)?;
                self.at_byte += record_bytes;
                let kind = self.buffer[2];
                return Ok(Next::Record(Record { at_byte, kind, bytes: &mut self.buffer }));
            }
            match self.appended.pop_front() {
                Some(appended) => {
                    self.source.seek(SeekFrom::Start(appended))?;
                    self.at_byte = appended;
                }
                None if self.lacks_appended => return Ok(Next::LacksAppended),
                None if left_bytes == 0 => return Ok(Next::End),
                None => return Ok(Next::CutOff(self.buffer.get(2).copied())),
            }
        }
    }

    /// Reads the length and the type of a record, and says how long it is with
    /// them: longer than the file where not even these are whole.
    fn record_bytes(&mut self, end_byte: u64) -> io::Result<u64> {
        self.buffer.clear();
        let wanted = end_byte.saturating_sub(self.at_byte).min(3);
        self.source.take(wanted).read_to_end(&mut self.buffer)?;
        match self.buffer[..] {
            [low, high, _] => Ok(u64::from(u16::from_le_bytes([low, high])) + 3),
            _ => Ok(u64::MAX),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    fn record(kind: u8, payload: &[u8]) -> Vec<u8> {
        let mut bytes = (payload.len() as u16).to_le_bytes().to_vec();
        bytes.push(kind);
        bytes.extend_from_slice(payload);
        bytes
    }

    /// A log of these records, which begins at the timestamp 1,000,000.
    fn file(records: &[Vec<u8>]) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.push(1);
        bytes.extend_from_slice(&1_000_000_u64.to_le_bytes());
        bytes.extend(records.concat());
        bytes
    }

    /// The payloads of all records, where each begins, and how it ends.
    fn read(bytes: &[u8], appended: &[u64]) -> (Vec<(u64, Vec<u8>)>, &'static str) {
        let mut source = Cursor::new(bytes);
        let (mut records, _) = Records::begin(&mut source).unwrap().unwrap();
        records.append(appended).unwrap();
        let mut all = Vec::new();
        loop {
            match records.next().unwrap() {
                Next::Record(record) => all.push((record.at_byte, record.payload().to_vec())),
                Next::CutOff(_) => return (all, "cut off"),
                Next::LacksAppended => return (all, "lacks appended"),
                Next::End => return (all, "end"),
            }
        }
    }

    #[test]
    fn records_follow_one_another() {
        let bytes = file(&[record(b'I', b"one"), record(b'I', b""), record(b'D', b"three")]);
        let expected = vec![(16, b"one".to_vec()), (22, b"".to_vec()), (25, b"three".to_vec())];
        assert_eq!(read(&bytes, &[]), (expected, "end"));
    }

    #[test]
    fn a_file_that_is_cut_anywhere_gives_the_records_before() {
        let bytes = file(&[record(b'I', b"one"), record(b'D', b"two")]);
        for end in 16..bytes.len() {
            let (records, ending) = read(&bytes[..end], &[]);
            assert_eq!(records.len(), (end - 16) / 6, "{end}");
            assert_eq!(ending, if (end - 16) % 6 == 0 { "end" } else { "cut off" }, "{end}");
        }
        for end in 0..16 {
            let mut source = Cursor::new(&bytes[..end]);
            let error = Records::begin(&mut source).unwrap().err().unwrap().to_string();
            let expected = match end {
                0 => "it is empty".to_string(),
                _ => format!("it ends at byte {end}, inside the header of 16 bytes"),
            };
            assert_eq!(error, expected);
        }
    }

    #[test]
    fn what_was_appended_follows_the_record_that_the_crash_cut_short() {
        let mut bytes = file(&[record(b'D', b"one")]);
        bytes.extend_from_slice(&record(b'D', b"never written")[..7]);
        let first = bytes.len() as u64;
        bytes.extend(record(b'D', b"two"));
        let second = bytes.len() as u64;
        bytes.extend(record(b'D', b"three"));
        let expected =
            vec![(16, b"one".to_vec()), (first, b"two".to_vec()), (second, b"three".to_vec())];
        assert_eq!(read(&bytes, &[first, second]), (expected.clone(), "end"));
        assert_eq!(read(&bytes, &[first]), (expected.clone(), "end"));

        // Cut off, so that nothing is left of what was appended.
        assert_eq!(read(&bytes[..22], &[first]), (expected[..1].to_vec(), "lacks appended"));
        assert_eq!(read(&bytes[..25], &[first]), (expected[..1].to_vec(), "lacks appended"));
    }

    #[test]
    fn appended_records_do_not_lie_where_we_have_been() {
        let bytes = file(&[record(b'D', b"one")]);
        let mut source = Cursor::new(&bytes);
        let (mut records, _) = Records::begin(&mut source).unwrap().unwrap();
        assert_eq!(records.append(&[0, 5, 0]), Err(5));
        assert_eq!(records.append(&[300, 200, 0]), Err(200));
    }
}
