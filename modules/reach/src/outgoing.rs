//! The threads on which messages leave.
//!
//! One is for what waits for room on the link, and one for what does not, so that
//! neither holds the other up. What waits does so for all: while one machine has no room
//! for a message, no reliable topic leaves for any. The bus never waits for either:
//! between them and it is each topic's stream, whose queue is the only one, and loses
//! its oldest message when it is full.
//!
//! A thread looks at its topics every 2 ms and never sleeps on their bells, so
//! publishers make no system call for it. Express topics ring.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{JoinHandle, sleep};
use std::time::Duration;

use uorb_core::{Error, QueueLength, RawSubscription, Session, StreamOptions, now_us, poll};
use uorb_modules::say;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Publisher;

use crate::communicator::{Communicator, lock, send_end, send_message};
use crate::counts::Counts;
use crate::keys::Source;
use crate::ledger::BroughtIn;
use crate::rules::Crossing;
use crate::wire::{Count, Header};

/// How long a message that does not ring may wait to be looked for.
const TICK: Duration = Duration::from_millis(2);
const IDLE_TICK: Duration = Duration::from_millis(20);

/// When to try again what could not be followed.
const TRY_AGAIN_US: u64 = 500_000;

/// So many messages of one topic leave before the next has its turn.
const TURN: usize = 64;
const TURNS_MAX: usize = 64;

/// A topic that somebody wants.
#[derive(Clone, Debug)]
pub(crate) struct Order {
    pub(crate) revision: u32,
    pub(crate) queue_length: QueueLength,
    pub(crate) priority: uorb_core::Priority,
    pub(crate) crossing: Crossing,
    /// The highest rate that anybody wants. None: every message.
    pub(crate) rate_mhz: Option<u32>,
    /// Counts those who have come to want it: each is sent the newest message.
    pub(crate) newcomers: u32,
    /// Nobody publishes it any more. Set when all that there is has left.
    pub(crate) ending: Option<Arc<AtomicBool>>,
    pub(crate) counts: Arc<Counts>,
}

/// What is to leave now.
pub(crate) type Orders = BTreeMap<Source, Order>;

/// One of the threads.
#[derive(Debug)]
pub(crate) struct Outgoing {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    orders: Mutex<Orders>,
    changes: AtomicU64,
    has_ended: AtomicBool,
}

impl Outgoing {
    /// `run` tells this run of this process from others.
    pub(crate) fn start(
        name: &str,
        session: &Session,
        communicator: &Arc<Communicator>,
        (run, brought_in): (u32, BroughtIn),
    ) -> std::io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let mut leaving = Leaving {
            session: session.clone(),
            communicator: communicator.clone(),
            shared: shared.clone(),
            run,
            brought_in,
            followed: BTreeMap::new(),
            refused: BTreeMap::new(),
        };
        let builder = std::thread::Builder::new().name(name.into());
        Ok(Self { shared, thread: Some(builder.spawn(move || leaving.run())?) })
    }

    pub(crate) fn order(&self, orders: Orders) {
        *lock(&self.shared.orders) = orders;
        self.shared.changes.fetch_add(1, Ordering::Release);
    }
}

