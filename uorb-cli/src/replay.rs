//! `uorb replay`: a flight log on the bus.
//!
//! The log's own formats describe its topics, so any log can be replayed, also
//! one of a PX4 that this was not built with. Messages go out in the order of
//! the file and with the bytes of the file: only when they go out is ours.

mod contents;
mod pace;

use std::collections::BTreeSet;
use std::io::Write;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context as _, anyhow, bail};
use indicatif::{ProgressBar, ProgressState, ProgressStyle};
use serde_json::json;
use uorb_core::broker_side::{Node, Role};
use uorb_core::{
    AdvertiseOptions, Claim, Error, Instance, Metadata, QueueLength, RawPublication, Session,
    is_topic_name,
};
use uorb_ulog::{Ending, Fault, Message, Series, Source, Told, read};

pub(crate) use self::contents::Span;
pub(crate) use self::pace::Judge;

use self::contents::Contents;
use self::pace::Speed;
use crate::context::Context;
use crate::exit::{Early, say};
use crate::flight_log::{check_patterns, is_match, open};
use crate::interrupt::Interrupt;
use crate::topics::compiled_in;

/// Publish a ULog flight log, at the pace at which it was recorded.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The flight log
    #[arg(value_name = "FILE.ulg")]
    file: PathBuf,

    /// So many times as fast as it was recorded, or `max`: as fast as it goes
    #[arg(long, default_value = "1", value_name = "X|max", allow_negative_numbers = true)]
    speed: Speed,

    /// Only topics of this name; `*` stands for any letters. May be repeated
    #[arg(long, value_name = "PATTERN")]
    topic: Vec<String>,

    /// No topics of this name; `*` stands for any letters. May be repeated
    #[arg(long, value_name = "PATTERN")]
    exclude: Vec<String>,

    /// Only instances of this number. May be repeated
    #[arg(long, short, value_name = "N", allow_negative_numbers = true)]
    instance: Vec<u8>,

    /// Leave out the first seconds of the log
    #[arg(
        long,
        default_value = "0",
        value_name = "SECONDS",
        value_parser = seconds,
        allow_negative_numbers = true
    )]
    start: Duration,

    /// Keep so many messages of each topic, up to 128, for subscribers that are
    /// slow; the log does not say how many it was
    #[arg(
        long,
        value_name = "LENGTH",
        value_parser = clap::value_parser!(u32).range(1..=QueueLength::MAX.into()),
        allow_negative_numbers = true
    )]
    queue: Option<u32>,

    /// Lose nothing: begin when every topic is followed, and wait for followers
    /// that ask for it (`uorb record --back-pressure`) when they are behind
    #[arg(long)]
    back_pressure: bool,

    /// No progress bar, and no closing line
    #[arg(long, short)]
    quiet: bool,

    /// Close with one line of JSON, which counts by topic and instance
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  uorb replay flight.ulg
  uorb replay flight.ulg --speed 4 --start 60
  uorb replay flight.ulg --topic 'sensor_*' --topic vehicle_attitude
  uorb replay flight.ulg --exclude sensor_combined
  uorb replay flight.ulg --speed max --json

All topics and instances of the log are advertised at the beginning, in the
log's own formats. A topic that a live process uses with other fields is an
error, and nothing is published: leave such topics out with --exclude.

The bytes of a message stay as they were recorded, its timestamp too: that is
the time since the start of the vehicle, not of this machine.

With `--speed max` a subscriber that is slower than the file is read loses
messages, as with any publisher that is too fast for it; `uorb top` counts them,
and `--queue 128` makes them fewer. A topic that is compiled in has the queue of
its .msg file, else one message.

A log that was cut off, as by a loss of power, is published as far as it is
whole, and then it is said. Exit code 0: to its end; 1: an error, a log that is
cut off among them; 130: Ctrl-C.";

