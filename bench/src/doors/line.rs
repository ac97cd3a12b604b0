//! Two floors: a word in shared memory that the other side spins on, and one on
//! which it sleeps by futex(2).

use std::fs::OpenOptions;
use std::hint::spin_loop;
use std::num::NonZero;
use std::sync::atomic::{AtomicU64, Ordering};

use nix::sys::mman::{MapFlags, ProtFlags, mmap};
use uorb_core::System;

use super::{Door, Side};

/// Words between the two: each on a cache line, and the line beside it, which
/// some processors fetch along, left alone.
const APART: usize = 16;

/// A page that both sides map: a file in the system's directory.
#[allow(unsafe_code)]
pub fn shared_words(system: &System, name: &str) -> &'static [AtomicU64] {
    let page_bytes = 4_096;
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(system.base().join(name))
        .expect("a file in /dev/shm");
    file.set_len(page_bytes as u64).expect("a page");
    let length = NonZero::new(page_bytes).expect("a page has bytes");
    let protection = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
    // SAFETY: it is never unmapped, as long as a page, and atomics may be written
    // by others.
    unsafe {
        let at = mmap(None, length, protection, MapFlags::MAP_SHARED, &file, 0).expect("mapped");
        std::slice::from_raw_parts(at.as_ptr().cast(), page_bytes / size_of::<AtomicU64>())
    }
}

/// The words out and in.
#[derive(Debug)]
pub struct Line {
    out: &'static AtomicU64,
    from: &'static AtomicU64,
    sent: u64,
    seen: u64,
}

impl Line {
    pub fn open(system: &System, side: Side) -> Self {
        let words = shared_words(system, "line");
        let (out, from) = match side {
            Side::Ping => (0, APART),
            Side::Pong => (APART, 0),
        };
        let [out, from] = [&words[out], &words[from]];
        Self { out, from, sent: 0, seen: from.load(Ordering::SeqCst) }
    }
}

impl Door for Line {
    /// The value has to change, so it counts where it is no time.
    fn send(&mut self, _sent_ns: u64) {
        self.sent += 1;
        self.out.store(self.sent, Ordering::Release);
    }

    fn wait(&mut self) -> u64 {
        while self.from.load(Ordering::Acquire) == self.seen {
            spin_loop();
        }
        self.seen = self.from.load(Ordering::Acquire);
        self.seen
    }
}

/// The same words: the lower half of one is the futex, another has the time.
#[derive(Debug)]
pub struct Futex {
    line: Line,
}

impl Futex {
    pub fn open(system: &System, side: Side) -> Self {
        Self { line: Line::open(system, side) }
    }
}

#[allow(unsafe_code)]
fn futex(word: &AtomicU64, operation: i32, value: u32) {
    // SAFETY: the word lives, is aligned, and little-endian, so that its lower
    // half is where it is.
    unsafe { libc::syscall(libc::SYS_futex, word, operation, value, 0_usize) };
}

impl Door for Futex {
    fn send(&mut self, sent_ns: u64) {
        self.line.out.store(sent_ns, Ordering::Release);
        futex(self.line.out, libc::FUTEX_WAKE, 1);
    }

    fn wait(&mut self) -> u64 {
        while self.line.from.load(Ordering::Acquire) == self.line.seen {
            futex(self.line.from, libc::FUTEX_WAIT, self.line.seen as u32);
        }
        self.line.seen = self.line.from.load(Ordering::Acquire);
        self.line.seen
    }
}
