//! How the listener shows a message: as text, JSON or CSV.

use std::io::{self, Write};

use anyhow::bail;
use uorb_core::{Copied, Instance, Layout, now_us};

use crate::fields::path::{self, Place};
use crate::fields::text::{Age, hex};
use crate::fields::{csv, json, text};

/// What is shown of every message.
#[derive(Debug, Default)]
pub(crate) struct Style {
    pub(crate) format: Format,
    /// The paths of the fields that are shown. Empty: all.
    pub(crate) fields: Vec<String>,
    /// Text: with how long ago it was.
    pub(crate) age: bool,
    /// JSON and CSV: with what is known of the message besides its fields.
    pub(crate) meta: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Format {
    #[default]
    Text,
    Json,
    Csv,
}

/// One message, and what is known of it besides its fields.
#[derive(Debug)]
pub(crate) struct Message<'m> {
    pub(crate) topic: &'m str,
    pub(crate) instance: Instance,
    /// Whether the head names the instance.
    pub(crate) names_instance: bool,
    /// Counts from 1.
    pub(crate) number: u64,
    pub(crate) bytes: &'m [u8],
    pub(crate) copied: Copied,
    /// Messages that were lost so far.
    pub(crate) lost: u64,
}

/// The member under which JSON has what is no field; CSV's columns begin with
/// it. No field of a .msg begins with an underscore.
const META: &str = "_meta";

/// Shows one message after the other.
#[derive(Debug)]
pub(crate) struct Printer {
    style: Style,
    /// The head that CSV has now.
    columns: Vec<String>,
}

impl Printer {
    pub(crate) fn new(style: Style) -> Self {
        Self { style, columns: Vec::new() }
    }

