//! Who publishes and who subscribes: the broker's one table, without any I/O.
//!
//! A request that may need files is planned first (`plan_advertise`,
//! `plan_subscribe`), which changes nothing; the broker makes the files; then
//! the table is told. So a full /dev/shm leaves the table as it was.
//!
//! Every request can come twice, after a broker has died before its answer:
//! (peer, handle) is the key, and what is in the table already is granted again.

use std::collections::{BTreeMap, BTreeSet};

use uorb_core::broker_side::{
    Advertise, Claim, Mismatch, PEER_MAX, PUBLISHERS_MAX, PeerInfo, PublisherEntry, Refusal,
    StreamEntry, Subject, Subscribe, Users, Wish,
};
use uorb_core::{INSTANCES_MAX, Instance, Layout, Metadata, Priority, STREAMS_MAX, is_topic_name};

use crate::limits::{HANDLES_MAX, NODES_MAX, PEERS_MAX, USERS_NAMED_MAX};

/// A node's key.
pub(crate) type NodeKey = (String, Instance);

#[derive(Debug, Default)]
pub(crate) struct Registry {
    peers: BTreeMap<u16, Peer>,
    topics: BTreeMap<String, Topic>,
    /// Who waits for topics that nobody has described yet: peer and handle.
    waiting: BTreeMap<String, BTreeSet<(u16, u32)>>,
    last_peer: u16,
}

#[derive(Debug)]
struct Peer {
    pid: u32,
    name: String,
    connected: bool,
    /// Set between a broker's start and the process's re-joining: the handles
    /// that it has named again so far.
    confirmed: Option<BTreeSet<u32>>,
    /// What it holds, by handle.
    held: BTreeMap<u32, Held>,
}

/// What a handle stands for.
#[derive(Clone, Debug, PartialEq)]
enum Held {
    Publication(NodeKey),
    Subscription(NodeKey),
    /// A subscription by name to a topic that nobody has described yet.
    Waiting(String, Instance),
}

#[derive(Debug)]
struct Topic {
    metadata: Metadata,
    nodes: BTreeMap<Instance, Node>,
}

#[derive(Debug, Default)]
struct Node {
    publishers: Vec<PublisherEntry>,
    subscribers: BTreeSet<(u16, u32)>,
    /// Subscribers that follow the stream too, each at its place.
    streams: [Option<StreamEntry>; STREAMS_MAX],
}

/// What must be there before a request is granted.
#[derive(Debug, PartialEq)]
pub(crate) struct Plan {
    pub(crate) instance: Instance,
    /// Nodes of another layout that no live process uses: they are removed.
    pub(crate) give_way: Vec<NodeKey>,
    /// The node to make, if it is not there.
    pub(crate) create: Option<Metadata>,
}

/// What a subscription gets.
#[derive(Debug, PartialEq)]
pub(crate) enum SubscribePlan {
    Node(Plan),
    /// Nobody has described the topic yet.
    Wait,
}

/// What a dead process leaves to be done.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Estate {
    /// Nodes that it had advertised: free its slots, ring.
    pub(crate) advertised: Vec<NodeKey>,
    /// Nodes that it had subscribed to.
    pub(crate) subscribed: Vec<NodeKey>,
}

impl Registry {
    // Peers.

    /// Enters a process under a new number.
    pub(crate) fn join(&mut self, pid: u32, name: String) -> Result<u16, Refusal> {
        if self.peers.len() >= PEERS_MAX {
            let what = "processes".into();
            return Err(Refusal::Limit { what, limit: PEERS_MAX as u32 });
        }
        // Numbers come round; 0 is nobody.
        let mut number = self.last_peer;
        loop {
            number = number % PEER_MAX + 1;
            if !self.peers.contains_key(&number) {
                break;
            }
        }
        self.last_peer = number;
        self.peers.insert(number, Peer::new(pid, name, true));
        Ok(number)
    }

