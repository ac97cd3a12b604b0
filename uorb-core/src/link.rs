//! The connection to the broker, and the thread that keeps it up.
//!
//! The thread sleeps on the socket and hands each answer to whoever waits for
//! it. When the broker dies it waits for the next one, joins it under the same
//! peer number, names again what the process holds, and asks again what was not
//! answered: every request can be asked twice with the same result. Handles
//! outlive brokers without noticing.
//!
//! The process proves that it lives by holding a record lock on its own file,
//! `peers/<number>`, opened once: the kernel drops the lock at its death, and
//! no forked child keeps it up.

#![allow(unsafe_code)]

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, Once, OnceLock, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::eventfd::{EfdFlags, EventFd};
use nix::sys::signal::{SigSet, SigmaskHow, pthread_sigmask};

use crate::error::Error;
use crate::protocol::{
    FromBroker, Join, PROCESS_NAME_MAX_BYTES, PROTOCOL_VERSION, Refusal, Rejoin, Reply, Request,
    ToBroker, decode, encode,
};
use crate::system::System;
use crate::transport::{connect_to_broker, receive_packet, send_packet};

/// How long a request waits for its answer, a restart of the broker included.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// The pauses between two attempts to find a new broker: from, to.
const RETRY_FROM: Duration = Duration::from_millis(10);
const RETRY_TO: Duration = Duration::from_millis(200);

/// How often this process is the child of a fork, counted by a handler that
/// fork(2) runs in the child.
static FORKS: AtomicU32 = AtomicU32::new(0);

extern "C" fn count_fork() {
    FORKS.fetch_add(1, Ordering::Relaxed);
}

#[derive(Debug)]
pub(crate) struct Link {
    /// Held locked for as long as the process lives. First, so that it is
    /// closed before the socket: the broker takes a process that has hung up
    /// and let go of its file for gone.
    _life: File,
    pub(crate) system: System,
    pub(crate) peer: u16,
    pub(crate) system_id: u64,
    /// [`FORKS`] when the link was made.
    forks: u32,
    ended: AtomicBool,
    /// Written when the session is over.
    quit: EventFd,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    /// None while there is no broker.
    socket: Option<OwnedFd>,
    next_number: u32,
    next_handle: u32,
    /// Requests that wait for an answer, by number.
    calls: BTreeMap<u32, Call>,
    /// What the process holds: the request that gets it again, by handle.
    held: BTreeMap<u32, Request>,
    /// Subscriptions that wait for a topic to be described, by handle.
    waiting: HashMap<u32, Arc<Waiting>>,
}

#[derive(Debug)]
struct Call {
    packet: Vec<u8>,
    answer: SyncSender<Reply>,
    /// Whether the next broker is to be asked again. Giving a handle back is
    /// done when the broker is gone: the next one is not told of it.
    again: bool,
}

/// A subscription by name to a topic that nobody has described yet. Its event
/// descriptor becomes readable when somebody has, or when the system ends.
#[derive(Debug)]
pub(crate) struct Waiting {
    pub(crate) event: EventFd,
    described: OnceLock<()>,
}

impl Waiting {
    pub(crate) fn new() -> Result<Arc<Self>, Error> {
        let event = EventFd::from_flags(EfdFlags::EFD_CLOEXEC | EfdFlags::EFD_NONBLOCK)
            .map_err(|errno| Error::io("make", "an event descriptor".as_ref(), errno.into()))?;
        Ok(Arc::new(Self { event, described: OnceLock::new() }))
    }

    pub(crate) fn is_over(&self) -> bool {
        self.described.get().is_some()
    }

    fn end(&self) {
        let _ = self.described.set(());
        self.wake();
    }

    fn wake(&self) {
        let _ = self.event.write(1);
    }
}

