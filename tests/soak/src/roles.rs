//! The processes of a soak: publishers, subscribers that poll, and a follower of
//! the streams. Each serves its topics until its input ends, and answers every
//! line with what happened since the last one.

use std::io::{self, BufRead};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Result;
use uorb_core::{
    AdvertiseOptions, Error, Instance, Layout, Metadata, QueueLength, RawPublication,
    RawSubscription, Session, StreamOptions, now_us, poll,
};

use crate::latencies::Latencies;

pub(crate) const TOPICS: usize = 100;

const MESSAGE_BYTES: usize = 64;

/// So long a reader that gets no core may sleep at 250 Hz: half a second.
const QUEUE_LENGTH: u32 = 128;

/// As in a vehicle: few topics are fast.
fn rate_hz(topic: usize) -> f64 {
    match topic % 25 {
        0 => 250.0,
        1..5 => 50.0,
        5..15 => 10.0,
        _ => 1.0,
    }
}

fn metadata(topic: usize) -> Metadata {
    let name = name(topic);
    let layout = Layout::untyped(name.clone(), MESSAGE_BYTES as u32);
    let queue_length = QueueLength::at_least(QUEUE_LENGTH);
    Metadata { name: name.into(), layout: std::borrow::Cow::Owned(layout), queue_length }
}

fn name(topic: usize) -> String {
    format!("soak_{topic:02}")
}

/// What happened since the last question.
#[derive(Debug)]
struct Tally {
    messages: u64,
    lost: u64,
    latencies: Latencies,
}

type Shared = Arc<Mutex<Tally>>;

/// Says ready, and answers from now on. At the end of the input the process ends.
fn answer() -> Shared {
    let tally = Tally { messages: 0, lost: 0, latencies: Latencies::new() };
    let shared = Arc::new(Mutex::new(tally));
    let counted = shared.clone();
    println!("ready");
    thread::spawn(move || {
        for _ in io::stdin().lock().lines().map_while(Result::ok) {
            let mut tally = counted.lock().unwrap_or_else(PoisonError::into_inner);
            println!("{} {} {}", tally.messages, tally.lost, tally.latencies);
            *tally = Tally { messages: 0, lost: 0, latencies: Latencies::new() };
        }
        std::process::exit(0);
    });
    shared
}

fn count(shared: &Shared, change: impl FnOnce(&mut Tally)) {
    change(&mut shared.lock().unwrap_or_else(PoisonError::into_inner));
}

/// The end of the system is the end of a role.
fn until_the_end(ended: Result<(), Error>) -> Result<()> {
    match ended {
        Err(Error::Ended { .. }) => Ok(()),
        other => Ok(other?),
    }
}

/// Publishes every `of`th topic from `first` on.
pub(crate) fn publish(session: &Session, first: usize, of: usize) -> Result<()> {
    struct Due {
        at: Instant,
        period: Duration,
        publication: RawPublication,
    }
    let start = Instant::now();
    let mut topics = Vec::new();
    for topic in (first..TOPICS).step_by(of) {
        let options = AdvertiseOptions::default();
        let publication = RawPublication::advertise(session, &metadata(topic), options)?;
        let period = Duration::from_secs_f64(1.0 / rate_hz(topic));
        topics.push(Due { at: start + period.mul_f64(topic as f64 / 100.0), period, publication });
    }
    let shared = answer();
    let mut message = [0; MESSAGE_BYTES];
    until_the_end(loop {
        let Some(next) = topics.iter_mut().min_by_key(|topic| topic.at) else { break Ok(()) };
        thread::sleep(next.at.saturating_duration_since(Instant::now()));
        message[..8].copy_from_slice(&now_us().to_ne_bytes());
        if let Err(error) = next.publication.publish(&message) {
            break Err(error);
        }
        count(&shared, |tally| tally.messages += 1);
        // Who was late does not make up for it in a burst.
        next.at = (next.at + next.period).max(Instant::now());
    })
}

/// Copies all topics: by `poll`, or every message by their streams.
pub(crate) fn copy(session: &Session, by_stream: bool) -> Result<()> {
    let mut topics = Vec::new();
    for topic in 0..TOPICS {
        topics.push(match by_stream {
            false => RawSubscription::subscribe(session, &name(topic), Instance::FIRST)?,
            true => {
                let options = StreamOptions::default();
                RawSubscription::subscribe_stream(session, &name(topic), Instance::FIRST, options)?
            }
        });
    }
    let shared = answer();
    let mut message = Vec::new();
    let mut lost_before = 0;
    until_the_end(loop {
        let mut waiting: Vec<&mut RawSubscription> = topics.iter_mut().collect();
        match poll(&mut waiting, Some(Duration::from_secs(1))) {
            Ok(_) => {}
            Err(error) => break Err(error),
        }
        for topic in &mut topics {
            while topic.updated() && topic.copy(&mut message) {
                let Some(published_us) = message.first_chunk() else { continue };
                let took_us = now_us().saturating_sub(u64::from_ne_bytes(*published_us));
                count(&shared, |tally| {
                    tally.messages += 1;
                    tally.latencies.add(took_us);
                });
            }
        }
        let lost: u64 = topics.iter().map(RawSubscription::lost).sum();
        count(&shared, |tally| tally.lost += lost - lost_before);
        lost_before = lost;
    })
}