    /// Enters a process that a broker before us knew and that still lives.
    pub(crate) fn adopt_peer(&mut self, number: u16, pid: u32, name: String) {
        let peer = Peer { confirmed: Some(BTreeSet::new()), ..Peer::new(pid, name, false) };
        self.peers.insert(number, peer);
        self.last_peer = self.last_peer.max(number);
    }

    /// A known process is connected again, and will name all its handles. False:
    /// it is connected already.
    pub(crate) fn rejoin(&mut self, number: u16, pid: u32, name: String) -> bool {
        let Some(peer) = self.peers.get_mut(&number).filter(|peer| !peer.connected) else {
            return false;
        };
        (peer.connected, peer.pid, peer.name) = (true, pid, name);
        peer.confirmed = Some(BTreeSet::new());
        true
    }

    /// It has named all its handles again: those that it did not are dropped.
    pub(crate) fn rejoined(&mut self, number: u16) -> Estate {
        let Some(peer) = self.peers.get_mut(&number) else { return Estate::default() };
        let Some(confirmed) = peer.confirmed.take() else { return Estate::default() };
        self.remove(number, |handle| !confirmed.contains(&handle))
    }

    /// It has hung up and may live: what it holds stays.
    pub(crate) fn disconnect(&mut self, number: u16) {
        if let Some(peer) = self.peers.get_mut(&number) {
            peer.connected = false;
        }
    }

    /// It is dead: all that it held is given back.
    pub(crate) fn bury(&mut self, number: u16) -> Estate {
        let estate = self.remove(number, |_| true);
        self.peers.remove(&number);
        estate
    }

    pub(crate) fn name_of(&self, number: u16) -> String {
        match self.peers.get(&number) {
            Some(peer) => format!("{} (pid {})", peer.name, peer.pid),
            None => format!("peer {number}"),
        }
    }

    /// Its process id; 0 where the kernel does not say.
    pub(crate) fn pid_of(&self, number: u16) -> u32 {
        self.peers.get(&number).map_or(0, |peer| peer.pid)
    }

    pub(crate) fn is_known(&self, number: u16) -> bool {
        self.peers.contains_key(&number)
    }

    /// Processes that a broker before us knew and that have not re-joined.
    fn expected(&self) -> impl Iterator<Item = u16> {
        self.peers.iter().filter(|(_, peer)| peer.confirmed.is_some()).map(|(number, _)| *number)
    }

    // Nodes.

    /// Enters a node that is there already.
    pub(crate) fn adopt_node(
        &mut self,
        metadata: Metadata,
        instance: Instance,
        publishers: Vec<PublisherEntry>,
        streams: Vec<Option<StreamEntry>>,
    ) {
        let key = (metadata.name.to_string(), instance);
        self.add_node(metadata, instance);
        for publisher in publishers {
            self.add_publisher(&key, publisher);
        }
        for (place, entry) in (0..).zip(streams) {
            let Some(StreamEntry { peer, handle, depth, back_pressure }) = entry else { continue };
            if self.is_known(peer) {
                self.add_subscriber(&key, peer, handle);
                let wish = Wish { depth, back_pressure, place: Some(place) };
                let _ = self.add_stream(&key, peer, handle, wish);
            }
        }
    }

    /// What it takes to grant a claim.
    pub(crate) fn plan_advertise(&self, peer: u16, wanted: &Advertise) -> Result<Plan, Refusal> {
        let Advertise { handle, metadata, claim, .. } = wanted;
        self.check_request(peer, metadata)?;
        match self.held(peer, *handle) {
            None => {}
            Some(Held::Publication((name, instance))) if *name == metadata.name => {
                return Ok(Plan { instance: *instance, give_way: Vec::new(), create: None });
            }
            Some(_) => return Err(handle_in_use(*handle)),
        }
        let give_way = self.give_way(metadata)?;
        // Where the old nodes give way, all instances are free.
        let topic = self.topics.get(&*metadata.name).filter(|_| give_way.is_empty());
        let instance = match claim {
            Claim::Shared(instance) => *instance,
            Claim::Lowest => Instance::all()
                .find(|instance| !topic.is_some_and(|topic| topic.is_advertised(*instance)))
                .ok_or_else(|| Refusal::InstancesTaken { topic: metadata.name.to_string() })?,
        };
        let node = topic.and_then(|topic| topic.nodes.get(&instance));
        if node.is_some_and(|node| node.publishers.len() >= PUBLISHERS_MAX as usize) {
            return Err(Refusal::PublishersTaken {
                topic: metadata.name.to_string(),
                instance,
                limit: PUBLISHERS_MAX,
            });
        }
        self.plan(instance, give_way, node.is_none(), metadata)
    }

