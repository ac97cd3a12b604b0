//! A program that knows iceoryx2 and nothing of ours.
//!
//! It lives in the process of the story, which is foreign as long as it has no
//! session of its own.

use uorb_core::broker_side::{Member, Node, Role, Stream, open_stream};
use uorb_core::{Instance, System, World};

/// A foreign program on the stream of an instance 0.
#[derive(Debug)]
pub struct Foreigner {
    stream: Stream,
    size_bytes: usize,
    _member: Member,
}

impl Foreigner {
    /// Opens the stream of a topic that has a node.
    pub fn open(system: &System, topic: &str) -> Self {
        let node = Node::open(system, topic, Instance::FIRST, Role::Observer).expect("a node");
        let metadata = &node.identity.metadata;
        let member = World::of(system).join("foreigner").expect("a folder and a prefix");
        let (stream, _) = open_stream(&member, system, metadata, Instance::FIRST, false)
            .expect("the broker has made it");
        Self { stream, size_bytes: metadata.layout.size_bytes as usize, _member: member }
    }

    /// Follows the stream, until what it returns is dropped.
    pub fn follow(&self) -> impl Sized {
        self.stream.subscriber_builder().create().expect("one more")
    }

    /// Becomes a publisher. Each call of what it returns sends a message.
    pub fn publish(&self) -> impl Fn() {
        let size_bytes = self.size_bytes;
        let builder = self.stream.publisher_builder().initial_max_slice_len(size_bytes);
        let publisher = builder.create().expect("one more");
        move || {
            let message = publisher.loan_slice_uninit(size_bytes).expect("memory");
            message.write_from_fn(|_| 0xff).send().expect("sent");
        }
    }
}
