//! Connections: who is let in, what they ask, and when they are cut off.

use std::fs::File;
use std::os::fd::{AsFd, AsRawFd, FromRawFd, OwnedFd, RawFd};

use nix::errno::Errno;
use nix::sys::epoll::{EpollEvent, EpollFlags};
use nix::sys::socket::{SockFlag, accept4};
use tracing::{debug, error, info, warn};
use uorb_core::broker_side::{
    FromBroker, Join, PROCESS_NAME_MAX_BYTES, PROTOCOL_VERSION, Refusal, Reply, Request, ToBroker,
    decode, decode_beginning, receive_packet,
};
use uorb_core::fail_point;

use super::nodes::refusal_of;
use super::streaming::Answer;
use super::{Broker, Event};
use crate::connection::{Connection, CutOff};
use crate::directory;
use crate::limits::{CONNECTIONS_MAX, PACKETS_A_TURN};
use crate::registry::Estate;
use crate::streams::Order;

impl Broker {
    pub(super) fn accept(&mut self) {
        // The streams' thread may have taken the descriptor that was given up
        // last. Another newcomer must not take it first: then nobody could be
        // turned away any more, and would wait.
        if self.reserve.is_none() {
            self.reserve = File::open("/dev/null").ok();
        }
        if self.reserve.is_none() {
            return self.stop_listening();
        }
        loop {
            let flags = SockFlag::SOCK_CLOEXEC | SockFlag::SOCK_NONBLOCK;
            let socket = match accept4(self.listener.as_raw_fd(), flags) {
                Ok(socket) => own(socket),
                Err(Errno::EINTR) => continue,
                Err(Errno::EAGAIN | Errno::ECONNABORTED) => return,
                Err(Errno::EMFILE) => {
                    // accept4 asks for a descriptor before it looks whether
                    // anybody connects, so this says nothing about the queue.
                    self.reserve = None;
                    let mut turned_away = 0;
                    while let Ok(socket) = accept4(self.listener.as_raw_fd(), flags) {
                        drop(own(socket));
                        turned_away += 1;
                    }
                    self.reserve = File::open("/dev/null").ok();
                    if turned_away > 0 {
                        warn!(
                            "turned {turned_away} processes away: there are no descriptors left \
                             (ulimit -n)"
                        );
                    }
                    return;
                }
                Err(errno) => {
                    error!("cannot accept a connection: {errno}; trying again in a second");
                    return self.stop_listening();
                }
            };
            if self.connections.len() >= CONNECTIONS_MAX {
                warn!("refused a connection: there are {CONNECTIONS_MAX} already");
                continue;
            }
            let Some(connection) = Connection::new(socket) else {
                warn!("refused a connection: it is another user's");
                continue;
            };
            self.last_connection = self.last_connection.wrapping_add(1);
            let number = self.last_connection;
            fail_point!("broker.accepted");
            let token = Event::Connection(number).to_token();
            let event = EpollEvent::new(EpollFlags::EPOLLIN, token);
            match self.epoll.add(&connection, event) {
                Ok(()) => _ = self.connections.insert(number, connection),
                Err(errno) => error!("cannot watch a connection: {errno}"),
            }
        }
    }

    /// Until the doubt timer: an error that stays would wake us for ever.
    fn stop_listening(&mut self) {
        let _ = self.epoll.delete(&self.listener);
        self.is_deaf = true;
        self.arm_doubt();
    }

    /// Takes what a connection has sent, and sends what waits for it.
    pub(super) fn serve(&mut self, number: u32) {
        for _ in 0..PACKETS_A_TURN {
            let Some(connection) = self.connections.get_mut(&number) else { return };
            if let Err(cut_off) = connection.flush() {
                return self.cut_off(number, &cut_off);
            }
            let packet = match receive_packet(connection.as_fd(), &mut self.buffer) {
                Ok([]) => return self.cut_off(number, &CutOff::HungUp),
                Ok(packet) => packet,
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => break,
                Err(error) => {
                    debug!("cannot read from pid {}: {error}", connection.pid);
                    return self.cut_off(number, &CutOff::HungUp);
                }
            };
            let Some(ToBroker { number: request_number, request }) = decode(packet) else {
                return self.cut_off_garbage(number);
            };
            if !self.answer(number, request_number, request) {
                return;
            }
        }
        self.watch_connection(number);
    }