    /// What it takes to grant a subscription.
    pub(crate) fn plan_subscribe(
        &self,
        peer: u16,
        wanted: &Subscribe,
    ) -> Result<SubscribePlan, Refusal> {
        let name = wanted.subject.name();
        match self.held(peer, wanted.handle) {
            None => {}
            Some(Held::Subscription((topic, instance)) | Held::Waiting(topic, instance))
                if topic == name && *instance == wanted.instance => {}
            Some(_) => return Err(handle_in_use(wanted.handle)),
        }
        let topic = self.topics.get(name);
        let metadata = match (&wanted.subject, topic) {
            (Subject::Described(metadata), _) => metadata,
            (Subject::Named(_), Some(topic)) => &topic.metadata,
            (Subject::Named(name), None) => {
                self.check_name(name)?;
                self.check_handles(peer)?;
                return Ok(SubscribePlan::Wait);
            }
        };
        self.check_request(peer, metadata)?;
        let give_way = self.give_way(metadata)?;
        let topic = topic.filter(|_| give_way.is_empty());
        let missing = !topic.is_some_and(|topic| topic.nodes.contains_key(&wanted.instance));
        self.plan(wanted.instance, give_way, missing, metadata).map(SubscribePlan::Node)
    }

    fn plan(
        &self,
        instance: Instance,
        give_way: Vec<NodeKey>,
        missing: bool,
        metadata: &Metadata,
    ) -> Result<Plan, Refusal> {
        if missing && self.node_count() >= NODES_MAX {
            return Err(Refusal::Limit { what: "nodes".into(), limit: NODES_MAX as u32 });
        }
        Ok(Plan { instance, give_way, create: missing.then(|| metadata.clone()) })
    }

    fn check_request(&self, peer: u16, metadata: &Metadata) -> Result<(), Refusal> {
        self.check_name(&metadata.name)?;
        metadata.layout.check()?;
        self.check_handles(peer)
    }

    fn check_name(&self, topic: &str) -> Result<(), Refusal> {
        if is_topic_name(topic) { Ok(()) } else { Err(Refusal::BadName { topic: topic.into() }) }
    }

    fn check_handles(&self, peer: u16) -> Result<(), Refusal> {
        if self.peers.get(&peer).map_or(0, |peer| peer.held.len()) >= HANDLES_MAX {
            let what = "publications and subscriptions of one process".into();
            return Err(Refusal::Limit { what, limit: HANDLES_MAX as u32 });
        }
        Ok(())
    }

    /// The nodes that a new layout replaces: all of the topic, if no live
    /// process uses any of them.
    fn give_way(&self, wanted: &Metadata) -> Result<Vec<NodeKey>, Refusal> {
        let Some(topic) = self.topics.get(&*wanted.name) else { return Ok(Vec::new()) };
        if wanted.layout.matches(&topic.metadata.layout) {
            return Ok(Vec::new());
        }
        // Who has not re-joined yet may use anything.
        let users: BTreeSet<u16> = topic.users().chain(self.expected()).collect();
        if !users.is_empty() {
            let layout = |metadata: &Metadata| Layout::clone(&metadata.layout);
            return Err(Refusal::LayoutMismatch(Box::new(Mismatch {
                topic: wanted.name.to_string(),
                ours: layout(wanted),
                theirs: layout(&topic.metadata),
                users: self.names_of(&users),
            })));
        }
        Ok(topic.nodes.keys().map(|instance| (wanted.name.to_string(), *instance)).collect())
    }

