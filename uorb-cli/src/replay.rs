//! `uorb replay`: a flight log on the bus.
//!
//! The log's own formats describe its topics, so any log can be replayed, also
//! one of a PX4 that this was not built with. Messages go out in the order of
//! the file and with the bytes of the file: only when they go out is ours.

mod closing;
mod contents;
mod followers;
mod keys;
mod outlet;
mod pace;
mod play;

use std::collections::HashMap;
use std::io::Write;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context as _, anyhow, bail};
use indicatif::{ProgressBar, ProgressState, ProgressStyle};
use uorb_core::{QueueLength, is_topic_name};
use uorb_ulog::{Ending, Fault, Series, is_match};

pub(crate) use self::contents::Span;
pub(crate) use self::pace::Judge;

use self::contents::Contents;
use self::followers::{wait_for_followers, wait_until_received};
use self::keys::Keys;
use self::outlet::{Outlet, publications};
use self::pace::{Pace, Speed};
use self::play::{Played, Replay};
use crate::context::Context;
use crate::exit::Early;
use crate::flight_log::{check_patterns, open};
use crate::interrupt::Interrupt;

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

    /// Publish topic OLD as NEW. May be repeated
    #[arg(long, short, value_name = "OLD=NEW", value_parser = remap)]
    remap: Vec<(String, String)>,

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

    /// End after so many seconds of the log
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    duration: Option<Duration>,

    /// Again and again, or N times
    #[arg(
        long = "loop",
        value_name = "N",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "18446744073709551615",
        value_parser = clap::value_parser!(u64).range(1..),
        hide_possible_values = true
    )]
    rounds: Option<u64>,

    /// Begin paused: a key goes on
    #[arg(long)]
    paused: bool,

    /// Keep so many messages of each topic, up to 128, for subscribers that are
    /// slow; the log does not say how many it was
    #[arg(
        long,
        value_name = "LENGTH",
        value_parser = clap::value_parser!(u32).range(1..=QueueLength::MAX.into()),
        allow_negative_numbers = true
    )]
    queue: Option<u32>,

    /// Lose nothing: begin when recorders that ask for it (`uorb record
    /// --back-pressure`) follow all that they want, and wait when they are behind
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
  uorb replay flight.ulg --start 60 --duration 10 --loop
  uorb replay flight.ulg --remap vehicle_attitude=recorded_attitude
  uorb replay flight.ulg --speed max --json

All topics and instances of the log are advertised at the beginning, in the
log's own formats. A topic that a live process uses with other fields is an
error, and nothing is published: leave such topics out with --exclude.

The bytes of a message stay as they were recorded, its timestamp too: that is
the time since the start of the vehicle, not of this machine; with --loop it
begins anew each time. A gap in the log, where messages were lost or the logger
was stopped, is as long as it was. Parameters in the log are not for the bus.