impl Link {
    /// Joins a system, and starts the thread.
    pub(crate) fn connect(system: &System) -> Result<(Arc<Self>, JoinHandle<()>), Error> {
        static COUNT_FORKS: Once = Once::new();
        COUNT_FORKS.call_once(|| {
            // SAFETY: the handler does one atomic addition, which is allowed in
            // the child of a fork, and it is never unloaded.
            unsafe { libc::pthread_atfork(None, None, Some(count_fork)) };
        });

        let path = system.socket();
        let socket = connect_to_broker(system).map_err(|error| no_broker(system, error))?;
        let (peer, system_id) = match join(system, &socket, None)? {
            Reply::Welcome { peer, system_id } => (peer, system_id),
            reply => return Err(unexpected(reply)),
        };
        let quit = EventFd::from_flags(EfdFlags::EFD_CLOEXEC)
            .map_err(|errno| Error::io("make an event for", &path, errno.into()))?;
        let link = Arc::new(Self {
            _life: lock_life(system, peer)?,
            system: system.clone(),
            peer,
            system_id,
            forks: FORKS.load(Ordering::Relaxed),
            ended: AtomicBool::new(false),
            quit,
            state: Mutex::new(State { socket: Some(socket), ..State::default() }),
        });
        let thread = spawn_quiet(link.clone())
            .map_err(|error| Error::io("start a thread for", &path, error))?;
        Ok((link, thread))
    }

    /// Ends the thread.
    pub(crate) fn quit(&self) {
        let _ = self.quit.write(1);
    }

    /// Whether this process is a child of the one that made the link.
    #[inline]
    pub(crate) fn is_forked(&self) -> bool {
        FORKS.load(Ordering::Relaxed) != self.forks
    }

    #[inline]
    pub(crate) fn has_ended(&self) -> bool {
        self.ended.load(Ordering::Relaxed)
    }

    /// Fails in the child of a fork, and when the system has ended.
    #[inline]
    pub(crate) fn check(&self) -> Result<(), Error> {
        if self.is_forked() || self.has_ended() { Err(self.unusable()) } else { Ok(()) }
    }