pub(crate) fn run(args: &Args, context: &Context, out: &mut dyn Write) -> anyhow::Result<()> {
    let file = args.file.display();
    let mut source = open(&args.file)?;
    let contents = Contents::look(&mut *source).with_context(|| file.to_string())?;
    let is_chosen = choose(args, &contents.series)?;
    let length = Duration::from_micros(contents.length_us);
    if args.start > length {
        let (start, length) = (args.start.as_secs_f64(), length.as_secs_f64());
        bail!("{file} is {length:.1} s long: --start {start} leaves nothing of it");
    }

    let session = context.session()?;
    let mut outlets = Vec::new();
    for (series, is_chosen) in contents.series.iter().zip(is_chosen) {
        outlets.push(if is_chosen { Some(Outlet::open(&session, series, args)?) } else { None });
    }

    if args.back_pressure {
        wait_for_followers(&session, &outlets)?;
    }
    let bar = bar(args, contents.length_us);
    let mut replay = Replay { args, contents: &contents, outlets, bar, position_us: 0 };
    let start = Instant::now();
    let ended = replay.publish_all(&mut *source, start);
    replay.bar.finish_and_clear();
    let is_interrupted =
        ended.as_ref().is_err_and(|error| matches!(error.downcast_ref(), Some(Early::Interrupted)));
    if ended.is_ok() || is_interrupted {
        replay.close(start.elapsed(), is_interrupted, out)?;
        out.flush()?;
    }
    ended.map_err(|error| match error.is::<Fault>() {
        true => error.context(file.to_string()),
        false => error,
    })?;
    match contents.ending {
        Ok(Ending::Whole) => Ok(()),
        Ok(Ending::CutOff { at_byte }) => bail!(
            "{file} is cut off: the record at byte {at_byte} is not whole; \
             all before it was published"
        ),
        Err(fault) => {
            Err(anyhow!(fault).context(format!("{file}, after {} messages", contents.messages)))
        }
    }
}

/// Which of the series are to be replayed.
fn choose(args: &Args, series: &[Series]) -> anyhow::Result<Vec<bool>> {
    let names: Vec<&str> = series.iter().map(|series| &*series.topic).collect();
    check_patterns(&args.file, args.topic.iter().chain(&args.exclude), &names)?;
    let is_chosen: Vec<bool> = series
        .iter()
        .map(|series| {
            let is_one_of = |patterns: &[String]| {
                patterns.iter().any(|pattern| is_match(pattern, &series.topic))
            };
            (is_one_of(&args.topic) || args.topic.is_empty())
                && !is_one_of(&args.exclude)
                && (args.instance.contains(&series.instance) || args.instance.is_empty())
        })
        .collect();
    if !is_chosen.contains(&true) {
        bail!("{} has no such instance of these topics, or all are left out", args.file.display());
    }
    Ok(is_chosen)
}

fn seconds(text: &str) -> Result<Duration, &'static str> {
    let seconds = text.parse().map_err(|_| "not a number")?;
    Duration::try_from_secs_f64(seconds).map_err(|_| "not a number from 0 up")
}

/// Where the messages of one series go.
struct Outlet {
    publication: RawPublication,
    /// A message with the padding at its end, which a log does not have.
    message: Vec<u8>,
    published: u64,
}

impl Outlet {
    fn open(session: &Session, series: &Series, args: &Args) -> anyhow::Result<Self> {
        let Series { topic, instance, layout } = series;
        let file = args.file.display();
        if !is_topic_name(topic) {
            bail!("{file} has a topic {topic:?}, which is no name for one");
        }
        let Some(instance) = Instance::new(*instance) else {
            bail!("{file} has an instance {instance} of {topic}; a topic has 0 to 9 (--instance)");
        };
        let metadata = Metadata {
            name: topic.clone().into(),
            layout: std::borrow::Cow::Owned(layout.clone()),
            // A log does not say how many messages a topic keeps.
            queue_length: compiled_in(topic).map_or(QueueLength::ONE, |ours| ours.queue_length),
        };
        let options = AdvertiseOptions {
            claim: Claim::Shared(instance),
            queue_length: args.queue.map(QueueLength::at_least),
            ..AdvertiseOptions::default()
        };
        let publication =
            RawPublication::advertise(session, &metadata, options).map_err(|error| {
                let cure = match error {
                    Error::LayoutMismatch(_) => format!(
                        ",\n  or leave it out of the replay with --exclude {topic}, or choose \
                         others with --topic"
                    ),
                    _ => String::new(),
                };
                anyhow!("cannot advertise {topic}{instance}: {error}{cure}")
            })?;
        Ok(Self { publication, message: vec![0; layout.size_bytes as usize], published: 0 })
    }
}

struct Replay<'a> {
    args: &'a Args,
    contents: &'a Contents,
    /// By the number of the series; None: not to be replayed.
    outlets: Vec<Option<Outlet>>,
    bar: ProgressBar,
    /// How far we have come in the log.
    position_us: u64,
}