    fn names_of(&self, users: &BTreeSet<u16>) -> Vec<String> {
        let named = users.iter().take(USERS_NAMED_MAX).map(|peer| self.name_of(*peer));
        let more = users.len().saturating_sub(USERS_NAMED_MAX);
        named.chain((more > 0).then(|| format!("and {more} more"))).collect()
    }

    /// Forgets nodes that gave way.
    pub(crate) fn remove_topic(&mut self, name: &str) {
        self.topics.remove(name);
    }

    /// Enters a node that was made.
    pub(crate) fn add_node(&mut self, metadata: Metadata, instance: Instance) {
        let topic = self.topics.entry(metadata.name.to_string());
        let topic = topic.or_insert_with(|| Topic { metadata, nodes: BTreeMap::new() });
        topic.nodes.entry(instance).or_default();
    }

    /// Enters a publisher of a node that is there.
    pub(crate) fn add_publisher(&mut self, key: &NodeKey, entry: PublisherEntry) {
        let held = Held::Publication(key.clone());
        if self.hold(entry.peer, entry.handle, held)
            && let Some(node) = self.node_mut(key)
        {
            node.publishers.push(entry);
        }
    }

    /// Enters a subscriber of a node that is there.
    pub(crate) fn add_subscriber(&mut self, key: &NodeKey, number: u16, handle: u32) {
        let held = Held::Subscription(key.clone());
        if self.hold(number, handle, held)
            && let Some(node) = self.node_mut(key)
        {
            node.subscribers.insert((number, handle));
        }
    }

    /// Gives a subscriber a place among the node's streams, or the one that it
    /// has.
    pub(crate) fn add_stream(
        &mut self,
        key: &NodeKey,
        peer: u16,
        handle: u32,
        wish: Wish,
    ) -> Result<u8, Refusal> {
        let Wish { depth, back_pressure, place } = wish;
        let Some(node) = self.node_mut(key) else {
            return Err(Refusal::OutOfOrder { what: "stream".into() });
        };
        let is_ours = |entry: &StreamEntry| (entry.peer, entry.handle) == (peer, handle);
        let is_free = |place: &usize| node.streams.get(*place).is_some_and(Option::is_none);
        let held = node.streams.iter().position(|entry| entry.as_ref().is_some_and(is_ours));
        let place = held
            .or(place.map(usize::from).filter(is_free))
            .or_else(|| (0..STREAMS_MAX).find(is_free))
            .ok_or_else(|| Refusal::Limit {
                what: format!("subscriptions to the stream of {}{}", key.0, key.1),
                limit: STREAMS_MAX as u32,
            })?;
        node.streams[place] = Some(StreamEntry { peer, handle, depth, back_pressure });
        Ok(place as u8)
    }

    /// Who follows a node's stream, each at its place.
    pub(crate) fn streams(&self, key: &NodeKey) -> &[Option<StreamEntry>] {
        match self.topics.get(&key.0).and_then(|topic| topic.nodes.get(&key.1)) {
            Some(node) => &node.streams,
            None => &[],
        }
    }

    /// The node that a handle stands for, and whether it publishes there.
    pub(crate) fn node_of(&self, peer: u16, handle: u32) -> Option<(&NodeKey, bool)> {
        match self.held(peer, handle)? {
            Held::Publication(key) => Some((key, true)),
            Held::Subscription(key) => Some((key, false)),
            Held::Waiting(..) => None,
        }
    }

    /// Enters a subscription that waits for its topic.
    pub(crate) fn add_waiting(&mut self, number: u16, wanted: &Subscribe) {
        let topic = wanted.subject.name().to_string();
        let held = Held::Waiting(topic.clone(), wanted.instance);
        if self.hold(number, wanted.handle, held) {
            self.waiting.entry(topic).or_default().insert((number, wanted.handle));
        }
    }

