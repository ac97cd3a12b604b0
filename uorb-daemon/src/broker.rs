//! The broker: one thread, one loop, everything that can happen in one enum.
//!
//! It makes nodes, says which instance is whose, and notices deaths. It is
//! never on the way of a message: killed, it leaves every handle working, and
//! the next one finds all it needs in the directory.

mod connections;
mod deaths;
mod nodes;
mod streaming;

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::os::fd::OwnedFd;
use std::os::unix::fs::MetadataExt;
use std::sync::Arc;

use anyhow::{Context, bail};
use nix::errno::Errno;
use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags, EpollTimeout};
use nix::sys::inotify::{AddWatchFlags, InitFlags, Inotify};
use nix::sys::signal::{SigSet, Signal};
use nix::sys::signalfd::{SfdFlags, SignalFd};
use nix::sys::timerfd::{ClockId, TimerFd, TimerFlags};
use tracing::{info, warn};
use uorb_core::broker_side::{Ending, FromBroker, Node, boot_id, listen_as_broker};
use uorb_core::{System, World, fail_point, now_us};

use crate::connection::Connection;
use crate::directory::{self, Survivor};
use crate::registry::{NodeKey, Registry};
use crate::streams::{Order, Streams};
use streaming::Streaming;

/// Everything that can wake the broker.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Event {
    /// A process connects.
    Connecting,
    /// SIGTERM or SIGINT: the system is to end.
    Signal,
    /// Something happened to the lock file: was the directory removed?
    Directory,
    /// The streams' thread has news.
    Streams,
    /// Time to look at processes whose death nobody would report.
    Doubt,
    /// A connection can be read, written, or has hung up.
    Connection(u32),
    /// A process has died.
    Death(u16),
}

impl Event {
    fn to_token(self) -> u64 {
        match self {
            Self::Connecting => 0,
            Self::Signal => 1,
            Self::Directory => 2,
            Self::Doubt => 3,
            Self::Streams => 4,
            Self::Connection(number) => 1 << 32 | u64::from(number),
            Self::Death(peer) => 2 << 32 | u64::from(peer),
        }
    }

    fn readable(self) -> EpollEvent {
        EpollEvent::new(EpollFlags::EPOLLIN, self.to_token())
    }

    fn from_token(token: u64) -> Self {
        match (token >> 32, token as u32) {
            (1, number) => Self::Connection(number),
            (2, peer) => Self::Death(peer as u16),
            (_, 0) => Self::Connecting,
            (_, 1) => Self::Signal,
            (_, 2) => Self::Directory,
            (_, 4) => Self::Streams,
            _ => Self::Doubt,
        }
    }
}

#[derive(Debug)]
pub(crate) struct Broker {
    system: System,
    system_id: u64,
    boot_id: [u8; 16],
    started_us: u64,
    registry: Registry,
    nodes: BTreeMap<NodeKey, Arc<Node>>,
    world: World,
    /// None once the system has ended.
    streams: Option<Streams>,
    /// Nodes whose streams are there, or cannot be, and why.
    streaming: HashMap<NodeKey, Streaming>,
    epoll: Epoll,
    listener: OwnedFd,
    signals: SignalFd,
    directory: Inotify,
    doubt: TimerFd,
    connections: HashMap<u32, Connection>,
    last_connection: u32,
    /// Which connection a process has.
    connected: HashMap<u16, u32>,
    /// What tells of a process's death.
    pidfds: HashMap<u16, OwnedFd>,
    /// Given up for a moment when there are no descriptors left, so that
    /// whoever connects can be turned away.
    reserve: Option<File>,
    /// Whether the listener is out of the loop until the doubt timer.
    is_deaf: bool,
    buffer: Vec<u8>,
    /// Held locked while the broker runs.
    lock: Arc<File>,
    ended: bool,
}

