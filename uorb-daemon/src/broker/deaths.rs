//! Deaths: how the broker hears of one, and what it does then.
//!
//! A pidfd or a hang-up is only a hint. A process is dead when the file that it
//! holds locked for its lifetime is not locked any more; until then what it
//! holds stays, for it may be in the middle of a publish.

use std::collections::BTreeMap;
use std::os::fd::OwnedFd;
use std::sync::Arc;

use nix::sys::time::TimeSpec;
use nix::sys::timerfd::{Expiration, TimerSetTimeFlags};
use tracing::{debug, error, info, warn};
use uorb_core::broker_side::{Ending, Node, Role};
use uorb_core::{Layout, fail_point};

use super::{Broker, Event, ring};
use crate::connection::pidfd_of;
use crate::directory::{self, Life, Survivor};
use crate::limits::DOUBT_INTERVAL;
use crate::registry::{Estate, NodeKey};
use crate::streams::Order;

impl Broker {
    pub(super) fn watch_process(&mut self, peer: u16, pidfd: OwnedFd) {
        if self.epoll.add(&pidfd, Event::Death(peer).readable()).is_ok() {
            // Closing the old one takes it out of the epoll instance.
            self.pidfds.insert(peer, pidfd);
        }
    }

    /// A process may be dead. If it is: frees its slots, gives back what it
    /// held, and wakes whoever it may have died before waking.
    pub(super) fn bury(&mut self, peer: u16) {
        if !self.registry.is_known(peer) {
            return;
        }
        if directory::life_of(&self.system, peer) != Life::Over {
            return self.arm_doubt();
        }
        fail_point!("bury.proven");
        let name = self.registry.name_of(peer);
        let pid = self.registry.pid_of(peer);
        let Estate { advertised, subscribed } = self.registry.bury(peer);
        // What it published last, before iceoryx2 cleans up after it, and while its
        // ports are known.
        for key in &advertised {
            self.order(Order::Save(key.clone()));
        }
        self.order(Order::Died(peer, pid));
        for key in &advertised {
            // The streams' thread frees its slots, when what it had not sent is.
            match self.nodes.get(key) {
                Some(_) if self.has_stream(key) => self.order(Order::Bury(key.clone(), peer)),
                Some(node) => node.free_slots_of(peer),
                None => {}
            }
            fail_point!("bury.freed");
            self.update_counts(key);
            fail_point!("bury.counted");
            if let Some(node) = self.nodes.get(key) {
                ring(key, node);
            }
            fail_point!("bury.rung");
        }
        subscribed.iter().for_each(|key| self.update_counts(key));
        self.pidfds.remove(&peer);
        if let Some(number) = self.connected.remove(&peer) {
            self.connections.remove(&number);
        }
        let _ = std::fs::remove_file(self.system.peer(peer));
        fail_point!("bury.forgotten");
        if advertised.is_empty() {
            debug!("{name} is gone");
        } else {
            let nodes: Vec<_> = advertised.iter().map(|(t, i)| format!("{t}{i}")).collect();
            info!("{name} is gone; it had advertised {}", nodes.join(", "));
        }
    }

    /// Processes that live without a connection: a pidfd tells of the process's
    /// death, but not of the session's, which a process may end before.
    fn doubtful(&self) -> Vec<u16> {
        let peers = self.registry.peers().into_iter();
        peers.filter(|peer| !peer.connected).map(|peer| peer.peer).collect()
    }

    pub(super) fn arm_doubt(&self) {
        if self.is_deaf || !self.doubtful().is_empty() {
            let due = TimeSpec::from_duration(DOUBT_INTERVAL);
            let _ = self.doubt.set(Expiration::OneShot(due), TimerSetTimeFlags::empty());
        }
    }

    pub(super) fn look_at_the_doubtful(&mut self) {
        let _ = self.doubt.unset();
        if self.is_deaf && self.epoll.add(&self.listener, Event::Connecting.readable()).is_ok() {
            self.is_deaf = false;
        }
        for peer in self.doubtful() {
            self.bury(peer);
        }
        self.arm_doubt();
    }