On a terminal, keys:
  space             pause, and go on
  . s Right         one message, while paused
  + -               twice as fast, half as fast
  q                 quit (exit code 0)

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
    check_remaps(args, &contents.series, &is_chosen)?;
    let length = Duration::from_micros(contents.length_us);
    if args.start > length {
        let (start, length) = (args.start.as_secs_f64(), length.as_secs_f64());
        bail!("{file} is {length:.1} s long: --start {start} leaves nothing of it");
    }

    let session = context.session()?;
    let mut outlets = Vec::new();
    for (series, is_chosen) in contents.series.iter().zip(is_chosen) {
        outlets.push(match is_chosen {
            true => Some(Outlet::open(&session, series, remapped(args, &series.topic), args)?),
            false => None,
        });
    }

    if args.back_pressure {
        wait_for_followers(&session, publications(&outlets))?;
    }
    let bar = bar(args, contents.length_us);
    let keys = Keys::listen()?;
    if args.paused && !keys.is_there() {
        bail!("--paused needs a terminal: without one nobody can press the key that goes on");
    }
    let start_us = micros(args.start);
    let mut replay = Replay {
        args,
        contents: &contents,
        outlets,
        bar,
        keys,
        interrupt: Interrupt::catch()?,
        pace: Pace::begin(args.speed, args.paused, start_us),
        start_us,
        position_us: start_us,
        played_us: 0,
        rounds: 0,
    };
    if replay.keys.is_there() {
        replay.show_pace();
    }
    let start = Instant::now();
    let ended = replay.play(&mut *source);
    replay.bar.finish_and_clear();
    if args.back_pressure && ended.is_ok() {
        wait_until_received(&session, publications(&replay.outlets))?;
    }
    let early = ended.as_ref().err().and_then(|error| error.downcast_ref::<Early>());
    let is_interrupted = matches!(early, Some(Early::Interrupted));
    if ended.is_ok() || is_interrupted {
        replay.close(start.elapsed(), is_interrupted, out)?;
        out.flush()?;
    }
    let signal = replay.keys.signal();
    // With it the terminal is as it was.
    drop(replay);
    if let Some(signal) = signal {
        signal_hook::low_level::emulate_default_handler(signal)?;
    }
    if ended.map_err(|error| match error.is::<Fault>() {
        true => error.context(file.to_string()),
        false => error,
    })? == Played::AsAsked
    {
        return Ok(());
    }
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

/// `OLD=NEW`
fn remap(text: &str) -> Result<(String, String), String> {
    let (old, new) = text.split_once('=').ok_or("it is not OLD=NEW")?;
    if old.contains('*') {
        return Err("OLD is the name of one topic, without a *".into());
    }
    if !is_topic_name(new) {
        return Err(format!("{new:?} is no name for a topic"));
    }
    Ok((old.to_string(), new.to_string()))
}

fn seconds(text: &str) -> Result<Duration, &'static str> {
    let seconds = text.parse().map_err(|_| "not a number")?;
    Duration::try_from_secs_f64(seconds).map_err(|_| "not a number from 0 up")
}

/// The name under which a topic of the log is published.
fn remapped<'a>(args: &'a Args, topic: &'a str) -> &'a str {
    args.remap.iter().find(|(old, _)| old == topic).map_or(topic, |(_, new)| new)
}

/// Checks that no two series go to one instance, and that each remap is of use.
fn check_remaps(args: &Args, series: &[Series], is_chosen: &[bool]) -> anyhow::Result<()> {
    let names: Vec<&str> = series.iter().map(|series| &*series.topic).collect();
    check_patterns(&args.file, args.remap.iter().map(|(old, _)| old), &names)?;
    let mut taken = HashMap::new();
    for (series, _) in series.iter().zip(is_chosen).filter(|(_, is_chosen)| **is_chosen) {
        let name = remapped(args, &series.topic);
        if let Some(other) = taken.insert((name, series.instance), &series.topic) {
            bail!(
                "{} and {other} would both be published as {name}{}: choose with --topic, or \
                 remap them to two names",
                series.topic,
                series.instance
            );
        }
    }
    Ok(())
}

fn micros(duration: Duration) -> u64 {
    u64::try_from(duration.as_micros()).unwrap_or(u64::MAX)
}

/// A bar on a terminal's stderr; nothing where that is none.
fn bar(args: &Args, length_us: u64) -> ProgressBar {
    if args.quiet {
        return ProgressBar::hidden();
    }
    let seconds = |us: u64| us as f64 / 1e6;
    let style = ProgressStyle::with_template("{wide_bar} {at} of {length} s{msg}")
        .expect("the template is sound")
        .with_key("at", move |state: &ProgressState, to: &mut dyn std::fmt::Write| {
            let _ = write!(to, "{:.1}", seconds(state.pos()));
        })
        .with_key("length", move |_: &ProgressState, to: &mut dyn std::fmt::Write| {
            let _ = write!(to, "{:.1}", seconds(length_us));
        });
    ProgressBar::new(length_us).with_style(style)
}
