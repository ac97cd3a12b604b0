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
    /// Nodes with a port of its, and what is to be received there.
    unreceived: Vec<(Arc<Node>, u64)>,
}

impl Dead {
    /// A process that has died just now, and had its ports in some of these nodes.
    pub(super) fn new<'a>(peer: u16, pid: u32, nodes: impl Iterator<Item = &'a Arc<Node>>) -> Self {
        let unreceived = nodes.filter_map(|node| Some((node.clone(), node.unreceived_of(peer)?)));
        Self { peer, pid, died: Instant::now(), unreceived: unreceived.collect() }
    }

    pub(super) fn pid(&self) -> u32 {
        self.pid
    }

    pub(super) fn is(&self, peer: u16, pid: u32) -> bool {
        (self.peer, self.pid) == (peer, pid)
    }

    /// Whether a follower may still find something in its ports.
    pub(super) fn is_needed(&self) -> bool {
        let mut unreceived = self.unreceived.iter();
        self.died.elapsed() < DEAD_KEPT_FOR
            && unreceived.any(|(node, newest)| !node.has_received(*newest))
    }

    /// Nobody is to receive anything of this node any more.
    pub(super) fn forget(&mut self, gone: &Arc<Node>) {
        self.unreceived.retain(|(node, _)| !Arc::ptr_eq(node, gone));
    }
}
