//! The topic that all of a bus share, and the bytes of its messages.
//!
//! There are four, one bus after the other: one whose generations pass 2^32 in
//! the first round, an ordinary one, one that is too large for a node and lives on
//! its stream alone, and one that is followed with back-pressure.

use std::borrow::Cow;

use uorb_core::zerocopy::{FromBytes, IntoBytes};
use uorb_core::{Layout, Metadata, QueueLength, Topic};
use uorb_tests::Stamped;

/// The queue of each of them.
pub(crate) const QUEUE: u32 = 16;

const WRAPS: &str = "orb_test_medium_wrap_around";
pub(crate) const ORDINARY: &str = "stamped";
const LARGE: &str = "chaos_large";
const PRESSED: &str = "chaos_pressed";

/// A large message is one of these after the other, all alike.
const COPIES_OF_LARGE: usize = 256;

/// The topic of the bus of this number.
pub(crate) fn of_bus(number: u64) -> &'static str {
    [WRAPS, ORDINARY, LARGE, PRESSED][number as usize % 4]
}

pub(crate) fn is_large(name: &str) -> bool {
    name == LARGE
}

/// Whether nobody may publish what a follower has no room for.
pub(crate) fn is_pressed(name: &str) -> bool {
    name == PRESSED
}

pub(crate) fn metadata(name: &str) -> Metadata {
    let queue_length = QueueLength::new(QUEUE).expect("a power of two");
    let mut metadata = Metadata { queue_length, ..Stamped::METADATA.clone() };
    if is_large(name) {
        metadata.layout = Cow::Owned(Layout {
            size_bytes: (COPIES_OF_LARGE * size_of::<Stamped>()) as u32,
            fields: Cow::Borrowed(&[]),
            ..metadata.layout.into_owned()
        });
    }
    Metadata { name: name.to_string().into(), ..metadata }
}

pub(crate) fn bytes_of(message: &Stamped, topic: &Metadata) -> Vec<u8> {
    message.as_bytes().repeat(topic.layout.size_bytes as usize / size_of::<Stamped>())
}

/// The message of these bytes. One that is not whole says so.
pub(crate) fn read(bytes: &[u8]) -> Option<Stamped> {
    let mut copies = bytes.chunks(size_of::<Stamped>()).map(Stamped::read_from_bytes);
    let mut first = copies.next()?.ok()?;
    let are_alike = |copy: &Stamped| copy.as_bytes() == first.as_bytes();
    if !copies.all(|copy| copy.as_ref().is_ok_and(are_alike)) {
        first.check = [0; 30];
    }
    Some(first)
}
