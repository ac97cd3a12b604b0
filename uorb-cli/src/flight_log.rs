//! A flight log on the command line: the file, and the topics that are meant.

mod about;

use std::fs::File;
use std::io::{BufReader, Cursor, Read};
use std::path::Path;

use anyhow::{Context as _, anyhow, bail};
use uorb_ulog::{Ending, Fault, Source, is_match};

pub(crate) use self::about::{About, parameter_json, parameter_text, text_of};

/// Opens a log. What cannot be read twice, as a pipe, is kept in memory.
pub(crate) fn open(path: &Path) -> anyhow::Result<Box<dyn Source>> {
    let name = || format!("cannot read {}", path.display());
    let mut file = File::open(path).with_context(name)?;
    if file.metadata().with_context(name)?.is_file() {
        return Ok(Box::new(BufReader::with_capacity(1 << 18, file)));
    }
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).with_context(name)?;
    Ok(Box::new(Cursor::new(bytes)))
}

/// Checks that every pattern is of use: a slip in one is an error, not an empty
/// result.
pub(crate) fn check_patterns<'n>(
    path: &Path,
    patterns: impl IntoIterator<Item = &'n String>,
    names: &[&str],
) -> anyhow::Result<()> {
    for pattern in patterns {
        if !names.iter().any(|name| is_match(pattern, name)) {
            let hint = crate::nearest::did_you_mean(pattern, names.iter().copied());
            bail!("no topic in {} is named {pattern}{hint}", path.display());
        }
    }
    Ok(())
}

/// What is to be said at the end, when all that is whole of a log was `done`:
/// "shown", "exported". `odd` is a note that makes no sense.
pub(crate) fn judge(
    path: &Path,
    ending: Result<Ending, Fault>,
    odd: Option<Fault>,
    messages: u64,
    done: &str,
) -> anyhow::Result<()> {
    let file = path.display();
    match ending {
        Ok(Ending::Whole) => match odd {
            None => Ok(()),
            Some(fault) => bail!("{file}: {fault}; all else was {done}"),
        },
        Ok(Ending::CutOff { at_byte }) => bail!(
            "{file} is cut off: the record at byte {at_byte} is not whole; all before it was {done}"
        ),
        Err(fault) if messages == 0 => Err(anyhow!(fault).context(file.to_string())),
        Err(fault) => Err(anyhow!(fault).context(format!("{file}, after {messages} messages"))),
    }
}

/// How a reading ended: a log that cannot be read any further is to be told at
/// the end, any other error at once.
pub(crate) fn ending_of(ended: anyhow::Result<Ending>) -> anyhow::Result<Result<Ending, Fault>> {
    match ended {
        Ok(ending) => Ok(Ok(ending)),
        Err(error) => Ok(Err(error.downcast::<Fault>()?)),
    }
}
