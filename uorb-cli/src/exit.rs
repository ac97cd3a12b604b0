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
    // `uorb listener | head` closed the pipe: the reader has seen enough.
    if output_error(&error).is_some_and(|io| io.kind() == ErrorKind::BrokenPipe) {
        return ExitCode::SUCCESS;
    }
    let code = match error.downcast_ref::<Early>() {
        // Whoever pressed it knows.
        Some(Early::Interrupted) => return INTERRUPTED.into(),
        Some(Early::TimedOut(_)) => TIMED_OUT,
        None => FAILURE,
    };
    say(format_args!("{}", words(&error)));
    code.into()
}

/// The error of writing to stdout: no other is an error of the system alone,
/// without a word about what was tried.
fn output_error(error: &anyhow::Error) -> Option<&io::Error> {
    error.downcast_ref().filter(|_| error.chain().len() == 1)
}

/// An error and its causes, each said once: some errors name their cause
/// themselves.
fn words(error: &anyhow::Error) -> String {
    if let Some(io) = output_error(error) {
        return format!("cannot write the output: {io}");
    }
    let mut words = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !words.ends_with(&cause) {
            words = format!("{words}: {cause}");
        }
    }
    words
}

/// Words for people, on stderr. That nobody reads them is no error.
pub(crate) fn say(words: std::fmt::Arguments<'_>) {
    // At once, as other processes may write there too.
    let line = format!("uorb: {words}\n");
    let _ = io::stderr().write_all(line.as_bytes());
}

#[cfg(test)]
mod tests {
    use anyhow::Context as _;

    use super::*;

    #[test]
    fn a_cause_is_said_once() {
        let refused = || io::Error::from(ErrorKind::ConnectionRefused);
        let own = uorb_core::Error::io("read", "/obj".as_ref(), refused());
        assert_eq!(words(&own.into()), "cannot read /obj: connection refused");
        assert_eq!(words(&refused().into()), "cannot write the output: connection refused");
        let wrapped = Err::<(), _>(refused()).context("cannot hear the broker").unwrap_err();
        assert_eq!(words(&wrapped), "cannot hear the broker: connection refused");
    }

    #[test]
    fn whoever_has_read_enough_makes_no_error() {
        let closed: anyhow::Error = io::Error::from(ErrorKind::BrokenPipe).into();
        assert_eq!(code(Err(closed)), ExitCode::SUCCESS);
        // That of the broker's socket is one.
        let broker = io::Error::from(ErrorKind::BrokenPipe);
        let broker = uorb_core::Error::io("write to", "broker.sock".as_ref(), broker);
        assert_eq!(code(Err(broker.into())), ExitCode::from(FAILURE));
    }
}