    /// Takes over what the broker before us left: nodes, and processes that
    /// live. Those that died meanwhile are buried now.
    pub(super) fn adopt(&mut self, living: Vec<Survivor>) -> anyhow::Result<()> {
        living.into_iter().for_each(|survivor| self.adopt_process(survivor));
        // Who was about to join when the broker before us died lives, too, or has
        // to join anew. Before anybody is given a number.
        for peer in directory::listed(&self.system) {
            if !self.registry.is_known(peer)
                && !directory::forget(&self.system, peer)
                && let Some(survivor) = directory::survivor(&self.system, peer)
            {
                self.adopt_process(survivor);
            }
        }
        fail_point!("adopt.peers");
        let mut topics = BTreeMap::<String, Vec<Node>>::new();
        for (topic, instance) in self.system.list_nodes()? {
            match Node::open(&self.system, &topic, instance, Role::Broker) {
                Ok(node) if node.identity.system_id != self.system_id => {
                    warn!("{topic}{instance} is of another system: left alone");
                }
                Ok(node) => topics.entry(topic).or_default().push(node),
                Err(error) => error!("cannot adopt {topic}{instance}: {error}"),
            }
        }
        for (topic, nodes) in topics {
            self.adopt_topic(&topic, nodes);
        }
        // Somebody may have died between its commit and its ring, and nobody
        // would have rung for it.
        for (key, node) in &self.nodes {
            ring(key, node);
        }
        fail_point!("adopt.rung");
        // Who has died since we looked first, and whose number another process
        // may have by now.
        self.doubtful().into_iter().for_each(|peer| self.bury(peer));
        fail_point!("adopt.buried");
        if !self.nodes.is_empty() {
            let peers = self.registry.peers().len();
            info!("adopted {} nodes and {peers} processes", self.nodes.len());
        }
        Ok(())
    }

    fn adopt_process(&mut self, Survivor { peer, pid, name }: Survivor) {
        self.registry.adopt_peer(peer, pid, name);
        self.order(Order::Joined(peer, pid));
        if let Some(pidfd) = pidfd_of(pid) {
            self.watch_process(peer, pidfd);
        }
    }

    /// Takes over a topic's nodes. They have one layout, unless the broker
    /// before us died while old nodes gave way to a new one.
    fn adopt_topic(&mut self, topic: &str, nodes: Vec<Node>) {
        let is_used = |node: &&Node| {
            let publishers = node.status().publishers;
            publishers.iter().any(|publisher| self.registry.is_known(publisher.peer))
        };
        let newest = |node: &&Node| {
            let path = self.system.node(topic, node.identity.instance);
            path.metadata().and_then(|file| file.modified()).ok()
        };
        let standing = || nodes.iter().filter(|node| node.ending().is_none());
        let chosen = standing().find(is_used).or_else(|| standing().max_by_key(newest));
        let layout = chosen.map(|node| node.identity.metadata.layout.clone());
        for node in nodes {
            let key = (topic.to_string(), node.identity.instance);
            let matches = |layout: &Layout| layout.matches(&node.identity.metadata.layout);
            if node.ending().is_none() && layout.as_deref().is_some_and(matches) {
                self.adopt_node(key, node);
            } else {
                info!("{topic}{}: has given way to another layout", key.1);
                node.end(Ending::GaveWay);
                let _ = std::fs::remove_file(self.system.node(topic, key.1));
                let _ = std::fs::remove_file(self.system.bell(topic, key.1));
            }
        }
    }

    fn adopt_node(&mut self, key: NodeKey, node: Node) {
        let (dead, living): (Vec<_>, Vec<_>) =
            node.status().publishers.into_iter().partition(|p| !self.registry.is_known(p.peer));
        for publisher in dead {
            info!("{}{}: publisher {} died meanwhile", key.0, key.1, publisher.peer);
        }
        // Those included whom the broker before us had counted out already.
        node.free_slots_of_the_dead(|peer| self.registry.is_known(peer));
        let streams = node.stream_places();
        self.registry.adopt_node(node.identity.metadata.clone(), key.1, living, streams);
        self.nodes.insert(key.clone(), Arc::new(node));
        self.make_stream(&key);
        self.update_counts(&key);
        fail_point!("adopt.node");
    }
}
