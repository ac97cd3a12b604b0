//! Joining a system: the connection, the first words, and the file by whose lock
//! the process proves that it lives.

use std::fs::File;
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::thread;
use std::time::Instant;

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::socket::{getsockopt, sockopt};
use nix::unistd::geteuid;

use super::{ANSWER_TIMEOUT, NO_NUMBER, RETRY_FROM, no_answer, no_broker};
use crate::error::Error;
use crate::protocol::{
    FromBroker, Join, PROCESS_NAME_MAX_BYTES, PROTOCOL_VERSION, Rejoin, Reply, Request, ToBroker,
    decode, encode,
};
use crate::system::System;
use crate::transport::{connect_to_broker, receive_packet, send_packet};

/// Connects; while the broker has more to accept than it can keep in line, as
/// when a hundred processes start at once, again.
pub(super) fn connect_patiently(system: &System) -> Result<OwnedFd, Error> {
    let deadline = Instant::now() + ANSWER_TIMEOUT;
    loop {
        match connect_to_broker(system) {
            Ok(socket) => return refuse_other_users(system, socket),
            Err(error) if error.kind() != io::ErrorKind::WouldBlock => {
                return Err(no_broker(system, error));
            }
            Err(_) if Instant::now() >= deadline => return Err(no_answer(system)),
            // Nothing tells when there is room in its line.
            Err(_) => thread::sleep(RETRY_FROM),
        }
    }
}

/// A broker takes processes of its own user and of root. The others are told why
/// here: it just hangs up on them.
pub(super) fn refuse_other_users(system: &System, socket: OwnedFd) -> Result<OwnedFd, Error> {
    let path = system.socket();
    let us = geteuid();
    let owner = getsockopt(&socket, sockopt::PeerCredentials)
        .map_err(|errno| Error::io("look at", &path, errno.into()))?
        .uid();
    if owner == us.as_raw() || us.is_root() {
        return Ok(socket);
    }
    Err(Error::OtherUser { path, owner, us: us.as_raw() })
}

/// One request and its answer on a connection that nobody else uses yet. The
/// broker may speak by itself between the two.
pub(super) fn exchange(
    system: &System,
    socket: &OwnedFd,
    request: Request,
    buffer: &mut Vec<u8>,
    hear: &mut dyn FnMut(FromBroker),
) -> Result<Reply, Error> {
    // A broker that was killed meanwhile is none.
    send_packet(socket, &encode(&ToBroker { number: NO_NUMBER, request }))
        .map_err(|error| no_broker(system, error))?;
    loop {
        let mut ready = [PollFd::new(socket.as_fd(), PollFlags::POLLIN)];
        let timeout = PollTimeout::try_from(ANSWER_TIMEOUT).unwrap_or(PollTimeout::MAX);
        match poll(&mut ready, timeout) {
            Ok(0) => return Err(no_answer(system)),
            Err(Errno::EINTR) => continue,
            _ => {}
        }
        let packet = match receive_packet(socket, buffer) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => continue,
            packet => packet.map_err(|error| no_broker(system, error))?,
        };
        match decode(packet) {
            Some(FromBroker::Reply { reply, .. }) => return Ok(reply),
            Some(FromBroker::Ended) => return Err(Error::Ended { path: system.dir() }),
            Some(word) => hear(word),
            None => return Err(system.no_broker()),
        }
    }
}

pub(super) fn join(
    system: &System,
    socket: &OwnedFd,
    rejoin: Option<Rejoin>,
) -> Result<Reply, Error> {
    let request = Request::Join(Join { version: PROTOCOL_VERSION, name: process_name(), rejoin });
    match exchange(system, socket, request, &mut Vec::new(), &mut |_| {})? {
        Reply::Refused(refusal) => Err(refusal.into()),
        reply => Ok(reply),
    }
}

/// The name that `uorb info` shows: that of the program file.
pub(super) fn process_name() -> String {
    let path = std::env::args_os().next().unwrap_or_default();
    let name = std::path::Path::new(&path).file_name().unwrap_or_default().to_string_lossy();
    let mut name = if name.is_empty() { "?".into() } else { name.into_owned() };
    let end = name.floor_char_boundary(PROCESS_NAME_MAX_BYTES);
    name.truncate(end);
    name
}

/// Opens the process's own file and locks it for as long as it lives. None: the
/// broker that gave us the number died before we had it locked, and the next one
/// has taken us for dead. Then the number may be another's by now.
pub(super) fn lock_life(system: &System, peer: u16) -> Result<Option<File>, Error> {
    let path = system.peer(peer);
    let file = File::options()
        .read(true)
        .write(true)
        .custom_flags(libc::O_CLOEXEC | libc::O_NOFOLLOW)
        .open(&path);
    let file = match file {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        file => file.map_err(|error| Error::io("open", &path, error))?,
    };
    fail_point!("join.welcome");
    // A record lock, not flock or an open file description's: those outlive
    // the process in a forked child.
    match fcntl(&file, FcntlArg::F_SETLK(&write_lock())) {
        Ok(_) => {}
        Err(Errno::EACCES | Errno::EAGAIN) => return Ok(None),
        Err(errno) => return Err(Error::io("lock", &path, errno.into())),
    }
    fail_point!("join.locked");
    // A broker locks a file before it removes it, so ours stays from now on if
    // it still has its name.
    let held = file.metadata().map_err(|error| Error::io("look at", &path, error))?;
    let is_ours = std::fs::metadata(&path)
        .is_ok_and(|named| (named.dev(), named.ino()) == (held.dev(), held.ino()));
    Ok(is_ours.then_some(file))
}

pub(super) fn write_lock() -> libc::flock {
    libc::flock {
        l_type: libc::F_WRLCK as libc::c_short,
        l_whence: libc::SEEK_SET as libc::c_short,
        l_start: 0,
        l_len: 0,
        l_pid: 0,
    }
}
