use super::*;

const BASE: u64 = 1 << 32;

struct Memory {
    words: Vec<AtomicU64>,
    geometry: Geometry,
    base: u64,
}

impl Memory {
    fn new(queue_length: u32, message_bytes: u32, base: u64) -> Self {
        let geometry = Geometry::new(queue_length, PUBLISHERS_MAX, message_bytes);
        let words = (0..geometry.words()).map(|_| AtomicU64::new(0)).collect();
        let memory = Self { words, geometry, base };
        memory.ring().format();
        memory
    }

    fn ring(&self) -> Ring<'_> {
        Ring::new(&self.words, self.geometry, self.base)
    }
}

fn take(ring: &Ring, cursor: &mut u64) -> Option<(Vec<u8>, u64)> {
    let mut message = vec![MaybeUninit::uninit(); ring.geometry.message_bytes];
    let taken = ring.take(*cursor, &mut message).unwrap()?;
    *cursor = taken.generation;
    // SAFETY: `take` has filled the whole message.
    let message = message.iter().map(|byte| unsafe { byte.assume_init() }).collect();
    Some((message, taken.lost))
}

#[test]
fn messages_of_every_length_come_back_whole() {
    for length in 1..=40 {
        let memory = Memory::new(1, length, BASE);
        let (ring, mut writer, mut cursor) = (memory.ring(), Writer::new(1, 7), BASE);
        assert!(ring.is_empty() && take(&ring, &mut cursor).is_none());
        let message: Vec<u8> = (1..=length as u8).collect();
        assert_eq!(ring.publish(&mut writer, 99, &message), Ok(BASE + 1));
        assert_eq!(take(&ring, &mut cursor), Some((message, 0)));
        let stamp = ring.newest_stamp(BASE).unwrap().unwrap();
        assert_eq!(stamp, Stamp { publish_time_us: 99, publisher: Writer::publisher(1, 7) });
    }
}

#[test]
fn a_reader_that_fell_behind_gets_the_newest_q_in_order() {
    for queue_length in [1_u64, 2, 4, 16, 128] {
        for base in [BASE, (1 << 33) - queue_length / 2] {
            let memory = Memory::new(queue_length as u32, 8, base);
            let (ring, mut writer, mut cursor) = (memory.ring(), Writer::new(1, 0), base);
            for value in 0..queue_length + 3 {
                ring.publish(&mut writer, 0, &value.to_ne_bytes()).unwrap();
            }
            assert_eq!(ring.newest_of_all(), base + queue_length + 3);
            for value in 3..queue_length + 3 {
                assert!(ring.has_newer(cursor));
                let lost = if value == 3 { 3 } else { 0 };
                assert_eq!(take(&ring, &mut cursor), Some((value.to_ne_bytes().into(), lost)));
            }
            assert!(!ring.has_newer(cursor));
            let last = (queue_length + 2).to_ne_bytes().into();
            assert_eq!(take(&ring, &mut cursor), Some((last, 0)));
        }
    }
}

#[test]
fn a_publisher_that_died_before_its_commit_costs_a_slot_until_it_is_freed() {
    let memory = Memory::new(1, 8, BASE);
    let ring = memory.ring();
    // As many peers as the node admits die with a claimed slot each.
    for peer in 1..=PUBLISHERS_MAX as u16 {
        ring.claim(&mut Writer::new(peer, 0)).unwrap();
    }
    let mut writer = Writer::new(100, 0);
    assert_eq!(ring.publish(&mut writer, 0, &[0; 8]), Ok(BASE + 1), "N slots are not named yet");
    for value in 0..100_u64 {
        if ring.publish(&mut writer, 0, &value.to_ne_bytes()) == Err(Busy) {
            for peer in 1..=PUBLISHERS_MAX as u16 {
                ring.free_slots_of(peer);
            }
            assert!(ring.publish(&mut writer, 0, &value.to_ne_bytes()).is_ok());
            return;
        }
    }
    panic!("seventeen handles never ran out of sixteen slots");
}

#[test]
fn a_publisher_that_died_after_its_commit_has_published() {
    let memory = Memory::new(1, 8, BASE);
    let ring = memory.ring();
    let mut dead = Writer::new(1, 0);
    let (index, slot) = ring.claim(&mut dead).unwrap();
    slot[PAYLOAD].store(42, Ordering::Relaxed);
    ring.commit(&dead, index, slot);
    ring.free_slots_of(1);

    let mut cursor = BASE;
    assert_eq!(take(&ring, &mut cursor), Some((42_u64.to_ne_bytes().into(), 0)));
    // The slot is not taken while it is named.
    let mut writer = Writer::new(2, 0);
    for value in 0..3_u64 {
        let (claimed, _) = ring.claim(&mut writer).unwrap();
        assert_ne!(claimed, index);
        ring.free_slots_of(2);
        ring.publish(&mut writer, 0, &value.to_ne_bytes()).unwrap();
    }
}

