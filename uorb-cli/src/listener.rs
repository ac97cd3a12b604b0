//! `uorb listener`: shows the messages of a topic, whatever its type.
//!
//! It is a subscription like any other: what it shows is what a module would
//! have copied. It never gives up by itself; Ctrl-C, `--timeout`, a count, or
//! the end of the system end it.
//!
//! What it copies is in the node, which keeps a few messages; with
//! `--all-messages`, and for a large topic, it is on the stream.

mod losses;
mod newest;

use std::io::{self, ErrorKind, Write};
use std::os::fd::AsFd;
use std::time::{Duration, Instant};

use clap_complete::ArgValueCandidates;
use nix::poll::{PollFd, PollFlags, PollTimeout};
use uorb_core::{Copied, Instance, RawSubscription, Session, StreamOptions};

use self::losses::Losses;
use self::newest::{Newest, newest_of_each};

use crate::completions::topic_names;
use crate::context::Context;
use crate::exit::{Early, say};
use crate::interrupt::{Interrupt, LOOK_AGAIN};
use crate::print::{Format, Message, Printer, Style};
use crate::topics;

/// Show the messages of a topic.
///
/// Without a count: the newest message of every instance. With one: so many of
/// instance 0, or of -i, the newest first and then as they are published.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The topic
    #[arg(add = ArgValueCandidates::new(topic_names))]
    topic: String,

    /// How many messages
    #[arg(conflicts_with_all = ["number", "follow"], value_parser = count, allow_negative_numbers = true)]
    count: Option<u64>,

    /// How many messages
    #[arg(short, value_name = "COUNT", conflicts_with = "follow", value_parser = count, allow_negative_numbers = true)]
    number: Option<u64>,

    /// Of which instance, 0 to 9 [default: 0; without a count, all]
    #[arg(short, long, value_parser = instance, allow_negative_numbers = true)]
    instance: Option<Instance>,

    /// At most so many messages a second; without a count, until Ctrl-C
    #[arg(short, long, value_name = "HZ", value_parser = positive, allow_negative_numbers = true)]
    rate: Option<f64>,

    /// Until Ctrl-C
    #[arg(short, long)]
    follow: bool,

    /// Every message, with a deep queue on the stream; without a count, until
    /// Ctrl-C
    #[arg(long, conflicts_with = "rate")]
    all_messages: bool,

    /// Give up when nothing came for so long (exit code 124)
    #[arg(long, value_name = "SECONDS", value_parser = positive, allow_negative_numbers = true)]
    timeout: Option<f64>,

    /// Wait for a topic that nobody has described yet, whatever its name
    #[arg(long)]
    wait: bool,

    /// One JSON object a line
    #[arg(long, group = "format")]
    json: bool,

    /// A table with a column for every number, as pyulog names them
    #[arg(long, group = "format")]
    csv: bool,

    /// Only these fields: xyz, xyz[1], esc[0].esc_rpm
    #[arg(long, value_name = "FIELD,..", value_delimiter = ',')]
    field: Vec<String>,

    /// Say how long ago a message was
    #[arg(long, conflicts_with = "format")]
    age: bool,

    /// Add instance, generation, time, sender and losses, in JSON under _meta
    #[arg(long, requires = "format")]
    meta: bool,
}

const EXAMPLES: &str = "\
Examples:
  uorb listener sensor_accel              the newest of every instance
  uorb listener sensor_accel 5            five messages of instance 0
  uorb listener sensor_accel -i 1 -n 5    five of instance 1
  uorb listener sensor_accel -r 2 --age   two a second, until Ctrl-C
  uorb listener vehicle_attitude -f --json --field q,timestamp | jq .q
  uorb listener sensor_gyro 1000 --csv > gyro.csv
  uorb listener battery_status 1 --timeout 5 || echo no battery
  uorb listener sensor_gyro --all-messages --csv > gyro.csv

A subscription has as many messages as the node keeps, often one: a publisher
that is faster than the listener overwrites the rest. With --all-messages it has
a queue of its own on the topic's stream, of 1,024 messages or 16 MiB of them;
what overruns even that is told on stderr as it happens. `uorb info` shows who
follows a stream.

In JSON every integer has all its digits, a float is the shortest that reads
back the same, NaN and infinities are null. A program that is installed (or
linked) under the name listener or px4-listener is this command.