    /// Notes what a handle stands for. False if that is noted already.
    fn hold(&mut self, number: u16, handle: u32, held: Held) -> bool {
        let Some(peer) = self.peers.get_mut(&number) else { return false };
        // What a broker before us has noted is confirmed by whoever comes back.
        if let Some(confirmed) = peer.confirmed.as_mut().filter(|_| peer.connected) {
            confirmed.insert(handle);
        }
        peer.held.insert(handle, held.clone()) != Some(held)
    }

    fn held(&self, number: u16, handle: u32) -> Option<&Held> {
        self.peers.get(&number)?.held.get(&handle)
    }

    fn node_mut(&mut self, key: &NodeKey) -> Option<&mut Node> {
        self.topics.get_mut(&key.0)?.nodes.get_mut(&key.1)
    }

    /// Subscriptions that wait for this topic, which is described now: who, by
    /// which handle, for which instance. They wait no more.
    pub(crate) fn take_waiting(&mut self, topic: &str) -> Vec<(u16, u32, Instance)> {
        let mut taken = Vec::new();
        for (number, handle) in self.waiting.remove(topic).unwrap_or_default() {
            let held = self.peers.get_mut(&number).and_then(|peer| peer.held.remove(&handle));
            if let Some(Held::Waiting(_, instance)) = held {
                taken.push((number, handle, instance));
            }
        }
        taken
    }

    /// Gives a handle back. Returns the nodes whose counts have changed.
    pub(crate) fn release(&mut self, number: u16, handle: u32) -> Estate {
        let mut estate = Estate::default();
        let peer = self.peers.get_mut(&number);
        if let Some(held) = peer.and_then(|peer| peer.held.remove(&handle)) {
            self.give_back(number, handle, held, &mut estate);
        }
        estate
    }

    fn remove(&mut self, number: u16, goes: impl Fn(u32) -> bool) -> Estate {
        let mut estate = Estate::default();
        let Some(peer) = self.peers.get_mut(&number) else { return estate };
        let gone: Vec<_> = peer.held.extract_if(.., |handle, _| goes(*handle)).collect();
        for (handle, held) in gone {
            self.give_back(number, handle, held, &mut estate);
        }
        for keys in [&mut estate.advertised, &mut estate.subscribed] {
            keys.sort();
            keys.dedup();
        }
        estate
    }

    fn give_back(&mut self, number: u16, handle: u32, held: Held, estate: &mut Estate) {
        match held {
            Held::Publication(key) => {
                if let Some(node) = self.node_mut(&key) {
                    node.publishers.retain(|entry| (entry.peer, entry.handle) != (number, handle));
                }
                estate.advertised.push(key);
            }
            Held::Subscription(key) => {
                if let Some(node) = self.node_mut(&key) {
                    node.subscribers.remove(&(number, handle));
                    for place in &mut node.streams {
                        place.take_if(|entry| (entry.peer, entry.handle) == (number, handle));
                    }
                }
                estate.subscribed.push(key);
            }
            Held::Waiting(topic, _) => {
                if let Some(waiting) = self.waiting.get_mut(&topic) {
                    waiting.remove(&(number, handle));
                    if waiting.is_empty() {
                        self.waiting.remove(&topic);
                    }
                }
            }
        }
    }

    // What people ask.

    /// A node's publishers and the number of its subscribers.
    pub(crate) fn counts(&self, key: &NodeKey) -> (&[PublisherEntry], u64) {
        match self.topics.get(&key.0).and_then(|topic| topic.nodes.get(&key.1)) {
            Some(node) => (&node.publishers, node.subscribers.len() as u64),
            None => (&[], 0),
        }
    }

