//! The broker's log: a file that cannot grow without end.
//!
//! When it has grown to its limit it is put aside as `broker.log.1`, over the
//! one before, and begun anew. A full disk loses log lines and nothing else.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::LevelFilter;

use crate::limits::LOG_MAX_BYTES;

/// The environment variable that names the level: `debug`, or
/// `uorbd=trace` and the like.
const LEVEL_VARIABLE: &str = "UORB_LOG";

/// Starts logging, to the file or to stderr.
pub(crate) fn start(file: Option<&Path>) -> io::Result<()> {
    let level = level(&std::env::var(LEVEL_VARIABLE).unwrap_or_default())?;
    let logger = tracing_subscriber::fmt().with_env_filter(level).with_target(false);
    match file {
        Some(path) => {
            let file = CappedFile::open(path)?;
            logger.with_ansi(false).with_writer(Mutex::new(file)).init();
        }
        None => {
            let is_terminal = io::IsTerminal::is_terminal(&io::stderr());
            logger.with_ansi(is_terminal).with_writer(io::stderr).init();
        }
    }
    Ok(())
}

/// What the variable says. A word that is no level would name a program, and nothing
/// would be logged.
fn level(words: &str) -> io::Result<EnvFilter> {
    let is_level = |word: &str| word.rsplit('=').next().unwrap_or(word).parse::<LevelFilter>();
    let filter = EnvFilter::builder().with_default_directive(LevelFilter::INFO.into());
    let is_refused = words.split(',').any(|word| !word.is_empty() && is_level(word).is_err());
    filter.parse(words).ok().filter(|_| !is_refused).ok_or_else(|| {
        let what = format!(
            "{LEVEL_VARIABLE} is {words:?}: it takes off, error, warn, info, debug or trace"
        );
        io::Error::new(io::ErrorKind::InvalidInput, what)
    })
}

struct CappedFile {
    path: PathBuf,
    file: File,
    size_bytes: u64,
}

impl CappedFile {
    fn open(path: &Path) -> io::Result<Self> {
        use std::os::unix::fs::OpenOptionsExt;
        let file = File::options().append(true).create(true).mode(0o600).open(path)?;
        let size_bytes = file.metadata()?.len();
        Ok(Self { path: path.into(), file, size_bytes })
    }
}

impl Write for CappedFile {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        if self.size_bytes + line.len() as u64 > LOG_MAX_BYTES {
            fs::rename(&self.path, self.path.with_extension("log.1"))?;
            match Self::open(&self.path) {
                Ok(anew) => *self = anew,
                // Better too long than silent: the next line tries again.
                Err(_) => fs::rename(self.path.with_extension("log.1"), &self.path)?,
            }
        }
        let written = self.file.write(line)?;
        self.size_bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_is_one_of_six_words() {
        for words in ["", "debug", "WARN", "uorbd=trace", "uorbd=trace,iceoryx2=off"] {
            assert!(level(words).is_ok(), "{words}");
        }
        for words in ["warning", "verbose", "uorbd=foo", "debug,foo"] {
            let refused = level(words).unwrap_err().to_string();
            assert!(refused.contains(words) && refused.contains("trace"), "{refused}");
        }
    }

    #[test]
    fn a_log_takes_twice_its_limit_at_most() {
        let dir = std::env::temp_dir().join(format!("uorbd-log-{}", std::process::id()));
        fs::create_dir(&dir).unwrap();
        let path = dir.join("broker.log");
        let mut log = CappedFile::open(&path).unwrap();
        let line = [b'x'; 1_000];
        for _ in 0..3 * LOG_MAX_BYTES / line.len() as u64 {
            log.write_all(&line).unwrap();
        }
        let sizes: Vec<u64> = fs::read_dir(&dir)
            .unwrap()
            .map(|entry| entry.unwrap().metadata().unwrap().len())
            .collect();
        fs::remove_dir_all(&dir).unwrap();
        assert_eq!(sizes.len(), 2);
        assert!(sizes.iter().all(|size| *size > 0 && *size <= LOG_MAX_BYTES), "{sizes:?}");
    }
}
