//! The other processes of a measurement: this program again, in a role.

use std::path::PathBuf;
use std::process::Command;

use anyhow::bail;
use nix::sys::prctl::set_pdeathsig;
use nix::sys::signal::Signal;
use uorb_tests::{Actor, Bus};

use crate::place::{self, Core};
use crate::{doors, rows};

/// The first argument of a process in a role; the second is its core.
const ROLE: &str = "role";

/// A command of this program in a role, on a bus or on none.
pub fn role(bus: Option<&Bus>, arguments: &[&str]) -> Command {
    let program: PathBuf = std::env::current_exe().expect("every program has a file");
    let mut command = match bus {
        Some(bus) => bus.command(&program),
        None => Command::new(&program),
    };
    command.arg(ROLE).args(arguments);
    command
}

/// Starts this program in a role. It dies with us.
pub fn play(bus: Option<&Bus>, arguments: &[&str]) -> Actor {
    Actor::spawn(role(bus, arguments))
}

/// Plays the role that the command line names. False if it names none.
pub fn play_if_asked() -> anyhow::Result<bool> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let [ROLE, name, core, rest @ ..] = &arguments[..] else { return Ok(false) };
    set_pdeathsig(Signal::SIGKILL)?;
    place::Core::parse(core).pin();
    match *name {
        "keep-awake" => place::keep_awake()?,
        "wake" => doors::exchange(rest)?,
        "sleeper" => rows::blocked::sleeper(rest)?,
        "publish-when-told" => rows::blocked::publish_when_told()?,
        "listen-to-pipe" => rows::blocked::listen_to_pipe(rest)?,
        "flat-out" => rows::flat_out::play(rest)?,
        "topics" => rows::scale::publish_topics(rest)?,
        "every-millisecond" => rows::costs::every_millisecond(rest)?,
        #[cfg(feature = "zenoh")]
        "zenoh-subscriber" => doors::zenoh::subscriber(rest)?,
        other => bail!("no such role: {other}"),
    }
    Ok(true)
}

/// A core as the argument that stands behind a role's name.
pub fn on(core: Core) -> String {
    core.to_string()
}
