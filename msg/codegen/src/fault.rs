//! What can be wrong with a folder of messages, and how it is told.
//!
//! A [`Fault`] names file, line and word. Nobody should have to compile six
//! times to find six mistakes, so the stages of the pipe note faults and go on,
//! and an [`Error`] holds all that were found in all files.

use std::fmt;
use std::path::PathBuf;

/// One thing that is wrong in a .msg file, or odd enough for a warning.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Fault {
    /// The file, as the folder was given: `msg/sensor_accel.msg`.
    pub path: String,
    /// The line, counted from 1; `None` where the whole file is meant.
    pub line: Option<u32>,
    /// What is wrong, with the offending word in it.
    pub text: String,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            Some(line) => write!(f, "{}:{line}: {}", self.path, self.text),
            None => write!(f, "{}: {}", self.path, self.text),
        }
    }
}

/// Why nothing was written.
#[derive(thiserror::Error)]
pub enum Error {
    /// The messages have mistakes: all that were found, by file and line.
    /// Correct the .msg files.
    #[error("{}", list(.0))]
    Messages(Vec<Fault>),
    /// A folder or file cannot be read or written. Check the path that was
    /// given to [`crate::compile`]; there it is relative to the crate's own folder.
    #[error("{}: {source}", path.display())]
    File {
        /// The path, as it was tried.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A folder has no .msg file in it. It is probably the wrong one.
    #[error("{}: there is no .msg file in this folder", .0.display())]
    Empty(PathBuf),
    /// No `OUT_DIR`: this is not a build script, so [`crate::Config::out_dir`]
    /// has to say where the module goes.
    #[error("OUT_DIR is not set: call this from build.rs, or name a folder with `Config::out_dir`")]
    NoOutDir,
}

// A build script that ends with `?` has its error printed with `Debug`, and
// what a user needs to see then is the list.
impl fmt::Debug for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

fn list(faults: &[Fault]) -> String {
    use fmt::Write;
    let mut text = match faults.len() {
        1 => "1 error in the messages".to_string(),
        count => format!("{count} errors in the messages"),
    };
    for fault in faults {
        let _ = write!(text, "\n{fault}");
    }
    text
}

/// The faults and warnings of one file, noted as they are met.
#[derive(Debug)]
pub(crate) struct Notes {
    path: String,
    pub(crate) faults: Vec<Fault>,
    pub(crate) warnings: Vec<Fault>,
}

impl Notes {
    pub(crate) fn new(path: &str) -> Self {
        Self { path: path.to_string(), faults: Vec::new(), warnings: Vec::new() }
    }

    pub(crate) fn path(&self) -> &str {
        &self.path
    }

    pub(crate) fn fault(&mut self, line: impl Into<Option<u32>>, text: impl Into<String>) {
        self.faults.push(self.note(line.into(), text.into()));
    }

    pub(crate) fn warn(&mut self, line: impl Into<Option<u32>>, text: impl Into<String>) {
        self.warnings.push(self.note(line.into(), text.into()));
    }

    fn note(&self, line: Option<u32>, text: String) -> Fault {
        Fault { path: self.path.clone(), line, text }
    }
}
