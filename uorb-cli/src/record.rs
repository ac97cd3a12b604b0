//! `uorb record`: a bus in a flight log.

use std::fs;
use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context as _, anyhow};
use signal_hook::consts::SIGTERM;
use uorb_ulog::{Choice, Place, Plan, Rule, Tally, parse_parameters, record};

use crate::context::Context;
use crate::interrupt::Interrupt;
use crate::listener::positive;
use crate::nearest::did_you_mean;
use crate::topics;

/// Record all topics, or some, in a ULog flight log.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// Only topics of this name, so often; `*` stands for any letters. May be
    /// repeated: the last one that matches counts
    #[arg(long, short, value_name = "TOPIC[:HZ]")]
    topic: Vec<Rule>,

    /// Only topics of the rules in this file, one a line; those of --topic follow
    #[arg(long, value_name = "FILE")]
    profile: Option<PathBuf>,

    /// The log, if it ends in `.ulg`; else a directory for `DATE/TIME.ulg`, in UTC
    #[arg(long, short, value_name = "FILE.ulg|DIR", default_value = "log")]
    output: PathBuf,

    /// End after so many seconds
    #[arg(long, value_name = "SECONDS", value_parser = positive, allow_negative_numbers = true)]
    duration: Option<f64>,

    /// Begin a new file when one has so many MiB
    #[arg(long, value_name = "MIB", value_parser = positive, allow_negative_numbers = true)]
    max_size: Option<f64>,

    /// Begin a new file every so many seconds
    #[arg(long, value_name = "SECONDS", value_parser = positive, allow_negative_numbers = true)]
    rotate_every: Option<f64>,

    /// The vehicle's parameters: QGroundControl's .params, or lines of `NAME
    /// VALUE [DEFAULT]`
    #[arg(long, value_name = "FILE")]
    params: Option<PathBuf>,

    /// How many MiB of memory to keep what the disk has not taken yet
    #[arg(
        long,
        value_name = "MIB",
        default_value = "16",
        value_parser = clap::value_parser!(u16).range(1..=4096)
    )]
    buffer: u16,

    /// Make publishers that can wait (`uorb replay --back-pressure`) wait for the
    /// disk, instead of losing messages
    #[arg(long)]
    back_pressure: bool,

    /// No progress line, and no closing line
    #[arg(long, short)]
    quiet: bool,
}

const EXAMPLES: &str = "\
Examples:
  uorb record                              all topics, until Ctrl-C
  uorb record -o flight.ulg --duration 60
  uorb record -t 'sensor_*:50' -t vehicle_attitude
  uorb record -o /var/log/uorb --max-size 100 --rotate-every 600

All instances are recorded, those too that appear later, every message of them
where no rate is given. A topic without a field `timestamp` gets the time of its
publication as one. A topic that appears with fields that were not known at the
beginning begins a new file: a log has all its formats at its head. What modules
say on the topic `log_message` is text in the log.

What is older than half a second is in the file, whatever happens to this
process; of a loss of power, two seconds. When the disk is slower than the bus
for longer than --buffer holds, messages are lost; so are those that a new topic
publishes before it is followed, some milliseconds. The log says where and for
how long, and the closing line counts them.

Exit code 0: until Ctrl-C, SIGTERM, --duration or the end of the bus; 1: an error.";

pub(crate) fn run(args: &Args, context: &Context) -> anyhow::Result<()> {
    let plan = args.plan()?;
    let session = context.session()?;
    if !args.quiet {
        let topics = topics::names(context);
        for name in plan.choice.unmatched(&topics) {
            let hint = did_you_mean(name, topics.iter().map(String::as_str));
            let _ = writeln!(io::stderr(), "uorb: no topic is named {name} yet{hint}");
        }
    }
    let interrupt = Interrupt::catch()?;
    let is_terminated = Arc::new(AtomicBool::new(false));
    signal_hook::flag::register(SIGTERM, is_terminated.clone()).context("cannot catch SIGTERM")?;

    let stop = || interrupt.has_come() || is_terminated.load(Ordering::Relaxed);
    let shows = !args.quiet && io::stderr().is_terminal();
    let mut tell = |tally: &Tally| {
        if shows {
            let _ = write!(io::stderr(), "\r{}\x1b[K", line(tally));
        }
    };
    let ended = record(&session, &plan, &stop, &mut tell);
    if shows {
        let _ = write!(io::stderr(), "\r\x1b[K");
    }
    let tally = ended?;
    if !args.quiet {
        let files: Vec<_> = tally.files.iter().map(|file| file.display().to_string()).collect();
        let _ = writeln!(io::stderr(), "uorb: {}: {}", files.join(" "), line(&tally));
    }
    Ok(())
}

/// `12.3 s, 4.5 MB, 1234 messages, 100 a second, 0 lost in 0 dropouts of 0.0 s`
fn line(tally: &Tally) -> String {
    let Tally { seconds, messages, bytes, lost, dropouts, dropped, .. } = tally;
    let rate = if *seconds > 0.0 { *messages as f64 / seconds } else { 0.0 };
    format!(
        "{seconds:.1} s, {:.1} MB, {messages} messages, {rate:.0} a second, \
         {lost} lost in {dropouts} dropouts of {:.1} s",
        *bytes as f64 / 1e6,
        dropped.as_secs_f64()
    )
}

impl Args {
    fn plan(&self) -> anyhow::Result<Plan> {
        let read = |path: &PathBuf| {
            fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
        };
        let mut rules = Vec::new();
        if let Some(path) = &self.profile {
            rules = Choice::parse_profile(&read(path)?)
                .map_err(|why| anyhow!("{}: {why}", path.display()))?;
        }
        rules.extend(self.topic.iter().cloned());
        let parameters = match &self.params {
            Some(path) => {
                parse_parameters(&read(path)?).with_context(|| path.display().to_string())?
            }
            None => Vec::new(),
        };
        let is_file = self.output.extension().is_some_and(|ending| ending == "ulg");
        let place = if is_file { Place::File } else { Place::Dated };
        let known = uorb_msg::TOPICS
            .iter()
            .map(|topic| (topic.name.to_string(), topic.layout.clone().into_owned()));
        Ok(Plan {
            choice: Choice::new(rules),
            place: place(self.output.clone()),
            max_size_bytes: self.max_size.map(|mib| (mib * f64::from(1 << 20)) as u64),
            rotate_every: self.rotate_every.map(Duration::from_secs_f64),
            duration: self.duration.map(Duration::from_secs_f64),
            back_pressure: self.back_pressure,
            buffer_bytes: usize::from(self.buffer) << 20,
            parameters,
            known: known.collect(),
        })
    }
}