impl Broker {
    /// A broker in a directory that is ours and locked.
    pub(crate) fn new(
        system: System,
        lock: Arc<File>,
        system_id: u64,
        living: Vec<Survivor>,
    ) -> anyhow::Result<Self> {
        let stop = SigSet::from_iter([Signal::SIGTERM, Signal::SIGINT]);
        stop.thread_block().context("cannot block signals")?;
        let listener = listen_as_broker(&system)
            .with_context(|| format!("cannot listen at {}", system.socket().display()))?;
        fail_point!("start.listening");
        let directory = Inotify::init(InitFlags::IN_CLOEXEC | InitFlags::IN_NONBLOCK)
            .context("cannot make an inotify instance")?;
        directory
            .add_watch(&system.lock(), AddWatchFlags::IN_ATTRIB)
            .context("cannot watch the lock file")?;
        let world = World::of(&system);
        let streams = Streams::start(system.clone(), world.clone())?;
        let timer_flags = TimerFlags::TFD_CLOEXEC | TimerFlags::TFD_NONBLOCK;
        let mut broker = Self {
            system_id,
            boot_id: boot_id()?,
            started_us: now_us(),
            registry: Registry::default(),
            nodes: BTreeMap::new(),
            world,
            streams: Some(streams),
            streaming: HashMap::new(),
            epoll: Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC).context("cannot make an epoll")?,
            listener,
            signals: SignalFd::with_flags(&stop, SfdFlags::SFD_CLOEXEC | SfdFlags::SFD_NONBLOCK)
                .context("cannot make a signalfd")?,
            directory,
            doubt: TimerFd::new(ClockId::CLOCK_MONOTONIC, timer_flags)
                .context("cannot make a timerfd")?,
            connections: HashMap::new(),
            last_connection: 0,
            connected: HashMap::new(),
            pidfds: HashMap::new(),
            reserve: File::open("/dev/null").ok(),
            is_deaf: false,
            buffer: Vec::new(),
            lock,
            ended: false,
            system,
        };
        let epoll = &broker.epoll;
        epoll.add(&broker.listener, Event::Connecting.readable())?;
        epoll.add(&broker.signals, Event::Signal.readable())?;
        epoll.add(&broker.directory, Event::Directory.readable())?;
        epoll.add(&broker.doubt, Event::Doubt.readable())?;
        if let Some(streams) = &broker.streams {
            epoll.add(&*streams.event, Event::Streams.readable())?;
        }
        broker.adopt(living)?;
        Ok(broker)
    }

    /// Serves until the system ends.
    pub(crate) fn run(&mut self) -> anyhow::Result<()> {
        info!("ready at {}", self.system);
        let mut events = [EpollEvent::empty(); 64];
        while !self.ended {
            let count = match self.epoll.wait(&mut events, EpollTimeout::NONE) {
                Ok(count) => count,
                Err(Errno::EINTR) => continue,
                Err(errno) => return Err(errno).context("cannot wait for events"),
            };
            for event in &events[..count] {
                // What else has happened does not matter once it has ended.
                if self.ended {
                    break;
                }
                self.handle(Event::from_token(event.data()))?;
            }
        }
        Ok(())
    }

    fn handle(&mut self, event: Event) -> anyhow::Result<()> {
        match event {
            Event::Connecting => self.accept(),
            Event::Connection(number) => self.serve(number),
            Event::Death(peer) => {
                // It stays readable, whatever the lock says.
                self.pidfds.remove(&peer);
                self.bury(peer);
            }
            Event::Streams => self.hear_streams(),
            Event::Doubt => self.look_at_the_doubtful(),
            Event::Signal => {
                let _ = self.signals.read_signal();
                info!("stopped by a signal");
                self.end();
            }
            Event::Directory => {
                let _ = self.directory.read_events();
                // A login user's files in /dev/shm are removed at logout where
                // systemd has RemoveIPC=yes. What has our name now is not ours.
                if self.lock.metadata().is_ok_and(|lock| lock.nlink() == 0) {
                    self.say_ended();
                    bail!(
                        "{} was removed: the system has ended. If that was at logout, \
                         enable lingering (loginctl enable-linger) or use a service user",
                        self.system,
                    );
                }
            }
        }
        Ok(())
    }

    /// Ends the system: every handle hears of it, and the directory goes.
    fn end(&mut self) {
        if self.ended {
            return;
        }
        // Nobody may come in any more.
        let _ = std::fs::remove_file(self.system.socket());
        fail_point!("end.socket_removed");
        self.say_ended();
        fail_point!("end.said");
        for (key, node) in &self.nodes {
            ring(key, node);
        }
        // Gives the streams up, and what iceoryx2 has for them.
        self.order(Order::Ended);
        self.streams = None;
        self.world.remove();
        directory::remove(&self.system);
    }

    /// Marks the system as ended, and tells every session.
    fn say_ended(&mut self) {
        self.ended = true;
        self.nodes.values().for_each(|node| node.end(Ending::System));
        for connection in self.connections.values_mut() {
            let _ = connection.send(&FromBroker::Ended);
        }
    }
}

/// Wakes the subscriptions of a node.
pub(crate) fn ring(key: &NodeKey, node: &Node) {
    if let Err(error) = node.ring_bell() {
        warn!("cannot ring for {}{}: {error}", key.0, key.1);
    }
}

/// Whether this kernel wakes an edge-triggered epoll when a byte is written to
/// a pipe that is not empty, on which the bell depends. Linux 5.5 to 5.10.55 and
/// 5.11 to 5.13.7 do not.
pub(crate) fn kernel_rings_bells() -> anyhow::Result<bool> {
    let (reader, writer) = nix::unistd::pipe().context("cannot make a pipe")?;
    let epoll = Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC).context("cannot make an epoll")?;
    nix::unistd::write(&writer, &[0]).context("cannot write to a pipe")?;
    let event = EpollEvent::new(EpollFlags::EPOLLIN | EpollFlags::EPOLLET, 0);
    epoll.add(&reader, event).context("cannot watch a pipe")?;
    let mut events = [EpollEvent::empty()];
    epoll.wait(&mut events, EpollTimeout::ZERO).context("cannot wait for a pipe")?;
    nix::unistd::write(&writer, &[0]).context("cannot write to a pipe")?;
    let rung = epoll.wait(&mut events, EpollTimeout::ZERO).context("cannot wait for a pipe")?;
    Ok(rung == 1)
}
