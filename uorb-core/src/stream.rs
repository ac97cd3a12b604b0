//! The stream of a node: every message, for whoever wants every message.
//!
//! Beside its node a topic instance is an iceoryx2 publish-subscribe service of
//! the name `uorb/<system>/<topic>/<instance>`. The broker makes it; this file
//! says what is agreed upon, and how large things are. A publisher has a *port*
//! to it (`stream/port.rs`) when somebody follows the stream, and a stream
//! subscription a *reader* (`stream/reader.rs`), which also looks at the node:
//! a message is committed there before it is sent here, so generations are
//! dense, and what is missing on the stream is known exactly.
//!
//! Only files of this name, and the broker's `streams.rs`, name iceoryx2. Its
//! "node" is a process that uses it; ours is a topic instance.

#![allow(unsafe_code)]

mod inbox;
pub(crate) mod port;
pub(crate) mod reader;
mod room;
mod unconnected;
mod unfinished;
mod world;

use iceoryx2::prelude::{AttributeSpecifier, AttributeVerifier, ServiceName, ZeroCopySend};
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeCreateError;
use iceoryx2::service::port_factory;

use crate::layout::Layout;
use crate::ring::PUBLISHERS_MAX;
use crate::system::System;
use crate::topic::{Instance, Metadata};

pub use inbox::Inbox;
pub use unfinished::Unfinished;
pub use world::{Member, World};

/// The kind of iceoryx2 service: between processes, with ports that have no lock
/// of their own. Those that threads hand to each other have one of ours around
/// them, or one owner, which costs a third.
pub type Ipc = iceoryx2::service::ipc::Service;
/// An opened stream.
pub type Stream = port_factory::publish_subscribe::PortFactory<Ipc, [u8], UorbHeader>;
/// The event service of the same name, for foreign programs that want to wait.
pub type Events = port_factory::event::PortFactory<Ipc>;

/// What stands before each message on a stream, for everybody who reads there.
#[derive(Debug, Clone, Copy, Default, ZeroCopySend)]
#[repr(C)]
#[type_name("UorbHeader")]
pub struct UorbHeader {
    /// Messages published up to this one, modulo 2^32.
    pub generation: u32,
    /// The process that published it, as the broker numbers them.
    pub publisher: u32,
    /// When it was published, in microseconds of CLOCK_MONOTONIC.
    pub publish_time_us: u64,
}

// The limits of a stream, and their sums.

/// Subscriptions to one stream, those of foreign programs included; one more is
/// the broker's own.
pub const STREAMS_MAX: usize = 16;

/// Publishers that iceoryx2 lets in: ours, as many whose publications are gone and
/// whose messages are not received yet, and a few foreign ones, so that they can be
/// seen and named.
pub(crate) const PORTS_MAX: usize = 2 * PUBLISHERS_MAX as usize + 4;

/// Processes that may have a stream open: one for each port and subscription,
/// and as many that died and were not cleaned up after yet.
const MEMBERS_MAX: usize = 2 * (PORTS_MAX + STREAMS_MAX + 1);

/// What a queue may hold, in bytes of messages, if its depth is not given.
const QUEUE_BUDGET_BYTES: usize = 16 << 20;
const DEPTH_MIN: usize = 2;
const DEPTH_MAX: usize = 1_024;

/// By how much several publishers may overrun a subscription with
/// back-pressure: each may have one message under way that was let through.
pub(crate) const OVERRUN_MAX: usize = PUBLISHERS_MAX as usize;

/// Messages of one publisher that a subscription may hold at once: the one that
/// the program has borrowed, and some that came before their turn.
const BORROWED_MAX: usize = 4;

/// Messages that a publisher may write at once.
const LOANED_MAX: usize = 2;

/// iceoryx2's header, and ours. They begin at a multiple of 8, and so does the
/// message behind them. To ask iceoryx2 for such an alignment makes it keep
/// eight bytes for each byte of a message.
const HEADERS_BYTES: usize = 48 + size_of::<UorbHeader>();
const _: () = assert!(HEADERS_BYTES.is_multiple_of(8) && align_of::<UorbHeader>() == 8);

/// The deepest queue of a stream with messages of this size: 1,024 messages, or
/// as many as 16 MiB hold, but at least 2.
pub fn depth_max(size_bytes: u32) -> u32 {
    let fit = QUEUE_BUDGET_BYTES / (size_bytes as usize).max(1);
    fit.clamp(DEPTH_MIN, DEPTH_MAX) as u32
}

/// The messages that a port has memory for: all queues hold the newest ones, so
/// the deepest of them counts once; what is borrowed counts for everybody.
pub(crate) fn slots(size_bytes: u32) -> usize {
    /// What iceoryx2 was seen to need beyond the sum, and as much again.
    const MARGIN: usize = 16;
    let history = 1;
    depth_max(size_bytes) as usize
        + OVERRUN_MAX
        + (STREAMS_MAX + 1) * BORROWED_MAX
        + LOANED_MAX
        + history
        + MARGIN
}

