//! The connection to the broker, and the thread that keeps it up.
//!
//! The thread (`link/thread.rs`) sleeps on the socket and hands each answer to whoever waits for
//! it. When the broker dies it waits for the next one, joins it under the same
//! peer number, names again what the process holds, and asks again what was not
//! answered: every request can be asked twice with the same result. Handles
//! outlive brokers without noticing.
//!
//! The process proves that it lives by holding a record lock on its own file,
//! `peers/<number>`, opened once: the kernel drops the lock at its death, and
//! no forked child keeps it up.

#![allow(unsafe_code)]

mod joining;
mod ports;
mod thread;

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, Once, OnceLock, PoisonError, Weak};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::sys::eventfd::{EfdFlags, EventFd};
use nix::sys::socket::{Shutdown, shutdown};

use joining::{connect_patiently, join, lock_life};
use thread::spawn_quiet;

use crate::error::Error;
use crate::node::{Node, Role};
use crate::node_file::DESCRIPTION_MAX_BYTES;
use crate::protocol::{
    Advertise, Claim, FromBroker, Refusal, Reply, Request, Subscribe, ToBroker, Wish, encode,
};
use crate::stream::port::Streamable;
use crate::stream::{Member, World};
use crate::system::System;
use crate::topic::Instance;
use crate::transport::send_packet;

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
    /// Ports whose publications are gone, and which are needed for a while.
    lingering: Mutex<Vec<ports::Lingering>>,
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
        // Whoever ends a system removes its socket before anybody else hears of it.
        let ended = |error| match system.is_removed() {
            true if is_loss(&error) => Error::Ended { path: system.dir() },
            _ => error,
        };
        let mut socket = connect_patiently(system)?;
        let deadline = Instant::now() + ANSWER_TIMEOUT;
        let (peer, system_id, world, life) = loop {
            fail_point!("join.connected");
            let (peer, system_id, world) = match join(system, &socket, None).map_err(ended)? {
                Reply::Welcome { peer, system_id, world } => (peer, system_id, world),
                reply => return Err(unexpected(reply)),
            };
            if let Some(life) = lock_life(system, peer).map_err(ended)? {
                break (peer, system_id, world, life);
            }
            // The broker has died meanwhile: the next one gives us a number.
            if Instant::now() >= deadline {
                return Err(no_answer(system));
            }
            // Nothing tells when it is there.
            std::thread::sleep(RETRY_FROM);
            socket = connect_patiently(system).map_err(ended)?;
        };
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
            lingering: Mutex::default(),
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