    /// The places of what is shown of messages of this layout. None of a
    /// message of which only the size is known.
    ///
    /// # Errors
    ///
    /// A field that is to be shown is not there.
    pub(crate) fn places<'l>(&self, layout: &'l Layout) -> anyhow::Result<Vec<Place<'l>>> {
        match &self.style.fields[..] {
            [] => Ok(path::all(layout)),
            _ if layout.is_untyped() => {
                bail!("message {} has no field list: nobody who uses it gave one", layout.name)
            }
            fields => fields.iter().map(|field| path::find(layout, field)).collect(),
        }
    }

    /// Shows what is at these places of a message.
    pub(crate) fn print(
        &mut self,
        out: &mut dyn Write,
        places: &[Place<'_>],
        message: &Message<'_>,
    ) -> io::Result<()> {
        match self.style.format {
            Format::Text => self.print_text(out, places, message),
            Format::Json => self.print_json(out, places, message),
            Format::Csv => self.print_csv(out, places, message),
        }
    }

    fn print_text(
        &self,
        out: &mut dyn Write,
        places: &[Place<'_>],
        message: &Message<'_>,
    ) -> io::Result<()> {
        let Message { topic, number, bytes, copied, .. } = message;
        match message.names_instance {
            true => writeln!(out, "\nTOPIC: {topic} instance {} #{number}", message.instance)?,
            false => writeln!(out, "\nTOPIC: {topic} #{number}")?,
        }
        if places.is_empty() {
            return writeln!(out, "{UNTYPED}: {}", hex(bytes));
        }
        let age = Age { now_us: now_us(), publish_time_us: copied.publish_time_us };
        text::print(out, places, bytes, self.style.age.then_some(age))
    }

    fn print_json(
        &self,
        out: &mut dyn Write,
        places: &[Place<'_>],
        message: &Message<'_>,
    ) -> io::Result<()> {
        write!(out, "{{")?;
        match places.is_empty() {
            true => write!(out, "\"{UNTYPED}\":\"{}\"", hex(message.bytes))?,
            false => json::print_members(out, places, message.bytes)?,
        }
        if self.style.meta {
            let members = message.meta().map(|(name, value)| format!("\"{name}\":{value}"));
            write!(
                out,
                ",\"{META}\":{{\"topic\":{},{}}}",
                json::string(message.topic),
                members.join(",")
            )?;
        }
        writeln!(out, "}}")
    }

    fn print_csv(
        &mut self,
        out: &mut dyn Write,
        places: &[Place<'_>],
        message: &Message<'_>,
    ) -> io::Result<()> {
        let (mut columns, mut row) = match places.is_empty() {
            true => (vec![UNTYPED.to_string()], vec![hex(message.bytes)]),
            false => (csv::columns(places), csv::row(places, message.bytes)),
        };
        if self.style.meta {
            columns.push(format!("{META}.topic"));
            row.push(message.topic.to_string());
            for (name, value) in message.meta() {
                columns.push(format!("{META}.{name}"));
                row.push(value.to_string());
            }
        }
        // Once, as all messages of a topic have the same columns; instances
        // that a log and a module publish may differ.
        if columns != self.columns {
            writeln!(out, "{}", columns.join(","))?;
            self.columns = columns;
        }
        writeln!(out, "{}", row.join(","))
    }
}

/// What the bytes are called where no field is known.
const UNTYPED: &str = "untyped";

impl Message<'_> {
    fn meta(&self) -> [(&'static str, u64); 5] {
        [
            ("instance", self.instance.number().into()),
            ("generation", self.copied.generation.get().into()),
            ("publish_time_us", self.copied.publish_time_us),
            ("peer", self.copied.peer.into()),
            ("lost", self.lost),
        ]
    }
}

#[cfg(test)]
mod tests {
    use uorb_core::Generation;

    use super::*;
    use crate::fields::samples;

    fn shown(style: Style, names_instance: bool) -> String {
        let layout = samples::vehicle_acceleration();
        let mut bytes = vec![0; 32];
        bytes[..8].copy_from_slice(&84_978_861_u64.to_ne_bytes());
        bytes[16..20].copy_from_slice(&(-0.123456_f32).to_ne_bytes());
        let copied =
            Copied { generation: Generation::default(), publish_time_us: 84_978_900, peer: 3 };
        let mut printer = Printer::new(style);
        let places = printer.places(&layout).unwrap();
        let mut out = Vec::new();
        for number in 1..=2 {
            let message = Message {
                topic: "vehicle_acceleration",
                instance: Instance::new(1).unwrap(),
                names_instance,
                number,
                bytes: &bytes,
                copied,
                lost: 7,
            };
            printer.print(&mut out, &places, &message).unwrap();
        }
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn messages_are_numbered_under_the_head_of_the_first_listener() {
        assert_eq!(
            shown(Style::default(), false),
            "
TOPIC: vehicle_acceleration #1
timestamp: 84978861
timestamp_sample: 0
xyz: [-0.12346, 0.00000, 0.00000]

TOPIC: vehicle_acceleration #2
timestamp: 84978861
timestamp_sample: 0
xyz: [-0.12346, 0.00000, 0.00000]
"
        );
        let head = shown(Style::default(), true);
        assert!(head.starts_with("\nTOPIC: vehicle_acceleration instance 1 #1\n"), "{head}");
    }

    #[test]
    fn json_is_one_object_a_line_and_meta_is_apart() {
        let fields = vec!["xyz[0]".to_string()];
        let style = Style { format: Format::Json, fields, ..Style::default() };
        assert_eq!(shown(style, true), "{\"xyz[0]\":-0.123456}\n{\"xyz[0]\":-0.123456}\n");

        let fields = vec!["timestamp".to_string()];
        let style = Style { format: Format::Json, fields, meta: true, ..Style::default() };
        assert_eq!(
            shown(style, true).lines().next().unwrap(),
            "{\"timestamp\":84978861,\"_meta\":{\"topic\":\"vehicle_acceleration\",\
             \"instance\":1,\"generation\":0,\"publish_time_us\":84978900,\"peer\":3,\"lost\":7}}"
        );
    }

    #[test]
    fn csv_has_one_head() {
        let fields = vec!["timestamp".to_string(), "xyz".to_string()];
        let style = Style { format: Format::Csv, fields, meta: true, ..Style::default() };
        assert_eq!(
            shown(style, false),
            "timestamp,xyz[0],xyz[1],xyz[2],_meta.topic,_meta.instance,_meta.generation,\
             _meta.publish_time_us,_meta.peer,_meta.lost\n\
             84978861,-0.123456,0.0,0.0,vehicle_acceleration,1,0,84978900,3,7\n\
             84978861,-0.123456,0.0,0.0,vehicle_acceleration,1,0,84978900,3,7\n"
        );
    }

    #[test]
    fn bytes_without_a_field_list_are_shown_as_they_are() {
        let layout = Layout::untyped("blob", 3);
        let mut printer = Printer::new(Style { format: Format::Json, ..Style::default() });
        let places = printer.places(&layout).unwrap();
        let message = Message {
            topic: "blob",
            instance: Instance::FIRST,
            names_instance: false,
            number: 1,
            bytes: &[1, 2, 255],
            copied: Copied { generation: Generation::default(), publish_time_us: 1, peer: 1 },
            lost: 0,
        };
        let mut out = Vec::new();
        printer.print(&mut out, &places, &message).unwrap();
        assert_eq!(String::from_utf8(out).unwrap(), "{\"untyped\":\"0102ff\"}\n");
    }
}
