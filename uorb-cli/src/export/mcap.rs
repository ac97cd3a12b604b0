//! One MCAP file: a channel for each topic and instance.
//!
//! It is written beside its place and moved there at the end, so that half a file
//! never has its name.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufWriter, Seek, Write};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Compression, McapResult, WriteOptions, Writer};
use uorb_ulog::{Message, Said, Series, Told, is_match, read_all};

use super::cdr::{Schema, encode};
use super::{Args, Exported};
use crate::flight_log::{About, check_patterns, ending_of, open, parameter_text, text_of};

pub(super) fn export(args: &Args, out: &mut dyn Write) -> anyhow::Result<Exported> {
    let mut source = open(&args.file)?;
    let file = args.output.clone().unwrap_or_else(|| args.file.with_extension("mcap"));
    let cannot_write = || format!("cannot write {}", file.display());
    let unfinished = Unfinished::beside(&file);
    let to = BufWriter::new(File::create(&unfinished.0).with_context(cannot_write)?);
    let options = WriteOptions::new()
        .compression(Some(Compression::Lz4))
        .profile("ros2")
        .library(concat!("uorb ", env!("CARGO_PKG_VERSION")));
    let writer = options.create(to).with_context(cannot_write)?;
    let mut channels = Channels::new(writer);
    let mut topics = Vec::new();
    let mut about = About::default();
    let ended = read_all::<anyhow::Error>(&mut *source, u64::MAX, |said| match said {
        Said::Noted(note) => {
            about.add(note);
            Ok(())
        }
        Said::Told(Told::Began { timestamp_us }) => {
            channels.now_us = timestamp_us;
            Ok(())
        }
        Said::Told(Told::Series(series)) => {
            about.begin_data();
            let is_match = |pattern: &String| is_match(pattern, &series.topic);
            let is_chosen = args.topic.is_empty() || args.topic.iter().any(is_match);
            topics.push(series.topic.clone());
            channels.announce(series, is_chosen);
            Ok(())
        }
        Said::Told(Told::Message(message)) => {
            about.pass(&message);
            channels.add(&message).with_context(cannot_write)
        }
    });
    let ending = ending_of(ended)?;
    // Of a file that is no log there is nothing to be kept.
    if ending.is_ok() || !topics.is_empty() {
        let topics: Vec<&str> = topics.iter().map(|topic| &**topic).collect();
        check_patterns(&args.file, &args.topic, &topics)?;
        channels.finish(&about).with_context(cannot_write)?;
        fs::rename(&unfinished.0, &file).with_context(cannot_write)?;
        if !args.quiet {
            writeln!(out, "{} ({} messages)", file.display(), channels.messages)?;
        }
    }
    Ok(Exported { messages: channels.messages, ending, odd: about.odd })
}

/// A file that is removed, unless it has got another name.
struct Unfinished(PathBuf);

impl Unfinished {
    fn beside(file: &Path) -> Self {
        let mut name = file.as_os_str().to_owned();
        name.push(".part");
        Self(name.into())
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}

struct Channels<W: Write + Seek> {
    writer: Writer<W>,
    /// By the number of the series; None: not to be exported.
    by_series: Vec<Option<Channel>>,
    messages: u64,
    /// The newest timestamp: the time of what has none.
    now_us: u64,
    /// The message that is being written.
    encoded: Vec<u8>,
}

struct Channel {
    series: Series,
    /// None: there was no message yet. Of what stays silent there is no channel.
    id: Option<u16>,
    messages: u32,
}

impl<W: Write + Seek> Channels<W> {
    fn new(writer: Writer<W>) -> Self {
        Self { writer, by_series: Vec::new(), messages: 0, now_us: 0, encoded: Vec::new() }
    }

    fn announce(&mut self, series: Series, is_chosen: bool) {
        let channel = Channel { series, id: None, messages: 0 };
        self.by_series.push(is_chosen.then_some(channel));
    }

    fn add(&mut self, message: &Message<'_>) -> McapResult<()> {
        self.now_us = message.timestamp_us.unwrap_or(self.now_us);
        let Some(channel) = &mut self.by_series[message.series] else { return Ok(()) };
        encode(&mut self.encoded, &channel.series.layout, message.bytes);
        let time_ns = self.now_us.saturating_mul(1_000);
        let header = MessageHeader {
            channel_id: channel.id(&mut self.writer)?,
            sequence: channel.messages,
            log_time: time_ns,
            publish_time: time_ns,
        };
        channel.messages += 1;
        self.messages += 1;
        self.writer.write_to_known_channel(&header, &self.encoded)
    }

    fn finish(&mut self, about: &About) -> McapResult<()> {
        let infos = about.infos.iter().map(|(name, value)| (name.clone(), text_of(value)));
        let texts = about.texts.iter().flat_map(|(name, parts)| {
            let numbered = parts.iter().enumerate();
            numbered.map(move |(number, part)| (format!("{name}[{number}]"), part.clone()))
        });
        let parameters = about.parameters.iter();
        let changes = about.changes.iter();
        let dropouts = about.dropouts.iter();
        let sections: [(&str, BTreeMap<String, String>); 4] = [
            ("info", infos.chain(texts).collect()),
            (
                "parameters",
                parameters.map(|(name, value)| (name.clone(), parameter_text(*value))).collect(),
            ),
            (
                "parameter_changes",
                changes
                    .map(|(at_us, name, value)| (format!("{at_us} {name}"), parameter_text(*value)))
                    .collect(),
            ),
            (
                "dropouts",
                dropouts
                    .map(|it| (it.at_us.to_string(), format!("{} ms", it.duration_ms)))
                    .collect(),
            ),
        ];
        for (name, metadata) in sections.into_iter().filter(|(_, it)| !it.is_empty()) {
            self.writer.write_metadata(&Metadata { name: name.into(), metadata })?;
        }
        self.writer.finish()?;
        Ok(())
    }
}

impl Channel {
    fn id<W: Write + Seek>(&mut self, writer: &mut Writer<W>) -> McapResult<u16> {
        if let Some(id) = self.id {
            return Ok(id);
        }
        let Series { topic, instance, layout } = &self.series;
        let Schema { name, text } = Schema::of(layout);
        let schema = writer.add_schema(&name, "ros2msg", text.as_bytes())?;
        // Not a number alone: that is no part of a name in ROS.
        let name = format!("/{topic}_{instance}");
        let id = writer.add_channel(schema, &name, "cdr", &BTreeMap::new())?;
        self.id = Some(id);
        Ok(id)
    }
}
