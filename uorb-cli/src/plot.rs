//! `uorb plot`: fields over time, of a bus on the terminal, of either as a picture.

mod draw;
mod lines;
mod live;
mod svg;

use std::io::{self, IsTerminal};
use std::path::{Path, PathBuf};

use anyhow::bail;
use clap_complete::engine::ArgValueCandidates;
use uorb_core::Instance;
use uorb_ulog::{Told, read};

use self::lines::Lines;
use crate::completions::topic_names;
use crate::context::Context;
use crate::flight_log::{ending_of, judge, open};
use crate::listener::{instance, positive};
use crate::nearest::did_you_mean;

/// Plot fields of a topic over time: live on the terminal, or as an SVG picture.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// A flight log, if it is not about a bus; the topic; and its fields: x, q[1], q
    #[arg(
        required = true,
        num_args = 1..,
        value_name = "[FILE.ulg] TOPIC FIELD",
        add = ArgValueCandidates::new(topic_names)
    )]
    words: Vec<String>,

    /// Of which instance
    #[arg(short, long, default_value = "0", value_parser = instance, allow_negative_numbers = true)]
    instance: Instance,

    /// How many seconds of a bus are seen, or gathered for --svg
    #[arg(long, default_value = "10", value_name = "SECONDS", value_parser = positive, allow_negative_numbers = true)]
    seconds: f64,

    /// Write a picture instead
    #[arg(long, value_name = "FILE.svg")]
    svg: Option<PathBuf>,
}

const EXAMPLES: &str = "\
Examples:
  uorb plot sensor_accel x y z                      live, the last ten seconds
  uorb plot vehicle_attitude q --seconds 60         all elements of an array
  uorb plot sensor_gyro x -i 1 --svg gyro.svg       ten seconds of a bus
  uorb plot flight.ulg vehicle_attitude q[0] q[1] --svg attitude.svg

A bus is drawn over the time at which messages were published, every one of
them; a log over their timestamps. A NaN is a gap. Units are those of the .msg
files that were compiled in; a log has none itself.

Keys of the live view:
  q, Esc, Ctrl-C    quit
  + -               a longer or a shorter time
  space             hold the picture, and let it go on";

/// What is to be plotted.
struct Wanted<'a> {
    topic: &'a str,
    fields: &'a [String],
}

pub(crate) fn run(args: &Args, context: &Context) -> anyhow::Result<()> {
    let [first, rest @ ..] = &args.words[..] else { bail!("nothing is to be plotted") };
    if is_log(first) {
        let [topic, fields @ ..] = rest else {
            bail!("which topic of {first}? `uorb ulog info {first}` lists them")
        };
        let Some(svg) = &args.svg else {
            bail!("a log is drawn as a picture: say where, with --svg FILE.svg");
        };
        return plot_log(args, first.as_ref(), &Wanted { topic, fields }, svg);
    }
    let wanted = Wanted { topic: first, fields: rest };
    match &args.svg {
        Some(svg) => live::gather(args, context, &wanted, svg),
        None if io::stdout().is_terminal() && io::stdin().is_terminal() => {
            live::show(args, context, &wanted)
        }
        None => bail!(
            "this is no terminal, where a plot could move: write a picture with --svg FILE.svg, \
             or numbers with `uorb listener {first} --csv`"
        ),
    }
}

/// A topic has no dots in its name, and no slashes.
fn is_log(word: &str) -> bool {
    word.contains(['.', '/'])
}

fn plot_log(args: &Args, path: &Path, wanted: &Wanted<'_>, svg: &Path) -> anyhow::Result<()> {
    let mut source = open(path)?;
    let mut topics: Vec<(String, u8)> = Vec::new();
    let mut plotted = None;
    let (mut first_us, mut messages) = (None, 0);
    let ended = read::<anyhow::Error>(&mut *source, u64::MAX, |told| {
        match told {
            Told::Began { .. } => {}
            Told::Series(series) => {
                let one = (series.topic, series.instance);
                if one.0 == wanted.topic && one.1 == args.instance.number() {
                    let lines = Lines::new(wanted.topic, &series.layout, wanted.fields)?;
                    plotted = Some((topics.len(), lines));
                }
                topics.push(one);
            }
            Told::Message(message) => {
                messages += 1;
                if let (Some((number, lines)), Some(timestamp_us)) =
                    (&mut plotted, message.timestamp_us)
                    && *number == message.series
                {
                    // Not the log's beginning: a topic may have begun before it.
                    let first_us = *first_us.get_or_insert(timestamp_us);
                    let seconds = (i128::from(timestamp_us) - i128::from(first_us)) as f64 / 1e6;
                    lines.add(seconds, message.bytes);
                }
            }
        }
        Ok(())
    });
    let ending = ending_of(ended)?;
    let Some((_, lines)) = plotted.filter(|(_, lines)| !lines.are_empty()) else {
        // What is wrong with the log may be why it is not there.
        judge(path, ending, None, messages, "read")?;
        bail!(no_such_series(args, path, wanted.topic, &topics));
    };
    let title = format!("{}, {}{}", name_of(path), wanted.topic, args.instance);
    let since = format!("seconds since {:.3} s", first_us.unwrap_or(0) as f64 / 1e6);
    svg::write(svg, &title, &since, &lines)?;
    judge(path, ending, None, messages, "drawn")
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

fn no_such_series(args: &Args, path: &Path, topic: &str, all: &[(String, u8)]) -> String {
    let file = path.display();
    let mut instances: Vec<u8> =
        all.iter().filter(|(name, _)| name == topic).map(|(_, instance)| *instance).collect();
    instances.sort_unstable();
    match &instances[..] {
        [] => {
            let mut names: Vec<&str> = all.iter().map(|(name, _)| &**name).collect();
            names.sort_unstable();
            names.dedup();
            format!("no topic in {file} is named {topic}{}", did_you_mean(topic, names.into_iter()))
        }
        others if !others.contains(&args.instance.number()) => {
            format!("{topic} in {file} has no instance {}: it has {others:?}", args.instance)
        }
        _ => format!("{file} has no message of {topic}{} with a timestamp", args.instance),
    }
}
