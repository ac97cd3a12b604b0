//! Deaths: how the broker hears of one, and what it does then.
//!
//! A pidfd or a hang-up is only a hint. A process is dead when the file that it
//! holds locked for its lifetime is not locked any more; until then what it
//! holds stays, for it may be in the middle of a publish.

use std::os::fd::OwnedFd;

use nix::sys::epoll::{EpollEvent, EpollFlags};
use nix::sys::time::TimeSpec;
use nix::sys::timerfd::{Expiration, TimerSetTimeFlags};
use tracing::{debug, error, info, warn};
use uorb_core::broker_side::{Node, Role};

use super::{Broker, Event, ring};
use crate::connection::pidfd_of;
use crate::directory::{self, Survivor};
use crate::limits::DOUBT_INTERVAL;
use crate::registry::{Estate, NodeKey};

impl Broker {
    pub(super) fn watch_process(&mut self, peer: u16, pidfd: OwnedFd) {
        let event = EpollEvent::new(EpollFlags::EPOLLIN, Event::Death(peer).to_token());
        if self.epoll.add(&pidfd, event).is_ok() {
            // Closing the old one takes it out of the epoll instance.
            self.pidfds.insert(peer, pidfd);
        }
    }

    /// A process is dead: frees its slots, gives back what it held, and wakes
    /// whoever it may have died before waking.
    pub(super) fn bury(&mut self, peer: u16) {
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

    pub(super) fn arm_doubt(&self) {
        if !self.doubtful().is_empty() {
            let due = TimeSpec::from_duration(DOUBT_INTERVAL);
            let _ = self.doubt.set(Expiration::OneShot(due), TimerSetTimeFlags::empty());
        }
    }

    pub(super) fn look_at_the_doubtful(&mut self) {
        let _ = self.doubt.unset();
        for peer in self.doubtful() {
            if directory::lock_holder(&self.system, peer).is_none() {
                self.bury(peer);
            }
        }
        self.arm_doubt();
    }

    /// Takes over what the broker before us left: nodes, and processes that
    /// live. Those that died meanwhile are buried now.
    pub(super) fn adopt(&mut self, living: Vec<Survivor>) -> anyhow::Result<()> {
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
}
