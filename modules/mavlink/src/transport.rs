//! What a link is made of: UDP, TCP or a serial device, without waiting.
//!
//! All three are told when a packet was good (`spoke`): only then does UDP
//! answer to its sender, so that nobody who sends garbage becomes the partner.

mod queue;
mod serial;
mod tcp;
mod udp;

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::os::fd::BorrowedFd;
use std::path::PathBuf;

use nix::poll::PollFlags;

use crate::frame::Delivery;

/// Where a link goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// Datagrams, to whoever has spoken last, before that to `remote`.
    Udp {
        /// Where we are.
        local: SocketAddr,
        /// Where the partner is until it has spoken.
        remote: SocketAddr,
    },
    /// A connection that we make, again and again if need be.
    TcpConnect(SocketAddr),
    /// A connection that the partner makes; the newest counts.
    TcpListen(SocketAddr),
    /// A serial device.
    Serial {
        /// Its file.
        device: PathBuf,
        /// How fast it is.
        baud: u32,
    },
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Udp { local, .. } => write!(f, "UDP {local}"),
            Self::TcpConnect(remote) => write!(f, "TCP {remote}"),
            Self::TcpListen(local) => write!(f, "TCP {local}"),
            Self::Serial { device, .. } => write!(f, "{}", device.display()),
        }
    }
}

/// What became of a packet that was to be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// It is on its way.
    Whole,
    /// There was no room for it.
    Dropped,
    /// Nobody is there to send it to.
    Nobody,
}

/// The way that bytes take. Nothing of it ever waits.
pub trait Transport: Send {
    /// What to wait for: until something can be received or be sent further.
    fn descriptors(&self) -> Vec<(BorrowedFd<'_>, PollFlags)>;

    /// How bytes arrive.
    fn delivery(&self) -> Delivery;

    /// The next bytes that have arrived; None when there are none. Also does
    /// what is left to do: sends what waits, connects again.
    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize>;

    /// Whether a stream of bytes has begun since this was asked last, as when another
    /// partner has connected. What was received last belongs to it.
    fn has_begun(&mut self) -> bool {
        false
    }

    /// Sends a packet, or none of it.
    fn send(&mut self, packet: &[u8]) -> Sent;

    /// What was received last was a good packet.
    fn spoke(&mut self) {}

    /// In words: where it is, and who is at the other end.
    fn describe(&self) -> String;
}

/// Opens a link's way.
///
/// # Errors
///
/// As the socket or the file.
pub fn open(address: &Address) -> io::Result<Box<dyn Transport>> {
    Ok(match address {
        Address::Udp { local, remote } => Box::new(udp::Udp::bind(*local, *remote)?),
        Address::TcpConnect(remote) => Box::new(tcp::Connector::new(*remote)),
        Address::TcpListen(local) => Box::new(tcp::Listener::bind(*local)?),
        Address::Serial { device, baud } => Box::new(serial::Serial::open(device, *baud)?),
    })
}