    pub(crate) fn users(&self, topic: &str, instance: Instance) -> Users {
        let Some(node) = self.topics.get(topic).and_then(|topic| topic.nodes.get(&instance)) else {
            return Users::default();
        };
        let mut subscribers = BTreeMap::<u16, u32>::new();
        for (peer, _) in &node.subscribers {
            *subscribers.entry(*peer).or_default() += 1;
        }
        let publisher =
            |entry: &PublisherEntry| -> (u16, Priority) { (entry.peer, entry.priority) };
        Users {
            publishers: node.publishers.iter().map(publisher).collect(),
            subscribers: subscribers.into_iter().collect(),
        }
    }

    pub(crate) fn peers(&self) -> Vec<PeerInfo> {
        let info = |(number, peer): (&u16, &Peer)| {
            let publications =
                peer.held.values().filter(|held| matches!(held, Held::Publication(_))).count();
            PeerInfo {
                peer: *number,
                pid: peer.pid,
                name: peer.name.clone(),
                connected: peer.connected,
                publications: publications as u32,
                subscriptions: (peer.held.len() - publications) as u32,
            }
        };
        self.peers.iter().map(info).collect()
    }

    pub(crate) fn topic_count(&self) -> usize {
        self.topics.len()
    }

    pub(crate) fn node_count(&self) -> usize {
        self.topics.values().map(|topic| topic.nodes.len()).sum()
    }

    pub(crate) fn advertised_count(&self) -> usize {
        let nodes = self.topics.values().flat_map(|topic| topic.nodes.values());
        nodes.filter(|node| !node.publishers.is_empty()).count()
    }
}

/// A handle stands for one thing: whoever gives it to another has lost count.
fn handle_in_use(handle: u32) -> Refusal {
    Refusal::OutOfOrder { what: format!("handle {handle} for a second thing") }
}

impl Peer {
    fn new(pid: u32, name: String, connected: bool) -> Self {
        Self { pid, name, connected, confirmed: None, held: BTreeMap::new() }
    }
}

impl Topic {
    fn is_advertised(&self, instance: Instance) -> bool {
        self.nodes.get(&instance).is_some_and(|node| !node.publishers.is_empty())
    }

    fn users(&self) -> impl Iterator<Item = u16> {
        self.nodes.values().flat_map(|node| {
            let publishers = node.publishers.iter().map(|entry| entry.peer);
            publishers.chain(node.subscribers.iter().map(|(peer, _)| *peer))
        })
    }
}

const _: () = assert!(INSTANCES_MAX > 0 && PEERS_MAX < u16::MAX as usize);

#[cfg(test)]
mod tests {
    use std::borrow::Cow;

    use uorb_core::{Field, FieldType, QueueLength};

    use super::*;

    fn metadata(name: &'static str, field: &'static str) -> Metadata {
        let field = Field {
            name: Cow::Borrowed(field),
            ty: FieldType::Uint32,
            array_length: None,
            offset_bytes: 0,
            unit: Cow::Borrowed(""),
        };
        let layout = Layout {
            name: Cow::Borrowed(name),
            size_bytes: 4,
            message_hash: 0,
            fields: Cow::Owned(vec![field]),
        };
        Metadata {
            name: Cow::Borrowed(name),
            layout: Cow::Owned(layout),
            queue_length: QueueLength::ONE,
        }
    }

    fn advertise(handle: u32, claim: Claim) -> Advertise {
        let (metadata, priority) = (metadata("accel", "x"), Priority::DEFAULT);
        Advertise { handle, metadata, claim, priority, queue_length: None }
    }

    fn by_name(handle: u32, name: &str) -> Subscribe {
        let subject = Subject::Named(name.into());
        Subscribe { handle, subject, instance: Instance::FIRST, stream: None }
    }

    fn described(handle: u32, metadata: Metadata) -> Subscribe {
        let subject = Subject::Described(metadata);
        Subscribe { handle, subject, instance: Instance::FIRST, stream: None }
    }

