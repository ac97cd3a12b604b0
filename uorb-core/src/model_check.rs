//! Ring and bell under loom's model checker, which runs these small programs
//! in every order of their steps that a preemption bound allows.
//!
//! One publisher beside one reader, or one sleeper, is checked exhaustively: in
//! every order. For all else `scripts/loom` sets LOOM_MAX_PREEMPTIONS=3: three
//! times in a run a thread may be interrupted anywhere; what it does of itself is
//! free. Two publishers beside two readers or sleepers have a bound of their own,
//! of two. A bound is not a proof of all orders.

use std::mem::MaybeUninit;

use loom::sync::{Arc, Condvar, Mutex};
use loom::thread;

use crate::bell;
use crate::ring::{Geometry, Ring, Writer};
use crate::sync::{AtomicU64, Ordering};

const BASE: u64 = 1 << 32;

/// Two words, so that one could be new while the other is old.
type Message = [u8; 16];

struct Node {
    words: Vec<AtomicU64>,
    geometry: Geometry,
    asked: AtomicU64,
    rung: AtomicU64,
    /// The FIFO: how often it was rung, and who sleeps until it is again.
    rings: Mutex<u32>,
    sleepers: Condvar,
}

impl Node {
    fn new(queue_length: u32, publishers: u32) -> Arc<Self> {
        let geometry = Geometry::new(queue_length, publishers, size_of::<Message>() as u32);
        let node = Self {
            words: (0..geometry.words()).map(|_| AtomicU64::new(0)).collect(),
            geometry,
            asked: AtomicU64::new(0),
            rung: AtomicU64::new(0),
            rings: Mutex::new(0),
            sleepers: Condvar::new(),
        };
        node.ring().format();
        Arc::new(node)
    }

    fn ring(&self) -> Ring<'_> {
        Ring::new(&self.words, self.geometry, BASE)
    }

    /// Without a look at the bell, whose fences would hide a missing one here.
    fn commit(&self, writer: &mut Writer, value: u64) -> u64 {
        let mut message = [0; 16];
        message[..8].copy_from_slice(&value.to_ne_bytes());
        message[8..].copy_from_slice(&(!value).to_ne_bytes());
        self.ring().publish(writer, 0, &message).expect("there are slots enough")
    }

    fn publish(&self, writer: &mut Writer, value: u64) -> u64 {
        let generation = self.commit(writer, value);
        bell::ring_if_asked(&self.asked, &self.rung, || {
            *self.rings.lock().unwrap() += 1;
            self.sleepers.notify_all();
            true
        });
        generation
    }

    /// Copies what a reader sees next, and checks that it is whole.
    fn take(&self, cursor: &mut u64) -> Option<(u64, u64)> {
        let mut message = [MaybeUninit::uninit(); 16];
        let taken = self.ring().take(*cursor, &mut message).expect("publishers keep the rules")?;
        // SAFETY: `take` has filled the whole message.
        let message = message.map(|byte| unsafe { byte.assume_init() });
        let [value, check] =
            [0, 8].map(|at| u64::from_ne_bytes(*message[at..].first_chunk().unwrap()));
        assert_eq!(check, !value, "torn");
        assert!(taken.generation >= *cursor, "out of order");
        *cursor = taken.generation;
        Some((value, taken.lost))
    }

    /// Sleeps until there is something newer than `cursor`, as `poll` does.
    fn sleep(&self, cursor: u64) {
        loop {
            let heard = *self.rings.lock().unwrap();
            bell::ask(&self.asked);
            if self.ring().has_newer(cursor) {
                return;
            }
            // loom reports a thread that nobody can wake any more.
            let mut rings = self.rings.lock().unwrap();
            while *rings == heard {
                rings = self.sleepers.wait(rings).unwrap();
            }
            if self.ring().has_newer(cursor) {
                return;
            }
        }
    }
}

/// Every order, whatever the environment bounds.
fn exhaustively(program: impl Fn() + Sync + Send + 'static) {
    within(None, program);
}

/// Every order with so many preemptions at most.
fn within(preemptions: Option<usize>, program: impl Fn() + Sync + Send + 'static) {
    let mut model = loom::model::Builder::new();
    model.preemption_bound = preemptions;
    model.check(program);
}

/// What four threads allow within a minute.
const PREEMPTIONS_OF_FOUR: Option<usize> = Some(2);

#[test]
fn a_reader_sees_whole_messages_in_order_while_two_publish() {
    loom::model(|| {
        let node = Node::new(1, 2);
        let publishers: Vec<_> = (1..=2)
            .map(|peer| {
                let node = node.clone();
                thread::spawn(move || node.commit(&mut Writer::new(peer, 0), peer.into()))
            })
            .collect();
        let mut cursor = BASE;
        node.take(&mut cursor);
        node.take(&mut cursor);
        let mut generations: Vec<_> =
            publishers.into_iter().map(|publisher| publisher.join().unwrap()).collect();
        generations.sort_unstable();
        assert_eq!(generations, [BASE + 1, BASE + 2], "dense, and each once");
        assert!(node.take(&mut cursor).is_some());
        assert_eq!(cursor, BASE + 2);
    });
}