impl Drop for Outgoing {
    fn drop(&mut self) {
        self.shared.has_ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Leaving {
    session: Session,
    communicator: Arc<Communicator>,
    shared: Arc<Shared>,
    run: u32,
    brought_in: BroughtIn,
    followed: BTreeMap<Source, Followed>,
    /// What could not be followed, and why.
    refused: BTreeMap<Source, String>,
}

struct Followed {
    order: Order,
    subscription: RawSubscription,
    sender: Publisher<'static>,
    /// What has left last, for newcomers.
    newest: Option<ZBytes>,
    generation: Option<u32>,
    lost: u64,
    message: Vec<u8>,
}

impl Leaving {
    fn run(&mut self) {
        let (mut seen, mut try_at_us) = (0, 0);
        while !self.shared.has_ended.load(Ordering::Relaxed) && !self.session.has_ended() {
            let changes = self.shared.changes.load(Ordering::Acquire);
            if changes != seen || now_us() >= try_at_us {
                seen = changes;
                let is_done = self.follow_orders();
                try_at_us = if is_done { u64::MAX } else { now_us() + TRY_AGAIN_US };
            }
            self.wait();
            // A publisher without a pause does not keep us from all else.
            for _ in 0..TURNS_MAX {
                if !self.send_some(seen) {
                    break;
                }
            }
        }
    }

    /// Sends some of each topic. A message may have to wait for room, so it looks behind
    /// each whether there is something else to do. True: there may be more.
    fn send_some(&mut self, seen: u64) -> bool {
        let shared = &self.shared;
        let is_called = || {
            shared.has_ended.load(Ordering::Relaxed)
                || shared.changes.load(Ordering::Relaxed) != seen
        };
        let mut has_more = false;
        for followed in self.followed.values_mut() {
            has_more |= followed.send_some(self.run, &self.brought_in, is_called);
            if shared.has_ended.load(Ordering::Relaxed) {
                return false;
            }
        }
        has_more && !is_called()
    }

    /// Follows what is wanted, and nothing else. False: something has to wait.
    fn follow_orders(&mut self) -> bool {
        let orders = lock(&self.shared.orders).clone();
        self.followed.retain(|source, _| orders.contains_key(source));
        let mut is_done = true;
        for (source, order) in orders {
            let mut before = self.followed.remove(&source);
            if let Some(mut followed) = before.take_if(|followed| followed.continues(&order)) {
                followed.take(order);
                self.followed.insert(source, followed);
                continue;
            }
            let generation = before.as_ref().and_then(|before| before.hands_over(&order));
            let ending = order.ending.clone();
            let communicator = &self.communicator;
            match Followed::begin(&self.session, communicator, &source, order, generation) {
                Ok(followed) => {
                    self.refused.remove(&source);
                    self.followed.insert(source, followed);
                }
                Err(why) => {
                    is_done = false;
                    // What cannot be followed has nothing more to send.
                    ending.iter().for_each(|ending| ending.store(true, Ordering::Relaxed));
                    self.refuse(source, &why.to_string());
                }
            }
        }
        is_done
    }

    /// Says why a topic cannot be followed, the first time.
    fn refuse(&mut self, source: Source, why: &str) {
        let before = self.refused.insert(source.clone(), why.to_string());
        if before.as_deref() != Some(why) {
            say(&format_args!("{source} cannot be sent: {why}; it is tried again"));
        }
    }

    /// Until an express message is there, or it is time to look.
    fn wait(&mut self) {
        let tick = if self.followed.is_empty() { IDLE_TICK } else { TICK };
        let express =
            self.followed.values_mut().filter(|it| it.order.crossing == Crossing::Express);
        let mut express: Vec<_> = express.map(|it| &mut it.subscription).collect();
        if poll(&mut express, Some(tick)).is_err() {
            // What is wrong with one of them is seen when its node is described anew.
            sleep(tick);
        }
    }
}

impl Followed {
    fn begin(
        session: &Session,
        communicator: &Communicator,
        source: &Source,
        order: Order,
        generation: Option<u32>,
    ) -> anyhow::Result<Self> {
        let subscription = subscribe(session, source, &order)?;
        let sender = communicator.sender(source, order.crossing)?;
        let (newest, lost, message) = (None, 0, Vec::new());
        Ok(Self { order, subscription, sender, newest, generation, lost, message })
    }

    /// Whether it can carry out another order as well.
    fn continues(&self, order: &Order) -> bool {
        let same_way = order.rate_mhz.is_some() == self.order.rate_mhz.is_some()
            && order.crossing == self.order.crossing;
        same_way && order.revision == self.order.revision && self.subscription.check().is_ok()
    }

    /// Up to where what comes after it counts as sent or left out, where a rate takes the
    /// place of every message or the other way round: what was not sent then was not
    /// wanted. In all other cases it is lost.
    fn hands_over(&self, order: &Order) -> Option<u32> {
        let is_of_a_rate = order.rate_mhz.is_some() || self.order.rate_mhz.is_some();
        self.generation.filter(|_| is_of_a_rate && order.revision == self.order.revision)
    }

    fn take(&mut self, order: Order) {
        if order.rate_mhz != self.order.rate_mhz {
            set_rate(&mut self.subscription, order.rate_mhz);
        }
        if order.newcomers != self.order.newcomers
            && let Some(newest) = &self.newest
        {
            // Whoever has it already knows it by its generation.
            send_message(&self.sender, newest.clone());
        }
        self.order = order;
    }

    /// Sends what there is, though not without end. True: there may be more.
    fn send_some(
        &mut self,
        run: u32,
        brought_in: &BroughtIn,
        is_called: impl Fn() -> bool,
    ) -> bool {
        for _ in 0..TURN {
            if !self.copy_next() {
                self.end_if_all_has_left();
                return false;
            }
            let Some(copied) = self.subscription.last_copied() else { return false };
            let generation = copied.generation.get();
            let is_again = self.generation == Some(generation);
            let left_out = self.count_up_to(generation);
            if brought_in.has(&copied) {
                // It came in by a reach, to an instance that somebody here has joined.
                self.order.counts.leave_out(u32::from(!is_again));
                continue;
            }
            let header = Header {
                priority: self.order.priority,
                queue_length: self.order.queue_length,
                revision: self.order.revision,
                size_bytes: self.message.len() as u32,
                count: Count { run, generation, left_out },
                publish_time_us: copied.publish_time_us,
            };
            let message = ZBytes::from(header.encode(&self.message));
            self.order.counts.count_message(message.len());
            send_message(&self.sender, message.clone());
            self.newest = Some(message);
            if is_called() {
                break;
            }
        }
        true
    }

    /// Says so behind the last message, where nobody publishes any more. What a rate
    /// holds back is not wanted.
    fn end_if_all_has_left(&self) {
        let Some(ending) = &self.order.ending else { return };
        let all_has_left = self.order.rate_mhz.is_some() || self.subscription.pending() == 0;
        if all_has_left && !ending.load(Ordering::Relaxed) {
            send_end(&self.sender);
            ending.store(true, Ordering::Relaxed);
        }
    }

    /// Counts what is missing before this message: it was lost, or else nobody wanted
    /// it. Returns how many nobody wanted, ever.
    fn count_up_to(&mut self, generation: u32) -> u32 {
        let counts = &self.order.counts;
        let lost_before = std::mem::replace(&mut self.lost, self.subscription.lost());
        let lost = self.lost - lost_before;
        counts.count_lost(lost);
        let before = self.generation.replace(generation);
        // One that begins where another has ended begins with the newest, maybe once more.
        let steps = before.map_or(0, |before| generation.wrapping_sub(before));
        let missing = steps.saturating_sub(1);
        counts.leave_out(missing.saturating_sub(lost as u32))
    }

    /// Where there is a rate the newest message is wanted, not the next.
    fn copy_next(&mut self) -> bool {
        if !self.subscription.updated() {
            return false;
        }
        if self.order.rate_mhz.is_some() && self.subscription.pending() > 1 {
            self.subscription.skip();
        }
        self.subscription.copy(&mut self.message)
    }
}

fn subscribe(session: &Session, source: &Source, order: &Order) -> Result<RawSubscription, Error> {
    if order.rate_mhz.is_some() {
        let mut subscription = RawSubscription::subscribe(session, &source.topic, source.instance)?;
        set_rate(&mut subscription, order.rate_mhz);
        return Ok(subscription);
    }
    let back_pressure = order.crossing == Crossing::Reliable;
    let options = StreamOptions { depth: None, back_pressure };
    RawSubscription::subscribe_stream(session, &source.topic, source.instance, options)
}

fn set_rate(subscription: &mut RawSubscription, rate_mhz: Option<u32>) {
    let interval = rate_mhz.map(|rate_mhz| Duration::from_secs_f64(1e3 / f64::from(rate_mhz)));
    subscription.set_interval(interval.unwrap_or_default());
}
