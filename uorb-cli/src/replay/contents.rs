//! A first look through the whole log, before anything is published.
//!
//! It finds the topics, so that all of them are advertised from the beginning;
//! how long the log is, for the progress bar; and what is wrong with it, so
//! that a log that makes no sense is refused before it is on the bus.

use std::collections::HashSet;
use std::io::SeekFrom;

use uorb_ulog::{Ending, Fault, Said, Series, Source, Told, read_all};

use super::pace::{Clock, Judge, Judged};
use crate::flight_log::About;

/// What is in a log.
#[derive(Debug)]
pub(super) struct Contents {
    /// The topic instances. A message has the number of its own.
    pub(super) series: Vec<Series>,
    pub(super) messages: u64,
    /// How long it is, in microseconds from its first message to its last.
    pub(super) length_us: u64,
    /// The timestamp with which it begins.
    origin_us: u64,
    /// The numbers of the messages that are ahead of their time.
    ahead: HashSet<u64>,
    /// Where what is whole ends.
    pub(super) until_byte: u64,
    /// Dropouts, parameters and the like. They are not for the bus.
    pub(super) about: About,
    /// How it ends: a fault where the rest cannot be read.
    pub(super) ending: Result<Ending, Fault>,
}

impl Contents {
    /// # Errors
    ///
    /// [`Fault`] where there is not one message to replay before it.
    pub(super) fn look(source: &mut dyn Source) -> Result<Self, Fault> {
        let mut series = Vec::new();
        let mut messages = 0;
        let mut span = Span::default();
        let mut judge = Judge::default();
        let mut about = About::default();
        let ending = read_all::<Fault>(source, u64::MAX, |said| {
            match said {
                Said::Noted(note) => about.add(note),
                Said::Told(Told::Began { timestamp_us }) => span.begin(timestamp_us),
                Said::Told(Told::Series(one)) => {
                    about.begin_data();
                    series.push(one);
                }
                Said::Told(Told::Message(message)) => {
                    about.pass(&message);
                    if let Some(timestamp_us) = message.timestamp_us {
                        span.add(judge.push(messages, timestamp_us));
                    }
                    messages += 1;
                }
            }
            Ok(())
        });
        while let Some(judged) = judge.pop() {
            span.add(Some(judged));
        }
        let until_byte = match &ending {
            Ok(Ending::Whole) => u64::MAX,
            Ok(Ending::CutOff { at_byte }) | Err(Fault::Record { at_byte, .. }) => *at_byte,
            Err(_) => 0,
        };
        match ending {
            Err(fault) if messages == 0 => Err(fault),
            Ok(_) if messages == 0 => Err(Fault::NoMessage(source.seek(SeekFrom::End(0))?)),
            ending => Ok(Self {
                series,
                messages,
                length_us: span.length_us(),
                origin_us: span.origin_us(),
                ahead: span.ahead,
                until_byte,
                about,
                ending,
            }),
        }
    }

    /// The log's own time, at its beginning.
    pub(super) fn clock(&self) -> Clock {
        Clock::new(self.origin_us)
    }

    /// Whether the message of this number is ahead of its time.
    pub(super) fn is_ahead(&self, number: u64) -> bool {
        self.ahead.contains(&number)
    }
}

/// From when to when the messages of a log are.
#[derive(Debug, Default)]
pub(crate) struct Span {
    began_us: u64,
    /// The first timestamp that is not from before the log began.
    first_us: Option<u64>,
    oldest_us: Option<u64>,
    newest_us: Option<u64>,
    ahead: HashSet<u64>,
}

impl Span {
    /// Takes the time of the header.
    pub(crate) fn begin(&mut self, began_us: u64) {
        self.began_us = began_us;
    }

    pub(crate) fn add(&mut self, judged: Option<Judged>) {
        let Some(Judged { number, timestamp_us, is_ahead }) = judged else { return };
        if is_ahead {
            self.ahead.insert(number);
            return;
        }
        let least = |one: &mut Option<u64>| {
            *one = Some(one.map_or(timestamp_us, |least| least.min(timestamp_us)));
        };
        if timestamp_us >= self.began_us {
            least(&mut self.first_us);
        }
        least(&mut self.oldest_us);
        self.newest_us = self.newest_us.max(Some(timestamp_us));
    }

    /// The timestamp with which the log begins. The oldest one, where the header
    /// is later than all that follows it.
    fn origin_us(&self) -> u64 {
        self.first_us.or(self.oldest_us).unwrap_or(self.began_us)
    }

    pub(crate) fn length_us(&self) -> u64 {
        self.newest_us.map_or(0, |newest_us| newest_us.saturating_sub(self.origin_us()))
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
        [b"ULog\x01\x12\x35\x01", &1_000_000_u64.to_le_bytes()[..], &records.concat()].concat()
    }

    const FORMAT: &[u8] = b"a:uint64_t timestamp;float x;uint8_t[4] _padding0;";

    fn announced(instance: u8, id: u16, topic: &str) -> Vec<u8> {
        let [low, high] = id.to_le_bytes();
        record(b'A', &[&[instance, low, high], topic.as_bytes()].concat())
    }

    fn message(id: u16, timestamp_us: u64, more_bytes: usize) -> Vec<u8> {
        let timestamp = timestamp_us.to_le_bytes();
        record(b'D', &[&id.to_le_bytes(), &timestamp[..], &vec![0; more_bytes]].concat())
    }

