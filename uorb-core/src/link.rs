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

mod ports;

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, Once, OnceLock, PoisonError, Weak};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::eventfd::{EfdFlags, EventFd};
use nix::sys::signal::{SigSet, SigmaskHow, pthread_sigmask};
use nix::sys::socket::{Shutdown, getsockopt, shutdown, sockopt};
use nix::unistd::geteuid;

use crate::error::Error;
use crate::node::{Node, Role};
use crate::node_file::DESCRIPTION_MAX_BYTES;
use crate::protocol::{
    Advertise, Claim, FromBroker, Join, PROCESS_NAME_MAX_BYTES, PROTOCOL_VERSION, Refusal, Rejoin,
    Reply, Request, Subscribe, ToBroker, Wish, decode, encode,
};
use crate::stream::port::Streamable;
use crate::stream::{Member, World};
use crate::system::System;
use crate::topic::Instance;
use crate::transport::{connect_to_broker, receive_packet, send_packet};

/// How long a request waits for its answer, a restart of the broker included.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// The pauses between two attempts to find a new broker: from, to.
const RETRY_FROM: Duration = Duration::from_millis(10);
const RETRY_TO: Duration = Duration::from_millis(200);

/// The number of requests whose answer nobody looks up.
const NO_NUMBER: u32 = 0;

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
    /// Where the system's streams are, and this process as a member of it, once
    /// it has a stream.
    world: World,
    member: Mutex<Option<Arc<Member>>>,
    /// Publications, whose ports are opened when somebody follows the stream.
    streamables: Mutex<HashMap<u32, Streamable>>,
    /// [`FORKS`] when the link was made.
    forks: u32,
    ended: AtomicBool,
    /// Written when the session is over.
    quit: EventFd,
    state: Mutex<State>,
    /// Nodes that are mapped, so that 10,000 subscriptions map one once.
    pub(crate) nodes: Mutex<HashMap<NodeKey, Weak<Node>>>,
}

pub(crate) type NodeKey = (String, Instance, Role);

#[derive(Debug, Default)]
struct State {
    /// None while there is no broker.
    socket: Option<Arc<OwnedFd>>,
    /// Whether the broker has let a request wait too long and said nothing
    /// since: it is stopped, and nobody waits for it again.
    is_silent: bool,
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
    request: Request,
    answer: SyncSender<Reply>,
}

impl State {
    /// Notes what a granted request has got, so that it is got again from the
    /// next broker. In one step with taking the answer: a re-join in between
    /// would not name it.
    fn note(&mut self, request: Request, reply: &Reply) {
        match (request, reply) {
            (Request::Advertise(advertise), Reply::Advertised(instance)) => {
                // From now on it is this instance, whatever was asked for.
                let claim = Claim::Shared(*instance);
                let handle = advertise.handle;
                self.held.insert(handle, Request::Advertise(Advertise { claim, ..advertise }));
            }
            (Request::Subscribe(subscribe), Reply::Subscribed) => {
                self.waiting.remove(&subscribe.handle);
                self.held.insert(subscribe.handle, Request::Subscribe(subscribe));
            }
            (Request::Subscribe(subscribe), Reply::Streaming { place }) => {
                // From now on it is this place, whoever grants it.
                let stream = subscribe.stream.map(|wish| Wish { place: Some(*place), ..wish });
                let handle = subscribe.handle;
                self.held.insert(handle, Request::Subscribe(Subscribe { stream, ..subscribe }));
            }
            (Request::Subscribe(subscribe), Reply::Waiting) => {
                self.held.insert(subscribe.handle, Request::Subscribe(subscribe));
            }
            _ => {}
        }
    }

    /// What the broker says by itself while the process re-joins.
    fn hear(&mut self, word: FromBroker, streamed: &mut Vec<u32>) {
        match word {
            FromBroker::Described { handle } => self.described(handle),
            FromBroker::Streamed { handle } => streamed.push(handle),
            FromBroker::Reply { .. } | FromBroker::Ended => {}
        }
    }

