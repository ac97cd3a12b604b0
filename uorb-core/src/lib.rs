//! uORB between processes: publish and copy small messages on named topics
//! through shared memory.
//!
//! ```no_run
//! use std::time::Duration;
//! use uorb_core::{Publication, Session, Subscription, poll, topic};
//!
//! topic! {
//!     /// A place in space.
//!     pub struct Position = "position" { pub x: i32, pub y: i32, pub z: i32 }
//! }
//!
//! # fn main() -> Result<(), uorb_core::Error> {
//! let session = Session::connect()?; // `uorb start` has started the broker
//! let mut position = Publication::<Position>::advertise(&session)?;
//! position.publish(&Position { x: 1, y: 2, z: 3 })?;
//!
//! // In another process, as a rule.
//! let mut position = Subscription::<Position>::subscribe(&session)?;
//! while poll(&mut [&mut position], Some(Duration::from_secs(1)))? > 0 {
//!     println!("{:?}", position.copy());
//! }
//! # Ok(())
//! # }
//! ```
//!
//! The words are PX4's: a **topic** is a kind of message with a name, an
//! **instance** one of its up to ten nodes, a **node** one topic instance in
//! shared memory with its newest messages. The **broker** (`uorbd`) makes nodes
//! and says who publishes on them; it is never on the way of a message.
//!
//! Publish: `publication.rs`, `node.rs`, `ring.rs`. Copy: `subscription.rs`,
//! `node.rs`, `ring.rs`. Advertise: `publication.rs`, `session.rs`,
//! `protocol.rs`, and then the broker.
#![deny(missing_docs)]
#![deny(unsafe_code)]
#![cfg_attr(loom, allow(dead_code))]

// The derives that `topic!` writes name this crate by its outside name.
extern crate self as uorb_core;

// First: its macro is for all that follow.
#[doc(hidden)]
#[macro_use]
pub mod fail_points;

mod bell;
#[cfg(all(test, loom))]
#[allow(unsafe_code)]
mod model_check;
mod ring;
mod sync;

// loom's atomics are not 64 bits wide, so nothing is mapped where it checks.
#[cfg(not(loom))]
mod clock;
#[cfg(not(loom))]
mod descriptor;
#[cfg(not(loom))]
mod error;
#[cfg(not(loom))]
mod generation;
#[cfg(not(loom))]
mod interval;
#[cfg(not(loom))]
mod layout;
#[cfg(not(loom))]
mod link;
#[cfg(not(loom))]
mod loan;
#[cfg(not(loom))]
mod mapping;
#[cfg(not(loom))]
mod message_hash;
#[cfg(not(loom))]
mod node;
#[cfg(not(loom))]
mod node_file;
#[cfg(not(loom))]
mod poll;
#[cfg(not(loom))]
mod protocol;
#[cfg(not(loom))]
mod publication;
#[cfg(not(loom))]
mod session;
#[cfg(not(loom))]
mod stream;
#[cfg(not(loom))]
mod stream_subscription;
#[cfg(not(loom))]
mod subscription;
#[cfg(not(loom))]
mod system;
#[cfg(not(loom))]
mod topic;
#[cfg(not(loom))]
mod transport;

#[cfg(not(loom))]
pub use self::{
    clock::now_us,
    error::Error,
    generation::Generation,
    layout::{
        Field, FieldType, FlatField, Layout, LayoutFault, MESSAGE_SIZE_MAX_BYTES,
        NODE_MESSAGE_MAX_BYTES,
    },
    loan::{Loan, RawLoan},
    message_hash::message_hash,
    poll::{SPIN_VARIABLE, poll, spin_time},
    protocol::{Claim, Mismatch, PeerInfo, Refusal},
    publication::{AdvertiseOptions, Publication, RawPublication, SharedPublication},
    session::Session,
    stream::{STREAMS_MAX, UorbHeader, World, depth_max},
    stream_subscription::{StreamOptions, StreamSubscription},
    subscription::{Copied, RawSubscription, Subscription},
    system::{DIR_VARIABLE, SYSTEM_VARIABLE, System},
    topic::{
        Bool, FieldKind, INSTANCES_MAX, Instance, Message, Metadata, Priority, QueueLength,
        TOPIC_NAME_MAX_BYTES, Topic, field_name, is_topic_name,
    },
};

/// What the broker and the `uorb` command share with this crate. Not for
/// modules: it changes without notice.
#[cfg(not(loom))]
#[doc(hidden)]
pub mod broker_side {
    pub use crate::node::{
        Ending, Foreigners, Node, NodeStatus, PublisherEntry, Role, StreamEntry, StreamStatus,
        base_of,
    };
    pub use crate::node_file::{Identity, NODE_FILE_VERSION, boot_id};
    pub use crate::protocol::*;
    pub use crate::ring::{PEER_MAX, PUBLISHERS_MAX};
    pub use crate::stream::port::Executor;
    pub use crate::stream::{
        Events, Inbox, Ipc, Member, Stream, Unfinished, open as open_stream, service_name,
    };
    pub use crate::transport::{listen_as_broker, receive_packet, send_packet};
}

#[cfg(not(loom))]
#[doc(no_inline)]
pub use zerocopy;
