//! The broker: one thread, one loop, everything that can happen in one enum.
//!
//! It makes nodes, says which instance is whose, and notices deaths. It is
//! never on the way of a message: killed, it leaves every handle working, and
//! the next one finds all it needs in the directory.

use std::collections::{BTreeMap, HashMap};
use std::os::fd::{AsFd, AsRawFd, FromRawFd, OwnedFd};

use anyhow::{Context, bail};
use nix::errno::Errno;
use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags, EpollTimeout};
use nix::sys::inotify::{AddWatchFlags, InitFlags, Inotify};
use nix::sys::signal::{SigSet, Signal};
use nix::sys::signalfd::{SfdFlags, SignalFd};
use nix::sys::socket::{SockFlag, accept4};
use nix::sys::time::TimeSpec;
use nix::sys::timerfd::{ClockId, Expiration, TimerFd, TimerFlags, TimerSetTimeFlags};
use tracing::{debug, error, info, warn};
use uorb_core::broker_side::{
    Advertise, BrokerStatus, FromBroker, Identity, Join, Node, PROTOCOL_VERSION, PublisherEntry,
    Refusal, Reply, Request, Role, Subscribe, ToBroker, base_of, boot_id, decode, decode_beginning,
    listen_as_broker, receive_packet,
};
use uorb_core::{Error, Instance, Metadata, QueueLength, System, now_us};

use crate::connection::{Connection, CutOff, pidfd_of};
use crate::directory::{self, Survivor};
use crate::limits::{CONNECTIONS_MAX, DOUBT_INTERVAL, PACKETS_A_TURN};
use crate::registry::{Estate, NodeKey, Plan, Registry, SubscribePlan};

