//! What is in a log, counted.

use std::path::Path;

use serde_json::{Map, Value, json};
use uorb_ulog::{Ending, Fault, Said, Told, read_all};

use crate::flight_log::{About, ending_of, open, parameter_json};
use crate::replay::{Judge, Span};

/// All of a log but its messages.
pub(super) struct Looked {
    /// When the logger was started; None: it is no log.
    pub(super) began_us: Option<u64>,
    /// From the first message to the last.
    pub(super) length_us: u64,
    pub(super) topics: Vec<Topic>,
    pub(super) messages: u64,
    pub(super) about: About,
    pub(super) ending: Result<Ending, Fault>,
}

/// A topic instance.
pub(super) struct Topic {
    pub(super) name: String,
    pub(super) instance: u8,
    /// Of a message, without the padding at its end.
    pub(super) message_bytes: u32,
    pub(super) messages: u64,
    first_us: Option<u64>,
    last_us: Option<u64>,
}

impl Topic {
    /// Messages a second; None where there are too few to say.
    pub(super) fn rate_hz(&self) -> Option<f64> {
        let us = self.last_us?.checked_sub(self.first_us?).filter(|&us| us > 0)?;
        Some((self.messages - 1) as f64 * 1e6 / us as f64)
    }

    pub(super) fn bytes(&self) -> u64 {
        u64::from(self.message_bytes) * self.messages
    }
}

pub(super) fn look(file: &Path) -> anyhow::Result<Looked> {
    let mut source = open(file)?;
    let mut about = About::default();
    let mut began_us = None;
    let mut topics: Vec<Topic> = Vec::new();
    let mut messages = 0;
    let (mut judge, mut span) = (Judge::default(), Span::default());
    let ended = read_all::<anyhow::Error>(&mut *source, u64::MAX, |said| {
        match said {
            Said::Noted(note) => about.add(note),
            Said::Told(Told::Began { timestamp_us }) => {
                began_us = Some(timestamp_us);
                span.begin(timestamp_us);
            }
            Said::Told(Told::Series(series)) => {
                about.begin_data();
                topics.push(Topic {
                    name: series.topic,
                    instance: series.instance,
                    message_bytes: series.layout.size_no_padding_bytes(),
                    messages: 0,
                    first_us: None,
                    last_us: None,
                });
            }
            Said::Told(Told::Message(message)) => {
                about.pass(&message);
                let topic = &mut topics[message.series];
                if let Some(timestamp_us) = message.timestamp_us {
                    span.add(judge.push(messages, timestamp_us));
                    topic.first_us = topic.first_us.or(Some(timestamp_us));
                    topic.last_us = Some(timestamp_us);
                }
                topic.messages += 1;
                messages += 1;
            }
        }
        Ok(())
    });
    while let Some(judged) = judge.pop() {
        span.add(Some(judged));
    }
    let ending = ending_of(ended)?;
    topics.sort_by(|a, b| (&a.name, a.instance).cmp(&(&b.name, b.instance)));
    Ok(Looked { began_us, length_us: span.length_us(), topics, messages, about, ending })
}

impl Looked {
    /// Where it is not whole.
    pub(super) fn broken_at_byte(&self) -> Option<u64> {
        match &self.ending {
            Ok(Ending::Whole) => None,
            Ok(Ending::CutOff { at_byte }) | Err(Fault::Record { at_byte, .. }) => Some(*at_byte),
            Err(_) => Some(0),
        }
    }

    pub(super) fn json(&self, file: &Path) -> Value {
        let about = &self.about;
        let parameters = |all: &std::collections::BTreeMap<_, _>| -> Map<String, Value> {
            all.iter()
                .map(|(name, value): (&String, _)| (name.clone(), parameter_json(*value)))
                .collect()
        };
        let topic = |topic: &Topic| {
            json!({
                "topic": topic.name,
                "instance": topic.instance,
                "messages": topic.messages,
                "rate_hz": topic.rate_hz(),
                "message_bytes": topic.message_bytes,
                "bytes": topic.bytes(),
            })
        };
        let change = |(at_us, name, value): &(u64, String, _)| json!({ "timestamp": at_us, "name": name, "value": parameter_json(*value) });
        json!({
            "file": file.to_string_lossy(),
            "start_us": self.began_us,
            "duration_s": self.length_us as f64 / 1e6,
            "whole": self.broken_at_byte().is_none(),
            "broken_at_byte": self.broken_at_byte(),
            "appended_at_bytes": about.appended,
            "dropouts": {
                "count": about.dropouts.len(),
                "total_ms": about.lost_ms(),
                "longest_ms": about.longest_dropout_ms(),
            },
            "info": about.infos,
            "multi_info": about.texts,
            "parameters": parameters(&about.parameters),
            "parameter_defaults": parameters(&about.defaults),
            "parameter_changes": about.changes.iter().map(change).collect::<Vec<_>>(),
            "logged": about.lines.iter().map(|line| json!({
                "timestamp": line.at_us,
                "level": char::from(line.level).to_string(),
                "text": line.text,
            })).collect::<Vec<_>>(),
            "messages": self.messages,
            "topics": self.topics.iter().map(topic).collect::<Vec<_>>(),
        })
    }
}
