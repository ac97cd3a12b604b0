//! Datagrams.

use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};

use nix::poll::PollFlags;

use super::{Sent, Transport};
use crate::frame::Delivery;

pub(super) struct Udp {
    socket: UdpSocket,
    /// Who gets what is sent.
    partner: SocketAddr,
    /// Who sent what was received last.
    sender: Option<SocketAddr>,
}

impl Udp {
    pub(super) fn bind(local: SocketAddr, remote: SocketAddr) -> io::Result<Self> {
        let socket = UdpSocket::bind(local)?;
        socket.set_nonblocking(true)?;
        Ok(Self { socket, partner: remote, sender: None })
    }
}

impl Transport for Udp {
    fn descriptors(&self) -> Vec<(BorrowedFd<'_>, PollFlags)> {
        vec![(self.socket.as_fd(), PollFlags::POLLIN)]
    }

    fn delivery(&self) -> Delivery {
        Delivery::Datagrams
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        loop {
            match self.socket.recv_from(buffer) {
                Ok((len, sender)) => {
                    self.sender = Some(sender);
                    return Some(len);
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return None,
                // The partner's machine says that nobody is there: it may come.
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {}
                Err(_) => return None,
            }
        }
    }

    fn send(&mut self, packet: &[u8]) -> Sent {
        match self.socket.send_to(packet, self.partner) {
            Ok(_) => Sent::Whole,
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Sent::Dropped,
            Err(error) if error.raw_os_error() == Some(libc::ENOBUFS) => Sent::Dropped,
            Err(_) => Sent::Nobody,
        }
    }

    fn spoke(&mut self) {
        self.partner = self.sender.unwrap_or(self.partner);
    }

    fn describe(&self) -> String {
        match self.socket.local_addr() {
            Ok(local) => format!("udp {local} -> {}", self.partner),
            Err(_) => format!("udp -> {}", self.partner),
        }
    }
}