    #[cold]
    pub(crate) fn unusable(&self) -> Error {
        if self.is_forked() { Error::Forked } else { Error::Ended { path: self.system.dir() } }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    // What the process holds.

    /// A number that nothing else of this process has.
    pub(crate) fn new_handle(&self) -> u32 {
        let mut state = self.state();
        state.next_handle += 1;
        state.next_handle
    }

    /// Notes by which request a handle is got again.
    pub(crate) fn hold(&self, handle: u32, request: Request) {
        self.state().held.insert(handle, request);
    }

    /// Notes that a subscription waits for its topic. Before the request: the
    /// broker may say that the topic is there in one breath with its answer.
    pub(crate) fn wait(&self, handle: u32, waiting: Arc<Waiting>) {
        self.state().waiting.insert(handle, waiting);
    }

    /// Notes that a subscription does not wait any more.
    pub(crate) fn stop_waiting(&self, handle: u32) {
        self.state().waiting.remove(&handle);
    }

    /// Gives a handle back. While there is no broker it is enough not to name
    /// it again to the next one.
    pub(crate) fn forget(&self, handle: u32, request: Request) {
        let connected = {
            let mut state = self.state();
            state.held.remove(&handle);
            state.waiting.remove(&handle);
            state.socket.is_some()
        };
        if connected && self.check().is_ok() {
            let _ = self.ask(request);
        }
    }

    // Requests.

    /// Asks the broker, now or when there is one again, and waits for the
    /// answer.
    pub(crate) fn ask(&self, request: Request) -> Result<Reply, Error> {
        self.check()?;
        let again = !matches!(request, Request::Unadvertise { .. } | Request::Unsubscribe { .. });
        let (sender, answer) = sync_channel(1);
        let mut state = self.state();
        state.next_number = state.next_number.wrapping_add(1);
        let number = state.next_number;
        let packet = encode(&ToBroker { number, request });
        if let Some(socket) = &state.socket {
            // That it fails means that the broker is gone. The thread notices
            // too, and sends all calls again to the next one.
            let _ = send_packet(socket, &packet);
        }
        state.calls.insert(number, Call { packet, answer: sender, again });
        drop(state);

        let reply = answer.recv_timeout(ANSWER_TIMEOUT);
        let mut state = self.state();
        state.calls.remove(&number);
        match reply {
            Ok(Reply::Refused(refusal)) => Err(refusal.into()),
            Ok(reply) => Ok(reply),
            Err(_) if self.has_ended() => Err(self.unusable()),
            Err(RecvTimeoutError::Timeout) if state.socket.is_some() => Err(Error::NoAnswer {
                path: self.system.socket(),
                seconds: ANSWER_TIMEOUT.as_secs(),
            }),
            Err(_) => Err(Error::NoBroker { path: self.system.socket() }),
        }
    }

    // The thread.

    /// The system is over: all that waits is told so.
    pub(crate) fn end(&self) {
        self.ended.store(true, Ordering::Relaxed);
        let mut state = self.state();
        state.socket = None;
        // Dropping the senders wakes the callers.
        state.calls.clear();
        state.waiting.values().for_each(|waiting| waiting.wake());
    }

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
        let socket = match &self.state().socket {
            Some(socket) => socket.try_clone(),
            None => return true,
        };
        let Ok(socket) = socket else { return true };
        loop {
            let mut ready = [
                PollFd::new(socket.as_fd(), PollFlags::POLLIN),
                PollFd::new(self.quit.as_fd(), PollFlags::POLLIN),
            ];
            match poll(&mut ready, PollTimeout::NONE) {
                Err(Errno::EINTR) => continue,
                Err(_) => return false,
                Ok(_) => {}
            }
            if ready[1].any() == Some(true) {
                return false;
            }
            let message = match receive_packet(&socket, buffer) {
                Ok(packet) if !packet.is_empty() => decode(packet),
                _ => None,
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
        state.calls.retain(|_, call| call.again);
        true
    }

    fn take(&self, message: FromBroker) {
        match message {
            FromBroker::Reply { number, reply } => {
                if let Some(call) = self.state().calls.remove(&number) {
                    let _ = call.answer.try_send(reply);
                }
            }
            FromBroker::Described { handle } => {
                if let Some(waiting) = self.state().waiting.remove(&handle) {
                    waiting.end();
                }
            }
            FromBroker::Ended => self.end(),
        }
    }

    /// Waits for a broker and joins it. False: the session is over.
    fn find_broker(&self, buffer: &mut Vec<u8>) -> bool {
        let mut pause = RETRY_FROM;
        loop {
            if let Ok(socket) = connect_to_broker(&self.system) {
                match self.rejoin(socket, buffer) {
                    Ok(()) => return true,
                    Err(Error::Refused(Refusal::OtherSystem | Refusal::Version { .. })) => {
                        self.end();
                        return false;
                    }
                    Err(_) => {}
                }
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
        let rejoin = Rejoin { peer: self.peer, system_id: self.system_id };
        match join(&self.system, &socket, Some(rejoin))? {
            Reply::Welcome { peer, system_id }
                if peer == self.peer && system_id == self.system_id => {}
            reply => return Err(unexpected(reply)),
        }
        let mut state = self.state();
        // The socket's buffers hold some hundred packets each way, and a process
        // may hold ten thousand handles: take each answer before the next
        // request. What is refused now was granted once; the handle goes on
        // with the node it has mapped.
        let held: Vec<(u32, Request)> =
            state.held.iter().map(|(handle, request)| (*handle, request.clone())).collect();
        for (handle, request) in held {
            match exchange(&self.system, &socket, request, buffer)? {
                Reply::Subscribed => {
                    if let Some(waiting) = state.waiting.remove(&handle) {
                        waiting.end();
                    }
                }
                Reply::Advertised(_) | Reply::Waiting | Reply::Refused(_) => {}
                reply => return Err(unexpected(reply)),
            }
        }
        exchange(&self.system, &socket, Request::Rejoined, buffer)?;
        for call in state.calls.values() {
            send_packet(&socket, &call.packet).map_err(|error| no_broker(&self.system, error))?;
        }
        state.socket = Some(socket);
        Ok(())
    }
}

/// One request and its answer on a connection that nobody else uses yet. The
/// broker may speak by itself between the two.
fn exchange(
    system: &System,
    socket: &OwnedFd,
    request: Request,
    buffer: &mut Vec<u8>,
) -> Result<Reply, Error> {
    let path = system.socket();
    // A broker that was killed meanwhile is none.
    send_packet(socket, &encode(&ToBroker { number: 0, request }))
        .map_err(|error| no_broker(system, error))?;
    let seconds = ANSWER_TIMEOUT.as_secs();
    loop {
        let mut ready = [PollFd::new(socket.as_fd(), PollFlags::POLLIN)];
        let timeout = PollTimeout::try_from(ANSWER_TIMEOUT).unwrap_or(PollTimeout::MAX);
        match poll(&mut ready, timeout) {
            Ok(0) => return Err(Error::NoAnswer { path, seconds }),
            Err(Errno::EINTR) => continue,
            _ => {}
        }
        let packet = receive_packet(socket, buffer).map_err(|error| no_broker(system, error))?;
        match decode(packet) {
            Some(FromBroker::Reply { reply, .. }) => return Ok(reply),
            Some(FromBroker::Ended) => return Err(Refusal::OtherSystem.into()),
            Some(FromBroker::Described { .. }) => {}
            None => return Err(Error::NoBroker { path }),
        }
    }
}

fn join(system: &System, socket: &OwnedFd, rejoin: Option<Rejoin>) -> Result<Reply, Error> {
    let request = Request::Join(Join { version: PROTOCOL_VERSION, name: process_name(), rejoin });
    match exchange(system, socket, request, &mut Vec::new())? {
        Reply::Refused(refusal) => Err(refusal.into()),
        reply => Ok(reply),
    }
}

/// The name that `uorb info` shows: that of the program file.
fn process_name() -> String {
    let path = std::env::args_os().next().unwrap_or_default();
    let name = std::path::Path::new(&path).file_name().unwrap_or_default().to_string_lossy();
    let mut name = if name.is_empty() { "?".into() } else { name.into_owned() };
    let end = name.floor_char_boundary(PROCESS_NAME_MAX_BYTES);
    name.truncate(end);
    name
}

/// Opens the process's own file and locks it for as long as it lives.
fn lock_life(system: &System, peer: u16) -> Result<File, Error> {
    let path = system.peer(peer);
    let file = File::options()
        .read(true)
        .write(true)
        .custom_flags(libc::O_CLOEXEC | libc::O_NOFOLLOW)
        .open(&path)
        .map_err(|error| Error::io("open", &path, error))?;
    // A record lock, not flock or an open file description's: those outlive
    // the process in a forked child.
    let lock = libc::flock {
        l_type: libc::F_WRLCK as libc::c_short,
        l_whence: libc::SEEK_SET as libc::c_short,
        l_start: 0,
        l_len: 0,
        l_pid: 0,
    };
    nix::fcntl::fcntl(&file, nix::fcntl::FcntlArg::F_SETLK(&lock))
        .map_err(|errno| Error::io("lock", &path, errno.into()))?;
    Ok(file)
}

/// Starts the thread with all signals blocked: a program's handlers run on its
/// own threads.
fn spawn_quiet(link: Arc<Link>) -> io::Result<JoinHandle<()>> {
    let mut before = SigSet::empty();
    pthread_sigmask(SigmaskHow::SIG_SETMASK, Some(&SigSet::all()), Some(&mut before))?;
    let thread = thread::Builder::new().name("uorb-session".into()).spawn(move || link.run());
    pthread_sigmask(SigmaskHow::SIG_SETMASK, Some(&before), None)?;
    thread
}

fn no_broker(system: &System, error: io::Error) -> Error {
    let path = system.socket();
    match error.kind() {
        io::ErrorKind::NotFound
        | io::ErrorKind::ConnectionRefused
        | io::ErrorKind::ConnectionReset
        | io::ErrorKind::BrokenPipe => Error::NoBroker { path },
        _ => Error::io("speak to", &path, error),
    }
}

/// An answer that does not belong to its request.
pub(crate) fn unexpected(reply: Reply) -> Error {
    match reply {
        Reply::Refused(refusal) => refusal.into(),
        reply => Refusal::OutOfOrder { what: format!("{reply:?}") }.into(),
    }
}