Exit codes: 0, also for Ctrl-C where no count was given; 130 for Ctrl-C before
all messages came; 124 when --timeout is over; 1 for any error.";

/// An instance's number on the command line.
pub(crate) fn instance(text: &str) -> Result<Instance, String> {
    let number: u8 = text.parse().map_err(|_| "it is not in 0..9".to_string())?;
    Instance::try_from(number)
}

/// A number of messages on the command line.
pub(crate) fn count(text: &str) -> Result<u64, String> {
    text.parse()
        .ok()
        .filter(|count| *count > 0)
        .ok_or_else(|| "it is not a number from 1 up".into())
}

/// A rate or a time on the command line.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        // A time that long is none, and a rate that low never comes to an end.
        Ok(value) if (1e-6..=1e9).contains(&value) => Ok(value),
        _ => Err("it is not a number from 0.000001 to 1000000000".into()),
    }
}

pub(crate) fn run(args: &Args, context: &Context, out: &mut dyn Write) -> anyhow::Result<()> {
    let session = context.session()?;
    let printer = Printer::new(args.style());
    match topics::describe(&session, &args.topic)? {
        // A field that is not there is said now, not when a message comes.
        Some(metadata) => drop(printer.places(&metadata.layout)?),
        None if args.wait => {}
        None => return Err(topics::unknown(context, &args.topic)),
    }
    let mut listener = Listener { args, interrupt: Interrupt::catch()?, printer, out };
    let ended = match args.number.or(args.count) {
        None if args.goes_on() => listener.show(&session, u64::MAX),
        None if args.instance.is_none() => listener.show_newest(&session, context),
        count => listener.show(&session, count.unwrap_or(1)),
    };
    listener.out.flush()?;
    ended
}

struct Listener<'a> {
    args: &'a Args,
    interrupt: Interrupt,
    printer: Printer,
    out: &'a mut dyn Write,
}

