//! A peer of the broker that is none of ours.

use std::os::fd::{AsRawFd, OwnedFd};

use nix::sys::socket::{
    AddressFamily, MsgFlags, SockFlag, SockType, UnixAddr, connect, recv, send, socket,
};
use uorb_core::System;
use uorb_core::broker_side::{
    FromBroker, Join, PACKET_MAX_BYTES, PROTOCOL_VERSION, Reply, Request, ToBroker, decode, encode,
};

/// A connection to the broker that says what it likes.
#[derive(Debug)]
pub struct Stranger {
    socket: OwnedFd,
}

impl Stranger {
    /// Connects, and says nothing yet.
    pub fn connect(system: &System) -> Self {
        let address = UnixAddr::new(&system.socket()).expect("a short path");
        let flags = SockFlag::SOCK_CLOEXEC;
        let socket =
            socket(AddressFamily::Unix, SockType::SeqPacket, flags, None).expect("a socket");
        connect(socket.as_raw_fd(), &address).expect("the broker listens");
        Self { socket }
    }

    /// Sends a packet. False: the broker has hung up.
    pub fn send(&self, packet: &[u8]) -> bool {
        send(self.socket.as_raw_fd(), packet, MsgFlags::MSG_NOSIGNAL).is_ok()
    }

    /// Waits for what the broker says. None: it has hung up.
    pub fn hear(&self) -> Option<FromBroker> {
        let mut packet = vec![0; PACKET_MAX_BYTES];
        let length = recv(self.socket.as_raw_fd(), &mut packet, MsgFlags::empty()).ok()?;
        decode(&packet[..length])
    }

    /// Asks, and waits for the answer. None: the broker has hung up.
    pub fn ask(&self, request: Request) -> Option<Reply> {
        self.send(&encode(&ToBroker { number: 1, request }));
        match self.hear()? {
            FromBroker::Reply { reply, .. } => Some(reply),
            _ => None,
        }
    }

    /// Joins under a name.
    pub fn join(&self, name: &str) -> Option<Reply> {
        let (version, name) = (PROTOCOL_VERSION, name.to_string());
        self.ask(Request::Join(Join { version, name, rejoin: None }))
    }
}
