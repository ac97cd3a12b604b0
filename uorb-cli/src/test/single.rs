//! One topic, one instance.

use std::io::Write;

use anyhow::ensure;
use uorb_core::{Instance, Publication, Session, Subscription, now_us};
use uorb_msg::OrbTest;

use super::{copy_new, drain, nothing_new};

pub(super) fn message(val: i32) -> OrbTest {
    OrbTest { timestamp: now_us(), val, ..OrbTest::default() }
}

/// What was published is copied, once as an update.
pub(super) fn test_single(session: &Session, _out: &mut dyn Write) -> anyhow::Result<()> {
    let mut publication = Publication::<OrbTest>::advertise(session)?;
    publication.publish(&message(0))?;

    let mut subscription = Subscription::<OrbTest>::subscribe(session)?;
    let copied = subscription.copy();
    ensure!(copied.is_some_and(|copied| copied.val == 0), "copied {copied:?} instead of 0");
    nothing_new(&mut subscription)?;

    publication.publish(&message(2))?;
    let copied = copy_new(&mut subscription)?;
    ensure!(copied.val == 2, "copied {} instead of 2", copied.val);

    drop(subscription);
    drop(publication);
    ensure!(!session.exists("orb_test", Instance::FIRST)?, "it is still advertised");
    Ok(())
}

/// Of two publishers of one instance, one leaves, and the other goes on.
///
/// PX4 hides the topic then; its pull request 16084 has this test.
pub(super) fn test_single_unadvertise(
    session: &Session,
    _out: &mut dyn Write,
) -> anyhow::Result<()> {
    let first = Publication::<OrbTest>::advertise(session)?;
    let mut second = Publication::<OrbTest>::advertise(session)?;
    let mut subscription = Subscription::<OrbTest>::subscribe(session)?;
    drain(&mut subscription);
    second.publish(&message(1))?;
    ensure!(copy_new(&mut subscription)?.val == 1, "the second publisher was not seen");

    drop(first);
    ensure!(subscription.advertised(), "unadvertised with a publisher left");
    nothing_new(&mut subscription)?;
    second.publish(&message(2))?;
    ensure!(copy_new(&mut subscription)?.val == 2, "the publisher that is left was not seen");

    drop(second);
    ensure!(!subscription.advertised(), "still advertised without a publisher");
    let last = subscription.copy();
    ensure!(last.is_some_and(|last| last.val == 2), "the last message is gone");
    Ok(())
}
