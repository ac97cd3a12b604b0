//! A node that keeps several messages.

use std::io::Write;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

use anyhow::{Context as _, ensure};
use uorb_core::{Publication, Session, Subscription, Topic, now_us, poll};
use uorb_msg::{
    OrbTestMedium, OrbTestMediumQueue, OrbTestMediumQueuePoll, OrbTestMediumWrapAround,
};

use super::{PATIENCE, copy_new, drain, nothing_new};

fn message(val: i32) -> OrbTestMedium {
    OrbTestMedium { timestamp: now_us(), val, ..OrbTestMedium::default() }
}

/// A queue works across the wrap of the 32-bit generation.
///
/// The broker makes new nodes of this topic with a generation shortly before
/// the wrap. On a system where the test has run before, its node is past that.
pub(super) fn test_wrap_around(session: &Session, out: &mut dyn Write) -> anyhow::Result<()> {
    let mut publication = Publication::<OrbTestMediumWrapAround>::advertise(session)?;
    let mut subscription = Subscription::<OrbTestMediumWrapAround>::subscribe(session)?;
    drain(&mut subscription);
    let start = publication.publish(&message(0))?;
    ensure!(copy_new(&mut subscription)?.val == 0, "the first message was not copied");
    fill_and_overflow(&mut publication, &mut subscription)?;
    let end = subscription.last_copied().context("nothing was copied")?.generation;
    if end.get() > start.get() {
        writeln!(
            out,
            "note: generations {start} to {end}; only a new system starts before the wrap"
        )?;
    }
    Ok(())
}

/// A queue keeps its newest messages in order.
pub(super) fn test_queue(session: &Session, _out: &mut dyn Write) -> anyhow::Result<()> {
    let mut subscription = Subscription::<OrbTestMediumQueue>::subscribe(session)?;
    drain(&mut subscription);
    let mut publication = Publication::<OrbTestMediumQueue>::advertise(session)?;
    nothing_new(&mut subscription)?;
    publication.publish(&message(0))?;
    ensure!(copy_new(&mut subscription)?.val == 0, "the first message was not copied");
    fill_and_overflow(&mut publication, &mut subscription)
}

/// Fills the queue and reads it, overflows it and reads it, reads what is
/// nothing new. The subscription has copied all there is.
fn fill_and_overflow<T: Topic<Message = OrbTestMedium>>(
    publication: &mut Publication<T>,
    subscription: &mut Subscription<T>,
) -> anyhow::Result<()> {
    let length = publication.queue_length().get() as i32;
    ensure!(length >= 4, "a queue of {length} is too short for this test");
    nothing_new(subscription)?;

    for val in 0..length - 2 {
        publication.publish(&message(val))?;
    }
    for expected in 0..length - 2 {
        let val = copy_new(subscription)?.val;
        ensure!(val == expected, "read {val} instead of {expected}");
    }
    nothing_new(subscription)?;

    // The oldest three are overwritten.
    const OVERFLOW: i32 = 3;
    let lost_before = subscription.lost();
    for val in 0..length + OVERFLOW {
        publication.publish(&message(val))?;
    }
    for expected in OVERFLOW..length + OVERFLOW {
        let val = copy_new(subscription)?.val;
        ensure!(val == expected, "after an overflow, read {val} instead of {expected}");
    }
    let lost = subscription.lost() - lost_before;
    ensure!(lost == OVERFLOW as u64, "{lost} lost instead of {OVERFLOW}");

    for _ in 0..length {
        nothing_new(subscription)?;
        let val = subscription.copy().context("the last message is gone")?.val;
        ensure!(val == length + OVERFLOW - 1, "the last message became {val}");
    }

    publication.publish(&message(943))?;
    let val = copy_new(subscription)?.val;
    ensure!(val == 943, "read {val} instead of 943");
    nothing_new(subscription)
}

/// One copy after each wake gets every message of bursts that fit the queue.
pub(super) fn test_queue_poll_notify(
    session: &Session,
    _out: &mut dyn Write,
) -> anyhow::Result<()> {
    let mut subscription = Subscription::<OrbTestMediumQueuePoll>::subscribe(session)?;
    drain(&mut subscription);
    let publication = Publication::<OrbTestMediumQueuePoll>::advertise(session)?;
    let length = publication.queue_length().get() as usize;
    // Fits the queue, whatever a queue of a power of two from 16 up is.
    let burst = length / 2 + 7;
    ensure!(burst <= length, "a queue of {length} is too short for this test");
    let bursts = (20 * length).div_ceil(burst);

    // The reader gives one token back for each message, and the next burst
    // comes when all of the last were read: then the reader is about to sleep,
    // or sleeps already, which is what this is about.
    let (taken, all_taken) = sync_channel(burst);
    thread::scope(|scope| {
        let publisher = scope.spawn(move || publish_bursts(publication, bursts, burst, &all_taken));
        let read = read_one_a_wake(&mut subscription, bursts * burst, &taken);
        // A publisher that waits for tokens ends.
        drop(taken);
        let published = publisher.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        read.and(published)
    })
}

fn publish_bursts(
    mut publication: Publication<OrbTestMediumQueuePoll>,
    bursts: usize,
    burst: usize,
    all_taken: &Receiver<()>,
) -> anyhow::Result<()> {
    let mut val = 0;
    for _ in 0..bursts {
        for _ in 0..burst {
            publication.publish(&message(val))?;
            val += 1;
        }
        for _ in 0..burst {
            all_taken.recv().context("the reader has given up")?;
        }
    }
    Ok(())
}

fn read_one_a_wake(
    subscription: &mut Subscription<OrbTestMediumQueuePoll>,
    messages: usize,
    taken: &SyncSender<()>,
) -> anyhow::Result<()> {
    for expected in 0..messages as i32 {
        let woken = poll(&mut [&mut **subscription], Some(PATIENCE))?;
        ensure!(woken > 0, "no wake for message {expected} of {messages}");
        let val = copy_new(subscription)?.val;
        ensure!(val == expected, "read {val} instead of {expected}");
        taken.send(()).context("the publisher has given up")?;
    }
    nothing_new(subscription)
}