    /// The flags, with these offsets of what was appended.
    fn flags(appended: [u64; 3]) -> Vec<u8> {
        let offsets = appended.map(u64::to_le_bytes).concat();
        record(b'B', &[&[0; 8][..], &[u8::from(appended[0] != 0)], &[0; 7], &offsets].concat())
    }

    fn start() -> Vec<Vec<u8>> {
        vec![flags([0; 3]), record(b'F', FORMAT), announced(0, 0, "a")]
    }

    fn look(more: &[Vec<u8>]) -> Result<Contents, Fault> {
        let bytes = file(&[start(), more.to_vec()].concat());
        Contents::look(&mut Cursor::new(bytes))
    }

    #[test]
    fn a_log_has_topics_messages_and_a_length() {
        let contents = look(&[
            announced(3, 7, "a"),
            message(0, 0, 4),
            message(7, 900_000, 4),
            message(0, 1_000_100, 4),
            // With the padding at its end, which most logs leave off.
            message(7, 1_250_100, 8),
            // Parameters are not for replay, what is unknown neither.
            record(b'P', b""),
            record(b'Z', b"?"),
        ])
        .unwrap();
        let series: Vec<_> =
            contents.series.iter().map(|series| (&*series.topic, series.instance)).collect();
        assert_eq!(series, [("a", 0), ("a", 3)]);
        assert_eq!((contents.messages, contents.length_us), (4, 250_000));
        assert_eq!(contents.clock().advance(Some(1_000_100), false), 0);
        assert!(matches!(contents.ending, Ok(Ending::Whole)));
    }

    #[test]
    fn one_announced_again_or_under_another_number_is_the_same() {
        let again = [announced(0, 0, "a"), announced(0, 5, "a")];
        let messages = [message(0, 1_000_000, 4), message(5, 1_000_000, 4)];
        let contents = look(&[&again[..], &messages[..]].concat()).unwrap();
        assert_eq!((contents.series.len(), contents.messages), (1, 2));
    }

    #[test]
    fn a_log_without_flags_is_read_too() {
        let bytes = file(&[&start()[1..], &[message(0, 1_000_000, 4)]].concat());
        assert_eq!(Contents::look(&mut Cursor::new(bytes)).unwrap().messages, 1);
    }

    #[test]
    fn what_was_appended_is_read() {
        let start = |appended| [vec![flags([appended, 0, 0])], start()[1..].to_vec()].concat();
        let mut bytes = file(&start(0));
        let appended = bytes.len() as u64 + 5;
        bytes = file(&start(appended));
        bytes.extend_from_slice(&message(0, 1_000_000, 4)[..5]);
        assert_eq!(
            Contents::look(&mut Cursor::new(bytes.clone())).unwrap_err().to_string(),
            "byte 119: the file ends here or soon, before the records that were appended to it"
        );
        bytes.extend(message(0, 1_000_000, 4));
        assert_eq!(Contents::look(&mut Cursor::new(bytes)).unwrap().messages, 1);
    }

    #[test]
    fn a_log_that_is_damaged_is_whole_up_to_there() {
        let good = message(0, 1_000_000, 4);
        let at = file(&start()).len() + good.len();
        for (bad, expected) in [
            (
                message(0, 1_000_000, 5),
                "a message of a has 13 bytes; its format has 16, 12 without",
            ),
            (message(7, 1_000_000, 4), "a message of number 7, under which no topic was announced"),
            (record(b'D', b"1"), "a record of type D has 1 bytes"),
            (record(b'A', b"1"), "a record of type A has 1 bytes"),
            (record(1, b"1"), "0x01 is no type of record"),
            (vec![255, 255, 1, 0], "0x01 is no type of record"),
            (announced(1, 0, "a"), "number 0 is a1, and was a0"),
            (announced(1, 1, "b"), "the log has no format of message b"),
            (record(b'F', &[255]), "the format is not UTF-8"),
            (flags([0; 3]), "flag bits at bad position"),
        ] {
            let contents = look(&[good.clone(), bad, good.clone()]).unwrap();
            assert_eq!((contents.messages, contents.until_byte), (1, at as u64), "{expected}");
            let error = contents.ending.unwrap_err().to_string();
            assert!(error.starts_with(&format!("byte {at}: {expected}")), "{error}");
        }
    }

    #[test]
    fn a_log_that_is_cut_off_is_whole_up_to_its_last_message() {
        let bytes = file(&[start(), vec![message(0, 1_000_000, 4); 2]].concat());
        let message_bytes = message(0, 0, 4).len();
        let second = bytes.len() - message_bytes;
        for end in 0..bytes.len() {
            let contents = Contents::look(&mut Cursor::new(&bytes[..end]));
            if end < second {
                contents.unwrap_err();
                continue;
            }
            let contents = contents.unwrap();
            assert_eq!(contents.messages, 1);
            let expected = match end == second {
                true => Ending::Whole,
                false => Ending::CutOff { at_byte: second as u64 },
            };
            assert_eq!(contents.ending.unwrap(), expected);
        }
    }

    #[test]
    fn a_message_from_the_future_does_not_make_the_log_longer() {
        let mut messages = vec![message(0, u64::MAX, 4)];
        messages.extend((0..50).map(|n| message(0, 1_000_000 + n * 1_000, 4)));
        let contents = look(&messages).unwrap();
        assert!(contents.is_ahead(0) && !contents.is_ahead(1));
        assert_eq!(contents.length_us, 49_000);
    }
}