    /// What the broker does with a plan, without the files.
    fn grant(registry: &mut Registry, peer: u16, wanted: &Advertise) -> Result<u8, Refusal> {
        let plan = registry.plan_advertise(peer, wanted)?;
        let key = (wanted.metadata.name.to_string(), plan.instance);
        if !plan.give_way.is_empty() {
            registry.remove_topic(&key.0);
        }
        if let Some(metadata) = plan.create {
            registry.add_node(metadata, plan.instance);
        }
        let entry = PublisherEntry { peer, handle: wanted.handle, priority: wanted.priority };
        registry.add_publisher(&key, entry);
        Ok(plan.instance.number())
    }

    fn registry(peers: u16) -> Registry {
        let mut registry = Registry::default();
        for number in 1..=peers {
            assert_eq!(registry.join(100, format!("process{number}")), Ok(number));
        }
        registry
    }

    const FIRST: Claim = Claim::Shared(Instance::FIRST);

    #[test]
    fn a_claim_that_is_asked_for_twice_is_granted_once() {
        let mut registry = registry(1);
        let claim = advertise(7, Claim::Lowest);
        assert_eq!(grant(&mut registry, 1, &claim), Ok(0));
        assert_eq!(grant(&mut registry, 1, &claim), Ok(0), "the answer was lost");
        assert_eq!(registry.counts(&("accel".into(), Instance::FIRST)).0.len(), 1);
        assert_eq!(grant(&mut registry, 1, &advertise(8, Claim::Lowest)), Ok(1));
    }

    #[test]
    fn a_plan_changes_nothing() {
        let registry = registry(1);
        for _ in 0..2 {
            let plan = registry.plan_advertise(1, &advertise(7, Claim::Lowest)).unwrap();
            assert_eq!(plan.instance, Instance::FIRST);
            assert!(plan.create.is_some());
        }
        assert_eq!(registry.node_count(), 0);
    }

    #[test]
    fn the_dead_leave_what_they_advertised_and_subscribed() {
        let mut registry = registry(2);
        let key = ("accel".to_string(), Instance::FIRST);
        grant(&mut registry, 1, &advertise(7, FIRST)).unwrap();
        grant(&mut registry, 2, &advertise(7, FIRST)).unwrap();
        registry.add_subscriber(&key, 1, 8);
        registry.add_subscriber(&key, 1, 9);
        registry.add_waiting(1, &by_name(10, "gyro"));

        let estate = registry.bury(1);

        assert_eq!(estate.advertised, vec![key.clone()]);
        assert_eq!(estate.subscribed, vec![key.clone()]);
        let (publishers, subscribers) = registry.counts(&key);
        assert_eq!(publishers.iter().map(|entry| entry.peer).collect::<Vec<_>>(), [2]);
        assert_eq!(subscribers, 0);
        assert_eq!(registry.take_waiting("gyro"), []);
        assert_eq!(registry.bury(1), Estate::default(), "nobody dies twice");
    }

    #[test]
    fn a_layout_gives_way_when_its_last_user_is_gone() {
        let mut registry = registry(2);
        grant(&mut registry, 1, &advertise(7, Claim::Lowest)).unwrap();
        grant(&mut registry, 1, &advertise(8, Claim::Lowest)).unwrap();
        let other = described(1, metadata("accel", "y"));
        let Err(Refusal::LayoutMismatch(mismatch)) = registry.plan_subscribe(2, &other) else {
            panic!("a live layout was given away");
        };
        assert_eq!(mismatch.users, ["process1 (pid 100)"]);

        registry.release(1, 7);
        assert!(registry.plan_subscribe(2, &other).is_err(), "the topic's other node is in use");
        registry.release(1, 8);

        let Ok(SubscribePlan::Node(plan)) = registry.plan_subscribe(2, &other) else {
            panic!("nobody uses it any more");
        };
        assert_eq!(plan.give_way.len(), 2);
    }

