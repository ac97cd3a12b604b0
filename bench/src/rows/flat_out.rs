//! As fast as it goes: one publisher and one subscriber, and four publishers on
//! one instance.
//!
//! A subscription that is slower than its publisher loses messages, and says how
//! many; the last message is never lost, and says that it is over.

use std::time::{Duration, Instant};

use anyhow::bail;
use uorb_core::{
    AdvertiseOptions, Publication, QueueLength, Session, StreamSubscription, Subscription, System,
};
use uorb_tests::{Bus, heard, number};

use super::Run;
use super::hot::Bytes64;
use crate::doors::{WORDS, iceoryx};
use crate::role::{self, on};
use crate::times::Times;

const OVER: u64 = u64::MAX;
const PUBLISHERS: usize = 4;
pub const FOUR: (&str, &str) = ("4 publishers on one instance", "64 B, the slowest");

pub fn measure(run: &mut Run, bus: &mut Bus) {
    let cores = [run.cores.other(), run.cores.alone()];
    for (who, how) in [
        ("uorb, queue of 1", "queue-1"),
        ("uorb, queue of 16", "queue-16"),
        ("uorb, stream", "stream"),
        ("iceoryx2", "iceoryx2"),
    ] {
        // A bus of its own: the first publisher says how long the queue is.
        let bus = Bus::start();
        let ms = (run.figures.effort.watch_ms / 5).to_string();
        let [there, here] = cores.map(on);
        let mut publisher = role::play(Some(&bus), &["flat-out", &here, "publish", how, &ms]);
        publisher.expect("ready");
        let mut follower = role::play(Some(&bus), &["flat-out", &there, "follow", how, &ms]);
        follower.expect("ready");
        publisher.say("go");
        let sent = publisher.line().expect("it says how many");
        let came = follower.line().expect("it says how many");
        let [sent, sent_s] = numbers(&sent);
        let [came, came_s] = numbers(&came);
        let row = ("flat out, one publisher and one subscriber", "64 B");
        let figures = &mut run.figures;
        figures.note_value((row.0, "64 B, published"), who, sent / sent_s / 1e6, "M/s");
        figures.note_value((row.0, "64 B, received"), who, came / came_s / 1e6, "M/s");
        figures.note_value((row.0, "64 B, lost"), who, (sent - came) / sent * 100.0, "%");
    }
    four_publishers(run, bus);
}

fn numbers<const COUNT: usize>(line: &str) -> [f64; COUNT] {
    let words = line.split_whitespace().map(|word| word.parse().expect("a number"));
    words.collect::<Vec<f64>>().try_into().expect("so many numbers")
}

fn four_publishers(run: &mut Run, bus: &Bus) {
    let ms = (run.figures.effort.watch_ms / 5).to_string();
    let start = |_| {
        let mut publisher = role::play(Some(bus), &["flat-out", "any", "publish-timed", "", &ms]);
        publisher.expect("ready");
        publisher
    };
    let mut publishers: Vec<_> = (0..PUBLISHERS).map(start).collect();
    publishers.iter_mut().for_each(|publisher| publisher.say("go"));
    let lines = publishers.iter_mut().map(|publisher| publisher.line().expect("its times"));
    let each: Vec<[f64; 3]> = lines.map(|line| numbers(&line)).collect();
    let slowest = each.iter().max_by(|a, b| (a[1] / a[0]).total_cmp(&(b[1] / b[0])));
    let [median, p999, max] = *slowest.expect("there are four");
    for (what, value, unit) in [
        ("median", median, "ns"),
        ("p99.9", p999, "ns"),
        ("max", max, "ns"),
        ("p99.9 by median", p999 / median, "x"),
    ] {
        run.figures.note_value((FOUR.0, &format!("{}, {what}", FOUR.1)), "uorb", value, unit);
    }
}

/// The roles of all of them.
pub fn play(arguments: &[&str]) -> anyhow::Result<()> {
    let [role, how, ms] = arguments else { bail!("no such role: {arguments:?}") };
    let system = System::from_env()?;
    let session = Session::connect()?;
    let watch = Duration::from_millis(number(ms));
    match (*role, *how) {
        ("publish", "iceoryx2") => {
            let (publisher, _) =
                iceoryx::publisher_and_subscribers::<[u64; WORDS]>(&system, "flat", 0);
            publish(watch, |count| {
                let sample = publisher.loan_uninit().expect("memory");
                sample.write_payload([count; WORDS]).send().expect("sent");
            });
        }
        ("publish", how) => {
            let queue_length = QueueLength::new(if how == "queue-16" { 16 } else { 1 });
            let options = AdvertiseOptions { queue_length, ..AdvertiseOptions::default() };
            let mut publication = Publication::<Bytes64>::advertise_with(&session, options)?;
            publish(watch, |count| {
                publication.publish(&Bytes64 { words: [count; WORDS] }).expect("published");
            });
        }
        ("follow", "iceoryx2") => {
            let (_, subscribers) =
                iceoryx::publisher_and_subscribers::<[u64; WORDS]>(&system, "flat", 1);
            follow(|| subscribers[0].receive().expect("received").map(|sample| sample[0]));
        }
        ("follow", "stream") => {
            let mut stream = StreamSubscription::<Bytes64>::subscribe(&session)?;
            follow(|| stream.update().map(|message| message.words[0]));
        }
        ("follow", _) => {
            let mut subscription = Subscription::<Bytes64>::subscribe(&session)?;
            follow(|| subscription.update().map(|message| message.words[0]));
        }
        ("publish-timed", _) => publish_timed(&session, watch)?,
        _ => bail!("no such role: {arguments:?}"),
    }
    heard();
    Ok(())
}

fn publish(watch: Duration, mut send: impl FnMut(u64)) {
    println!("ready");
    heard();
    let began = Instant::now();
    let mut sent = 0;
    while began.elapsed() < watch {
        for _ in 0..100 {
            sent += 1;
            send(sent);
        }
    }
    let took = began.elapsed();
    send(OVER);
    println!("{} {}", sent + 1, took.as_secs_f64());
}

fn follow(mut receive: impl FnMut() -> Option<u64>) {
    println!("ready");
    let mut began = None;
    let mut came = 0;
    loop {
        let Some(message) = receive() else { continue };
        let began = *began.get_or_insert_with(Instant::now);
        came += 1;
        if message == OVER {
            println!("{came} {}", began.elapsed().as_secs_f64());
            return;
        }
    }
}

/// Each publish by itself, one clock read included.
fn publish_timed(session: &Session, watch: Duration) -> anyhow::Result<()> {
    let mut publication = Publication::<Bytes64>::advertise(session)?;
    println!("ready");
    heard();
    let mut times = Times::none();
    let began = Instant::now();
    let mut before = began;
    while before - began < watch {
        publication.publish(&Bytes64 { words: [1; WORDS] })?;
        let now = Instant::now();
        times.add_ns((now - before).as_nanos() as f64);
        before = now;
    }
    println!("{} {} {}", times.median_ns(), times.at_ns(0.999), times.max_ns());
    Ok(())
}