    /// Answers one request. False: the connection is gone.
    fn answer(&mut self, number: u32, request_number: u32, request: Request) -> bool {
        let stops = request == Request::Stop;
        let reply = match self.grant(number, request) {
            Ok(Answer::Now(reply)) => reply,
            Ok(Answer::Later(key, reply)) => {
                self.wait_for_stream(key, (number, request_number, reply));
                return true;
            }
            Err(refusal) => {
                self.log_refusal(number, &refusal);
                Reply::Refused(refusal)
            }
        };
        let stops = stops && reply == Reply::Done;
        fail_point!("broker.granted");
        let sent = self.send(number, &FromBroker::Reply { number: request_number, reply });
        fail_point!("broker.answered");
        if stops {
            info!("stopped by {}", self.name_of(number));
            self.end();
        }
        sent && !stops
    }

    fn grant(&mut self, number: u32, request: Request) -> Result<Answer, Refusal> {
        let peer = self.connections.get(&number).and_then(|connection| connection.peer);
        let Some(peer) = peer else {
            return match request {
                Request::Join(join) => self.join(number, join).map(Answer::Now),
                other => Err(Refusal::OutOfOrder { what: format!("{other:?}") }),
            };
        };
        let reply = match request {
            Request::Join(_) => return Err(Refusal::OutOfOrder { what: "join".into() }),
            Request::Advertise(wanted) => return self.advertise(peer, wanted),
            Request::Subscribe(wanted) => return self.subscribe(peer, &wanted),
            Request::Rejoined => {
                let estate = self.registry.rejoined(peer);
                self.give_back(&estate)
            }
            Request::Unadvertise { handle } | Request::Unsubscribe { handle } => {
                let estate = self.registry.release(peer, handle);
                self.give_back(&estate)
            }
            Request::Following { handle } => {
                self.tell_of_follower(peer, handle);
                Reply::Done
            }
            Request::Port { handle, failure } => {
                self.note_port(peer, handle, failure);
                Reply::Done
            }
            Request::Status => Reply::Status(self.status()),
            Request::Peers => Reply::Peers(self.registry.peers()),
            Request::Users { topic, instance } => {
                Reply::Users(self.registry.users(&topic, instance))
            }
            Request::Stop => Reply::Done,
        };
        Ok(Answer::Now(reply))
    }

    /// A living process holds something no more.
    fn give_back(&mut self, estate: &Estate) -> Reply {
        for key in &estate.advertised {
            self.order(Order::Save(key.clone()));
        }
        estate.advertised.iter().chain(&estate.subscribed).for_each(|key| self.update_counts(key));
        Reply::Done
    }

    pub(super) fn join(&mut self, number: u32, join: Join) -> Result<Reply, Refusal> {
        if join.version != PROTOCOL_VERSION {
            return Err(Refusal::Version { broker: PROTOCOL_VERSION });
        }
        let Some(connection) = self.connections.get(&number) else {
            return Err(Refusal::OutOfOrder { what: "join".into() });
        };
        let (pid, pidfd) = (connection.pid, connection.pidfd());
        let name = printable(&join.name);
        let peer = match join.rejoin {
            None => {
                let peer = self.registry.join(pid, name.clone())?;
                if let Err(error) = directory::make_peer_file(&self.system, peer, &name) {
                    self.registry.bury(peer);
                    return Err(refusal_of(&error));
                }
                fail_point!("broker.peer_made");
                debug!("{name} (pid {pid}) joins as {peer}");
                peer
            }
            Some(rejoin) => {
                let peer = rejoin.peer;
                if rejoin.system_id != self.system_id || !self.registry.is_known(peer) {
                    return Err(Refusal::OtherSystem);
                }
                if !self.registry.rejoin(peer, pid, name.clone()) {
                    // Its old connection has not been seen to end yet.
                    return Err(Refusal::OutOfOrder { what: "re-join while connected".into() });
                }
                info!("{name} (pid {pid}) re-joins as {peer}");
                peer
            }
        };
        if let Some(pidfd) = pidfd {
            self.watch_process(peer, pidfd);
        }
        self.order(Order::Joined(peer, pid));
        self.connected.insert(peer, number);
        if let Some(connection) = self.connections.get_mut(&number) {
            connection.peer = Some(peer);
        }
        fail_point!("broker.welcoming");
        let (system_id, world) = (self.system_id, self.world.clone());
        Ok(Reply::Welcome { peer, system_id, world })
    }

