//! Nodes: how they come to be, who uses them, and when they give way.

use std::sync::Arc;

use tracing::{debug, error, info, warn};
use uorb_core::broker_side::{
    Advertise, BrokerStatus, Ending, FromBroker, Identity, Node, PublisherEntry, Refusal, Reply,
    Subscribe, base_of,
};
use uorb_core::{Error, Instance, Metadata, QueueLength, fail_point};

use super::streaming::Answer;
use super::{Broker, ring};
use crate::registry::{NodeKey, Plan, SubscribePlan};

impl Broker {
    pub(super) fn advertise(&mut self, peer: u16, wanted: Advertise) -> Result<Answer, Refusal> {
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
        let is_large = metadata.layout.is_large();
        self.registry.add_publisher(&key, PublisherEntry { peer, handle, priority });
        fail_point!("admit.noted");
        self.update_counts(&key);
        fail_point!("admit.counted");
        self.tell_new_publisher(&key, peer, handle);
        let reply = Reply::Advertised(key.1);
        // A large topic is nothing without its stream.
        if is_large { self.once_streaming(&key, reply) } else { Ok(Answer::Now(reply)) }
    }

    pub(super) fn subscribe(&mut self, peer: u16, wanted: &Subscribe) -> Result<Answer, Refusal> {
        match self.registry.plan_subscribe(peer, wanted)? {
            SubscribePlan::Wait => {
                self.registry.add_waiting(peer, wanted);
                Ok(Answer::Now(Reply::Waiting))
            }
            SubscribePlan::Node(plan) => {
                let key = (wanted.subject.name().to_string(), wanted.instance);
                self.carry_out(plan, &key)?;
                self.registry.add_subscriber(&key, peer, wanted.handle);
                self.update_counts(&key);
                match wanted.stream {
                    Some(wish) => self.follow_stream(&key, peer, wanted.handle, wish),
                    None => Ok(Answer::Now(Reply::Subscribed)),
                }
            }
        }
    }

    /// Makes the node that a plan needs. Only when it is made do the nodes of
    /// another layout go.
    fn carry_out(&mut self, plan: Plan, key: &NodeKey) -> Result<(), Refusal> {
        let Some(metadata) = plan.create else { return Ok(()) };
        let node = self.make_node(&metadata, key.1)?;
        if !plan.give_way.is_empty() {
            fail_point!("give_way.made");
            let give_way = match plan.give_way.len() {
                1 => "its node gives way".into(),
                count => format!("its {count} nodes give way"),
            };
            info!("{}: nobody uses the old layout any more, {give_way}", key.0);
            for old in &plan.give_way {
                self.discard(old, old != key);
                fail_point!("give_way.discarded");
            }
            self.registry.remove_topic(&key.0);
        }
        self.add_node(key, node);
        self.update_counts(key);
        self.tell_waiting(&metadata);
        Ok(())
    }

    fn add_node(&mut self, key: &NodeKey, node: Node) {
        self.registry.add_node(node.identity.metadata.clone(), key.1);
        self.nodes.insert(key.clone(), Arc::new(node));
        self.make_stream(key);
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
        self.forget_stream(key);
        node.end(Ending::GaveWay);
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
                    Ok(node) => self.add_node(&key, node),
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
    pub(super) fn update_counts(&self, key: &NodeKey) {
        if let Some(node) = self.nodes.get(key) {
            let (publishers, subscribers) = self.registry.counts(key);
            node.set_counts(publishers, subscribers);
            node.set_streams(self.registry.streams(key), self.foreign(key));
        }
    }

    pub(super) fn status(&self) -> BrokerStatus {
        BrokerStatus {
            version: env!("CARGO_PKG_VERSION").into(),
            pid: std::process::id(),
            started_us: self.started_us,
            system_id: self.system_id,
            peers: self.connected.len() as u32,
            topics: self.registry.topic_count() as u32,
            nodes: self.registry.node_count() as u32,
            advertised: self.registry.advertised_count() as u32,
            world: self.world.clone(),
            no_streams: self.no_streams(),
        }
    }
}

/// What the client library could not do, as an answer to a process.
pub(super) fn refusal_of(error: &Error) -> Refusal {
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
