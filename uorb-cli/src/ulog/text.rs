//! What `uorb ulog info` prints for people, in the order of pyulog's ulog_info.

use std::io::{self, Write};

use serde_json::Value;

use super::info::Looked;
use crate::flight_log::{parameter_text, text_of};

pub(super) fn print(looked: &Looked, verbose: bool, out: &mut dyn Write) -> io::Result<()> {
    let about = &looked.about;
    let start = clock(looked.began_us.unwrap_or(0));
    writeln!(out, "Logging start time: {start}, duration: {}", clock(looked.length_us))?;
    match about.dropouts.len() {
        0 => writeln!(out, "No Dropouts")?,
        count => writeln!(
            out,
            "Dropouts: count: {count}, total duration: {} ms, longest: {} ms",
            about.lost_ms(),
            about.longest_dropout_ms()
        )?,
    }
    for at_byte in &about.appended {
        writeln!(out, "Appended after a crash: from byte {at_byte}")?;
    }
    match looked.broken_at_byte() {
        None => writeln!(out, "Whole, to its end")?,
        Some(at_byte) => writeln!(out, "Not whole: it ends at byte {at_byte}")?,
    }

    if let Some(version) = about.infos.get("ver_sw_release").and_then(Value::as_u64) {
        writeln!(out, "SW Version: {}", release(version))?;
    }
    writeln!(out, "Info Messages:")?;
    // As pyulog has it: of performance counters there are hundreds.
    for (name, value) in about.infos.iter().filter(|it| verbose || !it.0.starts_with("perf_")) {
        writeln!(out, " {name}: {}", text_of(value))?;
    }
    if !about.texts.is_empty() {
        writeln!(out, "Info Multiple Messages:")?;
    }
    for (name, parts) in &about.texts {
        match verbose {
            false => writeln!(out, " {name}: {}", parts.len())?,
            true => parts.iter().try_for_each(|part| writeln!(out, " {name}: {part}"))?,
        }
    }
    let (parameters, changes) = (about.parameters.len(), about.changes.len());
    writeln!(out, "Parameters: {parameters}, {changes} changed in flight")?;
    if verbose {
        for (name, value) in &about.parameters {
            let value = parameter_text(*value);
            match about.defaults.get(name) {
                Some(default) => {
                    writeln!(out, " {name}: {value} (default {})", parameter_text(*default))?;
                }
                None => writeln!(out, " {name}: {value}")?,
            }
        }
        for (at_us, name, value) in &about.changes {
            writeln!(out, " at {}: {name}: {}", clock(*at_us), parameter_text(*value))?;
        }
        writeln!(out, "Logged Messages:")?;
        for line in &about.lines {
            writeln!(out, " {} {} {}", clock(line.at_us), level(line.level), line.text)?;
        }
    }

    writeln!(out)?;
    let width = looked.topics.iter().map(|topic| topic.name.len()).max().unwrap_or(0).max(10);
    writeln!(out, "{:width$} INST MESSAGES     RATE  SIZE      BYTES", "TOPIC NAME")?;
    for topic in &looked.topics {
        let rate = topic.rate_hz().map_or("-".to_string(), |rate_hz| format!("{rate_hz:.1}"));
        writeln!(
            out,
            "{:width$} {:4} {:8} {rate:>8} {:5} {:10}",
            topic.name,
            topic.instance,
            topic.messages,
            topic.message_bytes,
            topic.bytes()
        )?;
    }
    Ok(())
}

/// A version as PX4 packs it: v1.16.1, and how far it was then.
fn release(version: u64) -> String {
    let [major, minor, patch, kind] = (version as u32).to_be_bytes();
    let kind = match kind {
        0..64 => " (development)",
        64..128 => " (alpha)",
        128..192 => " (beta)",
        192..255 => " (RC)",
        255 => "",
    };
    format!("v{major}.{minor}.{patch}{kind}")
}

/// `0:01:07`
fn clock(us: u64) -> String {
    let seconds = us / 1_000_000;
    format!("{}:{:02}:{:02}", seconds / 3_600, seconds / 60 % 60, seconds % 60)
}

/// A level by the name that PX4 has for it.
fn level(level: u8) -> &'static str {
    match level {
        b'0' => "EMERGENCY",
        b'1' => "ALERT",
        b'2' => "CRITICAL",
        b'3' => "ERROR",
        b'4' => "WARNING",
        b'5' => "NOTICE",
        b'6' => "INFO",
        b'7' => "DEBUG",
        _ => "UNKNOWN",
    }
}
