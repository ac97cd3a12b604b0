//! A Unix datagram socket on each side.

use std::fs;
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;

use uorb_core::System;

use super::{Door, Side, WORDS};

#[derive(Debug)]
pub struct Sockets {
    socket: UnixDatagram,
    /// Until it is connected: the other side may not be there yet.
    other: Option<PathBuf>,
}

impl Sockets {
    pub fn open(system: &System, side: Side) -> Self {
        let [other, ours] = side.ways().map(|way| system.base().join(way));
        let _ = fs::remove_file(&ours);
        let socket = UnixDatagram::bind(ours).expect("a new path");
        Self { socket, other: Some(other) }
    }
}

impl Door for Sockets {
    fn send(&mut self, sent_ns: u64) {
        if let Some(other) = self.other.take() {
            self.socket.connect(other).expect("it is there");
        }
        let mut message = [0; WORDS * 8];
        message[..8].copy_from_slice(&sent_ns.to_ne_bytes());
        self.socket.send(&message).expect("sent");
    }

    fn wait(&mut self) -> u64 {
        let mut message = [0; WORDS * 8];
        self.socket.recv(&mut message).expect("received");
        u64::from_ne_bytes(*message.first_chunk().expect("it has 64 bytes"))
    }
}
