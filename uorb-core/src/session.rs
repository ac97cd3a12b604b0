//! The broker, as a process sees it.
//!
//! A [`Session`] is a socket and one thread that sleeps on it. Advertising and
//! subscribing ask the broker and wait for its answer; publishing and copying
//! never come here. When the broker dies the thread waits for the next one,
//! joins it under the same peer number and names again whatever the process
//! holds, so that handles outlive brokers without noticing.
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
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, Once, OnceLock, PoisonError, Weak};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::eventfd::{EfdFlags, EventFd};
use nix::sys::signal::{SigSet, SigmaskHow, pthread_sigmask};

use crate::error::Error;
use crate::node::{Node, Role};
use crate::protocol::{
    Advertise, Claim, FromBroker, Join, PROCESS_NAME_MAX_BYTES, PROTOCOL_VERSION, PeerInfo,
    Refusal, Rejoin, Reply, Request, Subject, Subscribe, ToBroker, decode, encode,
};
use crate::system::System;
use crate::topic::{Instance, Metadata};
use crate::transport::{connect_to_broker, receive_packet, send_packet};

/// How long a request waits for its answer, a restart of the broker included.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// The pauses between two attempts to find a new broker: from, to.
const RETRY_FROM: Duration = Duration::from_millis(10);
const RETRY_TO: Duration = Duration::from_millis(200);

/// How often this process is the child of a fork, counted from a handler that
/// fork(2) runs in the child.
static FORKS: AtomicU32 = AtomicU32::new(0);

extern "C" fn count_fork() {
    FORKS.fetch_add(1, Ordering::Relaxed);
}

/// A process's connection to the broker of one system. Clones are the same
/// session; it ends with the last of them and of its handles.
#[derive(Clone, Debug)]
pub struct Session {
    owner: Arc<Owner>,
}

/// Ends the thread when the last clone is dropped.
#[derive(Debug)]
struct Owner {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    /// Held locked for as long as the process lives. First, so that it is
    /// closed before the socket: the broker takes a process that has hung up
    /// and let go of its file for gone.
    _life: File,
    system: System,
    peer: u16,
    system_id: u64,
    /// [`FORKS`] when the session was made.
    forks: u32,
    ended: AtomicBool,
    /// Written when the session is dropped.
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
    /// Nodes that are mapped, so that 10,000 subscriptions map one once.
    nodes: HashMap<(String, Instance, Role), Weak<Node>>,
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
    pub(crate) fn is_over(&self) -> bool {
        self.described.get().is_some()
    }

    fn wake(&self) {
        let _ = self.event.write(1);
    }
}

/// What a new subscription gets: the node, or a place to wait for it.
pub(crate) enum Followed {
    Node(Arc<Node>),
    Waiting(Arc<Waiting>),
}

impl Session {
    /// Joins the system that the environment names (see [`System::from_env`]).
    ///
    /// # Errors
    ///
    /// [`Error::NoBroker`] where none runs; [`Error::Refused`] where it is of
    /// another version.
    pub fn connect() -> Result<Self, Error> {
        Self::connect_to(&System::from_env()?)
    }

    /// Joins a system.
    ///
    /// # Errors
    ///
    /// As [`Session::connect`].
    pub fn connect_to(system: &System) -> Result<Self, Error> {
        static COUNT_FORKS: Once = Once::new();
        COUNT_FORKS.call_once(|| {
            // SAFETY: the handler does one atomic addition, which is allowed in
            // the child of a fork, and it is never unloaded.
            unsafe { libc::pthread_atfork(None, None, Some(count_fork)) };
        });

        let socket = connect_to_broker(system).map_err(|error| no_broker(system, error))?;
        let (peer, system_id) = match join(system, &socket, None)? {
            Reply::Welcome { peer, system_id } => (peer, system_id),
            reply => return Err(unexpected(reply)),
        };
        let life = lock_life(system, peer)?;
        let quit = EventFd::from_flags(EfdFlags::EFD_CLOEXEC)
            .map_err(|errno| Error::io("make an event for", &system.socket(), errno.into()))?;
        let shared = Arc::new(Shared {
            _life: life,
            system: system.clone(),
            peer,
            system_id,
            forks: FORKS.load(Ordering::Relaxed),
            ended: AtomicBool::new(false),
            quit,
            state: Mutex::new(State { socket: Some(socket), ..State::default() }),
        });
        let thread = spawn_quiet(shared.clone())
            .map_err(|error| Error::io("start a thread for", &system.socket(), error))?;
        Ok(Self { owner: Arc::new(Owner { shared, thread: Some(thread) }) })
    }

