//! `uorb test`: PX4's unit tests of uORB by their own names, on the live bus.
//!
//! A running system remembers what earlier runs have published, so no test
//! assumes that a node is fresh: it first copies what is pending. Each stands
//! alone. They take the test topics for themselves: two runs at the same time,
//! or a module that publishes on one of them, disturb each other.

mod latency;
mod multi;
mod queue;
mod single;

use std::io::Write;
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use clap::builder::PossibleValuesParser;
use uorb_core::{RawSubscription, Session, Subscription, Topic};

use crate::context::Context;

/// Run PX4's unit tests against the bus.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// Which tests [default: all]
    #[arg(value_name = "NAME", value_parser = PossibleValuesParser::new(names()))]
    names: Vec<String>,
}

const EXAMPLES: &str = "\
Examples:
  uorb test
  uorb test test_queue test_wrap_around
  uorb test latency_test

The tests publish on orb_test, orb_multitest and orb_test_medium*, which nobody
else should do meanwhile. latency_test prints figures and does not judge them.";

type Test = fn(&Session, &mut dyn Write) -> anyhow::Result<()>;

/// In the order of PX4.
const TESTS: [(&str, Test); 11] = [
    ("test_single", single::test_single),
    ("test_SubscriptionMulti", multi::test_subscription_multi),
    ("test_multi", multi::test_multi),
    ("test_multi_reversed", multi::test_multi_reversed),
    ("test_unadvertise", multi::test_unadvertise),
    ("test_multi2", multi::test_multi2),
    ("test_wrap_around", queue::test_wrap_around),
    ("test_queue", queue::test_queue),
    ("test_queue_poll_notify", queue::test_queue_poll_notify),
    ("test_single_unadvertise", single::test_single_unadvertise),
    ("latency_test", latency::latency_test),
];

fn names() -> [&'static str; TESTS.len()] {
    TESTS.map(|(name, _)| name)
}

pub(crate) fn run(args: &Args, context: &Context, out: &mut dyn Write) -> anyhow::Result<()> {
    let session = context.session()?;
    let is_wanted = |name: &str| args.names.is_empty() || args.names.iter().any(|n| n == name);
    let (mut passed, mut failed) = (0, 0);
    for (name, test) in TESTS.into_iter().filter(|(name, _)| is_wanted(name)) {
        match test(&session, out) {
            Ok(()) => {
                passed += 1;
                writeln!(out, "PASS {name}")?;
            }
            Err(failure) => {
                failed += 1;
                writeln!(out, "FAIL {name}: {failure:#}")?;
            }
        }
        // The next one may take its time.
        out.flush()?;
    }
    writeln!(out, "{passed} passed, {failed} failed")?;
    if failed > 0 {
        bail!("{failed} of {} tests failed", passed + failed);
    }
    Ok(())
}

/// How long a test waits for what must come before it calls it missing. Not a
/// measure of speed: a loaded machine takes its time.
const PATIENCE: Duration = Duration::from_secs(10);

/// Copies what earlier runs have left.
fn drain<T: Topic>(subscription: &mut Subscription<T>) {
    while subscription.update().is_some() {}
}

/// Copies the message that must be new.
fn copy_new<T: Topic>(subscription: &mut Subscription<T>) -> anyhow::Result<T::Message> {
    ensure!(subscription.updated(), "{}: no update", describe(subscription));
    subscription.copy().with_context(|| format!("{}: copy failed", describe(subscription)))
}

/// Checks that nothing is new.
fn nothing_new<T: Topic>(subscription: &mut Subscription<T>) -> anyhow::Result<()> {
    ensure!(!subscription.updated(), "{}: a spurious update", describe(subscription));
    Ok(())
}

fn describe(subscription: &RawSubscription) -> String {
    format!("{} instance {}", subscription.topic(), subscription.instance())
}
