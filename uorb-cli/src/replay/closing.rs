//! What a replay says when it is over: a line for people, or one of JSON.

use std::collections::BTreeSet;
use std::io::Write;
use std::time::Duration;

use serde_json::json;
use uorb_ulog::{Ending, Series};

use super::play::Replay;

impl Replay<'_> {
    /// Says what was published.
    pub(super) fn close(
        &self,
        took: Duration,
        is_interrupted: bool,
        out: &mut dyn Write,
    ) -> anyhow::Result<()> {
        let advertised = self.outlets.iter().flatten().count();
        // A log announces topics too that stay silent. They are on the bus, and
        // they are not counted here, as no reader of logs counts them.
        let published: Vec<(&Series, u64)> = (self.contents.series.iter().zip(&self.outlets))
            .filter_map(|(series, outlet)| Some((series, outlet.as_ref()?.published)))
            .filter(|&(_, messages)| messages > 0)
            .collect();
        let messages: u64 = published.iter().map(|(_, messages)| messages).sum();
        let topics: BTreeSet<&str> = published.iter().map(|(series, _)| &*series.topic).collect();
        let (topics, instances) = (topics.len(), published.len());
        let played_us = self.played_us + (self.position_us - self.start_us);
        let log_seconds = played_us as f64 / 1e6;
        let about = &self.contents.about;
        let seconds = took.as_secs_f64();
        if self.args.json {
            let series: Vec<_> = published
                .iter()
                .map(|(series, messages)| {
                    json!({
                        "topic": series.topic,
                        "instance": series.instance,
                        "messages": messages,
                    })
                })
                .collect();
            let line = json!({
                "file": self.args.file.to_string_lossy(),
                "messages": messages,
                "topics": topics,
                "instances": instances,
                "advertised": advertised,
                "log_seconds": log_seconds,
                "seconds": seconds,
                "rounds": self.rounds,
                "dropouts": about.dropouts.len(),
                "dropped_ms": about.lost_ms(),
                "parameter_changes": about.changes.len(),
                "interrupted": is_interrupted,
                "whole": matches!(self.contents.ending, Ok(Ending::Whole)),
                "series": series,
            });
            writeln!(out, "{line}")?;
        } else if !self.args.quiet {
            writeln!(
                out,
                "{messages} messages, {topics} topics, {instances} instances, \
                 {log_seconds:.1} s of the log in {seconds:.1} s{}",
                match about.dropouts.len() {
                    0 => String::new(),
                    dropouts => format!("; {dropouts} dropouts, {} ms, in it", about.lost_ms()),
                }
            )?;
        }
        Ok(())
    }
}
