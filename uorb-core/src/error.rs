//! What can go wrong, and what to do about it.
//!
//! "Nothing yet" is not in here: a copy before the first publish is `None`.

use std::io;
use std::path::{Path, PathBuf};

use crate::node_file::NODE_FILE_VERSION;
use crate::protocol::{Mismatch, Refusal};
use crate::topic::Instance;

/// Everything that the client library can fail with.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// No broker runs for this system. Start one with `uorb start`.
    #[error(
        "no broker runs at {}: start one with `uorb start`, \
         or set UORB_DIR and UORB_SYSTEM to where it runs", path.display()
    )]
    NoBroker {
        /// The socket that was tried.
        path: PathBuf,
    },
    /// The system is another user's. Each user has systems of their own.
    #[error(
        "{} belongs to user {owner}, not to {us}: set UORB_DIR to a directory of your own",
        path.display()
    )]
    OtherUser {
        /// The directory, or the broker's socket.
        path: PathBuf,
        /// The user that it belongs to.
        owner: u32,
        /// The user that this process runs as.
        us: u32,
    },
    /// The broker runs and does not answer: it is stopped, or overloaded.
    #[error(
        "the broker at {} has not answered for {seconds} s: it may be stopped (SIGSTOP); \
         `uorb status` shows its pid", path.display()
    )]
    NoAnswer {
        /// The broker's socket.
        path: PathBuf,
        /// How long it was waited for, in seconds.
        seconds: u64,
    },
    /// The system has ended: somebody said `uorb stop`. What was published can
    /// still be copied; nothing new will come.
    #[error("the system at {} has ended (`uorb stop`)", path.display())]
    Ended {
        /// The system's directory.
        path: PathBuf,
    },
    /// The handle was made before a fork, and this is the child. Open a session
    /// of its own there.
    #[error("the handle belongs to the parent process: open a session after fork")]
    Forked,
    /// As many threads are inside `publish` with this node's handles as it has
    /// slots. Try again, or let each thread advertise for itself.
    #[error("too many threads publish on {node} at once")]
    Busy {
        /// The node: `sensor_accel0`.
        node: String,
    },
    /// A live process uses the topic with another layout. Rebuild one of the
    /// two from the same .msg text.
    #[error("{0}")]
    LayoutMismatch(Box<Mismatch>),
    /// The broker refuses; the reason says what to do.
    #[error("{0}")]
    Refused(Refusal),
    /// There is no such node.
    #[error("there is no node {topic}{instance}")]
    NoNode {
        /// The topic.
        topic: String,
        /// Which of its nodes.
        instance: Instance,
    },
    /// A node's file is not what a broker writes. Stop the system and start it
    /// again; something wrote into its directory.
    #[error(
        "{} is not a sound node file: {what}; `uorb stop` and `uorb start` make it anew",
        path.display()
    )]
    CorruptNode {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// A node's file was written by another build.
    #[error(
        "{} has node file version {found}, this program reads {}: \
         use programs of one build, or `uorb stop` and `uorb start`",
        path.display(), NODE_FILE_VERSION
    )]
    NodeVersion {
        /// The file.
        path: PathBuf,
        /// The version it has.
        found: u32,
    },
    /// Shared memory is full. Free some, or mount a larger /dev/shm.
    #[error(
        "no room for {}: it needs {needed_bytes} bytes; free some, or mount a larger /dev/shm",
        path.display()
    )]
    NoSpace {
        /// The file that did not fit.
        path: PathBuf,
        /// What it needs, in bytes.
        needed_bytes: u64,
    },
    /// A topic's field list is longer than a node file takes.
    #[error(
        "the field list of topic {topic} takes {size_bytes} bytes, more than {}",
        crate::node_file::DESCRIPTION_MAX_BYTES
    )]
    DescriptionTooLong {
        /// The topic.
        topic: String,
        /// What its description takes, in bytes.
        size_bytes: usize,
    },
    /// A message has not the size of its topic's layout.
    #[error("a message of topic {topic} has {expected_bytes} bytes, not {given_bytes}")]
    WrongSize {
        /// The topic.
        topic: String,
        /// What the layout says, in bytes.
        expected_bytes: usize,
        /// What was given, in bytes.
        given_bytes: usize,
    },
    /// The stream of a node cannot be used. The node still can.
    #[error("the stream of {node}: {what}")]
    Stream {
        /// The node: `sensor_accel0`.
        node: String,
        /// What is wrong, as iceoryx2 says it.
        what: String,
    },
    /// A stream subscription that asked for back-pressure has a full queue, so
    /// `try_publish` has published nothing. Try again when it has received, or
    /// `publish`, which overwrites what it has not.
    #[error("the queue of {process} on the stream of {node} is full: {depth} messages")]
    QueueFull {
        /// The node: `sensor_accel0`.
        node: String,
        /// The slow process: `logger (pid 4711)`.
        process: String,
        /// How many messages its queue holds.
        depth: u32,
    },
    /// The process has no descriptors left. Raise `ulimit -n`.
    #[error("no descriptors left for {what}: the limit is {limit} (ulimit -n)")]
    NoDescriptors {
        /// What one was needed for.
        what: String,
        /// The process's soft limit.
        limit: u64,
    },
    /// An environment variable does not say what it should.
    #[error("{variable}={value:?} is not {expected}")]
    BadEnvironment {
        /// The variable.
        variable: &'static str,
        /// What it says.
        value: String,
        /// What it should say.
        expected: &'static str,
    },
    /// The operating system refused something.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// On which file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

impl Error {
    /// An error of the operating system. Running out of descriptors has an
    /// error of its own, because it has a cure of its own.
    #[doc(hidden)]
    #[cold]
    pub fn io(action: &'static str, path: &Path, source: io::Error) -> Self {
        if source.raw_os_error() == Some(libc::EMFILE) {
            use nix::sys::resource::{Resource, getrlimit};
            let what = format!("{}", path.display());
            let limit = getrlimit(Resource::RLIMIT_NOFILE).map_or(0, |(soft, _)| soft);
            return Self::NoDescriptors { what, limit };
        }
        Self::Io { action, path: path.into(), source }
    }
}

impl Error {
    /// An error of a stream. iceoryx2 does not say when descriptors have run
    /// out, so we look.
    #[cold]
    pub(crate) fn stream(node: impl Into<String>, what: impl Into<String>) -> Self {
        let (node, what) = (node.into(), what.into());
        match std::fs::File::open("/dev/null") {
            Err(error) => Self::io("open", format!("the stream of {node}").as_ref(), error),
            Ok(_) => Self::Stream { node, what },
        }
    }
}

impl From<Refusal> for Error {
    fn from(refusal: Refusal) -> Self {
        match refusal {
            Refusal::LayoutMismatch(mismatch) => Self::LayoutMismatch(mismatch),
            Refusal::NoSpace { path, needed_bytes } => Self::NoSpace { path, needed_bytes },
            other => Self::Refused(other),
        }
    }
}