#[test]
fn two_readers_see_the_same_messages_while_two_publish() {
    within(PREEMPTIONS_OF_FOUR, || {
        let node = Node::new(1, 2);
        let publishers: Vec<_> = (1..=2)
            .map(|peer| {
                let node = node.clone();
                thread::spawn(move || node.commit(&mut Writer::new(peer, 0), peer.into()))
            })
            .collect();
        let read = |node: &Node| {
            let mut cursor = BASE;
            let seen: Vec<_> =
                (0..2).filter_map(|_| Some((node.take(&mut cursor)?.0, cursor))).collect();
            seen
        };
        let reader = {
            let node = node.clone();
            thread::spawn(move || read(&node))
        };
        let ours = read(&node);
        let theirs = reader.join().unwrap();
        // A generation is one message, whoever asks.
        for (value, generation) in ours {
            assert!(theirs.iter().all(|(other, at)| *at != generation || *other == value));
        }
        publishers.into_iter().for_each(|publisher| _ = publisher.join().unwrap());
        assert_eq!(node.ring().newest(BASE), BASE + 2);
    });
}

#[test]
fn a_reader_that_is_overtaken_by_a_whole_lap_copies_nothing_torn() {
    exhaustively(|| {
        let node = Node::new(1, 1);
        let mut writer = Writer::new(1, 0);
        // Four order words and five slots: the fifth publish from here on
        // writes into a slot that was named when the reader began.
        for value in 0..4 {
            node.commit(&mut writer, value);
        }
        let publisher = {
            let node = node.clone();
            thread::spawn(move || {
                for value in 4..9 {
                    node.commit(&mut writer, value);
                }
            })
        };
        let mut cursor = BASE;
        let (value, lost) = node.take(&mut cursor).expect("something was published");
        assert_eq!(value + 1, cursor - BASE);
        assert_eq!(lost + 1, cursor - BASE, "published = copied + lost");
        publisher.join().unwrap();
    });
}

#[test]
fn a_dead_publisher_s_slot_is_given_back_while_another_publishes() {
    loom::model(|| {
        let node = Node::new(1, 2);
        // Peer 2 dies between its claim and its commit.
        node.ring().claim(&mut Writer::new(2, 0)).unwrap();
        let publisher = {
            let node = node.clone();
            thread::spawn(move || {
                let mut writer = Writer::new(1, 0);
                (1..=3).for_each(|value| _ = node.commit(&mut writer, value));
            })
        };
        node.ring().free_slots_of(2);
        let mut cursor = BASE;
        node.take(&mut cursor);
        publisher.join().unwrap();
        assert_eq!(node.take(&mut cursor).map(|(value, _)| value), Some(3));
    });
}

#[test]
fn no_wake_is_lost_between_one_publisher_and_one_sleeper() {
    exhaustively(|| {
        let node = Node::new(1, 1);
        let publisher = {
            let node = node.clone();
            thread::spawn(move || {
                let mut writer = Writer::new(1, 0);
                node.publish(&mut writer, 1);
                node.publish(&mut writer, 2);
            })
        };
        let mut cursor = BASE;
        while cursor < BASE + 2 {
            node.sleep(cursor);
            assert!(node.take(&mut cursor).is_some());
        }
        publisher.join().unwrap();
    });
}

#[test]
fn no_wake_is_lost_between_two_publishers_and_one_sleeper() {
    loom::model(|| {
        let node = Node::new(1, 2);
        let publishers: Vec<_> = (1..=2)
            .map(|peer| {
                let node = node.clone();
                thread::spawn(move || node.publish(&mut Writer::new(peer, 0), peer.into()))
            })
            .collect();
        node.sleep(BASE + 1);
        publishers.into_iter().for_each(|publisher| _ = publisher.join().unwrap());
    });
}

#[test]
fn no_wake_is_lost_between_one_publisher_and_two_sleepers() {
    loom::model(|| {
        let node = Node::new(1, 1);
        let sleepers: Vec<_> = (0..2)
            .map(|_| {
                let node = node.clone();
                thread::spawn(move || node.sleep(BASE))
            })
            .collect();
        node.publish(&mut Writer::new(1, 0), 1);
        sleepers.into_iter().for_each(|sleeper| sleeper.join().unwrap());
    });
}

#[test]
fn no_wake_is_lost_between_two_publishers_and_two_sleepers() {
    within(PREEMPTIONS_OF_FOUR, || {
        let node = Node::new(1, 2);
        let publishers: Vec<_> = (1..=2)
            .map(|peer| {
                let node = node.clone();
                thread::spawn(move || node.publish(&mut Writer::new(peer, 0), peer.into()))
            })
            .collect();
        let sleeper = {
            let node = node.clone();
            thread::spawn(move || node.sleep(BASE + 1))
        };
        node.sleep(BASE + 1);
        sleeper.join().unwrap();
        publishers.into_iter().for_each(|publisher| _ = publisher.join().unwrap());
    });
}

#[test]
fn a_publisher_that_died_between_its_commit_and_its_ring_costs_no_later_wake() {
    loom::model(|| {
        let node = Node::new(1, 2);
        let sleeper = {
            let node = node.clone();
            thread::spawn(move || node.sleep(BASE + 1))
        };
        // Commits, and rings no bell any more.
        node.commit(&mut Writer::new(2, 0), 0);
        node.publish(&mut Writer::new(1, 0), 1);
        sleeper.join().unwrap();
        assert!(node.rung.load(Ordering::Relaxed) <= node.asked.load(Ordering::Relaxed));
    });
}
