//! Where logs go, named as PX4 names them.

use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use time::OffsetDateTime;

/// Where to put a log.
#[derive(Clone, Debug)]
pub enum Place {
    /// This file; those that follow it are `NAME_2.ulg` and so on.
    File(PathBuf),
    /// `DIR/2026-11-28/14_05_59.ulg`, in UTC.
    Dated(PathBuf),
    /// `DIR/sess001/log001.ulg`: the first session that is not there yet.
    Sessions(PathBuf),
}

/// The files of one recording, one after the other.
#[derive(Debug)]
pub(super) struct Files {
    place: Place,
    /// The directory of this session, once there is one.
    session: Option<PathBuf>,
    opened: u32,
}

impl Files {
    pub(super) fn new(place: Place) -> Self {
        Self { place, session: None, opened: 0 }
    }

    /// Makes the next file. One that is there already is never written over.
    pub(super) fn next(&mut self) -> Result<(PathBuf, File), (PathBuf, io::Error)> {
        let number = self.opened + 1;
        let path = match &self.place {
            Place::File(path) if number == 1 => path.clone(),
            Place::File(path) => {
                let stem = path.file_stem().unwrap_or_default().to_string_lossy();
                path.with_file_name(format!("{stem}_{number}.ulg"))
            }
            Place::Dated(dir) => dated(dir),
            Place::Sessions(dir) => {
                let session = match &self.session {
                    Some(session) => session.clone(),
                    None => {
                        self.session.insert(session(dir).map_err(|e| (dir.clone(), e))?).clone()
                    }
                };
                session.join(format!("log{number:03}.ulg"))
            }
        };
        // The name that was asked for is that name or none.
        let may_number = !matches!(self.place, Place::File(_)) || number > 1;
        let opened = open(&path, may_number);
        if opened.is_ok() {
            self.opened = number;
        }
        opened.map_err(|error| (path, error))
    }
}

fn dated(dir: &Path) -> PathBuf {
    let now = OffsetDateTime::now_utc();
    let date = format!("{:04}-{:02}-{:02}", now.year(), u8::from(now.month()), now.day());
    let (hour, minute, second) = now.to_hms();
    dir.join(date).join(format!("{hour:02}_{minute:02}_{second:02}.ulg"))
}

/// Makes the directory of a new session.
fn session(dir: &Path) -> io::Result<PathBuf> {
    fs::create_dir_all(dir)?;
    for number in 1.. {
        let session = dir.join(format!("sess{number:03}"));
        match fs::create_dir(&session) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            made => return made.map(|()| session),
        }
    }
    unreachable!("there is always one more number")
}

/// Where a file of this name is there already, as of the same second, this one
/// gets a number, if it may.
fn open(path: &Path, may_number: bool) -> io::Result<(PathBuf, File)> {
    if let Some(dir) = path.parent().filter(|dir| !dir.as_os_str().is_empty()) {
        fs::create_dir_all(dir)?;
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().to_string();
    for number in 1.. {
        let path = match number {
            1 => path.to_path_buf(),
            _ => path.with_file_name(format!("{stem}_{number}.ulg")),
        };
        match File::create_new(&path) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists && may_number => {}
            made => return made.map(|file| (path, file)),
        }
    }
    unreachable!("there is always one more number")
}
