//! The streams of all nodes: made and kept by a thread of their own.
//!
//! iceoryx2 works on the file system, in milliseconds, and the broker's loop
//! waits for nobody. So the loop gives *orders* and hears *news*. The thread
//! keeps every node's service open, cleans up after dead processes, which nobody
//! else does (`streams/dead.rs`), and looks who of the users of a stream is none
//! of ours.
//!
//! Of a large topic it is itself a subscriber, with a queue of one: when a
//! publisher goes, its newest message is still there, and is kept in the node.

mod dead;

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::Instant;

use anyhow::Context;
use iceoryx2::prelude::CallbackProgression;
use iceoryx2::service::port_factory::PortFactory;
use nix::sys::eventfd::{EfdFlags, EventFd};
use tracing::{debug, warn};
use uorb_core::broker_side::{
    Events, Executor, Foreigners, Inbox, Ipc, Member, Node, Stream, Unfinished, open_stream,
};
use uorb_core::{System, World, fail_point};

use crate::broker::ring;
use crate::limits::{
    CLEAN_UP_INTERVAL, DEAD_LOOK_INTERVAL, DEAD_MAX, LOOK_INTERVAL, UNFINISHED_INTERVAL,
};
use crate::registry::NodeKey;
use dead::Dead;

/// What the loop wants.
#[derive(Debug)]
pub(crate) enum Order {
    /// Make the stream of a node, and keep it.
    Make(NodeKey, Arc<Node>),
    /// The node gave way.
    Forget(NodeKey),
    /// A publisher has opened its port.
    Ported(NodeKey),
    /// A publisher of a large topic goes: keep what it published last.
    Save(NodeKey),
    /// A process is one of ours: its number, and its process id.
    Joined(u16, u32),
    /// A publisher of a node has died: send what it has not sent, then give its
    /// slots back.
    Bury(NodeKey, u16),
    /// A process of ours has died: clean up after it.
    Died(u16, u32),
    /// The system has ended: nobody needs anything of the dead.
    Ended,
}

/// What the thread says.
#[derive(Debug)]
pub(crate) enum News {
    /// A node's stream is there, or cannot be.
    Made(NodeKey, Result<(), String>),
    /// How many foreign programs follow a node's stream, and publish there.
    Foreign(NodeKey, (u64, u64)),
}

/// The loop's end of the thread.
#[derive(Debug)]
pub(crate) struct Streams {
    orders: Option<Sender<Order>>,
    news: Receiver<News>,
    /// Readable while there is news.
    pub(crate) event: Arc<EventFd>,
    thread: Option<JoinHandle<()>>,
    /// What the other thread may wait for without end, this one removes.
    sweeper: Option<JoinHandle<()>>,
    sweeps: Option<Sender<()>>,
}

impl Streams {
    pub(crate) fn start(system: System, world: World) -> anyhow::Result<Self> {
        let flags = EfdFlags::EFD_CLOEXEC | EfdFlags::EFD_NONBLOCK;
        let event = Arc::new(EventFd::from_flags(flags).context("cannot make an eventfd")?);
        let (sweeps, until) = channel();
        let unfinished = Unfinished::of(world.clone());
        tell_of(&unfinished.remove_services());
        let sweeper = thread::Builder::new()
            .name("sweeper".into())
            .spawn(move || sweep(unfinished, &until))
            .context("cannot start the thread that sweeps")?;
        let (orders, taken) = channel();
        let (told, news) = channel();
        let reporter = Reporter { news: told, event: event.clone() };
        let thread = thread::Builder::new()
            .name("streams".into())
            .spawn(move || keep(&system, &world, &taken, &reporter))
            .context("cannot start the thread of the streams")?;
        let (orders, thread) = (Some(orders), Some(thread));
        let (sweeper, sweeps) = (Some(sweeper), Some(sweeps));
        Ok(Self { orders, news, event, thread, sweeper, sweeps })
    }

    pub(crate) fn order(&self, order: Order) {
        if let Some(orders) = &self.orders {
            let _ = orders.send(order);
        }
    }

    pub(crate) fn news(&self) -> Vec<News> {
        let _ = self.event.read();
        self.news.try_iter().collect()
    }
}

impl Drop for Streams {
    /// Ends the thread, which gives all streams up.
    fn drop(&mut self) {
        self.orders = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        // Last: the other one may have waited for it.
        self.sweeps = None;
        if let Some(sweeper) = self.sweeper.take() {
            let _ = sweeper.join();
        }
    }
}