    fn shared(&self) -> &Shared {
        &self.owner.shared
    }

    /// The system it belongs to.
    pub fn system(&self) -> &System {
        &self.shared().system
    }

    /// The number under which the broker knows this process.
    pub fn peer(&self) -> u16 {
        self.shared().peer
    }

    /// Whether the system has ended. Handles then fail with [`Error::Ended`];
    /// what was published can still be copied.
    pub fn has_ended(&self) -> bool {
        self.shared().ended.load(Ordering::Relaxed)
    }

    /// Fails in the child of a fork, and when the system has ended.
    #[inline]
    pub(crate) fn check(&self) -> Result<(), Error> {
        let shared = self.shared();
        let forked = FORKS.load(Ordering::Relaxed) != shared.forks;
        if forked || shared.ended.load(Ordering::Relaxed) {
            return Err(shared.unusable(forked));
        }
        Ok(())
    }

    /// The error of a handle whose system has ended.
    #[cold]
    pub(crate) fn ended(&self) -> Error {
        self.shared().unusable(false)
    }

    /// Whether a topic's instance has a publisher.
    ///
    /// # Errors
    ///
    /// [`Error::CorruptNode`] and the like where the node cannot be read; that
    /// there is none is `false`.
    #[doc(alias = "orb_exists")]
    pub fn exists(&self, topic: &str, instance: Instance) -> Result<bool, Error> {
        match Node::open(self.system(), topic, instance, Role::Observer) {
            Ok(node) => Ok(node.publishers() > 0),
            Err(Error::NoNode { .. }) => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// How many instances a topic has, counted from 0 up to the first that does
    /// not exist. One that is only subscribed exists.
    #[doc(alias = "orb_group_count")]
    pub fn group_count(&self, topic: &str) -> usize {
        let exists = |instance: &Instance| self.system().node(topic, *instance).exists();
        Instance::all().take_while(exists).count()
    }

    /// Asks the broker something and waits for the answer.
    ///
    /// # Errors
    ///
    /// [`Error::NoBroker`] and [`Error::NoAnswer`] where none comes in time.
    #[doc(hidden)]
    pub fn ask(&self, request: Request) -> Result<Reply, Error> {
        self.check()?;
        let (number, answer) = self.shared().call(request);
        self.shared().wait_for(number, &answer)
    }

    /// Becomes a publisher. Returns the handle and the node, ready to publish.
    pub(crate) fn advertise(&self, advertise: Advertise) -> Result<(u32, Arc<Node>), Error> {
        self.check()?;
        let handle = self.shared().state().new_handle();
        let name = advertise.metadata.name.to_string();
        let mut advertise = Advertise { handle, ..advertise };
        let instance = match self.ask(Request::Advertise(advertise.clone()))? {
            Reply::Advertised(instance) => instance,
            reply => return Err(unexpected(reply)),
        };
        // From now on it is this instance, whatever was asked for first.
        advertise.claim = Claim::Shared(instance);
        self.shared().state().held.insert(handle, Request::Advertise(advertise));
        match self.node(&name, instance, Role::Publisher) {
            Ok(node) => Ok((handle, node)),
            Err(error) => {
                self.unadvertise(handle);
                Err(error)
            }
        }
    }

    /// Stops being a publisher.
    pub(crate) fn unadvertise(&self, handle: u32) {
        self.shared().forget(handle, Request::Unadvertise { handle });
    }

    /// Follows a node. Returns the handle and the node.
    pub(crate) fn subscribe(
        &self,
        subject: Subject,
        instance: Instance,
    ) -> Result<(u32, Followed), Error> {
        self.check()?;
        let event = match &subject {
            Subject::Described(_) => None,
            Subject::Named(_) => Some(Arc::new(Waiting {
                event: EventFd::from_flags(EfdFlags::EFD_CLOEXEC | EfdFlags::EFD_NONBLOCK)
                    .map_err(|errno| {
                        Error::io("make an event for", &self.system().socket(), errno.into())
                    })?,
                described: OnceLock::new(),
            })),
        };
        let name = subject.name().to_string();
        let handle = self.shared().state().new_handle();
        let request = Request::Subscribe(Subscribe { handle, subject, instance });
        if let Some(waiting) = &event {
            // Before the request: the broker may say that the topic is there in
            // the same breath in which it answers.
            self.shared().state().waiting.insert(handle, waiting.clone());
        }
        let answered = self.ask(request.clone()).and_then(|reply| match (reply, event) {
            (Reply::Subscribed, _) => {
                self.node(&name, instance, Role::Subscriber).map(Followed::Node)
            }
            (Reply::Waiting, Some(waiting)) => Ok(Followed::Waiting(waiting)),
            (reply, _) => Err(unexpected(reply)),
        });
        let mut state = self.shared().state();
        match answered {
            Ok(followed) => {
                if let Followed::Node(_) = followed {
                    state.waiting.remove(&handle);
                }
                state.held.insert(handle, request);
                Ok((handle, followed))
            }
            Err(error) => {
                state.waiting.remove(&handle);
                drop(state);
                self.unsubscribe(handle);
                Err(error)
            }
        }
    }

    /// Stops following a node.
    pub(crate) fn unsubscribe(&self, handle: u32) {
        self.shared().state().waiting.remove(&handle);
        self.shared().forget(handle, Request::Unsubscribe { handle });
    }

    /// The node as this process has it mapped for `role`.
    pub(crate) fn node(
        &self,
        topic: &str,
        instance: Instance,
        role: Role,
    ) -> Result<Arc<Node>, Error> {
        let key = (topic.to_string(), instance, role);
        let mut state = self.shared().state();
        if let Some(node) = state.nodes.get(&key).and_then(Weak::upgrade) {
            return Ok(node);
        }
        let node = Node::open(self.system(), topic, instance, role)?;
        if node.identity.system_id != self.shared().system_id {
            drop(state);
            self.shared().end();
            return Err(self.ended());
        }
        let node = Arc::new(node);
        state.nodes.insert(key, Arc::downgrade(&node));
        Ok(node)
    }

    /// The process that the broker knows by this number: the sender of a
    /// message, for one (see [`crate::Copied::peer`]). None where it has ended.
    ///
    /// # Errors
    ///
    /// [`Error::NoBroker`] and [`Error::NoAnswer`] where nobody can say.
    pub fn process(&self, peer: u16) -> Result<Option<PeerInfo>, Error> {
        match self.ask(Request::Peers)? {
            Reply::Peers(peers) => Ok(peers.into_iter().find(|process| process.peer == peer)),
            reply => Err(unexpected(reply)),
        }
    }

    /// The description of a topic that exists, from any of its nodes.
    ///
    /// # Errors
    ///
    /// [`Error::NoNode`] where the topic has no node.
    pub fn describe(&self, topic: &str) -> Result<Metadata, Error> {
        let node = Instance::all()
            .map(|instance| Node::open(self.system(), topic, instance, Role::Observer))
            .find(|node| !matches!(node, Err(Error::NoNode { .. })));
        match node {
            Some(node) => Ok(node?.identity.metadata),
            None => Err(Error::NoNode { topic: topic.into(), instance: Instance::FIRST }),
        }
    }
}

impl Drop for Owner {
    fn drop(&mut self) {
        let _ = self.shared.quit.write(1);
        if let Some(thread) = self.thread.take()
            && FORKS.load(Ordering::Relaxed) == self.shared.forks
        {
            // In the child of a fork the thread does not exist.
            let _ = thread.join();
        }
    }
}

impl State {
    fn new_handle(&mut self) -> u32 {
        self.next_handle += 1;
        self.next_handle
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    #[cold]
    fn unusable(&self, forked: bool) -> Error {
        if forked { Error::Forked } else { Error::Ended { path: self.system.dir() } }
    }

    /// Sends a request, now or when there is a broker again.
    fn call(&self, request: Request) -> (u32, Receiver<Reply>) {
        let (sender, receiver) = sync_channel(1);
        let mut state = self.state();
        state.next_number = state.next_number.wrapping_add(1);
        let number = state.next_number;
        let again = !matches!(request, Request::Unadvertise { .. } | Request::Unsubscribe { .. });
        let packet = encode(&ToBroker { number, request });
        if let Some(socket) = &state.socket {
            // That it fails means that the broker is gone. The thread notices
            // too, and sends all calls again to the next one.
            let _ = send_packet(socket, &packet);
        }
        state.calls.insert(number, Call { packet, answer: sender, again });
        (number, receiver)
    }

    fn wait_for(&self, number: u32, answer: &Receiver<Reply>) -> Result<Reply, Error> {
        let reply = answer.recv_timeout(ANSWER_TIMEOUT);
        let mut state = self.state();
        state.calls.remove(&number);
        match reply {
            Ok(Reply::Refused(refusal)) => Err(refusal.into()),
            Ok(reply) => Ok(reply),
            Err(_) if self.ended.load(Ordering::Relaxed) => Err(self.unusable(false)),
            Err(RecvTimeoutError::Timeout) if state.socket.is_some() => Err(Error::NoAnswer {
                path: self.system.socket(),
                seconds: ANSWER_TIMEOUT.as_secs(),
            }),
            Err(_) => Err(Error::NoBroker { path: self.system.socket() }),
        }
    }

    /// Gives a handle back. While there is no broker it is enough not to name
    /// it again to the next one.
    fn forget(&self, handle: u32, request: Request) {
        let connected = {
            let mut state = self.state();
            state.held.remove(&handle);
            state.socket.is_some()
        };
        let forked = FORKS.load(Ordering::Relaxed) != self.forks;
        if connected && !forked && !self.ended.load(Ordering::Relaxed) {
            let (number, answer) = self.call(request);
            let _ = self.wait_for(number, &answer);
        }
    }

    /// The system is over: all that waits is told so.
    fn end(&self) {
        self.ended.store(true, Ordering::Relaxed);
        let mut state = self.state();
        state.socket = None;
        // Dropping the senders wakes the callers.
        state.calls.clear();
        for waiting in state.waiting.values() {
            waiting.wake();
        }
    }

    /// The thread's whole life: listen to the broker, and find the next one.
    fn run(&self) {
        let mut buffer = Vec::new();
        while !self.ended.load(Ordering::Relaxed) {
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
            if ready[1].revents() != Some(PollFlags::empty()) {
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
            if self.ended.load(Ordering::Relaxed) {
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
                    let _ = waiting.described.set(());
                    waiting.wake();
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
                        let _ = waiting.described.set(());
                        waiting.wake();
                    }
                }
                Reply::Advertised(_) | Reply::Waiting | Reply::Refused(_) => {}
                reply => return Err(unexpected(reply)),
            }
        }
        exchange(&self.system, &socket, Request::Rejoined, buffer)?;
        for call in state.calls.values() {
            send_packet(&socket, &call.packet)
                .map_err(|error| Error::io("write to", &self.system.socket(), error))?;
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
    // SAFETY: flock is plain numbers, and zeros are a value of each.
    let mut lock: libc::flock = unsafe { std::mem::zeroed() };
    lock.l_type = libc::F_WRLCK as libc::c_short;
    lock.l_whence = libc::SEEK_SET as libc::c_short;
    nix::fcntl::fcntl(&file, nix::fcntl::FcntlArg::F_SETLK(&lock))
        .map_err(|errno| Error::io("lock", &path, errno.into()))?;
    Ok(file)
}

/// Starts the thread with all signals blocked: a program's handlers run on its
/// own threads.
fn spawn_quiet(shared: Arc<Shared>) -> io::Result<JoinHandle<()>> {
    let mut before = SigSet::empty();
    pthread_sigmask(SigmaskHow::SIG_SETMASK, Some(&SigSet::all()), Some(&mut before))?;
    let thread = thread::Builder::new().name("uorb-session".into()).spawn(move || shared.run());
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
        _ => Error::io("connect to", &path, error),
    }
}

fn unexpected(reply: Reply) -> Error {
    match reply {
        Reply::Refused(refusal) => refusal.into(),
        reply => Refusal::OutOfOrder { what: format!("{reply:?}") }.into(),
    }
}
