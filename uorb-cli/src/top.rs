//! `uorb top`: how much is published, and how much is lost, node by node.
//!
//! On a terminal it is a live view; elsewhere it is PX4's text, once a second.
//! A rate is what was counted between two looks, divided by the time between
//! them as it was, not as it should have been.

mod draw;
mod model;
mod nodes;
mod screen;
mod text;

use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

use anyhow::bail;
use clap_complete::engine::ArgValueCandidates;
use serde::Serialize;
use uorb_core::Error;

use self::model::{Selection, Update};
use self::nodes::Nodes;
use crate::completions::topic_names;
use crate::context::Context;
use crate::exit::Early;
use crate::interrupt::Interrupt;
use crate::unreadable::Unreadable;

/// From one update to the next, as in PX4.
const INTERVAL: Duration = Duration::from_secs(1);

/// Show how often topics are published, and what subscribers lose.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// Show all nodes, not only those on which something is published
    #[arg(short, long)]
    all: bool,

    /// Print one update and exit
    #[arg(short = '1', long = "once")]
    once: bool,

    /// Print one JSON object an update, with exact rates
    #[arg(long)]
    json: bool,

    /// Only topics with this in their name; implies -a
    #[arg(value_name = "FILTER", add = ArgValueCandidates::new(topic_names))]
    filters: Vec<String>,
}

const EXAMPLES: &str = "\
Examples:
  uorb top
  uorb top -1 sensor_ vehicle_attitude
  uorb top -a -1
  uorb top --json | jq -c '.topics[] | [.topic, .instance, .rate_hz]'

Columns, all of the last update, which is one second:
  #SUB    subscriptions
  #MSG    messages that were published
  #LOST   messages that were overwritten before a subscription had copied them,
          all its subscriptions together; what an interval skips is not lost
  #QSIZE  messages that the node keeps, 0 before its first publisher
  SIZE    bytes of a message
  kB/s    thousands of bytes that were published
  #STR    those who follow the stream, with a queue of their own there: some of
          the subscriptions (of a large topic all), and foreign programs; what
          they lose is in #LOST

On a terminal, -1 and --json apart, it is a live view:
  q, Esc, Ctrl-C        quit
  n r l s               sort by name, rate, lost, subscriptions; again: turn round
  a                     all nodes, or those that publish
  /                     type a filter; Enter keeps it, Esc drops it
  arrows, PgUp, PgDn    scroll";

/// What `--json` prints: an update, and the nodes that could not be looked at.
#[derive(Serialize)]
struct Line<'a> {
    #[serde(flatten)]
    update: &'a Update,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    unreadable: Vec<&'a Unreadable>,
}

pub(crate) fn run(args: &Args, context: &Context, out: &mut dyn Write) -> anyhow::Result<()> {
    let mut nodes = Nodes::new(&context.system);
    if !nodes.exist() {
        bail!(context.system.no_broker());
    }
    let selection = Selection { all: args.all, filters: args.filters.clone() };
    if !args.once && !args.json && std::io::stdout().is_terminal() {
        return screen::show(&mut nodes, selection);
    }

    let interrupt = Interrupt::catch()?;
    let mut next = Instant::now();
    let mut before = nodes.look()?;
    for number in 0_u64.. {
        next += INTERVAL;
        if interrupt.wait_until(Some(next))? {
            // That is how one ends it, where it does not end by itself.
            return if args.once { bail!(Early::Interrupted) } else { Ok(()) };
        }
        if !nodes.exist() {
            bail!(Error::Ended { path: context.system.dir() });
        }
        let after = nodes.look()?;
        let update = Update::between(&before, &after).select(&selection);
        let unreadable = nodes.unreadable(&selection);
        if args.json {
            writeln!(out, "{}", serde_json::to_string(&Line { update: &update, unreadable })?)?;
        } else {
            if number > 0 {
                writeln!(out)?;
            }
            text::print(&update, out)?;
            for node in unreadable {
                writeln!(out, "{node}")?;
            }
        }
        out.flush()?;
        if args.once {
            break;
        }
        before = after;
    }
    Ok(())
}
