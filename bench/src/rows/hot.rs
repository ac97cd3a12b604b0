//! Publish, copy, and the looks, with 64 bytes: what a control loop does a
//! thousand times a second. All of it in one process on one core; what another
//! process does with the same memory does not change it.

use std::hint::black_box;
use std::time::Duration;

use nix::sys::resource::{UsageWho, getrusage};
use uorb_core::{AdvertiseOptions, Publication, QueueLength, Subscription, poll, topic};
use uorb_tests::Bus;

use super::Run;
use super::kernel::{CLOCK, clock_read};
use crate::doors::WORDS;
use crate::figures::Contestant;
use crate::times::per_call;

topic! { pub struct Bytes64 = "bytes64" { pub words: [u64; WORDS] } }
topic! { pub struct Touched = "touched" { pub bytes: [u8; 4_096] } }

/// How many idle subscriptions a publish is measured with.
pub const IDLE: [usize; 5] = [0, 1, 4, 16, 64];

pub fn setting(subscriptions: usize) -> String {
    format!("64 B, {subscriptions} idle")
}

pub fn measure(run: &mut Run, bus: &mut Bus) {
    publish(run, bus);
    looks(run, bus);
    faults(run, bus);
}

fn publish(run: &mut Run, bus: &mut Bus) {
    let batches = run.figures.effort.batches;
    let mut publication = bus.advertise::<Bytes64>();
    let message = Bytes64 { words: [1; WORDS] };
    let mut idle = Vec::new();
    run.alone(|figures| {
        for subscriptions in IDLE {
            idle.resize_with(subscriptions, || bus.subscribe::<Bytes64>());
            let ours = Contestant::new("uorb", || {
                per_call(batches, || {
                    publication.publish(black_box(&message)).expect("published");
                })
            });
            let setting = setting(subscriptions);
            let floor = &mut || clock_read(batches);
            figures.measure(("publish", &setting), (CLOCK, floor), vec![ours]);
        }
    });
}

fn looks(run: &mut Run, bus: &mut Bus) {
    let batches = run.figures.effort.batches;
    let mut publication = bus.advertise::<Bytes64>();
    let mut subscription = bus.subscribe::<Bytes64>();
    let mut message = Bytes64 { words: [1; WORDS] };
    run.alone(|figures| {
        publication.publish(&message).expect("published");
        let mut row = |row: &str, measure: &mut dyn FnMut() -> _| {
            let ours = Contestant::new("uorb", measure);
            figures.measure((row, "64 B"), (CLOCK, &mut || clock_read(batches)), vec![ours]);
        };
        // Before anything is copied the message stays new.
        row("updated, it is", &mut || per_call(batches, || subscription.updated()));
        row("poll, ready", &mut || {
            per_call(batches, || {
                let ready = poll(&mut [black_box(&mut *subscription)], Some(Duration::MAX));
                assert_eq!(ready.expect("it can be polled"), 1);
            })
        });
        row("copy", &mut || per_call(batches, || subscription.copy()));
        row("copy, in place", &mut || {
            per_call(batches, || subscription.copy_into(black_box(&mut message)))
        });
        row("updated, it is not", &mut || per_call(batches, || subscription.updated()));
        row("update, nothing new", &mut || per_call(batches, || subscription.update()));
        row("publish and update", &mut || {
            per_call(batches, || {
                publication.publish(black_box(&message)).expect("published");
                black_box(subscription.update());
            })
        });
        row("poll, not ready", &mut || {
            per_call(batches, || {
                let ready = poll(&mut [black_box(&mut *subscription)], Some(Duration::ZERO));
                assert_eq!(ready.expect("it can be polled"), 0);
            })
        });
    });
}

/// Page faults from the first copy on: the memory is there already.
fn faults(run: &mut Run, bus: &mut Bus) {
    let options =
        AdvertiseOptions { queue_length: QueueLength::new(16), ..AdvertiseOptions::default() };
    let publication = Publication::<Touched>::advertise_with(&bus.session(), options);
    let mut publication = publication.expect("advertised");
    let mut subscription: Subscription<Touched> = bus.subscribe();
    let mut message = Touched { bytes: [1; 4_096] };
    publication.publish(&message).expect("published");
    subscription.copy_into(&mut message);
    let minor = || getrusage(UsageWho::RUSAGE_THREAD).expect("Linux counts").minor_page_faults();
    let before = minor();
    for _ in 0..1_000 {
        publication.publish(&message).expect("published");
        subscription.copy_into(&mut message);
    }
    let faults = (minor() - before) as f64;
    let setting = "1,000 publishes and copies of 4 KiB, a queue of 16";
    run.figures.note_value(("page faults", setting), "uorb", faults, "faults");
}