    #[test]
    fn whoever_has_not_re_joined_may_use_any_layout() {
        let mut registry = Registry::default();
        registry.adopt_peer(5, 100, "sleeper".into());
        registry.adopt_node(metadata("accel", "x"), Instance::FIRST, Vec::new(), Vec::new());
        let new = registry.join(101, "newcomer".into()).unwrap();
        assert_eq!(new, 6, "numbers of the living are not given again");
        let other = described(1, metadata("accel", "y"));
        assert!(registry.plan_subscribe(new, &other).is_err());

        assert!(registry.rejoin(5, 100, "sleeper".into()));
        assert!(registry.plan_subscribe(new, &other).is_err(), "it has not named its handles yet");
        registry.rejoined(5);

        assert!(registry.plan_subscribe(new, &other).is_ok());
        assert!(!registry.rejoin(5, 100, "impostor".into()), "it is connected");
    }

    #[test]
    fn handles_that_a_process_does_not_name_again_are_dropped() {
        let mut registry = Registry::default();
        registry.adopt_peer(5, 100, "sensors".into());
        let entry = |handle| PublisherEntry { peer: 5, handle, priority: Priority::DEFAULT };
        let both = vec![entry(1), entry(2)];
        registry.adopt_node(metadata("accel", "x"), Instance::FIRST, both, Vec::new());
        registry.rejoin(5, 100, "sensors".into());
        assert_eq!(grant(&mut registry, 5, &advertise(2, FIRST)), Ok(0));

        let key = ("accel".to_string(), Instance::FIRST);
        assert_eq!(registry.rejoined(5).advertised, vec![key.clone()]);

        let handles: Vec<_> = registry.counts(&key).0.iter().map(|entry| entry.handle).collect();
        assert_eq!(handles, [2]);
    }

    #[test]
    fn a_process_that_re_joins_the_same_broker_drops_what_it_does_not_name() {
        let mut registry = registry(1);
        let key = ("accel".to_string(), Instance::FIRST);
        grant(&mut registry, 1, &advertise(7, FIRST)).unwrap();
        registry.add_subscriber(&key, 1, 8);
        registry.disconnect(1);
        assert!(registry.rejoin(1, 100, "process1".into()));

        let estate = registry.rejoined(1);

        assert_eq!((&estate.advertised, &estate.subscribed), (&vec![key.clone()], &vec![key]));
    }

    #[test]
    fn a_handle_stands_for_one_thing() {
        let mut registry = registry(1);
        grant(&mut registry, 1, &advertise(7, FIRST)).unwrap();
        let other = Advertise { metadata: metadata("gyro", "x"), ..advertise(7, FIRST) };
        assert!(matches!(registry.plan_advertise(1, &other), Err(Refusal::OutOfOrder { .. })));
        let as_subscription = registry.plan_subscribe(1, &by_name(7, "accel"));
        assert!(matches!(as_subscription, Err(Refusal::OutOfOrder { .. })));
    }

    #[test]
    fn limits_name_themselves() {
        let mut registry = registry(1);
        for handle in 0..u32::from(INSTANCES_MAX) {
            grant(&mut registry, 1, &advertise(handle, Claim::Lowest)).unwrap();
        }
        let eleventh = registry.plan_advertise(1, &advertise(10, Claim::Lowest));
        assert_eq!(eleventh, Err(Refusal::InstancesTaken { topic: "accel".into() }));
        for handle in 100..100 + PUBLISHERS_MAX - 1 {
            grant(&mut registry, 1, &advertise(handle, FIRST)).unwrap();
        }
        let seventeenth = registry.plan_advertise(1, &advertise(200, FIRST));
        assert!(matches!(seventeenth, Err(Refusal::PublishersTaken { limit: 16, .. })));
        for handle in registry.peers()[0].publications..HANDLES_MAX as u32 {
            registry.add_waiting(1, &by_name(1_000 + handle, "gyro"));
        }
        let many = registry.plan_subscribe(1, &by_name(999, "gyro"));
        assert!(matches!(many, Err(Refusal::Limit { limit: 65_536, .. })));
        let bad = registry.plan_subscribe(1, &by_name(999, "../gyro"));
        assert!(matches!(bad, Err(Refusal::BadName { .. })));
    }
}