    /// Sends to a connection. False: it is gone.
    pub(super) fn send(&mut self, number: u32, message: &FromBroker) -> bool {
        let Some(connection) = self.connections.get_mut(&number) else { return false };
        match connection.send(message) {
            Ok(()) => {
                if connection.is_waiting() {
                    self.watch_connection(number);
                }
                true
            }
            Err(cut_off) => {
                self.cut_off(number, &cut_off);
                false
            }
        }
    }

    /// Waits for the socket to take more exactly if there is more.
    fn watch_connection(&mut self, number: u32) {
        let Some(connection) = self.connections.get(&number) else { return };
        let mut flags = EpollFlags::EPOLLIN;
        flags.set(EpollFlags::EPOLLOUT, connection.is_waiting());
        let mut event = EpollEvent::new(flags, Event::Connection(number).to_token());
        let _ = self.epoll.modify(connection, &mut event);
    }

    /// Closes a connection that sent what is no request. One of another version
    /// is told so: a join begins alike in all of them.
    fn cut_off_garbage(&mut self, number: u32) {
        match decode_beginning(&self.buffer) {
            Some((request_number, 0, version)) if version != PROTOCOL_VERSION => {
                warn!("{} speaks protocol {version}, not {PROTOCOL_VERSION}", self.name_of(number));
                let reply = Reply::Refused(Refusal::Version { broker: PROTOCOL_VERSION });
                self.send(number, &FromBroker::Reply { number: request_number, reply });
            }
            _ => warn!("cut off {}: it sent what is no request", self.name_of(number)),
        }
        self.cut_off(number, &CutOff::HungUp);
    }

    /// Closes a connection. Its process may live: then what it holds stays until
    /// its death, for it may be in the middle of a publish.
    fn cut_off(&mut self, number: u32, why: &CutOff) {
        if *why == CutOff::DoesNotRead {
            warn!("cut off {}: it does not read", self.name_of(number));
        }
        let Some(connection) = self.connections.remove(&number) else { return };
        let Some(peer) = connection.peer else { return };
        self.connected.remove(&peer);
        self.registry.disconnect(peer);
        drop(connection);
        self.bury(peer);
    }

    pub(super) fn name_of(&self, number: u32) -> String {
        match self.connections.get(&number) {
            Some(Connection { peer: Some(peer), .. }) => self.registry.name_of(*peer),
            Some(Connection { pid, .. }) => format!("pid {pid}"),
            None => "a process".into(),
        }
    }

    fn log_refusal(&self, number: u32, refusal: &Refusal) {
        let name = self.name_of(number);
        match refusal {
            Refusal::LayoutMismatch(mismatch) => warn!("refused {name}: {mismatch}"),
            Refusal::Failed { .. } | Refusal::NoSpace { .. } => error!("refused {name}: {refusal}"),
            _ => warn!("refused {name}: {refusal}"),
        }
    }
}

/// A process's name as people are shown it.
fn printable(name: &str) -> String {
    let name = &name[..name.floor_char_boundary(PROCESS_NAME_MAX_BYTES)];
    name.chars().map(|letter| if letter.is_control() { '?' } else { letter }).collect()
}

#[allow(unsafe_code)]
fn own(socket: RawFd) -> OwnedFd {
    // SAFETY: accept4 has just made it, and nobody else knows its number.
    unsafe { OwnedFd::from_raw_fd(socket) }
}