impl Replay<'_> {
    fn publish_all(&mut self, source: &mut dyn Source, start: Instant) -> anyhow::Result<()> {
        let interrupt = Interrupt::catch()?;
        let skip_us = u64::try_from(self.args.start.as_micros()).unwrap_or(u64::MAX);
        let mut clock = self.contents.clock();
        let mut numbers = 0..;
        read(source, self.contents.until_byte, |told| {
            let Told::Message(message) = told else { return Ok(()) };
            let is_ahead = numbers.next().is_some_and(|number| self.contents.is_ahead(number));
            let position_us = clock.advance(message.timestamp_us, is_ahead);
            if position_us < skip_us || self.outlets[message.series].is_none() {
                return Ok(());
            }
            if interrupt.has_come() {
                bail!(Early::Interrupted);
            }
            if let Some(due) = self.args.speed.due(start, position_us - skip_us)
                && interrupt.wait_until(due)?
            {
                bail!(Early::Interrupted);
            }
            self.position_us = position_us;
            self.bar.set_position(position_us);
            self.publish(message, &interrupt)
        })?;
        Ok(())
    }

    fn publish(&mut self, message: Message<'_>, interrupt: &Interrupt) -> anyhow::Result<()> {
        let Some(outlet) = &mut self.outlets[message.series] else { return Ok(()) };
        outlet.message[..message.bytes.len()].copy_from_slice(message.bytes);
        if !self.args.back_pressure {
            outlet.publication.publish(&outlet.message)?;
        } else {
            while let Err(error) = outlet.publication.try_publish(&outlet.message) {
                match error {
                    Error::QueueFull { .. } if interrupt.has_come() => bail!(Early::Interrupted),
                    Error::QueueFull { .. } => std::thread::sleep(QUEUE_FULL_PAUSE),
                    error => return Err(error.into()),
                }
            }
        }
        outlet.published += 1;
        Ok(())
    }

    /// Says what was published.
    fn close(
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
        let skipped_us = self.args.start.as_micros() as u64;
        let log_seconds = self.position_us.saturating_sub(skipped_us) as f64 / 1e6;
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
                "interrupted": is_interrupted,
                "whole": matches!(self.contents.ending, Ok(Ending::Whole)),
                "series": series,
            });
            writeln!(out, "{line}")?;
        } else if !self.args.quiet {
            writeln!(
                out,
                "{messages} messages, {topics} topics, {instances} instances, \
                 {log_seconds:.1} s of the log in {seconds:.1} s"
            )?;
        }
        Ok(())
    }
}

/// How long to wait for room in a follower's queue before one looks again.
const QUEUE_FULL_PAUSE: Duration = Duration::from_millis(1);

/// Waits until somebody follows the stream of each instance.
fn wait_for_followers(session: &Session, outlets: &[Option<Outlet>]) -> anyhow::Result<()> {
    let interrupt = Interrupt::catch()?;
    for outlet in outlets.iter().flatten() {
        let (topic, instance) =
            (&outlet.publication.metadata().name, outlet.publication.instance());
        let node = Node::open(session.system(), topic, instance, Role::Observer)?;
        let since = Instant::now();
        let mut has_said = false;
        while !node.streams().iter().any(|stream| stream.entry.back_pressure) {
            if !has_said && since.elapsed() >= Duration::from_secs(1) {
                say(format_args!(
                    "{topic}{instance} is not followed with back-pressure yet; waiting, Ctrl-C ends it"
                ));
                has_said = true;
            }
            let soon = Instant::now() + Duration::from_millis(5);
            if interrupt.wait_until(Some(soon))? {
                bail!(Early::Interrupted);
            }
        }
    }
    Ok(())
}

/// A bar on a terminal's stderr; nothing where that is none.
fn bar(args: &Args, length_us: u64) -> ProgressBar {
    if args.quiet {
        return ProgressBar::hidden();
    }
    let seconds = |us: u64| us as f64 / 1e6;
    let style = ProgressStyle::with_template("{wide_bar} {at} of {length} s")
        .expect("the template is sound")
        .with_key("at", move |state: &ProgressState, to: &mut dyn std::fmt::Write| {
            let _ = write!(to, "{:.1}", seconds(state.pos()));
        })
        .with_key("length", move |_: &ProgressState, to: &mut dyn std::fmt::Write| {
            let _ = write!(to, "{:.1}", seconds(length_us));
        });
    ProgressBar::new(length_us).with_style(style)
}
