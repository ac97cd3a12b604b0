//! The files of C and C++, on their way to a folder.
//!
//! A build looks at the times of files, so one whose text is the same is not
//! written again. A file that an earlier run wrote and this one does not is
//! removed: a source of a message that is gone would be compiled for ever. It is
//! known by its first line; no other file is touched.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::{fs, io};

use crate::c::MARK;
use crate::fault::{Error, Fault};

/// The folders that files are written to.
const FOLDERS: [&str; 3] = ["include/uORB/topics", "include/uORB", "src"];

/// Headers and sources that were made, and what is odd about the messages.
#[derive(Clone, Debug)]
pub struct GeneratedC {
    /// The path within the output folder, and the text of each file.
    pub files: Vec<(String, String)>,
    /// What should be looked at, though it is no mistake.
    pub warnings: Vec<Fault>,
}

/// What has changed in the output folder.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// The files that are new or have another text than before.
    pub changed: Vec<PathBuf>,
    /// The files of an earlier run that are no more.
    pub removed: Vec<PathBuf>,
}

impl GeneratedC {
    /// Writes the files below this folder, which is made if need be.
    pub fn write_to(&self, folder: impl AsRef<Path>) -> Result<Written, Error> {
        let folder = folder.as_ref();
        let mut written = Written::default();
        for name in FOLDERS {
            let path = folder.join(name);
            fs::create_dir_all(&path).map_err(|source| Error::File { path, source })?;
        }
        let mut ours = BTreeSet::new();
        for (name, text) in &self.files {
            let path = folder.join(name);
            let is_new = write_if_changed(&path, text);
            if is_new.map_err(|source| Error::File { path: path.clone(), source })? {
                written.changed.push(path.clone());
            }
            ours.insert(path);
        }
        for name in FOLDERS {
            let path = folder.join(name);
            let removed = remove_others(&path, &ours);
            written.removed.extend(removed.map_err(|source| Error::File { path, source })?);
        }
        Ok(written)
    }
}

fn write_if_changed(path: &Path, text: &str) -> io::Result<bool> {
    if fs::read(path).is_ok_and(|before| before == text.as_bytes()) {
        return Ok(false);
    }
    fs::write(path, text)?;
    Ok(true)
}

/// Removes what an earlier run wrote into a folder, but for these.
fn remove_others(folder: &Path, ours: &BTreeSet<PathBuf>) -> io::Result<Vec<PathBuf>> {
    let mut removed = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let is_known = ours.contains(&path) || !path.is_file();
        if !is_known && fs::read(&path).is_ok_and(|text| text.starts_with(MARK.as_bytes())) {
            fs::remove_file(&path)?;
            removed.push(path);
        }
    }
    removed.sort();
    Ok(removed)
}
