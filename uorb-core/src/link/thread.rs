//! The thread that keeps the connection up: it hears the broker, and finds the
//! next one.

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::sync::Arc;
use std::thread::{self, JoinHandle};

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::signal::{SigSet, SigmaskHow, pthread_sigmask};

use super::joining::{exchange, join};
use super::{Call, Link, RETRY_FROM, RETRY_TO, no_broker, unexpected};
use crate::error::Error;
use crate::protocol::{FromBroker, Refusal, Rejoin, Reply, Request, ToBroker, decode, encode};
use crate::transport::{connect_to_broker, receive_packet, send_packet};

/// How often the thread looks whether ports of publications that are gone are
/// still needed.
const LINGERING_LOOK_MS: u8 = 5;

impl Link {
    /// Listens to the broker, and finds the next one, until the session or the
    /// system is over.
    fn run(&self) {
        let mut buffer = Vec::new();
        while !self.has_ended() {
            if !self.listen(&mut buffer) || !self.find_broker(&mut buffer) {
                return;
            }
        }
    }

    /// Takes what the broker says until it is gone. False: the session is over.
    fn listen(&self, buffer: &mut Vec<u8>) -> bool {
        let Some(socket) = self.state().socket.clone() else { return true };
        loop {
            let mut ready = [
                PollFd::new(socket.as_fd(), PollFlags::POLLIN),
                PollFd::new(self.quit.as_fd(), PollFlags::POLLIN),
            ];
            // Whoever leaves a port here is answered by the broker, and so the
            // thread hears of it.
            let timeout = match self.has_lingering_ports() {
                true => PollTimeout::from(LINGERING_LOOK_MS),
                false => PollTimeout::NONE,
            };
            match poll(&mut ready, timeout) {
                Ok(0) | Err(Errno::EINTR) => continue,
                Err(_) => return false,
                Ok(_) => {}
            }
            if ready[1].any() == Some(true) {
                return false;
            }
            let message = match receive_packet(&socket, buffer) {
                Ok(packet) => decode(packet),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => continue,
                Err(_) => None,
            };
            match message {
                Some(message) => self.take(message),
                // Gone, or not a broker of ours.
                None => break,
            }
            if self.has_ended() {
                return false;
            }
        }
        let mut state = self.state();
        state.socket = None;
        state.is_silent = false;
        // Giving a handle back is done when the broker is gone: the next one is
        // not told of it.
        state.calls.retain(|_, call| {
            !matches!(call.request, Request::Unadvertise { .. } | Request::Unsubscribe { .. })
        });
        true
    }

    fn take(&self, message: FromBroker) {
        match message {
            FromBroker::Reply { number, reply } => {
                let mut state = self.state();
                state.is_silent = false;
                if let Some(Call { request, answer }) = state.calls.remove(&number) {
                    state.note(request, &reply);
                    let _ = answer.try_send(reply);
                }
            }
            FromBroker::Described { handle } => self.state().described(handle),
            // The broker has been told why, if it cannot be opened.
            FromBroker::Streamed { handle } => _ = self.open_port(handle),
            FromBroker::Ended => self.end(),
        }
    }

    /// Waits for a broker and joins it. False: the session is over.
    fn find_broker(&self, buffer: &mut Vec<u8>) -> bool {
        let mut pause = RETRY_FROM;
        loop {
            let is_over = match connect_to_broker(&self.system) {
                Ok(socket) => match self.rejoin(socket, buffer) {
                    Ok(()) => return true,
                    Err(Error::Refused(Refusal::OtherSystem | Refusal::Version { .. })) => true,
                    Err(Error::Ended { .. }) => true,
                    Err(_) => false,
                },
                // The lock goes last, and never while the system has a future.
                Err(_) => self.system.is_unlocked(),
            };
            if is_over {
                self.end();
                return false;
            }
            // The processes of a system lose their broker at the same instant;
            // each of them comes back at another.
            let jitter = pause.mul_f64(f64::from(self.peer % 64) / 128.0);
            let mut quit = [PollFd::new(self.quit.as_fd(), PollFlags::POLLIN)];
            let timeout = PollTimeout::try_from(pause + jitter).unwrap_or(PollTimeout::MAX);
            match poll(&mut quit, timeout) {
                Ok(0) | Err(Errno::EINTR) => pause = (pause * 2).min(RETRY_TO),
                _ => return false,
            }
        }
    }

    /// Joins under the old number, names again what the process holds, and asks
    /// again what was not answered.
    fn rejoin(&self, socket: OwnedFd, buffer: &mut Vec<u8>) -> Result<(), Error> {
        fail_point!("rejoin.connected");
        let rejoin = Rejoin { peer: self.peer, system_id: self.system_id };
        match join(&self.system, &socket, Some(rejoin))? {
            Reply::Welcome { peer, system_id, .. }
                if peer == self.peer && system_id == self.system_id => {}
            reply => return Err(unexpected(reply)),
        }
        fail_point!("rejoin.welcome");
        let mut streamed = Vec::new();
        let mut state = self.state();
        // The socket's buffers hold some hundred packets each way, and a process
        // may hold ten thousand handles: take each answer before the next
        // request. What is refused now was granted once; the handle goes on
        // with the node it has mapped.
        let held: Vec<(u32, Request)> =
            state.held.iter().map(|(handle, request)| (*handle, request.clone())).collect();
        for (handle, request) in held {
            let mut hear = |word| state.hear(word, &mut streamed);
            let reply = exchange(&self.system, &socket, request, buffer, &mut hear)?;
            fail_point!("rejoin.named");
            match reply {
                Reply::Subscribed | Reply::Streaming { .. } => state.described(handle),
                Reply::Advertised(_) | Reply::Waiting | Reply::Refused(_) => {}
                reply => return Err(unexpected(reply)),
            }
        }
        let mut hear = |word| state.hear(word, &mut streamed);
        exchange(&self.system, &socket, Request::Rejoined, buffer, &mut hear)?;
        fail_point!("rejoin.confirmed");
        for (number, call) in &state.calls {
            let request = call.request.clone();
            send_packet(&socket, &encode(&ToBroker { number: *number, request }))
                .map_err(|error| no_broker(&self.system, error))?;
        }
        state.socket = Some(Arc::new(socket));
        fail_point!("rejoin.asked_again");
        drop(state);
        for handle in streamed {
            let _ = self.open_port(handle);
        }
        Ok(())
    }
}

/// Starts the thread with all signals blocked: a program's handlers run on its
/// own threads.
pub(super) fn spawn_quiet(link: Arc<Link>) -> io::Result<JoinHandle<()>> {
    let mut before = SigSet::empty();
    pthread_sigmask(SigmaskHow::SIG_SETMASK, Some(&SigSet::all()), Some(&mut before))?;
    let thread = thread::Builder::new().name("uorb-session".into()).spawn(move || link.run());
    pthread_sigmask(SigmaskHow::SIG_SETMASK, Some(&before), None)?;
    thread
}
