//! How long a message takes from `publish` to a reader that slept in `poll`.
//!
//! It prints and does not judge: what a loaded machine takes says nothing about
//! the bus.

use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use anyhow::ensure;
use uorb_core::{Publication, Session, Subscription, Topic, now_us, poll};
use uorb_msg::{OrbTest, OrbTestLarge, OrbTestMedium};

use super::{PATIENCE, drain};

/// Messages that are measured; one a millisecond.
const MESSAGES: usize = 1_000;

pub(super) fn latency_test(session: &Session, out: &mut dyn Write) -> anyhow::Result<()> {
    let at = |timestamp| OrbTest { timestamp, ..OrbTest::default() };
    measure::<OrbTest>(session, out, at, |message| message.timestamp)?;
    let at = |timestamp| OrbTestMedium { timestamp, ..OrbTestMedium::default() };
    measure::<OrbTestMedium>(session, out, at, |message| message.timestamp)?;
    let at = |timestamp| OrbTestLarge { timestamp, ..OrbTestLarge::default() };
    measure::<OrbTestLarge>(session, out, at, |message| message.timestamp)
}

fn measure<T: Topic>(
    session: &Session,
    out: &mut dyn Write,
    message_at: fn(u64) -> T::Message,
    time_of: fn(&T::Message) -> u64,
) -> anyhow::Result<()> {
    let mut publication = Publication::<T>::advertise(session)?;
    let mut subscription = Subscription::<T>::subscribe(session)?;
    drain(&mut subscription);
    let lost_before = subscription.lost();
    let is_done = AtomicBool::new(false);

    let latencies_us = thread::scope(|scope| {
        let publisher = scope.spawn(|| -> anyhow::Result<()> {
            while !is_done.load(Ordering::Relaxed) {
                publication.publish(&message_at(now_us()))?;
                thread::sleep(Duration::from_millis(1));
            }
            Ok(())
        });
        let latencies_us = read(&mut subscription, time_of);
        is_done.store(true, Ordering::Relaxed);
        let published = publisher.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        published.and(latencies_us)
    })?;

    let count = latencies_us.len() as f64;
    let mean = latencies_us.iter().sum::<f64>() / count;
    let variance = latencies_us.iter().map(|latency| (latency - mean).powi(2)).sum::<f64>() / count;
    let (min, max) = latencies_us
        .iter()
        .fold((f64::MAX, f64::MIN), |(min, max), latency| (min.min(*latency), max.max(*latency)));
    let lost = subscription.lost() - lost_before;
    let metadata = T::METADATA;
    writeln!(
        out,
        "latency {} ({} bytes): mean {mean:.1} us, std dev {:.1} us, min {min} us, max {max} us, \
         missed topic updates {lost}",
        metadata.name,
        metadata.layout.size_bytes,
        variance.sqrt(),
    )?;
    Ok(())
}

/// Sleeps for each message and notes how long it was on its way.
fn read<T: Topic>(
    subscription: &mut Subscription<T>,
    time_of: fn(&T::Message) -> u64,
) -> anyhow::Result<Vec<f64>> {
    let mut latencies_us = Vec::with_capacity(MESSAGES);
    while latencies_us.len() < MESSAGES {
        let woken = poll(&mut [&mut **subscription], Some(PATIENCE))?;
        ensure!(woken > 0, "{} of {MESSAGES} messages came", latencies_us.len());
        if let Some(message) = subscription.update() {
            latencies_us.push(now_us().saturating_sub(time_of(&message)) as f64);
        }
    }
    Ok(latencies_us)
}
