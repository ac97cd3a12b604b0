//! A TCP connection: one that we make, or one that the partner makes.
//!
//! Either comes again by itself when it was cut. Of several partners that
//! connect, the newest is the one: the one before it may be dead and not know.

use std::io::{self, Read};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use nix::poll::PollFlags;
use uorb_core::now_us;

use super::queue::Queue;
use super::{Sent, Transport};
use crate::frame::Delivery;

/// How often it is tried to connect.
const CONNECT_EVERY_US: u64 = 1_000_000;

/// How long one attempt may take: the link does nothing else meanwhile.
const CONNECT_TIMEOUT: Duration = Duration::from_millis(200);

/// A connection, while there is one.
#[derive(Default)]
struct Connection {
    stream: Option<TcpStream>,
    queue: Queue,
    has_begun: bool,
}

impl Connection {
    fn begin(&mut self, stream: TcpStream) {
        let is_set = stream.set_nonblocking(true).and_then(|()| stream.set_nodelay(true));
        self.queue.clear();
        self.has_begun = true;
        self.stream = is_set.is_ok().then_some(stream);
    }

    fn descriptor(&self) -> Option<(BorrowedFd<'_>, PollFlags)> {
        let mut events = PollFlags::POLLIN;
        events.set(PollFlags::POLLOUT, !self.queue.is_empty());
        self.stream.as_ref().map(|stream| (stream.as_fd(), events))
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        let stream = self.stream.as_mut()?;
        let received = self.queue.flush(stream).and_then(|()| stream.read(buffer));
        match received {
            Ok(len) if len > 0 => return Some(len),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            // It has ended.
            _ => self.stream = None,
        }
        None
    }

    fn send(&mut self, packet: &[u8]) -> Sent {
        let Some(stream) = &mut self.stream else { return Sent::Nobody };
        self.queue.send(stream, packet).unwrap_or_else(|_| {
            self.stream = None;
            Sent::Nobody
        })
    }
}

/// Connects to a partner.
pub(super) struct Connector {
    remote: SocketAddr,
    connection: Connection,
    next_try_us: u64,
}

impl Connector {
    pub(super) fn new(remote: SocketAddr) -> Self {
        Self { remote, connection: Connection::default(), next_try_us: 0 }
    }
}

impl Transport for Connector {
    fn descriptors(&self) -> Vec<(BorrowedFd<'_>, PollFlags)> {
        self.connection.descriptor().into_iter().collect()
    }

    fn delivery(&self) -> Delivery {
        Delivery::Stream
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        if self.connection.stream.is_none() && now_us() >= self.next_try_us {
            self.next_try_us = now_us() + CONNECT_EVERY_US;
            if let Ok(stream) = TcpStream::connect_timeout(&self.remote, CONNECT_TIMEOUT) {
                self.connection.begin(stream);
            }
        }
        self.connection.receive(buffer)
    }

    fn has_begun(&mut self) -> bool {
        std::mem::take(&mut self.connection.has_begun)
    }

    fn send(&mut self, packet: &[u8]) -> Sent {
        self.connection.send(packet)
    }

    fn describe(&self) -> String {
        let is_connected = self.connection.stream.is_some();
        format!("tcp -> {}{}", self.remote, if is_connected { "" } else { " (not connected)" })
    }
}

/// Waits for a partner to connect.
pub(super) struct Listener {
    listener: TcpListener,
    connection: Connection,
}

impl Listener {
    pub(super) fn bind(local: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(local)?;
        listener.set_nonblocking(true)?;
        Ok(Self { listener, connection: Connection::default() })
    }
}

impl Transport for Listener {
    fn descriptors(&self) -> Vec<(BorrowedFd<'_>, PollFlags)> {
        let listener = (self.listener.as_fd(), PollFlags::POLLIN);
        [listener].into_iter().chain(self.connection.descriptor()).collect()
    }

    fn delivery(&self) -> Delivery {
        Delivery::Stream
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        while let Ok((stream, _)) = self.listener.accept() {
            self.connection.begin(stream);
        }
        self.connection.receive(buffer)
    }

    fn has_begun(&mut self) -> bool {
        std::mem::take(&mut self.connection.has_begun)
    }

    fn send(&mut self, packet: &[u8]) -> Sent {
        self.connection.send(packet)
    }

    fn describe(&self) -> String {
        let local = self.listener.local_addr().map_or_else(|_| "?".into(), |it| it.to_string());
        let stream = self.connection.stream.as_ref();
        match stream.and_then(|stream| stream.peer_addr().ok()) {
            Some(partner) => format!("tcp {local} <- {partner}"),
            None => format!("tcp {local} (nobody connected)"),
        }
    }
}
