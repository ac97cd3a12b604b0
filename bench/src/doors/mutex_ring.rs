//! What PX4's uORB does inside one process: a ring behind a mutex, and a
//! condition for whoever waits.
//!
//! The publisher copies its message into the ring under the lock and wakes the
//! waiters while it holds it (uORBDeviceNode.cpp); a copy takes the same lock;
//! whether there is anything new is one load of the generation.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread;

use super::{Door, Side, WORDS, ways};
use crate::place::Place;
use crate::times::Times;

pub const NAME: &str = "mutex-ring";

/// A queue of one, as most of PX4's topics have it.
#[derive(Debug, Default)]
pub struct Ring {
    slot: Mutex<Slot>,
    published: Condvar,
    generation: AtomicU64,
}

#[derive(Debug, Default)]
struct Slot {
    message: [u64; WORDS],
    /// Whom to wake: without them PX4 makes no system call either.
    waiters: usize,
}

impl Ring {
    pub fn publish(&self, message: &[u64; WORDS]) {
        let mut slot = self.lock();
        slot.message = *message;
        self.generation.fetch_add(1, Ordering::Release);
        if slot.waiters > 0 {
            self.published.notify_all();
        }
    }

    pub fn copy(&self, seen: &mut u64) -> [u64; WORDS] {
        let slot = self.lock();
        *seen = self.generation.load(Ordering::Acquire);
        slot.message
    }

    pub fn updated(&self, seen: u64) -> bool {
        self.generation.load(Ordering::Acquire) != seen
    }

    fn wait(&self, seen: u64) {
        let mut slot = self.lock();
        slot.waiters += 1;
        let is_old = |_: &mut Slot| !self.updated(seen);
        let slot = self.published.wait_while(slot, is_old);
        slot.expect("nobody panics with it").waiters -= 1;
    }

    fn lock(&self) -> MutexGuard<'_, Slot> {
        self.slot.lock().expect("nobody panics with it")
    }
}

struct Ends {
    out: Arc<Ring>,
    from: Arc<Ring>,
    seen: u64,
}

impl Door for Ends {
    fn send(&mut self, sent_ns: u64) {
        let mut message = [0; WORDS];
        message[0] = sent_ns;
        self.out.publish(&message);
    }

    fn wait(&mut self) -> u64 {
        self.from.wait(self.seen);
        self.from.copy(&mut self.seen)[0]
    }
}

/// Two threads of this process, where the place says.
pub fn one_way(place: &Place, count: u32) -> Times {
    let rings = [Arc::new(Ring::default()), Arc::new(Ring::default())];
    let sides = [Side::Ping, Side::Pong].map(|side| {
        let [ping, pong] = rings.clone();
        let (out, from) = if side == Side::Ping { (ping, pong) } else { (pong, ping) };
        let core = place.cores[usize::from(side == Side::Pong)];
        thread::spawn(move || {
            core.pin();
            ways(&mut Ends { out, from, seen: 0 }, side, count as usize)
        })
    });
    let mut times = Times::none();
    for side in sides {
        times.add(&Times::of_ns(side.join().expect("it ends")));
    }
    times
}
