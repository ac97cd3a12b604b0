//! One process's connection, as the broker holds it.
//!
//! The broker never waits for a process: what cannot be sent at once is kept,
//! up to a limit, and sent when the socket takes it.

use std::collections::VecDeque;
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};

use nix::sys::socket::{getsockopt, sockopt};
use uorb_core::broker_side::{FromBroker, PACKET_MAX_BYTES, Refusal, Reply, encode, send_packet};

use crate::limits::OUTBOUND_MAX_BYTES;

#[derive(Debug)]
pub(crate) struct Connection {
    socket: OwnedFd,
    /// Who it is, once it has said so.
    pub(crate) peer: Option<u16>,
    pub(crate) pid: u32,
    outbound: VecDeque<Vec<u8>>,
    outbound_bytes: usize,
}

/// The connection cannot go on.
#[derive(Debug, PartialEq)]
pub(crate) enum CutOff {
    /// It does not read what it is sent.
    DoesNotRead,
    /// It has hung up.
    HungUp,
}

impl Connection {
    /// A connection that was accepted. None if its process belongs to another
    /// user; the directory's mode keeps those out already.
    pub(crate) fn new(socket: OwnedFd) -> Option<Self> {
        let credentials = getsockopt(&socket, sockopt::PeerCredentials).ok()?;
        let us = nix::unistd::geteuid().as_raw();
        if credentials.uid() != us && credentials.uid() != 0 {
            return None;
        }
        let pid = u32::try_from(credentials.pid()).unwrap_or(0);
        Some(Self { socket, peer: None, pid, outbound: VecDeque::new(), outbound_bytes: 0 })
    }

    /// Sends a message now, or when the socket takes it.
    pub(crate) fn send(&mut self, message: &FromBroker) -> Result<(), CutOff> {
        let mut packet = encode(message);
        if let (FromBroker::Reply { number, .. }, true) = (message, packet.len() > PACKET_MAX_BYTES)
        {
            let limit = PACKET_MAX_BYTES as u32;
            let refusal = Refusal::Limit { what: "bytes of one answer".into(), limit };
            let reply = Reply::Refused(refusal);
            packet = encode(&FromBroker::Reply { number: *number, reply });
        }
        self.outbound_bytes += packet.len();
        self.outbound.push_back(packet);
        self.flush()?;
        let too_much = self.outbound_bytes > OUTBOUND_MAX_BYTES;
        if too_much { Err(CutOff::DoesNotRead) } else { Ok(()) }
    }

    /// Sends what the socket takes.
    pub(crate) fn flush(&mut self) -> Result<(), CutOff> {
        while let Some(packet) = self.outbound.front() {
            match send_packet(&self.socket, packet) {
                Ok(()) => {
                    self.outbound_bytes -= packet.len();
                    self.outbound.pop_front();
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
                Err(_) => return Err(CutOff::HungUp),
            }
        }
        Ok(())
    }

    /// Whether there is something left to send.
    pub(crate) fn is_waiting(&self) -> bool {
        !self.outbound.is_empty()
    }

    /// A descriptor that becomes readable when the process dies, whoever else
    /// holds the other end of the socket. None on kernels and in process
    /// namespaces that do not give one.
    pub(crate) fn pidfd(&self) -> Option<OwnedFd> {
        socket_pidfd(self.socket.as_fd()).or_else(|| pidfd_of(self.pid))
    }
}

impl AsFd for Connection {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

/// The process that connected, by the kernel's own record of it: Linux 6.5.
#[allow(unsafe_code)]
fn socket_pidfd(socket: BorrowedFd) -> Option<OwnedFd> {
    let mut pidfd: libc::c_int = -1;
    let mut length = size_of::<libc::c_int>() as libc::socklen_t;
    // SAFETY: the two pointers are to locals of the type and length that
    // SO_PEERPIDFD writes.
    let got = unsafe {
        libc::getsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_PEERPIDFD,
            (&raw mut pidfd).cast(),
            &mut length,
        )
    };
    // SAFETY: the kernel has just made the descriptor for us, and nobody else
    // knows of it.
    (got == 0 && pidfd >= 0).then(|| unsafe { OwnedFd::from_raw_fd(pidfd) })
}

/// A process by its number. It may be another by now; the caller looks at the
/// lock of the process that it means before it believes in a death.
#[allow(unsafe_code)]
pub(crate) fn pidfd_of(pid: u32) -> Option<OwnedFd> {
    let pid = libc::pid_t::try_from(pid).ok().filter(|pid| *pid > 0)?;
    // SAFETY: plain numbers go in, a new descriptor or -1 comes out.
    let pidfd = unsafe { libc::syscall(libc::SYS_pidfd_open, pid, 0) };
    let pidfd = libc::c_int::try_from(pidfd).ok().filter(|pidfd| *pidfd >= 0)?;
    // SAFETY: as above, it is ours alone.
    Some(unsafe { OwnedFd::from_raw_fd(pidfd) })
}
