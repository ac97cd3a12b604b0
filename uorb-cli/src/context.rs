//! What every subcommand needs: which system it is about.

use std::path::PathBuf;

use uorb_core::{Error, Session, System};

// Where the system is, for all subcommands alike. Not a doc comment: clap would
// take it for what the command is about.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Which system")]
pub(crate) struct Place {
    /// The directory of all systems [default: $UORB_DIR, else /dev/shm/uorb-<uid>]
    #[arg(long, global = true, value_name = "DIR")]
    pub(crate) dir: Option<PathBuf>,

    /// The number of the system [default: $UORB_SYSTEM, else 0]
    #[arg(long, global = true, value_name = "N", allow_negative_numbers = true)]
    pub(crate) system: Option<u32>,
}

/// What every subcommand gets.
#[derive(Debug)]
pub(crate) struct Context {
    /// The system that the command is about.
    pub(crate) system: System,
}

impl Context {
    pub(crate) fn new(place: &Place) -> Result<Self, Error> {
        // The environment is not looked at, and so cannot be wrong, where an
        // option says it.
        let number = match place.system {
            Some(number) => number,
            None => System::from_env()?.number(),
        };
        let base = place.dir.clone().unwrap_or_else(System::base_from_env);
        Ok(Self { system: System::new(base, number) })
    }

    /// Joins the system.
    pub(crate) fn session(&self) -> Result<Session, Error> {
        Session::connect_to(&self.system)
    }
}
