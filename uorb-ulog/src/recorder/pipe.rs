//! From the thread that follows the bus to the file, through bounded memory.
//!
//! Whole records go in at one end; a thread writes them at the other, at most
//! [`FLUSH_EVERY`] later and in one piece each time, so a process that is killed
//! leaves all that is older in its file. When the disk is slower than the bus the
//! memory fills, and then [`Pipe::has_room`] says so: nobody waits here.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Seek, Write};
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How long a record waits at most before it is handed to the kernel.
pub(super) const FLUSH_EVERY: Duration = Duration::from_millis(250);

/// How long it takes at most until the kernel is asked to put it on the disk:
/// what a loss of power costs.
const SYNC_EVERY: Duration = Duration::from_secs(1);

/// So much is written without waiting for more.
const WORTH_WRITING_BYTES: usize = 1 << 16;

/// The end at which records go in.
#[derive(Debug)]
pub(super) struct Pipe {
    shared: Arc<Shared>,
    limit_bytes: usize,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

type Files = VecDeque<(usize, Option<(PathBuf, File)>)>;

#[derive(Debug, Default)]
struct State {
    bytes: Vec<u8>,
    /// From which of the bytes on they go into another file. None: into the same
    /// one, from its beginning.
    files: Files,
    /// Not to be waited with.
    is_urgent: bool,
    has_ended: bool,
    failed: Option<(PathBuf, io::Error)>,
}

impl Pipe {
    /// A pipe that holds so many bytes, and as many that are being written.
    pub(super) fn new(limit_bytes: usize) -> io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let its = shared.clone();
        let write = move || its.write_all();
        let thread = std::thread::Builder::new().name("log_writer".into()).spawn(write)?;
        Ok(Self { shared, limit_bytes, thread: Some(thread) })
    }

    /// What goes in from now on goes into this file.
    pub(super) fn next_file(&self, path: PathBuf, file: File) {
        let mut state = self.shared.state();
        let at = state.bytes.len();
        state.files.push_back((at, Some((path, file))));
    }

    /// What goes in from now on goes into the same file, instead of what is there.
    pub(super) fn same_file_anew(&self) {
        let mut state = self.shared.state();
        let at = state.bytes.len();
        state.files.push_back((at, None));
    }

    /// What is in it goes to the kernel at once: a log without its head is none.
    pub(super) fn hurry(&self) {
        self.shared.state().is_urgent = true;
        self.shared.changed.notify_one();
    }

    pub(super) fn has_room(&self, bytes: usize) -> bool {
        self.shared.state().bytes.len() + bytes <= self.limit_bytes
    }

    /// Why the file cannot be written, if it cannot. Said once.
    pub(super) fn failed(&self) -> Option<(PathBuf, io::Error)> {
        self.shared.state().failed.take()
    }

    /// Waits until all is written.
    pub(super) fn end(mut self) -> Option<(PathBuf, io::Error)> {
        self.join();
        self.failed()
    }

    fn join(&mut self) {
        self.shared.state().has_ended = true;
        self.shared.changed.notify_one();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Drop for Pipe {
    fn drop(&mut self) {
        self.join();
    }
}

impl Write for &Pipe {
    fn write(&mut self, record: &[u8]) -> io::Result<usize> {
        let mut state = self.shared.state();
        state.bytes.extend_from_slice(record);
        if state.bytes.len() >= WORTH_WRITING_BYTES {
            self.shared.changed.notify_one();
        }
        Ok(record.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Shared {
    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The thread that writes.
    fn write_all(&self) {
        let mut open: Option<(PathBuf, File)> = None;
        let mut chunk = Vec::new();
        let mut synced = Instant::now();
        loop {
            let state = self.state();
            let waits = |state: &mut State| {
                let is_much = state.bytes.len() >= WORTH_WRITING_BYTES;
                !(is_much || state.is_urgent || state.has_ended)
            };
            let waited = self.changed.wait_timeout_while(state, FLUSH_EVERY, waits);
            let (mut state, _) = waited.unwrap_or_else(PoisonError::into_inner);
            chunk.clear();
            std::mem::swap(&mut state.bytes, &mut chunk);
            let files = std::mem::take(&mut state.files);
            state.is_urgent = false;
            let has_ended = state.has_ended;
            drop(state);

            let is_due = has_ended || synced.elapsed() >= SYNC_EVERY;
            if let Err(error) = write(&mut open, &chunk, files, is_due) {
                let path = open.map(|(path, _)| path).unwrap_or_default();
                self.state().failed = Some((path, error));
                return;
            }
            if is_due {
                synced = Instant::now();
            }
            if has_ended {
                return;
            }
        }
    }
}

/// Writes the bytes to the file that is open, and on into those that follow.
fn write(
    open: &mut Option<(PathBuf, File)>,
    bytes: &[u8],
    files: Files,
    is_due: bool,
) -> io::Result<()> {
    let mut from = 0;
    for (at, next) in files {
        match (&mut *open, next) {
            (Some((_, same)), None) => {
                same.set_len(0)?;
                same.rewind()?;
            }
            (Some((_, before)), next) => {
                before.write_all(&bytes[from..at])?;
                before.sync_data()?;
                *open = next;
            }
            (None, next) => *open = next,
        }
        from = at;
    }
    if let Some((_, file)) = open {
        file.write_all(&bytes[from..])?;
        if is_due {
            file.sync_data()?;
        }
    }
    Ok(())
}
