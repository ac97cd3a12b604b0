//! The process's session: made by the first call that needs one.
//!
//! When the system was stopped and started again, the next call that needs one
//! makes another.

use std::sync::{Mutex, PoisonError};

use uorb_core::{Error, Session};

use crate::per_process::PerProcess;

/// The session, which is made if there is none.
pub(crate) fn session() -> Result<Session, Error> {
    static SESSION: PerProcess<Mutex<Option<Session>>> = PerProcess::new();
    let mut session = SESSION.get().lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(session) = &*session
        && !session.has_ended()
    {
        return Ok(session.clone());
    }
    let made = Session::connect()?;
    *session = Some(made.clone());
    Ok(made)
}
