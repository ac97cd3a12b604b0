//! Processes that are dead, and not cleaned up after yet.
//!
//! A follower maps a publisher's port when it looks at the stream, and what it has
//! not mapped goes with the port. So a dead process keeps its ports until all who
//! follow have received what was published up to its death, or for a second: as
//! the port of a publication that is gone does.

use std::sync::Arc;
use std::time::Instant;

use uorb_core::broker_side::Node;

use crate::limits::DEAD_KEPT_FOR;

#[derive(Debug)]
pub(super) struct Dead {
    peer: u16,
    pid: u32,
    died: Instant,
    /// Nodes with a port of its, and what is to be received there; of one that died
    /// before this broker began nobody knows.
    unreceived: Option<Vec<(Arc<Node>, u64)>>,
}

impl Dead {
    /// A process that has died just now, and had its ports in some of these nodes.
    pub(super) fn new<'a>(peer: u16, pid: u32, nodes: impl Iterator<Item = &'a Arc<Node>>) -> Self {
        let unreceived = nodes.filter_map(|node| Some((node.clone(), node.unreceived_of(peer)?)));
        Self { peer, pid, died: Instant::now(), unreceived: Some(unreceived.collect()) }
    }

    /// A process that was dead when this broker began.
    pub(super) fn before_us(peer: u16, pid: u32) -> Self {
        Self { peer, pid, died: Instant::now(), unreceived: None }
    }

    pub(super) fn pid(&self) -> u32 {
        self.pid
    }

    pub(super) fn is(&self, peer: u16, pid: u32) -> bool {
        (self.peer, self.pid) == (peer, pid)
    }

    /// Whether a follower may still find something in its ports.
    pub(super) fn is_needed(&self) -> bool {
        let is_unreceived = |(node, newest): &(Arc<Node>, u64)| !node.has_received(*newest);
        self.died.elapsed() < DEAD_KEPT_FOR
            && self.unreceived.as_ref().is_none_or(|nodes| nodes.iter().any(is_unreceived))
    }
}
