//! Records a bus: every message of the topics that are chosen, into a log.
//!
//! It looks at all its subscriptions every 5 ms, as PX4's logger does, and
//! never sleeps on a bell: publishers make no system call for it. Their streams
//! keep 1,024 messages meanwhile. What is lost all the same is counted, and a
//! dropout says for how long: on a stream, where the memory before the disk was
//! full, and of a topic that appeared and spoke before it was followed.

mod choice;
mod files;
mod follow;
mod head;
mod pipe;
mod run;
mod words;

use std::io;
use std::path::PathBuf;
use std::time::Duration;

use uorb_core::{Layout, Session, topic};

pub use self::choice::{Choice, Rule};
pub use self::files::Place;

use self::pipe::Pipe;
use self::run::Recorder;
use crate::writer::Parameter;

topic! {
    /// The question of a replay whether all that it has advertised is followed.
    /// Who records with back-pressure takes a message of it when it follows
    /// everything that was there when the message was published. It is in no log.
    pub struct ReplayReady = "replay_ready" {
        /// When it was asked.
        pub timestamp: u64,
    }
}

/// What to record, and how.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Which topics.
    pub choice: Choice,
    /// Where to.
    pub place: Place,
    /// Begins a new file when one is as long as this.
    pub max_size_bytes: Option<u64>,
    /// Begins a new file after this time.
    pub rotate_every: Option<Duration>,
    /// Ends after this time.
    pub duration: Option<Duration>,
    /// Whether `try_publish` waits for the recorder: it loses nothing then, and
    /// the disk decides how fast the bus is.
    pub back_pressure: bool,
    /// The memory between the bus and the disk.
    pub buffer_bytes: usize,
    /// The parameters of the vehicle.
    pub parameters: Vec<Parameter>,
    /// Topics that may appear, so that they need no new file.
    pub known: Vec<(String, Layout)>,
}

/// What has been recorded.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Since the beginning.
    pub seconds: f64,
    /// Messages written.
    pub messages: u64,
    /// Bytes written.
    pub bytes: u64,
    /// Messages lost, on the streams or before the disk.
    pub lost: u64,
    /// How often some were.
    pub dropouts: u64,
    /// How long that was, together.
    pub dropped: Duration,
    /// The files, in their order.
    pub files: Vec<PathBuf>,
}

/// Why a recording has ended.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// Something of the bus.
    #[error(transparent)]
    Bus(#[from] uorb_core::Error),
    /// A file, or the disk under it.
    #[error("cannot write {}: {error}{}", path.display(), cure(error))]
    File {
        /// Which one.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// No thread can be made.
    #[error("cannot start the thread that writes: {0}")]
    Thread(io::Error),
}

fn cure(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "; free some space, or record elsewhere with -o. What was written can be read"
        }
        io::ErrorKind::AlreadyExists => "; remove it, or record elsewhere with -o",
        _ => "",
    }
}

impl From<(PathBuf, io::Error)> for RecordError {
    fn from((path, error): (PathBuf, io::Error)) -> Self {
        Self::File { path, error }
    }
}

/// Records until `stop` says so, the plan's time is over, or the system ends.
/// `tell` hears once a second how far it has come.
///
/// # Errors
///
/// [`RecordError`]. What was written until then can be read.
pub fn record(
    session: &Session,
    plan: &Plan,
    stop: &dyn Fn() -> bool,
    tell: &mut dyn FnMut(&Tally),
) -> Result<Tally, RecordError> {
    let pipe = Pipe::new(plan.buffer_bytes).map_err(RecordError::Thread)?;
    let tally = Recorder::begin(session, plan, &pipe)?.run(stop, tell)?;
    match pipe.end() {
        Some(failed) => Err(failed.into()),
        None => Ok(tally),
    }
}
