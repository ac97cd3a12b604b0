//! The file of a node: whatever it holds, opening it and looking at it is an
//! error or fine.
//!
//! A file is pages long, and only its first bytes are worth choosing one by one.
//! So the input begins with a recipe of 16 bytes: the file's length, the queue
//! length that its counts tell, and a word that fills the rest.

use std::fs::{self, File, OpenOptions};
use std::os::unix::fs::FileExt;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};

use nix::sys::stat::Mode;
use uorb_core::broker_side::{Node, Role};
use uorb_core::{Instance, System};

const TOPIC: &str = "orb_test";
const PAGE_BYTES: u64 = 4096;
/// So much is filled; what is beyond, up to the length, is a hole.
const FILLED_MAX_BYTES: u64 = 32 * PAGE_BYTES;

/// Recipe, then the identity.
pub(crate) fn open(bytes: &[u8]) {
    let Some((recipe, identity)) = bytes.split_first_chunk::<16>() else { return };
    let word = |at: usize| u32::from_le_bytes(*recipe[at..].first_chunk().unwrap());
    let (length, queue_length) = (u64::from(word(0)), u64::from(word(4)));
    let filling = &recipe[8..];

    let place = Place::new();
    let system = System::new(&place.0, 0);
    for directory in [system.nodes(), system.bells()] {
        fs::create_dir_all(directory).expect("a new directory");
    }
    let bell = system.bell(TOPIC, Instance::FIRST);
    nix::unistd::mkfifo(&bell, Mode::S_IRUSR | Mode::S_IWUSR).expect("a new FIFO");
    // A publisher's end opens where somebody reads.
    let _reader = OpenOptions::new().read(true).write(true).open(&bell).expect("it is there");

    let file = File::create(system.node(TOPIC, Instance::FIRST)).expect("a new file");
    let filled = length.min(FILLED_MAX_BYTES) as usize;
    file.write_all_at(&filling.repeat(filled.div_ceil(8))[..filled], 0).expect("room for it");
    file.write_all_at(identity, 0).expect("room for it");
    let counts = (identity.len() as u64).next_multiple_of(PAGE_BYTES);
    file.write_all_at(&queue_length.to_ne_bytes(), counts + 8).expect("room for it");
    file.set_len(length).expect("a length");

    for role in [Role::Observer, Role::Subscriber, Role::Publisher, Role::Broker] {
        match Node::open(&system, TOPIC, Instance::FIRST, role) {
            Ok(node) => look_at(&node),
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
}

fn look_at(node: &Node) {
    let _ = (node.name(), node.ending(), node.publishers(), node.queue_length());
    let _ = (node.status(), node.slot_holders());
}

/// A directory of one's own, removed with it.
struct Place(PathBuf);

impl Place {
    fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("uorb-fuzz-{}-{count}", std::process::id());
        Self(std::env::temp_dir().join(name))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}