/// Removes what was begun in the memory of streams and never finished, until
/// there are no streams any more. In a thread of its own: the other one waits in
/// iceoryx2 when it meets such a file, and so may every process of the system.
fn sweep(mut unfinished: Unfinished, until: &Receiver<()>) {
    loop {
        tell_of(&unfinished.remove());
        match until.recv_timeout(UNFINISHED_INTERVAL) {
            Err(RecvTimeoutError::Timeout) => {}
            Ok(()) | Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

/// Whoever waited for one of them asks why.
fn tell_of(removed: &[PathBuf]) {
    for path in removed {
        warn!("{} was begun by somebody who was killed: it is removed", path.display());
    }
}

struct Reporter {
    news: Sender<News>,
    event: Arc<EventFd>,
}

impl Reporter {
    fn tell(&self, news: News) {
        let _ = self.news.send(news);
        let _ = self.event.write(1);
    }
}

/// One stream that is kept.
struct Kept {
    node: Arc<Node>,
    stream: Stream,
    events: Events,
    /// Of a large topic: what holds its newest message.
    newest: Option<Inbox>,
    foreign: (u64, u64),
    /// What sends for the dead, once it was needed.
    executor: Option<Executor>,
    /// Foreign publishers seen at the last look: at the second they are told of.
    suspects: HashSet<u128>,
    /// Those of which the log has a line.
    named: HashSet<u128>,
}

impl Kept {
    /// Maps new ports, where the newest message is kept.
    fn connect(&mut self) {
        if let Some(newest) = &mut self.newest {
            newest.connect(&self.stream);
        }
    }

    /// The publishers that are none of ours, by their ports. The log has a line of
    /// each that was there at the last look, too.
    fn strangers(&mut self, key: &NodeKey) -> HashSet<u128> {
        let mut strangers = HashSet::new();
        self.stream.dynamic_config().list_publishers(|publisher| {
            let id = publisher.publisher_id.value();
            // A port of ours is there an instant before its id is known.
            if !self.node.has_port_id(id) {
                strangers.insert(id);
                if self.suspects.contains(&id) && self.named.insert(id) {
                    let pid = publisher.node_id.pid::<Ipc>().map_or(0, |pid| pid.value());
                    warn!(
                        "{}{}: a foreign program (pid {pid}) publishes on the stream; its \
                         messages are dropped",
                        key.0, key.1,
                    );
                }
            }
            CallbackProgression::Continue
        });
        strangers
    }
}

fn keep(system: &System, world: &World, orders: &Receiver<Order>, reporter: &Reporter) {
    let member = world.join("uorbd");
    if let Err(why) = &member {
        warn!("there are no streams: {why}");
    }
    let mut keeper = Keeper {
        system,
        member,
        kept: BTreeMap::new(),
        ours: HashMap::new(),
        dead: Vec::new(),
        cleaned: Instant::now(),
    };
    keeper.begin();
    let mut looked = Instant::now();
    loop {
        let rest = LOOK_INTERVAL.saturating_sub(looked.elapsed());
        let order = match (keeper.dead.is_empty(), keeper.kept.is_empty()) {
            (true, true) => orders.recv().map_err(|_| RecvTimeoutError::Disconnected),
            (true, false) => orders.recv_timeout(rest),
            (false, _) => orders.recv_timeout(rest.min(DEAD_LOOK_INTERVAL)),
        };
        match order {
            Ok(order) => keeper.carry_out(order, orders, reporter),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
        keeper.let_go();
        if looked.elapsed() >= LOOK_INTERVAL {
            looked = Instant::now();
            keeper.look(reporter);
        }
    }
    keeper.kept.clear();
    keeper.clean_up();
}

struct Keeper<'s> {
    system: &'s System,
    member: Result<Member, String>,
    kept: BTreeMap<NodeKey, Kept>,
    /// The process ids of our processes, by their numbers.
    ours: HashMap<u16, u32>,
    /// Those of them that are dead and not cleaned up after yet.
    dead: Vec<Dead>,
    cleaned: Instant,
}

impl Keeper<'_> {
    fn carry_out(&mut self, order: Order, orders: &Receiver<Order>, reporter: &Reporter) {
        // All that is there: who dies, dies in crowds, and is cleaned up after
        // once.
        let mut next = Some(order);
        while let Some(order) = next {
            match order {
                Order::Make(key, node) => {
                    let made = self.make(&key, node);
                    reporter.tell(News::Made(key, made));
                }
                Order::Forget(key) => _ = self.kept.remove(&key),
                Order::Ported(key) => self.connect(&key),
                Order::Save(key) => self.save(&key),
                Order::Bury(key, peer) => self.bury(&key, peer),
                Order::Joined(peer, pid) => _ = self.ours.insert(peer, pid),
                Order::Died(peer, pid) => {
                    self.ours.remove(&peer);
                    self.dead.push(Dead::new(peer, pid, self.kept.values().map(|kept| &kept.node)));
                }
                Order::Ended => {
                    self.ours.clear();
                    self.dead.clear();
                }
            }
            next = orders.try_recv().ok();
        }
    }

    /// Cleans up what a broker before us has left, but for what the dead may have
    /// sent.
    fn begin(&mut self) {
        let mut dead = Vec::new();
        self.clean_up_after_all_but(|peer, pid| {
            dead.push(Dead::before_us(peer, pid));
            true
        });
        self.dead = dead;
    }

    fn make(&mut self, key: &NodeKey, node: Arc<Node>) -> Result<(), String> {
        let member = self.member.as_ref().map_err(Clone::clone)?;
        let metadata = &node.identity.metadata;
        fail_point!("stream.making");
        let open = || open_stream(member, self.system, metadata, key.1, true);
        let (stream, events) = match open() {
            // One of the dead may have a stream open that gave way to this one.
            Err(_) if !self.dead.is_empty() => {
                self.dead.clear();
                member.clean_up(|_, _| false);
                open()
            }
            opened => opened,
        }?;
        let newest = metadata
            .layout
            .is_large()
            .then(|| Inbox::open(&stream, 1))
            .transpose()
            .map_err(|why| format!("cannot keep {}{}: iceoryx2 says {why:?}", key.0, key.1))?;
        // An adopted node has what the broker before us saw.
        let Foreigners { subscribers, publishers, .. } = node.foreigners();
        let foreign = (subscribers, publishers);
        let (executor, suspects, named) = (None, HashSet::new(), HashSet::new());
        let kept = Kept { node, stream, events, newest, foreign, executor, suspects, named };
        self.kept.insert(key.clone(), kept);
        fail_point!("stream.made");
        Ok(())
    }

    /// Maps a new port: what is sent there from now on outlives it.
    fn connect(&mut self, key: &NodeKey) {
        if let Some(kept) = self.kept.get_mut(key) {
            kept.connect();
        }
    }

    /// Keeps the newest message of a large topic in its node.
    fn save(&mut self, key: &NodeKey) {
        let Some(kept) = self.kept.get_mut(key) else { return };
        let received = kept
            .newest
            .iter_mut()
            .flat_map(|newest| std::iter::from_fn(|| newest.receive(&kept.stream)));
        for sample in received.filter(|sample| kept.node.has_port_id(sample.origin().value())) {
            let header = sample.user_header();
            let stamp = (header.publish_time_us, header.publisher);
            kept.node.save_last(header.generation, stamp, sample.payload());
            debug!(
                "keeps the last message of {}{}, generation {}",
                key.0, key.1, header.generation
            );
        }
    }

    fn bury(&mut self, key: &NodeKey, peer: u16) {
        let (Some(kept), Ok(member)) = (self.kept.get_mut(key), &self.member) else { return };
        let sent = Executor::send_for(&mut kept.executor, member, self.system, &kept.node, peer);
        if let Err(error) = sent {
            warn!("{}{}: a message of the dead was not sent: {error}", key.0, key.1);
        }
        fail_point!("stream.executed");
        kept.node.free_slots_of(peer);
        fail_point!("stream.freed");
        ring(key, &kept.node);
        // What came of it while the dead were cleaned up after would hold their
        // memory until somebody else dies.
        self.save(key);
    }

    /// Cleans up after the dead whose ports nobody needs any more.
    fn let_go(&mut self) {
        let waiting = self.dead.len();
        self.dead.retain(Dead::is_needed);
        self.dead.drain(..self.dead.len().saturating_sub(DEAD_MAX));
        if self.dead.len() < waiting {
            self.clean_up();
        }
    }

    fn clean_up(&mut self) {
        // One of ours that is dead, and of whose death nobody has told, has sent what
        // is not saved yet.
        self.clean_up_after_all_but(|peer, pid| {
            self.ours.get(&peer) == Some(&pid) || self.dead.iter().any(|dead| dead.is(peer, pid))
        });
        self.cleaned = Instant::now();
    }

    fn clean_up_after_all_but(&self, is_spared: impl FnMut(u16, u32) -> bool) {
        fail_point!("stream.cleaning");
        if let Ok(member) = &self.member {
            member.clean_up(is_spared);
            fail_point!("stream.cleaned");
        }
    }

    /// Looks who uses the streams.
    fn look(&mut self, reporter: &Reporter) {
        if self.cleaned.elapsed() >= CLEAN_UP_INTERVAL {
            self.clean_up();
        }
        let dead = self.dead.iter().map(Dead::pid);
        let ours: HashSet<u32> =
            self.ours.values().copied().chain(dead).chain([std::process::id()]).collect();
        for (key, kept) in &mut self.kept {
            kept.connect();
            if let Some(executor) = &kept.executor {
                executor.tidy();
            }
            let users = kept.stream.dynamic_config();
            let mut followers = 0;
            // The number costs nothing; most streams have no follower.
            if users.number_of_subscribers() > usize::from(kept.newest.is_some()) {
                users.list_subscribers(|subscriber| {
                    let pid = subscriber.node_id.pid::<Ipc>().map(|pid| pid.value() as u32);
                    followers += u64::from(!pid.is_ok_and(|pid| ours.contains(&pid)));
                    CallbackProgression::Continue
                });
            }
            let listeners = kept.events.dynamic_config().number_of_listeners() as u64;
            let strangers = match users.number_of_publishers() {
                0 => HashSet::new(),
                _ => kept.strangers(key),
            };
            kept.named.retain(|id| strangers.contains(id));
            kept.suspects = strangers;
            let foreign = (followers.max(listeners), kept.named.len() as u64);
            if foreign != kept.foreign {
                kept.foreign = foreign;
                reporter.tell(News::Foreign(key.clone(), foreign));
            }
        }
    }
}
