//! The message compiler: reads a folder of .msg files, as PX4 has them in
//! `msg/`, and writes a Rust module with a struct and topics for each, or headers
//! and sources in C and C++ ([`Config::generate_c`], the command `uorb msg`).
//!
//! A crate with messages of its own needs a folder with them, a build script
//! and one line:
//!
//! ```text
//! my_messages/
//!   Cargo.toml            [dependencies]        uorb-core = { path = ".." }
//!                         [build-dependencies]  uorb-codegen = { path = ".." }
//!   build.rs
//!   msg/distance.msg
//!   src/lib.rs
//! ```
//!
//! `msg/distance.msg`:
//!
//! ```text
//! # Distance to the ground.
//!
//! float32 current_distance   # [m] distance now
//! uint8 ORB_QUEUE_LENGTH = 4
//! ```
//!
//! `build.rs`:
//!
//! ```no_run
//! fn main() -> Result<(), uorb_codegen::Error> {
//!     uorb_codegen::compile("msg")
//! }
//! ```
//!
//! `src/lib.rs`:
//!
//! ```text
//! include!(concat!(env!("OUT_DIR"), "/uorb_msg.rs"));
//! ```
//!
//! There is now a struct `Distance` with the fields `timestamp` (inserted, as
//! PX4 does) and `current_distance`, which is a message and a topic, besides
//! `TOPICS` and `OrbId` for all of the folder. A mistake in a .msg file fails
//! the build with file, line and word, all mistakes at once.
#![deny(missing_docs)]

/// `write!` to a String cannot fail; this is `writeln!` without the `Result`.
macro_rules! line {
    ($out:expr, $($arguments:tt)*) => {{
        let _ = writeln!($out, $($arguments)*);
    }};
}

mod c;
mod comment;
mod fault;
mod folder;
mod layout;
mod message;
mod names;
mod output;
mod parse;
mod rust;
mod scalar;

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use fault::Notes;
pub use fault::{Error, Fault};
use layout::Layout;
use message::Messages;
pub use output::{GeneratedC, Written};

/// Compiles a folder of .msg files in a build script: writes
/// `$OUT_DIR/uorb_msg.rs`, prints the warnings, and tells cargo to come back
/// when the folder changes.
///
/// The path is relative to the crate's own folder. Use it as the crate's
/// documentation shows; more can be said with [`Config`].
pub fn compile(folder: impl AsRef<Path>) -> Result<(), Error> {
    Config::new().folder(folder).compile()
}

/// What to compile, and to where.
///
/// ```no_run
/// # fn main() -> Result<(), uorb_codegen::Error> {
/// uorb_codegen::Config::new()
///     .folder("msg")
///     .folder("msg/versioned")
///     .search("../uorb/msg")
///     .compile()
/// # }
/// ```
#[derive(Clone, Debug, Default)]
pub struct Config {
    folders: Vec<PathBuf>,
    searched: Vec<PathBuf>,
    texts: Vec<(String, String)>,
    out_dir: Option<PathBuf>,
}

/// A module that was made, and what is odd about the messages.
#[derive(Clone, Debug)]
pub struct Generated {
    /// The text of the Rust module.
    pub rust: String,
    /// What should be looked at, though it is no mistake.
    pub warnings: Vec<Fault>,
}

impl Config {
    /// Nothing to compile yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Compiles all .msg files that lie directly in this folder.
    pub fn folder(mut self, folder: impl AsRef<Path>) -> Self {
        self.folders.push(folder.as_ref().to_path_buf());
        self
    }

    /// Looks here, too, for messages that are fields of others. They become
    /// structs beside those that contain them, without topics of their own.
    pub fn search(mut self, folder: impl AsRef<Path>) -> Self {
        self.searched.push(folder.as_ref().to_path_buf());
        self
    }

    /// Compiles this text as if it lay in a file: `text("distance.msg", ..)`.
    pub fn text(mut self, path: impl Into<String>, text: impl Into<String>) -> Self {
        self.texts.push((path.into(), text.into()));
        self
    }