/// The bytes from one message of a port to the next.
pub(crate) fn stride_bytes(size_bytes: u32) -> usize {
    (HEADERS_BYTES + size_bytes as usize).next_multiple_of(8)
}

/// The name of a stream, as iceoryx2 has it.
pub fn service_name(system: &System, topic: &str, instance: Instance) -> String {
    format!("uorb/{}/{topic}/{instance}", system.number())
}

fn attributes_of(metadata: &Metadata) -> [(&'static str, String); 4] {
    let layout = &metadata.layout;
    [
        ("uorb.topic", metadata.name.to_string()),
        ("uorb.hash", format!("{:#010x}", layout.message_hash)),
        ("uorb.size", layout.size_bytes.to_string()),
        ("uorb.depth", depth_max(layout.size_bytes).to_string()),
    ]
}

/// Opens a stream, or makes it. The broker does the one, everybody the other.
///
/// # Errors
///
/// What iceoryx2 says, and of which service.
pub fn open(
    member: &Member,
    system: &System,
    metadata: &Metadata,
    instance: Instance,
    make: bool,
) -> Result<(Stream, Events), String> {
    let name = service_name(system, &metadata.name, instance);
    let failed = |what: &str, why: &dyn std::fmt::Debug| {
        format!("cannot {what} the stream {name}: iceoryx2 says {why:?}")
    };
    let service_name: ServiceName = name.as_str().try_into().map_err(|why| failed("name", &why))?;
    let size_bytes = metadata.layout.size_bytes;
    let mut verifier = AttributeVerifier::new();
    let mut specifier = AttributeSpecifier::new();
    for (key, value) in attributes_of(metadata) {
        let key = key.try_into().map_err(|why| failed("describe", &why))?;
        let value = value.as_str().try_into().map_err(|why| failed("describe", &why))?;
        verifier = verifier.require(&key, &value).map_err(|why| failed("describe", &why))?;
        specifier = specifier.define(&key, &value).map_err(|why| failed("describe", &why))?;
    }
    let builder = || {
        member
            .node
            .service_builder(&service_name)
            .publish_subscribe::<[u8]>()
            .user_header::<UorbHeader>()
            .max_subscribers(STREAMS_MAX + 1)
            .max_publishers(PORTS_MAX)
            .max_nodes(MEMBERS_MAX)
            .subscriber_max_buffer_size(depth_max(size_bytes) as usize + OVERRUN_MAX)
            .subscriber_max_borrowed_samples(BORROWED_MAX)
            .history_size(usize::from(metadata.layout.is_large()))
            .enable_safe_overflow(true)
    };
    // One that a foreign program kept over a restart of the broker is opened.
    let stream = patiently(make, || match builder().open_with_attributes(&verifier) {
        Ok(stream) => Ok(stream),
        Err(not_opened) if make => {
            builder().create_with_attributes(&specifier).map_err(|why| match why {
                // A foreign program has kept one of another layout.
                PublishSubscribeCreateError::AlreadyExists => failed("open", &not_opened),
                why => failed("make", &why),
            })
        }
        Err(why) => Err(failed("open", &why)),
    })?;
    let events = || {
        member
            .node
            .service_builder(&service_name)
            .event()
            .max_listeners(STREAMS_MAX)
            .max_notifiers(PORTS_MAX)
            .max_nodes(MEMBERS_MAX)
    };
    let events = patiently(make, || match events().open() {
        Ok(events) => Ok(events),
        Err(_) if make => events().create().map_err(|why| failed("make the events of", &why)),
        Err(why) => Err(failed("open the events of", &why)),
    })?;
    Ok((stream, events))
}

/// Whoever makes a stream tries again: what one who was killed has begun is in the
/// way until `Unfinished` removes it, and each try waits half a second for it.
fn patiently<T>(make: bool, open: impl Fn() -> Result<T, String>) -> Result<T, String> {
    const TRIES: usize = 4;
    let tries = if make { TRIES } else { 1 };
    (1..tries).find_map(|_| open().ok()).map_or_else(&open, Ok)
}

/// The memory of a stream's port: for ordinary messages all that its slots take,
/// for large ones what a single subscription keeps busy. The rest is taken slot
/// by slot, when it is needed.
pub(crate) fn port_bytes(layout: &Layout) -> u64 {
    let size_bytes = layout.size_bytes;
    let slots = if layout.is_large() { DEPTH_MIN + LOANED_MAX } else { slots(size_bytes) };
    (slots * stride_bytes(size_bytes)) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_follows_the_message_size_and_the_budget() {
        assert_eq!(depth_max(16), 1_024);
        assert_eq!(depth_max(16 << 10), 1_024);
        assert_eq!(depth_max(64 << 10), 256);
        assert_eq!(depth_max(6 << 20), 2);
        assert_eq!(depth_max(200 << 20), 2);
    }
}
