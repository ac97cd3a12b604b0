//! What actors have done, in memory that outlives them.
//!
//! Each process of a run has a cell. A publisher notes that a publish begins,
//! then publishes, then notes under which generation: so of a killed one it is
//! known which message may or may not be there. Whoever copies notes what. The
//! controller reads the cells when everybody has paused, and of the dead when
//! they are.

#![allow(unsafe_code)]

use std::fs::File;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use nix::sys::mman::{MapFlags, ProtFlags, mmap};

pub(crate) const CELLS: usize = 48;
/// Messages of one round that a cell has room for.
pub(crate) const LOG_MAX: usize = 16_384;
const LATES_MAX: usize = 64;
const ERROR_WORDS: usize = 64;

const HEAD_WORDS: usize = 64;
const CELL_WORDS: usize = 64 + ERROR_WORDS + LATES_MAX * LATE_WORDS + LOG_MAX * 2;
const LATE_WORDS: usize = 4;

/// A word of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub(crate) enum Word {
    /// 1: it does what it is for. 2: it failed, and says why.
    State,
    /// The round in which it has paused, and 1.
    PausedIn,
    /// Messages whose publish was begun, and those that were published.
    Begun,
    Done,
    Logged,
    Copied,
    /// Messages lost, by the subscription's own count.
    Lost,
    Pending,
    /// The generation from which its account begins, and `Lost` then.
    First,
    LostBefore,
    /// The newest generation that it has copied.
    Seen,
    Torn,
    Lates,
    /// The instance that it claimed, and 1.
    Instance,
    ErrorBytes,
    /// Requests made and the slowest, in microseconds.
    Requests,
    SlowestRequest,
}

/// Something that took longer than anybody should wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Late {
    pub(crate) what: LateWhat,
    pub(crate) from_us: u64,
    pub(crate) to_us: u64,
    /// How much of it the process was ready to run and did not.
    pub(crate) off_cpu_us: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub(crate) enum LateWhat {
    /// A publish that took long.
    Publish = 1,
    /// A message that was copied long after it was published.
    Copy,
    /// A request to the broker.
    Request,
    /// One that waits for streams.
    StreamRequest,
}

#[derive(Debug)]
pub(crate) struct Ledger {
    words: &'static [AtomicU64],
    pub(crate) path: PathBuf,
}

/// What everybody does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    Run,
    /// Publishers pause.
    Quiet,
    /// All copy what there is, and pause.
    Drain,
}

impl Ledger {
    pub(crate) fn create(dir: &Path) -> std::io::Result<Self> {
        let path = dir.join("ledger");
        let file = File::options().read(true).write(true).create_new(true).open(&path)?;
        file.set_len(((HEAD_WORDS + CELLS * CELL_WORDS) * 8) as u64)?;
        Self::map(&file, path)
    }

    pub(crate) fn open(path: PathBuf) -> std::io::Result<Self> {
        let file = File::options().read(true).write(true).open(&path)?;
        Self::map(&file, path)
    }

    fn map(file: &File, path: PathBuf) -> std::io::Result<Self> {
        let words = HEAD_WORDS + CELLS * CELL_WORDS;
        let length = NonZeroUsize::new(words * 8).expect("more than nothing");
        let protection = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
        // SAFETY: a new mapping, of a file that has this length, at an address of
        // the kernel's choice; it is never unmapped.
        let words = unsafe {
            let start = mmap(None, length, protection, MapFlags::MAP_SHARED, file, 0)?;
            std::slice::from_raw_parts(start.as_ptr().cast::<AtomicU64>(), words)
        };
        Ok(Self { words, path })
    }

    pub(crate) fn cell(&self, index: usize) -> Cell {
        let from = HEAD_WORDS + index * CELL_WORDS;
        Cell { words: &self.words[from..from + CELL_WORDS], index }
    }

    pub(crate) fn set_phase(&self, round: u64, phase: Phase) {
        self.words[0].store(round * 4 + phase as u64, Ordering::SeqCst);
    }

    pub(crate) fn phase(&self) -> (u64, Phase) {
        let word = self.words[0].load(Ordering::SeqCst);
        let phase = match word % 4 {
            0 => Phase::Run,
            1 => Phase::Quiet,
            _ => Phase::Drain,
        };
        (word / 4, phase)
    }

    /// A word that all share: how far the slowest has come, in `restarts`.
    pub(crate) fn shared(&self, index: usize) -> &AtomicU64 {
        &self.words[8 + index]
    }
}

