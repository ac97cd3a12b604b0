//! The hot path, to be counted in instructions and not in time: the count is the
//! same on a busy machine.
//!
//! `scripts/instructions` runs it under callgrind, which counts only what happens
//! inside the function that is named on its command line.

use std::hint::black_box;
use std::time::Duration;

use uorb_core::{Publication, Subscription, poll, topic};
use uorb_tests::Bus;

topic! { pub struct Counted = "counted" { pub words: [u64; 8] } }

const CALLS: usize = 1_000;

#[inline(never)]
fn count_publish(publication: &mut Publication<Counted>, message: &Counted) {
    for _ in 0..CALLS {
        publication.publish(black_box(message)).expect("published");
    }
}

#[inline(never)]
fn count_copy(subscription: &mut Subscription<Counted>, message: &mut Counted) {
    for _ in 0..CALLS {
        black_box(subscription.copy_into(black_box(message)));
    }
}

#[inline(never)]
fn count_updated(subscription: &mut Subscription<Counted>) {
    for _ in 0..CALLS {
        black_box(subscription.updated());
    }
}

#[inline(never)]
fn count_poll_ready(subscription: &mut Subscription<Counted>) {
    for _ in 0..CALLS {
        let ready = poll(&mut [black_box(&mut *subscription)], Some(Duration::MAX));
        assert_eq!(ready.expect("it can be polled"), 1);
    }
}

fn main() {
    let mut bus = Bus::start();
    let mut publication = bus.advertise::<Counted>();
    let mut subscription = bus.subscribe::<Counted>();
    let mut message = Counted { words: [1; 8] };
    // Everything is mapped, and every slot was written once.
    for _ in 0..100 {
        publication.publish(&message).expect("published");
        assert!(subscription.copy_into(&mut message));
    }
    match &*std::env::args().nth(1).expect("publish, copy, updated or poll_ready") {
        "publish" => count_publish(&mut publication, &message),
        "copy" => count_copy(&mut subscription, &mut message),
        "updated" => count_updated(&mut subscription),
        "poll_ready" => {
            publication.publish(&message).expect("published");
            count_poll_ready(&mut subscription);
        }
        other => panic!("{other} is not counted"),
    }
}
