//! A first look through the whole log, before anything is published.
//!
//! It finds the topics, so that all of them are advertised from the beginning;
//! how long the log is, for the progress bar; and what is wrong with it, so
//! that a log that makes no sense is refused before it is on the bus.

use std::collections::HashSet;
use std::io::SeekFrom;

use super::log::{Ending, Fault, Series, Told, read};
use super::pace::{Clock, Judge, Judged};
use super::record::Source;

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
        let ending = read::<Fault>(source, u64::MAX, |told| {
            match told {
                Told::Began { timestamp_us } => span.began_us = timestamp_us,
                Told::Series(one) => series.push(one),
                Told::Message(message) => {
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
struct Span {
    began_us: u64,
    /// The first timestamp that is not from before the log began.
    first_us: Option<u64>,
    oldest_us: Option<u64>,
    newest_us: Option<u64>,
    ahead: HashSet<u64>,
}

impl Span {
    fn add(&mut self, judged: Option<Judged>) {
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

    fn length_us(&self) -> u64 {
        self.newest_us.map_or(0, |newest_us| newest_us.saturating_sub(self.origin_us()))
    }
}