#[test]
fn random_words_never_lead_outside_the_tables_or_round_for_ever() {
    use std::hash::{BuildHasher, RandomState};
    let hasher = RandomState::new();
    for round in 0..2_000_u64 {
        let memory = Memory::new(1 << (round % 4), 24, BASE);
        for (index, word) in memory.words.iter().enumerate() {
            let random = hasher.hash_one((round, index));
            // Half of the generations near the base, where they hurt most.
            let near = ((BASE + random % 64) << LOW_BITS) | (random >> 58);
            word.store(if random & 1 == 0 { random } else { near }, Ordering::Relaxed);
        }
        let ring = memory.ring();
        let mut message = [MaybeUninit::uninit(); 24];
        let _ = ring.take(BASE, &mut message);
        let _ = ring.take(ring.newest_of_all(), &mut message);
        let _ = ring.newest_stamp(BASE);
        let _ = ring.publish(&mut Writer::new(9, 0), 0, &[0; 24]);
        ring.free_slots_of(9);
    }
}

fn unsent(ring: &Ring, generation: u64) -> (Unsent, Vec<u8>) {
    let mut message = vec![MaybeUninit::new(0); ring.geometry.message_bytes];
    let outcome = ring.unsent(generation, &mut message);
    // SAFETY: all of it was initialised before.
    (outcome, message.iter().map(|byte| unsafe { byte.assume_init() }).collect())
}

#[test]
fn a_message_that_is_not_sent_yet_can_be_read_when_the_ring_names_it_no_more() {
    let memory = Memory::new(1, 8, BASE);
    let ring = memory.ring();
    let (mut slow, mut fast) = (Writer::new(1, 0), Writer::new(2, 0));
    let held = ring.publish_unsent(&mut slow, 7, &[1; 8]).unwrap();
    for value in 2..=50 {
        ring.publish_unsent(&mut fast, 0, &[value; 8]).unwrap().sent();
    }
    assert_eq!(ring.read_exactly(BASE + 1, &mut [MaybeUninit::uninit(); 8]), Ok(None));

    let stamp = Stamp { publish_time_us: 7, publisher: Writer::publisher(1, 0) };
    assert_eq!(unsent(&ring, BASE + 1), (Unsent::Read(stamp), vec![1; 8]));
    assert_eq!(ring.least_unsent(BASE + 1), Some(BASE + 1));
    assert_eq!(ring.least_unsent(BASE + 2), None);
    assert_eq!(ring.unsent_of(1), [(BASE + 1, stamp, vec![1; 8])]);
    assert_eq!(ring.unsent_of(2), []);

    held.sent();
    assert_eq!(unsent(&ring, BASE + 1).0, Unsent::Over);
    assert_eq!(ring.unsent_of(1), []);
}

#[test]
fn who_overwrites_an_unmarked_message_marks_it() {
    let memory = Memory::new(1, 8, BASE);
    let ring = memory.ring();
    let (mut stopped, mut fast) = (Writer::new(1, 0), Writer::new(2, 0));
    // Committed, and interrupted before the next instruction.
    let (generation, owner) = ring.write_and_commit(&mut stopped, 0, &[1; 8]).unwrap();
    assert_eq!(ring.unsent_of(1).len(), 1, "the ring names it");
    for value in 2..=4 {
        ring.publish_unsent(&mut fast, 0, &[value; 8]).unwrap().sent();
    }
    assert_eq!(unsent(&ring, generation).0, Unsent::Unknown, "nobody has overwritten it");
    for value in 5..=50 {
        ring.publish_unsent(&mut fast, 0, &[value; 8]).unwrap().sent();
    }
    assert!(matches!(unsent(&ring, generation), (Unsent::Read(_), bytes) if bytes == [1; 8]));
    owner.store(word(generation, 0), Ordering::Release);
    assert_eq!(unsent(&ring, generation).0, Unsent::Over);
}

#[test]
fn a_slot_that_is_claimed_anew_is_not_taken_for_what_was_in_it() {
    let memory = Memory::new(1, 8, BASE);
    let ring = memory.ring();
    let (mut one, mut two) = (Writer::new(1, 0), Writer::new(2, 0));
    for value in 1..=20 {
        ring.publish(&mut one, 0, &[value; 8]).unwrap();
    }
    ring.claim(&mut two).unwrap();
    for generation in BASE + 1..=BASE + 20 {
        assert_eq!(unsent(&ring, generation).0, Unsent::Over);
    }
}
