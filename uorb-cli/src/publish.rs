//! `uorb pub`: publishes from the command line.
//!
//! The last message outlives its publisher, so to publish once and be gone is
//! of use: whoever subscribes later has it at once.

use std::ops::Range;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use clap_complete::ArgValueCandidates;
use uorb_core::{
    AdvertiseOptions, Claim, FieldType, Instance, Layout, Priority, RawPublication,
    RawSubscription, Session, now_us,
};

use crate::completions::topic_names;
use crate::context::Context;
use crate::exit::{Early, say};
use crate::fields::assign::Assignment;
use crate::interrupt::{Interrupt, LOOK_AGAIN};
use crate::{listener, topics};

/// Publish messages, field by field.
///
/// Fields that are not given are 0; the timestamp, if it is not given, is now.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The topic
    #[arg(add = ArgValueCandidates::new(topic_names))]
    topic: String,

    /// What the fields are to be: x=-0.5, q[0]=1, xyz=[1,2,3], esc[2].esc_rpm=5
    #[arg(value_name = "FIELD=VALUE")]
    fields: Vec<String>,

    /// On which instance, 0 to 9, beside any others
    #[arg(
        short,
        long,
        default_value = "0",
        value_parser = listener::instance,
        allow_negative_numbers = true
    )]
    instance: Instance,

    /// On the lowest instance that nobody has advertised
    #[arg(long, conflicts_with_all = ["instance", "from_last"])]
    multi: bool,

    /// So many times a second; without -n, until Ctrl-C
    #[arg(
        short,
        long,
        value_name = "HZ",
        value_parser = listener::positive,
        allow_negative_numbers = true
    )]
    rate: Option<f64>,

    /// So many messages [default: 1]
    #[arg(
        short,
        long,
        value_name = "COUNT",
        value_parser = listener::count,
        allow_negative_numbers = true
    )]
    number: Option<u64>,

    /// What subscribers choose among instances by, 0 to 255
    #[arg(
        long,
        default_value_t = Priority::DEFAULT.0,
        value_name = "PRIORITY",
        allow_negative_numbers = true
    )]
    priority: u8,

    /// Change the newest message instead of one of zeros
    #[arg(long)]
    from_last: bool,

    /// Stay the publisher until Ctrl-C
    #[arg(long)]
    keep: bool,
}

const EXAMPLES: &str = "\
Examples:
  uorb pub orb_test val=5
  uorb pub sensor_accel x=0.1 y=-0.2 z=-9.81 -r 250
  uorb pub vehicle_attitude 'q=[1, 0, 0, 0]' --multi --priority 100 --keep
  uorb pub battery_status voltage_v=10.5 --from-last
  uorb pub esc_status 'esc[2].esc_rpm=5' -n 10 -r 1

The fields of a topic: `uorb info TOPIC`. Numbers may be hexadecimal (0x1f) or
binary (0b101); floats also nan and inf; truth values True, False, 1, 0; a char
array is a text. Elements of an array that are not given stay as they are.";

pub(crate) fn run(args: &Args, context: &Context) -> anyhow::Result<()> {
    let session = context.session()?;
    let Some(metadata) = topics::describe(&session, &args.topic)? else {
        return Err(topics::unknown(context, &args.topic));
    };
    let layout = &metadata.layout;
    let assignments: Vec<Assignment> = args
        .fields
        .iter()
        .map(|field| Assignment::parse(layout, field))
        .collect::<anyhow::Result<_>>()?;
    for (number, assignment) in assignments.iter().enumerate() {
        if assignments[..number].iter().any(|earlier| earlier.path == assignment.path) {
            bail!("{} is given twice", assignment.path);
        }
    }
    let mut message = match args.from_last {
        true => newest(args, &session)?,
        false => vec![0; layout.size_bytes as usize],
    };
    for assignment in &assignments {
        assignment.write(&mut message);
    }
    let is_given = assignments.iter().any(|assignment| assignment.path == TIMESTAMP);
    let timestamp = if is_given { None } else { timestamp_of(layout) };

    let claim = if args.multi { Claim::Lowest } else { Claim::Shared(args.instance) };
    let options =
        AdvertiseOptions { claim, priority: Priority(args.priority), ..Default::default() };
    let interrupt = Interrupt::catch()?;
    let mut publication = RawPublication::advertise(&session, &metadata, options)?;

    let count = args.number.unwrap_or(if args.rate.is_some() { u64::MAX } else { 1 });
    let period = args.rate.map_or(Duration::ZERO, |rate_hz| Duration::from_secs_f64(1.0 / rate_hz));
    let mut due = Instant::now();
    let mut published = 0;
    while published < count && !wait_until(Some(due), &interrupt, &session)? {
        if let Some(time) = timestamp.clone().and_then(|place| message.get_mut(place)) {
            time.copy_from_slice(&now_us().to_ne_bytes());
        }
        publication.publish(&message)?;
        published += 1;
        due += period;
    }
    let messages = if published == 1 { "message" } else { "messages" };
    let (topic, instance) = (&args.topic, publication.instance());
    say(format_args!("published {published} {messages} on {topic} instance {instance}"));
    if args.keep {
        wait_until(None, &interrupt, &session)?;
    } else if published < count && count < u64::MAX {
        bail!(Early::Interrupted);
    }
    Ok(())
}

/// Waits until this moment (None: for ever) or for Ctrl-C. True: it was Ctrl-C.
///
/// # Errors
///
/// The system ended meanwhile.
fn wait_until(
    moment: Option<Instant>,
    interrupt: &Interrupt,
    session: &Session,
) -> anyhow::Result<bool> {
    loop {
        let look_again = Instant::now() + LOOK_AGAIN;
        let until = moment.map_or(look_again, |moment| moment.min(look_again));
        if interrupt.wait_until(Some(until))? {
            return Ok(true);
        }
        if moment.is_some_and(|moment| moment <= until) {
            return Ok(false);
        }
        if session.has_ended() {
            bail!(uorb_core::Error::Ended { path: session.system().dir() });
        }
    }
}

/// The newest message of the instance.
fn newest(args: &Args, session: &Session) -> anyhow::Result<Vec<u8>> {
    let mut message = Vec::new();
    let mut subscription = RawSubscription::subscribe(session, &args.topic, args.instance)?;
    subscription.copy(&mut message).then_some(message).with_context(|| {
        format!(
            "nothing was published on {} instance {} yet: leave out --from-last",
            args.topic, args.instance
        )
    })
}

const TIMESTAMP: &str = "timestamp";

/// Where the time of publishing goes, if the message has a place for it.
fn timestamp_of(layout: &Layout) -> Option<Range<usize>> {
    let field = layout.fields.iter().find(|field| field.name == TIMESTAMP)?;
    let is_time = field.ty == FieldType::Uint64 && field.array_length.is_none();
    let start = field.offset_bytes as usize;
    is_time.then(|| start..start + size_of::<u64>())
}
