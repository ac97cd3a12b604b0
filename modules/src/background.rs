//! A module that nobody's shell waits for, as `logger start` makes one: it is
//! started again in the background, found, and ended.
//!
//! Who runs is not kept in a file, which could be wrong: whoever publishes the
//! module's status topic is one.

use std::error::Error;
use std::ffi::OsString;
use std::io::Read;
use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use uorb_core::{Instance, Session, Subscription, Topic, now_us};

use crate::Stop;

/// How often to look whether it has come, or has gone.
const LOOK_EVERY_US: u64 = 20_000;

/// One that runs, and what it said last.
#[derive(Debug)]
pub struct Running<M> {
    /// Its process id.
    pub pid: u32,
    /// Its status.
    pub status: M,
}

/// All that publish the status topic `T` on this system.
///
/// # Errors
///
/// What the broker says.
pub fn running<T: Topic>(session: &Session) -> Result<Vec<Running<T::Message>>, uorb_core::Error> {
    let mut running = Vec::new();
    for instance in Instance::all() {
        if !session.exists(&T::METADATA.name, instance)? {
            continue;
        }
        let mut status = Subscription::<T>::subscribe_instance(session, instance)?;
        let Some(said) = status.copy() else { continue };
        let peer = status.last_copied().map(|copied| copied.peer);
        let process = peer.map(|peer| session.process(peer)).transpose()?.flatten();
        running.extend(process.map(|process| Running { pid: process.pid, status: said }));
    }
    Ok(running)
}

fn runs<T: Topic>(session: &Session, pid: u32) -> Result<bool, uorb_core::Error> {
    Ok(running::<T>(session)?.iter().any(|one| one.pid == pid))
}

/// Starts this program in the background, with these arguments, and waits until it
/// publishes `T`. Returns its process id. None: we are to stop ourselves, and it ends
/// with us.
///
/// # Errors
///
/// What it said on stderr, where it has ended instead.
pub fn start<T: Topic>(
    session: &Session,
    arguments: impl IntoIterator<Item = OsString>,
    stop: &Stop,
) -> Result<Option<u32>, Box<dyn Error>> {
    let program = std::env::current_exe()?;
    let mut child = Command::new(&program)
        .args(arguments)
        .process_group(0)
        .stdin(Stdio::null())
        // Whoever waits for the end of our output must not wait for its.
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()?;
    while stop.sleep_until(now_us() + LOOK_EVERY_US) {
        if child.try_wait()?.is_some() {
            let mut words = String::new();
            if let Some(stderr) = &mut child.stderr {
                stderr.read_to_string(&mut words)?;
            }
            // It has said who it is; so shall we.
            let name = program.file_name().unwrap_or_default().to_string_lossy();
            return Err(words.trim().trim_start_matches(&format!("{name}: ")).into());
        }
        if runs::<T>(session, child.id())? {
            return Ok(Some(child.id()));
        }
    }
    kill(Pid::from_raw(child.id() as i32), Signal::SIGTERM)?;
    Ok(None)
}

/// Asks one to end, and waits until it publishes `T` no more. False: it does not
/// end in this time, or we are to stop ourselves.
///
/// # Errors
///
/// Who may not end it, and what the broker says.
pub fn end<T: Topic>(
    session: &Session,
    pid: u32,
    timeout_us: u64,
    stop: &Stop,
) -> Result<bool, Box<dyn Error>> {
    kill(Pid::from_raw(pid as i32), Signal::SIGTERM)?;
    let deadline_us = now_us() + timeout_us;
    while runs::<T>(session, pid)? {
        if now_us() > deadline_us || !stop.sleep_until(now_us() + LOOK_EVERY_US) {
            return Ok(false);
        }
    }
    Ok(true)
}
