//! What the loop does about streams: it grants places, tells publishers that
//! somebody follows, and lets requests wait until the streams' thread has made
//! what they need.

use tracing::{info, warn};
use uorb_core::broker_side::{Foreigners, FromBroker, Refusal, Reply, Wish};

use super::Broker;
use crate::registry::NodeKey;
use crate::streams::{News, Order};

/// A node's stream, as the loop knows it.
#[derive(Debug, Default)]
pub(super) struct Streaming {
    /// None until the thread has said so.
    made: Option<Result<(), String>>,
    /// Answers that wait for it: connection, request, answer.
    waiting: Vec<(u32, u32, Reply)>,
    /// Foreign programs that follow, and that publish.
    foreign: (u64, u64),
}

/// An answer to a request, now or when the node's stream is there.
#[derive(Debug)]
pub(super) enum Answer {
    Now(Reply),
    Later(NodeKey, Reply),
}

impl Broker {
    pub(super) fn order(&self, order: Order) {
        if let Some(streams) = &self.streams {
            streams.order(order);
        }
    }

    /// Has the stream of a node made.
    pub(super) fn make_stream(&mut self, key: &NodeKey) {
        let Some(node) = self.nodes.get(key) else { return };
        self.order(Order::Make(key.clone(), node.clone()));
        // Whoever followed an adopted node's stream is believed to do so still,
        // until the thread has looked: else publishers would pause for that long.
        let Foreigners { subscribers, publishers, .. } = node.foreigners();
        let streaming = Streaming { foreign: (subscribers, publishers), ..Streaming::default() };
        self.streaming.insert(key.clone(), streaming);
    }

    /// A node gave way: so does its stream.
    pub(super) fn forget_stream(&mut self, key: &NodeKey) {
        self.order(Order::Forget(key.clone()));
        let Some(streaming) = self.streaming.remove(key) else { return };
        for (number, request_number, _) in streaming.waiting {
            let what = format!("{}{} gave way to another layout", key.0, key.1);
            let reply = Reply::Refused(Refusal::NoStream { what });
            self.send(number, &FromBroker::Reply { number: request_number, reply });
        }
    }

    /// Whether a node's stream is there.
    pub(super) fn has_stream(&self, key: &NodeKey) -> bool {
        self.streaming.get(key).is_some_and(|streaming| streaming.made == Some(Ok(())))
    }

    /// An answer that says nothing before the node's stream is there.
    pub(super) fn once_streaming(&self, key: &NodeKey, reply: Reply) -> Result<Answer, Refusal> {
        match self.streaming.get(key).and_then(|streaming| streaming.made.as_ref()) {
            Some(Ok(())) => Ok(Answer::Now(reply)),
            Some(Err(what)) => Err(Refusal::NoStream { what: what.clone() }),
            None => Ok(Answer::Later(key.clone(), reply)),
        }
    }

    pub(super) fn wait_for_stream(&mut self, key: NodeKey, waiting: (u32, u32, Reply)) {
        self.streaming.entry(key).or_default().waiting.push(waiting);
    }

    /// A subscriber follows the stream of its node too.
    pub(super) fn follow_stream(
        &mut self,
        key: &NodeKey,
        peer: u16,
        handle: u32,
        wish: Wish,
    ) -> Result<Answer, Refusal> {
        let place = self.registry.add_stream(key, peer, handle, wish)?;
        if let Some(node) = self.nodes.get(key).filter(|_| wish.place.is_none()) {
            node.admit_stream(place);
        }
        self.update_counts(key);
        self.once_streaming(key, Reply::Streaming { place })
    }

    /// A subscriber has its queue.
    pub(super) fn tell_of_follower(&mut self, peer: u16, handle: u32) {
        if let Some((key, false)) = self.registry.node_of(peer, handle) {
            self.tell_publishers(&key.clone());
        }
    }

    /// Somebody has begun to follow a stream: publishers open their ports, and tell
    /// newcomers what they published last.
    fn tell_publishers(&mut self, key: &NodeKey) {
        let publishers = self.registry.counts(key).0.to_vec();
        for publisher in publishers {
            self.tell_publisher(publisher.peer, publisher.handle);
        }
    }

    fn tell_publisher(&mut self, peer: u16, handle: u32) {
        if let Some(number) = self.connected.get(&peer) {
            self.send(*number, &FromBroker::Streamed { handle });
        }
    }

    /// A publisher has been granted: it is told if somebody follows already.
    pub(super) fn tell_new_publisher(&mut self, key: &NodeKey, peer: u16, handle: u32) {
        if self.is_followed(key) && self.has_stream(key) {
            self.tell_publisher(peer, handle);
        }
    }

    /// Whether somebody follows a stream: one of ours, or a foreign program.
    fn is_followed(&self, key: &NodeKey) -> bool {
        self.registry.streams(key).iter().any(Option::is_some) || self.foreign(key).0 > 0
    }

    /// A publisher has its port, or could not open it.
    pub(super) fn note_port(&self, peer: u16, handle: u32, failure: Option<String>) {
        let Some((key, true)) = self.registry.node_of(peer, handle) else { return };
        match failure {
            None => self.order(Order::Ported(key.clone())),
            Some(failure) => {
                let name = self.registry.name_of(peer);
                warn!("{}{}: {name} cannot send on the stream: {failure}", key.0, key.1);
            }
        }
    }

    pub(super) fn foreign(&self, key: &NodeKey) -> (u64, u64) {
        self.streaming.get(key).map_or((0, 0), |streaming| streaming.foreign)
    }

    /// Why there are no streams, if none of several could be made.
    pub(super) fn no_streams(&self) -> Option<String> {
        let mut made = self.streaming.values().filter_map(|streaming| streaming.made.as_ref());
        made.find_map(|made| made.as_ref().err().cloned())
    }

    pub(super) fn hear_streams(&mut self) {
        let news = self.streams.as_ref().map(|streams| streams.news()).unwrap_or_default();
        for news in news {
            match news {
                News::Made(key, made) => self.hear_made(key, made),
                News::Foreign(key, foreign) => {
                    let Some(streaming) = self.streaming.get_mut(&key) else { continue };
                    let before = std::mem::replace(&mut streaming.foreign, foreign);
                    if foreign.0 != before.0 {
                        info!(
                            "{}{}: foreign programs that follow the stream: {}",
                            key.0, key.1, foreign.0
                        );
                    }
                    self.update_counts(&key);
                    if foreign.0 > before.0 {
                        self.tell_publishers(&key);
                    }
                }
            }
        }
    }

    fn hear_made(&mut self, key: NodeKey, made: Result<(), String>) {
        if let Err(what) = &made {
            warn!("{}{} has no stream: {what}", key.0, key.1);
        }
        let Some(streaming) = self.streaming.get_mut(&key) else { return };
        streaming.made = Some(made.clone());
        for (number, request_number, reply) in std::mem::take(&mut streaming.waiting) {
            let reply = match &made {
                Ok(()) => reply,
                Err(what) => Reply::Refused(Refusal::NoStream { what: what.clone() }),
            };
            self.send(number, &FromBroker::Reply { number: request_number, reply });
        }
        // Those who followed before a restart of the broker have their queues.
        if made.is_ok() && self.is_followed(&key) {
            self.tell_publishers(&key);
        }
    }
}