/// Everything that can wake the broker.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Event {
    /// A process connects.
    Connecting,
    /// SIGTERM or SIGINT: the system is to end.
    Signal,
    /// Something happened to the lock file: was the directory removed?
    Directory,
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
            Self::Connection(number) => 1 << 32 | u64::from(number),
            Self::Death(peer) => 2 << 32 | u64::from(peer),
        }
    }

    fn from_token(token: u64) -> Self {
        match (token >> 32, token as u32) {
            (1, number) => Self::Connection(number),
            (2, peer) => Self::Death(peer as u16),
            (_, 0) => Self::Connecting,
            (_, 1) => Self::Signal,
            (_, 2) => Self::Directory,
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
    nodes: BTreeMap<NodeKey, Node>,
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
    buffer: Vec<u8>,
    ended: bool,
}

impl Broker {
    /// A broker in a directory that is ours and locked.
    pub(crate) fn new(
        system: System,
        system_id: u64,
        living: Vec<Survivor>,
    ) -> anyhow::Result<Self> {
        let stop = SigSet::from_iter([Signal::SIGTERM, Signal::SIGINT]);
        stop.thread_block().context("cannot block signals")?;
        let listener = listen_as_broker(&system)
            .with_context(|| format!("cannot listen at {}", system.socket().display()))?;
        let directory = Inotify::init(InitFlags::IN_CLOEXEC | InitFlags::IN_NONBLOCK)
            .context("cannot make an inotify instance")?;
        directory
            .add_watch(&system.lock(), AddWatchFlags::IN_ATTRIB)
            .context("cannot watch the lock file")?;
        let timer_flags = TimerFlags::TFD_CLOEXEC | TimerFlags::TFD_NONBLOCK;
        let mut broker = Self {
            system_id,
            boot_id: boot_id()?,
            started_us: now_us(),
            registry: Registry::default(),
            nodes: BTreeMap::new(),
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
            buffer: Vec::new(),
            ended: false,
            system,
        };
        let readable = |event: Event| EpollEvent::new(EpollFlags::EPOLLIN, event.to_token());
        let epoll = &broker.epoll;
        epoll.add(&broker.listener, readable(Event::Connecting))?;
        epoll.add(&broker.signals, readable(Event::Signal))?;
        epoll.add(&broker.directory, readable(Event::Directory))?;
        epoll.add(&broker.doubt, readable(Event::Doubt))?;
        broker.adopt(living)?;
        Ok(broker)
    }

    /// Takes over what the broker before us left: nodes, and processes that
    /// live. Those that died meanwhile are buried now.
    fn adopt(&mut self, living: Vec<Survivor>) -> anyhow::Result<()> {
        for Survivor { peer, pid, name } in living {
            self.registry.adopt_peer(peer, pid, name);
            if let Some(pidfd) = pidfd_of(pid) {
                self.watch_process(peer, pidfd);
            }
        }
        for (topic, instance) in self.system.list_nodes()? {
            let key = (topic, instance);
            match Node::open(&self.system, &key.0, instance, Role::Broker) {
                Ok(node) if node.identity.system_id == self.system_id => self.adopt_node(key, node),
                Ok(_) => warn!("{}{instance} is of another system: left alone", key.0),
                Err(error) => error!("cannot adopt {}{instance}: {error}", key.0),
            }
        }
        for peer in directory::listed(&self.system) {
            if !self.registry.is_known(peer) {
                let _ = std::fs::remove_file(self.system.peer(peer));
            }
        }
        // Somebody may have died between its commit and its ring, and nobody
        // would have rung for it.
        for (key, node) in &self.nodes {
            ring(key, node);
        }
        self.arm_doubt();
        if !self.nodes.is_empty() {
            let peers = self.registry.peers().len();
            info!("adopted {} nodes and {peers} processes", self.nodes.len());
        }
        Ok(())
    }

    fn adopt_node(&mut self, key: NodeKey, node: Node) {
        let (dead, living): (Vec<_>, Vec<_>) =
            node.status().publishers.into_iter().partition(|p| !self.registry.is_known(p.peer));
        for publisher in dead {
            info!("{}{}: publisher {} died meanwhile", key.0, key.1, publisher.peer);
            node.free_slots_of(publisher.peer);
        }
        self.registry.adopt_node(node.identity.metadata.clone(), key.1, living);
        self.nodes.insert(key.clone(), node);
        self.update_counts(&key);
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
                self.handle(Event::from_token(event.data()))?;
            }
        }
        Ok(())
    }

    fn handle(&mut self, event: Event) -> anyhow::Result<()> {
        match event {
            Event::Connecting => self.accept(),
            Event::Connection(number) => self.serve(number),
            Event::Death(peer) => self.bury(peer),
            Event::Doubt => self.look_at_the_doubtful(),
            Event::Signal => {
                let _ = self.signals.read_signal();
                info!("stopped by a signal");
                self.end();
            }
            Event::Directory => {
                let _ = self.directory.read_events();
                // A login user's files in /dev/shm are removed at logout where
                // systemd has RemoveIPC=yes.
                if !self.system.lock().exists() {
                    self.end();
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

    // Connections.

    fn accept(&mut self) {
        loop {
            let flags = SockFlag::SOCK_CLOEXEC | SockFlag::SOCK_NONBLOCK;
            let socket = match accept4(self.listener.as_raw_fd(), flags) {
                Ok(socket) => own(socket),
                Err(Errno::EINTR) => continue,
                Err(Errno::EAGAIN | Errno::ECONNABORTED) => return,
                Err(errno) => {
                    error!("cannot accept a connection: {errno}");
                    return;
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
            let token = Event::Connection(number).to_token();
            let event = EpollEvent::new(EpollFlags::EPOLLIN, token);
            match self.epoll.add(&connection, event) {
                Ok(()) => _ = self.connections.insert(number, connection),
                Err(errno) => error!("cannot watch a connection: {errno}"),
            }
        }
    }

    /// Takes what a connection has sent, and sends what waits for it.
    fn serve(&mut self, number: u32) {
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
            Ok(reply) => reply,
            Err(refusal) => {
                self.log_refusal(number, &refusal);
                Reply::Refused(refusal)
            }
        };
        let stops = stops && reply == Reply::Done;
        let sent = self.send(number, &FromBroker::Reply { number: request_number, reply });
        if stops {
            info!("stopped by {}", self.name_of(number));
            self.end();
        }
        sent && !stops
    }

    fn grant(&mut self, number: u32, request: Request) -> Result<Reply, Refusal> {
        let peer = self.connections.get(&number).and_then(|connection| connection.peer);
        let Some(peer) = peer else {
            return match request {
                Request::Join(join) => self.join(number, join),
                other => Err(Refusal::OutOfOrder { what: format!("{other:?}") }),
            };
        };
        match request {
            Request::Join(_) => Err(Refusal::OutOfOrder { what: "join".into() }),
            Request::Rejoined => {
                for key in self.registry.rejoined(peer) {
                    self.update_counts(&key);
                }
                Ok(Reply::Done)
            }
            Request::Advertise(wanted) => self.advertise(peer, wanted),
            Request::Subscribe(wanted) => self.subscribe(peer, &wanted),
            Request::Unadvertise { handle } | Request::Unsubscribe { handle } => {
                let Estate { advertised, subscribed } = self.registry.release(peer, handle);
                advertised.iter().chain(&subscribed).for_each(|key| self.update_counts(key));
                Ok(Reply::Done)
            }
            Request::Status => Ok(Reply::Status(self.status())),
            Request::Peers => Ok(Reply::Peers(self.registry.peers())),
            Request::Users { topic, instance } => {
                Ok(Reply::Users(self.registry.users(&topic, instance)))
            }
            Request::Stop => Ok(Reply::Done),
        }
    }

    fn join(&mut self, number: u32, join: Join) -> Result<Reply, Refusal> {
        if join.version != PROTOCOL_VERSION {
            return Err(Refusal::Version { broker: PROTOCOL_VERSION });
        }
        let Some(connection) = self.connections.get(&number) else {
            return Err(Refusal::OutOfOrder { what: "join".into() });
        };
        let (pid, pidfd) = (connection.pid, connection.pidfd());
        let peer = match join.rejoin {
            None => {
                let peer = self.registry.join(pid, join.name.clone())?;
                if let Err(error) = directory::make_peer_file(&self.system, peer, &join.name) {
                    self.registry.bury(peer);
                    return Err(failed(&error));
                }
                debug!("{} (pid {pid}) joins as {peer}", join.name);
                peer
            }
            Some(rejoin) => {
                let known = rejoin.system_id == self.system_id
                    && self.registry.rejoin(rejoin.peer, pid, join.name.clone()).is_some();
                if !known {
                    return Err(Refusal::OtherSystem);
                }
                info!("{} (pid {pid}) re-joins as {}", join.name, rejoin.peer);
                rejoin.peer
            }
        };
        if let Some(pidfd) = pidfd {
            self.watch_process(peer, pidfd);
        }
        self.connected.insert(peer, number);
        if let Some(connection) = self.connections.get_mut(&number) {
            connection.peer = Some(peer);
        }
        Ok(Reply::Welcome { peer, system_id: self.system_id })
    }

    /// Sends to a connection. False: it is gone.
    fn send(&mut self, number: u32, message: &FromBroker) -> bool {
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
        match directory::lock_holder(&self.system, peer) {
            None => self.bury(peer),
            Some(_) => self.arm_doubt(),
        }
    }

    fn name_of(&self, number: u32) -> String {
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

    // Deaths.

    fn watch_process(&mut self, peer: u16, pidfd: OwnedFd) {
        let event = EpollEvent::new(EpollFlags::EPOLLIN, Event::Death(peer).to_token());
        if self.epoll.add(&pidfd, event).is_ok() {
            // Closing the old one takes it out of the epoll instance.
            self.pidfds.insert(peer, pidfd);
        }
    }

    /// A process is dead: frees its slots, gives back what it held, and wakes
    /// whoever it may have died before waking.
    fn bury(&mut self, peer: u16) {
        self.pidfds.remove(&peer);
        if !self.registry.is_known(peer) {
            return;
        }
        if directory::lock_holder(&self.system, peer).is_some() {
            // Its number is somebody else's by now, or it gave us a descriptor
            // of another process: its own lock says that it lives.
            return self.arm_doubt();
        }
        let name = self.registry.name_of(peer);
        let Estate { advertised, subscribed } = self.registry.bury(peer);
        for key in &advertised {
            if let Some(node) = self.nodes.get(key) {
                node.free_slots_of(peer);
            }
            self.update_counts(key);
            if let Some(node) = self.nodes.get(key) {
                ring(key, node);
            }
        }
        subscribed.iter().for_each(|key| self.update_counts(key));
        if let Some(number) = self.connected.remove(&peer) {
            self.connections.remove(&number);
        }
        let _ = std::fs::remove_file(self.system.peer(peer));
        if advertised.is_empty() {
            debug!("{name} is gone");
        } else {
            let nodes: Vec<_> = advertised.iter().map(|(t, i)| format!("{t}{i}")).collect();
            info!("{name} is gone; it had advertised {}", nodes.join(", "));
        }
    }

    /// Processes that live without a connection and of which no pidfd tells.
    fn doubtful(&self) -> Vec<u16> {
        let peers = self.registry.peers().into_iter();
        peers
            .filter(|peer| !peer.connected && !self.pidfds.contains_key(&peer.peer))
            .map(|peer| peer.peer)
            .collect()
    }

    fn arm_doubt(&self) {
        if !self.doubtful().is_empty() {
            let due = TimeSpec::from_duration(DOUBT_INTERVAL);
            let _ = self.doubt.set(Expiration::OneShot(due), TimerSetTimeFlags::empty());
        }
    }

    fn look_at_the_doubtful(&mut self) {
        let _ = self.doubt.unset();
        for peer in self.doubtful() {
            if directory::lock_holder(&self.system, peer).is_none() {
                self.bury(peer);
            }
        }
        self.arm_doubt();
    }

    // Nodes.

    fn advertise(&mut self, peer: u16, wanted: Advertise) -> Result<Reply, Refusal> {
        let plan = self.registry.plan_advertise(peer, &wanted)?;
        let Advertise { handle, metadata, priority, queue_length, .. } = wanted;
        let key = (metadata.name.to_string(), plan.instance);
        self.carry_out(plan, &key)?;
        let asked_for = queue_length.unwrap_or(QueueLength::ONE).max(metadata.queue_length);
        if let Some(node) = self.nodes.get(&key) {
            node.make_ring(asked_for).map_err(|error| refusal_of(&error))?;
            let granted = node.queue_length().unwrap_or(QueueLength::ONE);
            if queue_length.is_some_and(|asked_for| asked_for > granted) {
                let name = self.registry.name_of(peer);
                warn!(
                    "{}{}: {name} asks for a queue of {}, its first publisher had {}",
                    key.0,
                    key.1,
                    asked_for.get(),
                    granted.get(),
                );
            }
        }
        self.registry.add_publisher(&key, PublisherEntry { peer, handle, priority });
        self.update_counts(&key);
        Ok(Reply::Advertised(key.1))
    }

    fn subscribe(&mut self, peer: u16, wanted: &Subscribe) -> Result<Reply, Refusal> {
        match self.registry.plan_subscribe(peer, wanted)? {
            SubscribePlan::Wait => {
                self.registry.add_waiting(peer, wanted);
                Ok(Reply::Waiting)
            }
            SubscribePlan::Node(plan) => {
                let key = (wanted.subject.name().to_string(), wanted.instance);
                self.carry_out(plan, &key)?;
                self.registry.add_subscriber(&key, peer, wanted.handle);
                self.update_counts(&key);
                Ok(Reply::Subscribed)
            }
        }
    }

    /// Makes the node that a plan needs. Only when it is made do the nodes of
    /// another layout go.
    fn carry_out(&mut self, plan: Plan, key: &NodeKey) -> Result<(), Refusal> {
        let Some(metadata) = plan.create else { return Ok(()) };
        let node = self.make_node(&metadata, key.1)?;
        if !plan.give_way.is_empty() {
            info!(
                "{}: nobody uses the old layout any more, its {} nodes give way",
                key.0,
                plan.give_way.len()
            );
            for old in &plan.give_way {
                self.discard(old, old != key);
            }
            self.registry.remove_topic(&key.0);
        }
        self.registry.add_node(metadata.clone(), key.1);
        self.nodes.insert(key.clone(), node);
        self.update_counts(key);
        self.tell_waiting(&metadata);
        Ok(())
    }

    fn make_node(&self, metadata: &Metadata, instance: Instance) -> Result<Node, Refusal> {
        let identity = Identity {
            system_id: self.system_id,
            boot_id: self.boot_id,
            instance,
            base: base_of(&metadata.name, metadata.queue_length),
            metadata: metadata.clone(),
        };
        debug!("makes {}{instance}", metadata.name);
        Node::create(&self.system, identity).map_err(|error| refusal_of(&error))
    }

    fn discard(&mut self, key: &NodeKey, has_files: bool) {
        let Some(node) = self.nodes.remove(key) else { return };
        node.end();
        if has_files {
            ring(key, &node);
            let _ = std::fs::remove_file(self.system.node(&key.0, key.1));
            let _ = std::fs::remove_file(self.system.bell(&key.0, key.1));
        }
    }

    /// A topic is described now: subscriptions by name get their nodes.
    fn tell_waiting(&mut self, metadata: &Metadata) {
        for (peer, handle, instance) in self.registry.take_waiting(&metadata.name) {
            let key = (metadata.name.to_string(), instance);
            if !self.nodes.contains_key(&key) {
                match self.make_node(metadata, instance) {
                    Ok(node) => {
                        self.registry.add_node(metadata.clone(), instance);
                        self.nodes.insert(key.clone(), node);
                    }
                    Err(refusal) => {
                        error!("{}{instance} cannot be made: {refusal}", metadata.name);
                        continue;
                    }
                }
            }
            self.registry.add_subscriber(&key, peer, handle);
            self.update_counts(&key);
            if let Some(number) = self.connected.get(&peer) {
                self.send(*number, &FromBroker::Described { handle });
            }
        }
    }

    /// Writes into a node who publishes and how many subscribe.
    fn update_counts(&self, key: &NodeKey) {
        if let Some(node) = self.nodes.get(key) {
            let (publishers, subscribers) = self.registry.counts(key);
            node.set_counts(publishers, subscribers);
        }
    }

    fn status(&self) -> BrokerStatus {
        BrokerStatus {
            version: env!("CARGO_PKG_VERSION").into(),
            pid: std::process::id(),
            started_us: self.started_us,
            system_id: self.system_id,
            peers: self.connected.len() as u32,
            topics: self.registry.topic_count() as u32,
            nodes: self.registry.node_count() as u32,
            advertised: self.registry.advertised_count() as u32,
        }
    }

    /// Ends the system: every handle hears of it, and the directory goes.
    fn end(&mut self) {
        if self.ended {
            return;
        }
        self.ended = true;
        // Nobody may come in any more.
        let _ = std::fs::remove_file(self.system.socket());
        for (key, node) in &self.nodes {
            node.end();
            ring(key, node);
        }
        for connection in self.connections.values_mut() {
            let _ = connection.send(&FromBroker::Ended);
        }
        directory::remove(&self.system);
    }
}

/// Wakes the subscriptions of a node.
fn ring(key: &NodeKey, node: &Node) {
    if let Err(error) = node.ring_bell() {
        warn!("cannot ring for {}{}: {error}", key.0, key.1);
    }
}

#[allow(unsafe_code)]
fn own(socket: std::os::fd::RawFd) -> OwnedFd {
    // SAFETY: accept4 has just made it, and nobody else knows its number.
    unsafe { OwnedFd::from_raw_fd(socket) }
}

/// What the client library could not do, as an answer to a process.
fn refusal_of(error: &Error) -> Refusal {
    match error {
        Error::NoSpace { path, needed_bytes } => {
            Refusal::NoSpace { path: path.clone(), needed_bytes: *needed_bytes }
        }
        other => failed(other),
    }
}

fn failed(error: &dyn std::fmt::Display) -> Refusal {
    Refusal::Failed { what: error.to_string() }
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
