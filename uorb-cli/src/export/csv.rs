//! A table for each topic and instance, with the names, the columns and the values
//! that ulog2csv gives it.
//!
//! Not with its bytes: in which of its forms numpy writes a float is a matter of
//! numpy's version. And two things that ulog2csv does are left out: the padding of
//! nested messages is no column here, and a text with a comma makes no new cell.
//!
//! A log can have thousands of topics, and a process a thousand open files. So
//! rows are collected in memory, and when they have become many each table gets
//! its own at its end: one file is open at a time.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use uorb_core::Layout;
use uorb_ulog::{Message, Series, Told, is_match, read};

use super::{Args, Exported};
use crate::fields::csv;
use crate::fields::path::{self, Place};
use crate::flight_log::{check_patterns, ending_of, open};

/// How many bytes of rows are collected before they are written.
const PENDING_MAX_BYTES: usize = 32 << 20;

/// The table of one series.
struct Table {
    file: PathBuf,
    layout: Layout,
    messages: u64,
    /// Rows that are not in the file yet.
    pending: String,
    /// The file is there, with the head.
    is_begun: bool,
}

pub(super) fn export(args: &Args, out: &mut dyn Write) -> anyhow::Result<Exported> {
    let mut source = open(&args.file)?;
    let mut tables = Tables::default();
    if let Some(dir) = &args.output {
        fs::create_dir_all(dir).with_context(|| format!("cannot make {}", dir.display()))?;
    }
    let prefix = prefix(args);
    let ended = read::<anyhow::Error>(&mut *source, u64::MAX, |told| match told {
        Told::Began { .. } => Ok(()),
        Told::Series(series) => tables.announce(args, &prefix, series),
        Told::Message(message) => tables.add(message),
    });
    let ending = ending_of(ended)?;
    let names: Vec<&str> = tables.topics.iter().map(|topic| &**topic).collect();
    // Of a file that is no log, that is what is to be said.
    if ending.is_ok() || !names.is_empty() {
        check_patterns(&args.file, &args.topic, &names)?;
    }
    tables.write()?;
    let written = tables.by_series.iter().flatten().filter(|table| table.is_begun);
    for table in written.clone().filter(|_| !args.quiet) {
        writeln!(out, "{} ({} messages)", table.file.display(), table.messages)?;
    }
    Ok(Exported { messages: written.map(|table| table.messages).sum(), ending, odd: None })
}

/// `flight.ulg` as `DIR/flight`.
fn prefix(args: &Args) -> PathBuf {
    let is_log = args.file.extension().is_some_and(|it| it.eq_ignore_ascii_case("ulg"));
    let stem = if is_log { args.file.with_extension("") } else { args.file.clone() };
    match &args.output {
        Some(dir) => dir.join(stem.file_name().unwrap_or_default()),
        None => stem,
    }
}

#[derive(Default)]
struct Tables {
    /// By the number of the series; None: not to be exported.
    by_series: Vec<Option<Table>>,
    /// Those that the log has.
    topics: Vec<String>,
    by_file: HashMap<PathBuf, String>,
    pending_bytes: usize,
}

impl Tables {
    fn announce(&mut self, args: &Args, prefix: &Path, series: Series) -> anyhow::Result<()> {
        let Series { topic, instance, layout } = series;
        let is_chosen =
            args.topic.is_empty() || args.topic.iter().any(|pattern| is_match(pattern, &topic));
        let mut table = None;
        if is_chosen {
            let mut file = prefix.as_os_str().to_owned();
            file.push(format!("_{}_{instance}.csv", topic.replace('/', "_")));
            let file = PathBuf::from(file);
            if let Some(other) = self.by_file.insert(file.clone(), topic.clone()) {
                bail!("{topic} and {other} would both be {}: choose with -t", file.display());
            }
            let (pending, is_begun) = (String::new(), false);
            table = Some(Table { file, layout, messages: 0, pending, is_begun });
        }
        self.topics.push(topic);
        self.by_series.push(table);
        Ok(())
    }

    fn add(&mut self, message: Message<'_>) -> anyhow::Result<()> {
        let Some(table) = &mut self.by_series[message.series] else { return Ok(()) };
        let places = places(&table.layout);
        let before = table.pending.len();
        if table.messages == 0 {
            push_row(&mut table.pending, &csv::columns(&places));
        }
        push_row(&mut table.pending, &csv::row(&places, message.bytes));
        table.messages += 1;
        self.pending_bytes += table.pending.len() - before;
        if self.pending_bytes > PENDING_MAX_BYTES {
            self.write()?;
        }
        Ok(())
    }

    /// Writes what is pending.
    fn write(&mut self) -> anyhow::Result<()> {
        for table in self.by_series.iter_mut().flatten().filter(|it| !it.pending.is_empty()) {
            table.write().with_context(|| format!("cannot write {}", table.file.display()))?;
        }
        self.pending_bytes = 0;
        Ok(())
    }
}

impl Table {
    fn write(&mut self) -> std::io::Result<()> {
        let mut file = match self.is_begun {
            false => File::create(&self.file)?,
            true => File::options().append(true).open(&self.file)?,
        };
        file.write_all(self.pending.as_bytes())?;
        self.is_begun = true;
        // Not cleared: of a topic that has become silent the memory is given back.
        self.pending = String::new();
        Ok(())
    }
}

/// The fields, the timestamp first.
fn places(layout: &Layout) -> Vec<Place<'_>> {
    let mut places = path::all(layout);
    places.sort_by_key(|place| place.path != "timestamp");
    places
}

fn push_row(text: &mut String, cells: &[String]) {
    for (number, cell) in cells.iter().enumerate() {
        if number > 0 {
            text.push(',');
        }
        text.push_str(cell);
    }
    text.push('\n');
}
