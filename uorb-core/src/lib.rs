//! uORB between processes: publish and copy small messages on named topics
//! through shared memory.
#![deny(missing_docs)]

// The derives that `topic!` writes name this crate by its outside name.
extern crate self as uorb_core;

mod layout;
mod topic;

pub use layout::{
    Field, FieldType, FlatField, Layout, LayoutFault, MESSAGE_SIZE_MAX_BYTES, message_hash,
};
pub use topic::{
    Bool, FieldKind, INSTANCES_MAX, Instance, Message, Metadata, Priority, QueueLength,
    TOPIC_NAME_MAX_BYTES, Topic, is_topic_name,
};

#[doc(no_inline)]
pub use zerocopy;