impl Listener<'_> {
    /// Shows the newest message of every instance, once.
    fn show_newest(&mut self, session: &Session, context: &Context) -> anyhow::Result<()> {
        let topic = &self.args.topic;
        let nodes = context.system.list_nodes()?.into_iter();
        let mut instances: Vec<Instance> =
            nodes.filter(|(name, _)| name == topic).map(|(_, instance)| instance).collect();
        if instances.is_empty() {
            instances.push(Instance::FIRST);
        }
        let mut subscriptions = Vec::new();
        for instance in instances {
            subscriptions.push(RawSubscription::subscribe(session, topic, instance)?);
        }
        let mut newest = newest_of_each(&mut subscriptions)?;
        if newest.is_empty() {
            self.say_that_we_wait();
        }
        while newest.is_empty() {
            let mut waiting: Vec<_> = subscriptions.iter_mut().collect();
            self.wait(&mut waiting)?;
            newest = newest_of_each(&mut subscriptions)?;
        }
        let names_instance = newest.len() > 1;
        for Newest { metadata, instance, bytes, copied, lost } in &newest {
            let places = self.printer.places(&metadata.layout)?;
            let message = Message {
                topic,
                instance: *instance,
                names_instance,
                number: 1,
                bytes,
                copied: *copied,
                lost: *lost,
            };
            self.printer.print(self.out, &places, &message)?;
        }
        Ok(())
    }

    /// Shows so many messages of one instance, and waits for them.
    fn show(&mut self, session: &Session, count: u64) -> anyhow::Result<()> {
        let instance = self.args.instance.unwrap_or(Instance::FIRST);
        let topic = &self.args.topic;
        let mut subscription = match self.args.all_messages {
            true => {
                let deepest = StreamOptions::default();
                RawSubscription::subscribe_stream(session, topic, instance, deepest)?
            }
            false => RawSubscription::subscribe(session, topic, instance)?,
        };
        if let Some(rate_hz) = self.args.rate {
            subscription.set_interval(Duration::from_secs_f64(1.0 / rate_hz));
        }
        if !subscription.updated() {
            self.say_that_we_wait();
        }
        let shown = self.show_messages(&mut subscription, count);
        if subscription.lost() > 0 {
            let lost = subscription.lost();
            say(format_args!("{lost} messages were overwritten before they could be copied"));
        }
        match shown {
            // This is how it ends where no end was given.
            Err(error) if count == u64::MAX && is_interrupt(&error) => Ok(()),
            shown => shown,
        }
    }

    fn show_messages(
        &mut self,
        subscription: &mut RawSubscription,
        count: u64,
    ) -> anyhow::Result<()> {
        // The layout is known when there is something to copy, and not before.
        self.wait(&mut [subscription])?;
        let Some(metadata) = subscription.metadata().cloned() else { return Ok(()) };
        let metadata = topics::typed(metadata);
        let places = self.printer.places(&metadata.layout)?;
        let mut losses = self.args.all_messages.then(Losses::default);
        let mut bytes = Vec::new();
        for number in 1..=count {
            let copied = loop {
                self.wait(&mut [subscription])?;
                if let Some(copied) = take(subscription, &mut bytes) {
                    break copied;
                }
            };
            let lost = subscription.lost();
            if let Some(losses) = &mut losses
                && let Some(more) = losses.worth_saying(lost, Instant::now())
            {
                say(format_args!("messages lost before #{number}: {more}"));
            }
            let message = Message {
                topic: &metadata.name,
                instance: subscription.instance(),
                names_instance: self.args.instance.is_some(),
                number,
                bytes: &bytes,
                copied,
                lost,
            };
            self.printer.print(self.out, &places, &message)?;
        }
        Ok(())
    }

    /// Waits until there is something to copy.
    fn wait(&mut self, subscriptions: &mut [&mut RawSubscription]) -> anyhow::Result<()> {
        let since = Instant::now();
        let timeout = self.args.timeout.map(Duration::from_secs_f64);
        let mut rest = Duration::ZERO;
        loop {
            if self.interrupt.has_come() {
                return Err(Early::Interrupted.into());
            }
            if uorb_core::poll(subscriptions, Some(rest))? > 0 {
                return Ok(());
            }
            // Whoever reads may see all that came, and know that more will.
            self.out.flush()?;
            if reader_is_gone() {
                return Err(io::Error::from(ErrorKind::BrokenPipe).into());
            }
            rest = match timeout.map(|timeout| timeout.saturating_sub(since.elapsed())) {
                Some(Duration::ZERO) => {
                    let seconds = self.args.timeout.unwrap_or_default();
                    let words = format!("no message of {} for {seconds} s", self.args.topic);
                    return Err(Early::TimedOut(words).into());
                }
                Some(rest) => rest.min(LOOK_AGAIN),
                None => LOOK_AGAIN,
            };
        }
    }

    fn say_that_we_wait(&self) {
        let Args { topic, instance, .. } = self.args;
        let which = instance.map_or(String::new(), |instance| format!(" instance {instance}"));
        say(format_args!("{topic}{which}: nothing was published yet; waiting, Ctrl-C ends it"));
    }
}

/// Copies the next message. None: what was new on a stream is lost, or is still
/// on its way, and `copy` gives the last message again.
pub(crate) fn take(subscription: &mut RawSubscription, bytes: &mut Vec<u8>) -> Option<Copied> {
    let before = subscription.last_copied();
    if !subscription.copy(bytes) {
        return None;
    }
    subscription.last_copied().filter(|copied| Some(*copied) != before)
}

impl Args {
    /// Whether it ends by Ctrl-C, where no count is given.
    fn goes_on(&self) -> bool {
        self.follow || self.rate.is_some() || self.all_messages
    }

    fn style(&self) -> Style {
        let format = match (self.json, self.csv) {
            (true, _) => Format::Json,
            (_, true) => Format::Csv,
            _ => Format::Text,
        };
        Style { format, fields: self.field.clone(), age: self.age, meta: self.meta }
    }
}

fn is_interrupt(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(Early::Interrupted))
}

/// Whether stdout is a pipe that nobody reads any more. A topic may be slow,
/// and `head` is gone long before there is something to write.
fn reader_is_gone() -> bool {
    let stdout = io::stdout();
    let mut pipe = [PollFd::new(stdout.as_fd(), PollFlags::empty())];
    let polled = nix::poll::poll(&mut pipe, PollTimeout::ZERO);
    polled.is_ok() && pipe[0].revents().is_some_and(|events| events.contains(PollFlags::POLLERR))
}