    /// A topic that a subscription waits for is described.
    fn described(&mut self, handle: u32) {
        if let Some(waiting) = self.waiting.remove(&handle) {
            let _ = waiting.described.set(());
            waiting.wake();
        }
    }
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
        let socket = connect_patiently(system)?;
        // Whoever ends a system removes its socket before anybody else hears of it.
        let ended = |error| match system.is_removed() {
            true if is_loss(&error) => Error::Ended { path: system.dir() },
            _ => error,
        };
        let (peer, system_id, world) = match join(system, &socket, None).map_err(ended)? {
            Reply::Welcome { peer, system_id, world } => (peer, system_id, world),
            reply => return Err(unexpected(reply)),
        };
        let life = lock_life(system, peer).map_err(ended)?;
        let quit = EventFd::from_flags(EfdFlags::EFD_CLOEXEC)
            .map_err(|errno| Error::io("make an event for", &path, errno.into()))?;
        let link = Arc::new(Self {
            _life: life,
            system: system.clone(),
            peer,
            system_id,
            world,
            member: Mutex::default(),
            streamables: Mutex::default(),
            forks: FORKS.load(Ordering::Relaxed),
            ended: AtomicBool::new(false),
            quit,
            state: Mutex::new(State { socket: Some(Arc::new(socket)), ..State::default() }),
            nodes: Mutex::default(),
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

    /// The error of using what the broker has granted. A file that is gone went
    /// with the system, as a rule, and we may not have heard that yet: the broker
    /// says it before it removes anything, so one more word with it tells.
    #[cold]
    pub(crate) fn explain(&self, error: Error) -> Error {
        if !is_loss(&error) {
            return error;
        }
        match self.ask(Request::Status) {
            Err(ended @ Error::Ended { .. }) => ended,
            _ if self.system.is_removed() => {
                self.end();
                self.unusable()
            }
            _ => error,
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    // What the process holds.

    /// A number that nothing else of this process has.
    pub(crate) fn new_handle(&self) -> u32 {
        let mut state = self.state();
        state.next_handle = state.next_handle.wrapping_add(1);
        state.next_handle
    }

    /// Notes that a subscription waits for its topic. Before the request: the
    /// broker may say that the topic is there in one breath with its answer.
    pub(crate) fn wait(&self, handle: u32, waiting: Arc<Waiting>) {
        self.state().waiting.insert(handle, waiting);
    }

    /// Gives a handle back, and waits until the broker has noted it. While there
    /// is no broker it is enough not to name it again to the next one.
    pub(crate) fn forget(&self, handle: u32, request: Request) {
        // In the child of a fork it is the parent's, and a thread of the parent
        // may have held the lock at the fork.
        if self.is_forked() {
            return;
        }
        let waits = {
            let mut state = self.state();
            state.held.remove(&handle);
            state.waiting.remove(&handle);
            state.socket.is_some() && !state.is_silent && !self.has_ended()
        };
        if !waits || self.ask(request.clone()).is_err() {
            self.tell(request);
        }
    }

    /// Gives back what a failed request may have got, without waiting.
    pub(crate) fn take_back(&self, handle: u32, request: Request) {
        if self.is_forked() {
            return;
        }
        let mut state = self.state();
        state.held.remove(&handle);
        state.waiting.remove(&handle);
        drop(state);
        self.tell(request);
    }

    // Requests.

    /// Asks the broker, now or when there is one again, and waits for the
    /// answer.
    pub(crate) fn ask(&self, request: Request) -> Result<Reply, Error> {
        self.check()?;
        let (number, answer) = self.call(request)?;
        let reply = answer.recv_timeout(ANSWER_TIMEOUT);
        let mut state = self.state();
        state.calls.remove(&number);
        match reply {
            Ok(Reply::Refused(refusal)) => Err(refusal.into()),
            Ok(reply) => Ok(reply),
            Err(_) if self.has_ended() => Err(self.unusable()),
            Err(RecvTimeoutError::Timeout) if state.socket.is_some() => {
                state.is_silent = true;
                Err(self.no_answer())
            }
            Err(_) => Err(Error::NoBroker { path: self.system.socket() }),
        }
    }

    /// Sends a request, and notes it for the next broker.
    fn call(&self, request: Request) -> Result<(u32, Receiver<Reply>), Error> {
        let (sender, answer) = sync_channel(1);
        let mut state = self.state();
        if self.has_ended() {
            return Err(self.unusable());
        }
        state.next_number = state.next_number.wrapping_add(1);
        let number = state.next_number;
        let packet = encode(&ToBroker { number, request: request.clone() });
        check_size(&request, packet.len())?;
        if let Some(socket) = &state.socket {
            match send_packet(socket, &packet) {
                // A broker that reads nothing any more is stopped.
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    state.is_silent = true;
                    return Err(self.no_answer());
                }
                // The broker is gone. The thread notices too, and sends all
                // calls again to the next one.
                _ => {}
            }
        }
        state.calls.insert(number, Call { request, answer: sender });
        Ok((number, answer))
    }

    /// Tells the broker something whose answer does not matter. If it cannot be
    /// told, the connection is given up: re-joining tells it the same.
    pub(crate) fn tell(&self, request: Request) {
        if self.check().is_err() {
            return;
        }
        let state = self.state();
        if let Some(socket) = &state.socket {
            let packet = encode(&ToBroker { number: NO_NUMBER, request });
            if send_packet(socket, &packet).is_err() {
                let _ = shutdown(socket.as_raw_fd(), Shutdown::Both);
            }
        }
    }

    #[cold]
    fn no_answer(&self) -> Error {
        no_answer(&self.system)
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
        drop(state);
        // Whoever sleeps on a node: the bells may have lost their paths, so no
        // broker can ring them.
        let nodes = self.nodes.lock().unwrap_or_else(PoisonError::into_inner);
        nodes.values().filter_map(Weak::upgrade).for_each(|node| node.ring_own_bells());
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
        let Some(socket) = self.state().socket.clone() else { return true };
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
        let rejoin = Rejoin { peer: self.peer, system_id: self.system_id };
        match join(&self.system, &socket, Some(rejoin))? {
            Reply::Welcome { peer, system_id, .. }
                if peer == self.peer && system_id == self.system_id => {}
            reply => return Err(unexpected(reply)),
        }
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
            match reply {
                Reply::Subscribed | Reply::Streaming { .. } => state.described(handle),
                Reply::Advertised(_) | Reply::Waiting | Reply::Refused(_) => {}
                reply => return Err(unexpected(reply)),
            }
        }
        let mut hear = |word| state.hear(word, &mut streamed);
        exchange(&self.system, &socket, Request::Rejoined, buffer, &mut hear)?;
        for (number, call) in &state.calls {
            let request = call.request.clone();
            send_packet(&socket, &encode(&ToBroker { number: *number, request }))
                .map_err(|error| no_broker(&self.system, error))?;
        }
        state.socket = Some(Arc::new(socket));
        drop(state);
        for handle in streamed {
            let _ = self.open_port(handle);
        }
        Ok(())
    }
}

/// Connects; while the broker has more to accept than it can keep in line, as
/// when a hundred processes start at once, again.
fn connect_patiently(system: &System) -> Result<OwnedFd, Error> {
    let deadline = Instant::now() + ANSWER_TIMEOUT;
    loop {
        match connect_to_broker(system) {
            Ok(socket) => return refuse_other_users(system, socket),
            Err(error) if error.kind() != io::ErrorKind::WouldBlock => {
                return Err(no_broker(system, error));
            }
            Err(_) if Instant::now() >= deadline => return Err(no_answer(system)),
            // Nothing tells when there is room in its line.
            Err(_) => thread::sleep(RETRY_FROM),
        }
    }
}

/// A broker takes processes of its own user and of root. The others are told why
/// here: it just hangs up on them.
fn refuse_other_users(system: &System, socket: OwnedFd) -> Result<OwnedFd, Error> {
    let path = system.socket();
    let us = geteuid();
    let owner = getsockopt(&socket, sockopt::PeerCredentials)
        .map_err(|errno| Error::io("look at", &path, errno.into()))?
        .uid();
    if owner == us.as_raw() || us.is_root() {
        return Ok(socket);
    }
    Err(Error::OtherUser { path, owner, us: us.as_raw() })
}

/// One request and its answer on a connection that nobody else uses yet. The
/// broker may speak by itself between the two.
fn exchange(
    system: &System,
    socket: &OwnedFd,
    request: Request,
    buffer: &mut Vec<u8>,
    hear: &mut dyn FnMut(FromBroker),
) -> Result<Reply, Error> {
    // A broker that was killed meanwhile is none.
    send_packet(socket, &encode(&ToBroker { number: NO_NUMBER, request }))
        .map_err(|error| no_broker(system, error))?;
    loop {
        let mut ready = [PollFd::new(socket.as_fd(), PollFlags::POLLIN)];
        let timeout = PollTimeout::try_from(ANSWER_TIMEOUT).unwrap_or(PollTimeout::MAX);
        match poll(&mut ready, timeout) {
            Ok(0) => return Err(no_answer(system)),
            Err(Errno::EINTR) => continue,
            _ => {}
        }
        let packet = match receive_packet(socket, buffer) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => continue,
            packet => packet.map_err(|error| no_broker(system, error))?,
        };
        match decode(packet) {
            Some(FromBroker::Reply { reply, .. }) => return Ok(reply),
            Some(FromBroker::Ended) => return Err(Error::Ended { path: system.dir() }),
            Some(word) => hear(word),
            None => return Err(system.no_broker()),
        }
    }
}

fn join(system: &System, socket: &OwnedFd, rejoin: Option<Rejoin>) -> Result<Reply, Error> {
    let request = Request::Join(Join { version: PROTOCOL_VERSION, name: process_name(), rejoin });
    match exchange(system, socket, request, &mut Vec::new(), &mut |_| {})? {
        Reply::Refused(refusal) => Err(refusal.into()),
        reply => Ok(reply),
    }
}

/// A description that no node file takes is refused here: the packet might not
/// even arrive.
fn check_size(request: &Request, size_bytes: usize) -> Result<(), Error> {
    let topic = match request {
        Request::Advertise(Advertise { metadata, .. }) => &*metadata.name,
        Request::Subscribe(Subscribe { subject, .. }) => subject.name(),
        _ => return Ok(()),
    };
    if size_bytes > DESCRIPTION_MAX_BYTES {
        return Err(Error::DescriptionTooLong { topic: topic.into(), size_bytes });
    }
    Ok(())
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
    fcntl(&file, FcntlArg::F_SETLK(&write_lock()))
        .map_err(|errno| Error::io("lock", &path, errno.into()))?;
    Ok(file)
}

fn write_lock() -> libc::flock {
    libc::flock {
        l_type: libc::F_WRLCK as libc::c_short,
        l_whence: libc::SEEK_SET as libc::c_short,
        l_start: 0,
        l_len: 0,
        l_pid: 0,
    }
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

#[cold]
fn no_answer(system: &System) -> Error {
    Error::NoAnswer { path: system.socket(), seconds: ANSWER_TIMEOUT.as_secs() }
}

#[cold]
fn no_broker(system: &System, error: io::Error) -> Error {
    match error.kind() {
        io::ErrorKind::NotFound
        | io::ErrorKind::ConnectionRefused
        | io::ErrorKind::ConnectionReset
        | io::ErrorKind::BrokenPipe => system.no_broker(),
        io::ErrorKind::WouldBlock => no_answer(system),
        _ => system.other_user().unwrap_or_else(|| Error::io("speak to", &system.socket(), error)),
    }
}

/// Whether an error says that something is gone which was there a moment ago:
/// the broker, or a file.
fn is_loss(error: &Error) -> bool {
    match error {
        Error::NoBroker { .. } | Error::NoNode { .. } => true,
        Error::Io { source, .. } => source.kind() == io::ErrorKind::NotFound,
        _ => false,
    }
}

/// An answer that does not belong to its request.
pub(crate) fn unexpected(reply: Reply) -> Error {
    match reply {
        Reply::Refused(refusal) => refusal.into(),
        reply => Refusal::OutOfOrder { what: format!("{reply:?}") }.into(),
    }
}