/// One process's place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cell {
    words: &'static [AtomicU64],
    pub(crate) index: usize,
}

impl Cell {
    pub(crate) fn word(&self, word: Word) -> &AtomicU64 {
        &self.words[word as usize]
    }

    pub(crate) fn get(&self, word: Word) -> u64 {
        self.word(word).load(Ordering::SeqCst)
    }

    pub(crate) fn set(&self, word: Word, value: u64) {
        self.word(word).store(value, Ordering::SeqCst);
    }

    pub(crate) fn add(&self, word: Word, value: u64) {
        self.word(word).fetch_add(value, Ordering::SeqCst);
    }

    /// As new.
    pub(crate) fn clear(&self) {
        self.words[..64].iter().for_each(|word| word.store(0, Ordering::SeqCst));
    }

    fn part(&self, from: usize, words: usize) -> &'static [AtomicU64] {
        &self.words[from..from + words]
    }

    /// Notes a message: its generation, who sent it, and its number there.
    pub(crate) fn log(&self, generation: u64, sender: u64, count: u64) {
        let logged = self.get(Word::Logged) as usize;
        if logged < LOG_MAX {
            let entry = self.part(64 + ERROR_WORDS + LATES_MAX * LATE_WORDS + logged * 2, 2);
            entry[0].store(generation, Ordering::Relaxed);
            entry[1].store(sender << 32 | count, Ordering::Relaxed);
        }
        self.set(Word::Logged, logged as u64 + 1);
    }

    pub(crate) fn is_full(&self) -> bool {
        self.get(Word::Logged) as usize >= LOG_MAX
    }

    /// The messages noted in this round: generation, sender, number.
    pub(crate) fn logged(&self) -> Vec<(u32, u64, u64)> {
        let count = (self.get(Word::Logged) as usize).min(LOG_MAX);
        let entries = self.part(64 + ERROR_WORDS + LATES_MAX * LATE_WORDS, count * 2);
        let read = |entry: &[AtomicU64]| {
            let [generation, message] = [0, 1].map(|word| entry[word].load(Ordering::Relaxed));
            (generation as u32, message >> 32, message & 0xffff_ffff)
        };
        entries.chunks_exact(2).map(read).collect()
    }

    pub(crate) fn late(&self, late: Late) {
        let index = self.get(Word::Lates) as usize;
        if index < LATES_MAX {
            let entry = self.part(64 + ERROR_WORDS + index * LATE_WORDS, LATE_WORDS);
            let words = [late.what as u64, late.from_us, late.to_us, late.off_cpu_us];
            entry.iter().zip(words).for_each(|(word, value)| word.store(value, Ordering::SeqCst));
        }
        self.set(Word::Lates, index as u64 + 1);
    }

    pub(crate) fn lates(&self) -> Vec<Late> {
        let count = (self.get(Word::Lates) as usize).min(LATES_MAX);
        let entries = self.part(64 + ERROR_WORDS, count * LATE_WORDS);
        let read = |entry: &[AtomicU64]| {
            let words = [0, 1, 2, 3].map(|word| entry[word].load(Ordering::SeqCst));
            let what = match words[0] {
                1 => LateWhat::Publish,
                2 => LateWhat::Copy,
                3 => LateWhat::Request,
                _ => LateWhat::StreamRequest,
            };
            Late { what, from_us: words[1], to_us: words[2], off_cpu_us: words[3] }
        };
        entries.chunks_exact(LATE_WORDS).map(read).collect()
    }

    /// Says why it cannot go on.
    pub(crate) fn fail(&self, why: &str) {
        let bytes = &why.as_bytes()[..why.len().min(ERROR_WORDS * 8)];
        for (word, chunk) in self.part(64, ERROR_WORDS).iter().zip(bytes.chunks(8)) {
            let mut whole = [0; 8];
            whole[..chunk.len()].copy_from_slice(chunk);
            word.store(u64::from_ne_bytes(whole), Ordering::SeqCst);
        }
        self.set(Word::ErrorBytes, bytes.len() as u64);
        self.set(Word::State, 2);
    }

    pub(crate) fn failure(&self) -> Option<String> {
        if self.get(Word::State) != 2 {
            return None;
        }
        let words = self.part(64, ERROR_WORDS).iter();
        let bytes: Vec<u8> =
            words.flat_map(|word| word.load(Ordering::SeqCst).to_ne_bytes()).collect();
        let length = (self.get(Word::ErrorBytes) as usize).min(bytes.len());
        Some(String::from_utf8_lossy(&bytes[..length]).into_owned())
    }
}