    /// Writes the module here, and not to `OUT_DIR`.
    pub fn out_dir(mut self, folder: impl AsRef<Path>) -> Self {
        self.out_dir = Some(folder.as_ref().to_path_buf());
        self
    }

    /// Makes the module and writes it as `uorb_msg.rs`, with the words for
    /// cargo that a build script prints.
    pub fn compile(&self) -> Result<(), Error> {
        for folder in self.folders.iter().chain(&self.searched) {
            println!("cargo::rerun-if-changed={}", folder.display());
        }
        let generated = self.generate()?;
        for warning in &generated.warnings {
            println!("cargo::warning={warning}");
        }
        let out_dir = self.out_dir.clone().or_else(|| std::env::var_os("OUT_DIR").map(Into::into));
        let path = out_dir.ok_or(Error::NoOutDir)?.join("uorb_msg.rs");
        fs::write(&path, generated.rust).map_err(|source| Error::File { path, source })
    }

    /// Makes the module and returns it.
    pub fn generate(&self) -> Result<Generated, Error> {
        let mut messages = self.read()?;
        let layouts = lay_out(&mut messages)?;
        let rust = rust::module(&messages, &layouts);
        Ok(Generated { rust, warnings: messages.warnings })
    }

    /// Makes the headers and sources of C and C++ and returns them: for each
    /// message `include/uORB/topics/<message>.h` and `src/<message>.c`, and for
    /// all of them `uORBTopics.h`, `uORBTopics.hpp` and `uORBTopics.c`.
    ///
    /// Names that are words of these languages are faults here, besides those
    /// that are anywhere. Messages of more than 65,535 bytes are left out, with
    /// a warning.
    pub fn generate_c(&self) -> Result<GeneratedC, Error> {
        let mut messages = self.read()?;
        c::refuse_names(&mut messages);
        let layouts = lay_out(&mut messages)?;
        let files = c::files(&messages, &layouts);
        let mut warnings = messages.warnings.clone();
        warnings.extend(c::warnings(&messages, &layouts));
        warnings.sort();
        Ok(GeneratedC { files, warnings })
    }

    /// Reads the messages, with what is wrong in them.
    fn read(&self) -> Result<Messages, Error> {
        let mut files = Vec::new();
        for (path, text) in &self.texts {
            files.push(read(Path::new(path), text.as_bytes(), false));
        }
        for (folder, searched) in
            self.folders.iter().map(|f| (f, false)).chain(self.searched.iter().map(|f| (f, true)))
        {
            let paths = msg_files(folder)?;
            if paths.is_empty() {
                return Err(Error::Empty(folder.clone()));
            }
            for path in paths {
                match fs::read(&path) {
                    Ok(bytes) => files.push(read(&path, &bytes, searched)),
                    Err(source) => return Err(Error::File { path, source }),
                }
            }
        }
        Ok(folder::resolve(files))
    }
}

/// Lays out messages that have no fault so far, and none in their layouts.
fn lay_out(messages: &mut Messages) -> Result<Vec<Layout>, Error> {
    let (layouts, faults) = layout::lay_out(messages);
    messages.faults.extend(faults);
    messages.faults.sort();
    messages.warnings.sort();
    if messages.faults.is_empty() {
        Ok(layouts)
    } else {
        Err(Error::Messages(std::mem::take(&mut messages.faults)))
    }
}

/// The .msg files of a folder, sorted by name.
fn msg_files(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let failed = |source| Error::File { path: folder.to_path_buf(), source };
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.extension() == Some(OsStr::new("msg")) && path.is_file() {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

fn read(path: &Path, bytes: &[u8], searched: bool) -> folder::File {
    let shown = path.strip_prefix(".").unwrap_or(path).display().to_string();
    let mut notes = Notes::new(&shown);
    // Only comments have other letters than ASCII in them, so what cannot be
    // read changes no field.
    let text = String::from_utf8_lossy(bytes);
    if let std::borrow::Cow::Owned(_) = text {
        notes.warn(None, "this file is not UTF-8; some letters of its comments are lost");
    }
    let ast = parse::parse(&text, &mut notes);
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    folder::File { stem, ast, notes, searched }
}
