//! How the command ends: what is said, and the exit code.
//!
//! | code | when |
//! |---|---|
//! | 0 | it is done; whoever read its output has seen enough |
//! | 1 | an error |
//! | 2 | the command line makes no sense |
//! | 124 | `--timeout` is over, as timeout(1) has it |
//! | 130 | Ctrl-C came before what was asked for was done |

use std::io::{self, ErrorKind, Write};
use std::process::ExitCode;

const FAILURE: u8 = 1;
const TIMED_OUT: u8 = 124;
pub(crate) const INTERRUPTED: u8 = 130;

/// Ends with an exit code of their own.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Early {
    /// Nothing came in the time that was given.
    #[error("{0}")]
    TimedOut(String),
    /// Ctrl-C, before all was done.
    #[error("interrupted")]
    Interrupted,
}

/// Says what went wrong, if anything did, and with which code to exit.
pub(crate) fn code(ended: anyhow::Result<()>) -> ExitCode {
    let Err(error) = ended else { return ExitCode::SUCCESS };
    // `uorb listener | head` closed the pipe: the reader has seen enough. Only
    // writing to it fails with a bare error of this kind.
    if error.downcast_ref::<io::Error>().is_some_and(|io| io.kind() == ErrorKind::BrokenPipe) {
        return ExitCode::SUCCESS;
    }
    let code = match error.downcast_ref::<Early>() {
        // Whoever pressed it knows.
        Some(Early::Interrupted) => return INTERRUPTED.into(),
        Some(Early::TimedOut(_)) => TIMED_OUT,
        None => FAILURE,
    };
    say(format_args!("{error:#}"));
    code.into()
}

/// Words for people, on stderr. That nobody reads them is no error.
pub(crate) fn say(words: std::fmt::Arguments<'_>) {
    let _ = writeln!(io::stderr(), "uorb: {words}");
}
