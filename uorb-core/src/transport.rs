//! Packets on the broker's socket: how both sides send and receive them.

use std::fs::File;
use std::io;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;

use nix::errno::Errno;
use nix::sys::socket::{
    AddressFamily, Backlog, MsgFlags, SockFlag, SockType, UnixAddr, bind, connect, listen, recv,
    send, socket,
};

use crate::protocol::PACKET_MAX_BYTES;
use crate::system::System;

/// Connections that wait to be accepted.
const BACKLOG: i32 = 128;

/// Connects to the broker of a system, without waiting.
///
/// # Errors
///
/// What connect(2) says: `ENOENT` and `ECONNREFUSED` mean that no broker runs,
/// `EAGAIN` that too many wait for it already.
pub(crate) fn connect_to_broker(system: &System) -> io::Result<OwnedFd> {
    let socket = new_socket()?;
    let (address, _dir) = address(system)?;
    connect(socket.as_raw_fd(), &address)?;
    Ok(socket)
}

/// Makes the broker's own socket. A stale one is removed first:
/// the caller holds the broker's lock.
///
/// # Errors
///
/// What bind(2) and listen(2) say.
pub fn listen_as_broker(system: &System) -> io::Result<OwnedFd> {
    let socket = new_socket()?;
    match std::fs::remove_file(system.socket()) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let (address, _dir) = address(system)?;
    bind(socket.as_raw_fd(), &address)?;
    listen(&socket, Backlog::new(BACKLOG)?)?;
    Ok(socket)
}

/// No socket of ours blocks: who is stopped stops nobody else.
fn new_socket() -> io::Result<OwnedFd> {
    let flags = SockFlag::SOCK_CLOEXEC | SockFlag::SOCK_NONBLOCK;
    Ok(socket(AddressFamily::Unix, SockType::SeqPacket, flags, None)?)
}

/// The socket's address, and a directory that must stay open while it is used:
/// a Unix address has 108 bytes, a path may have more, and then it goes by way
/// of the open directory.
fn address(system: &System) -> io::Result<(UnixAddr, Option<File>)> {
    match UnixAddr::new(&system.socket()) {
        Ok(address) => Ok((address, None)),
        Err(Errno::ENAMETOOLONG) => {
            let flags = libc::O_PATH | libc::O_DIRECTORY | libc::O_CLOEXEC;
            let dir = File::options().read(true).custom_flags(flags).open(system.dir())?;
            let path = PathBuf::from(format!("/proc/self/fd/{}/broker.sock", dir.as_raw_fd()));
            Ok((UnixAddr::new(&path)?, Some(dir)))
        }
        Err(errno) => Err(errno.into()),
    }
}

/// Sends one packet. A closed connection is `EPIPE`, never a signal.
///
/// # Errors
///
/// What send(2) says; `EAGAIN` where the other side does not read.
pub fn send_packet(socket: impl AsFd, packet: &[u8]) -> io::Result<()> {
    loop {
        match send(socket.as_fd().as_raw_fd(), packet, MsgFlags::MSG_NOSIGNAL) {
            Ok(_) => return Ok(()),
            Err(Errno::EINTR) => {}
            Err(errno) => return Err(errno.into()),
        }
    }
}

/// Receives one packet into `buffer`. Empty: the other side has hung up, or it
/// sent an empty packet, which nobody does.
///
/// # Errors
///
/// What recv(2) says; `EAGAIN` where there is nothing, `EMSGSIZE` for a packet
/// that is too long.
pub fn receive_packet(socket: impl AsFd, buffer: &mut Vec<u8>) -> io::Result<&[u8]> {
    buffer.resize(PACKET_MAX_BYTES, 0);
    loop {
        match recv(socket.as_fd().as_raw_fd(), buffer, MsgFlags::MSG_TRUNC) {
            Ok(length) if length > buffer.len() => return Err(Errno::EMSGSIZE.into()),
            Ok(length) => return Ok(&buffer[..length]),
            Err(Errno::EINTR) => {}
            Err(errno) => return Err(errno.into()),
        }
    }
}
