//! All nodes of a system, kept open from one look to the next.
//!
//! The broker is not asked: who is measured is not disturbed, and a broker that
//! has died does not blind the one who looks for the reason.

use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;

use nix::sys::resource::{Resource, getrlimit, setrlimit};
use uorb_core::broker_side::{Node, NodeStatus};
use uorb_core::{Error, Instance, System, now_us};

use super::model::{Look, Name, Seen, Selection, Stream};
use crate::unreadable::{Looked, Unreadable, look_at};

#[derive(Debug)]
pub(super) struct Nodes {
    system: System,
    open: BTreeMap<Name, Open>,
    /// Those that the last look could not read.
    unreadable: Vec<Unreadable>,
}

#[derive(Debug)]
struct Open {
    node: Node,
    inode: u64,
}

impl Nodes {
    pub(super) fn new(system: &System) -> Self {
        // A node without a publisher keeps its file open, and there may be ten
        // of a topic. Where it cannot be raised, the limit names itself later.
        if let Ok((soft, hard)) = getrlimit(Resource::RLIMIT_NOFILE)
            && soft < hard
        {
            let _ = setrlimit(Resource::RLIMIT_NOFILE, hard, hard);
        }
        Self { system: system.clone(), open: BTreeMap::new(), unreadable: Vec::new() }
    }

    /// Whether there is a system, be there nodes or not.
    pub(super) fn exist(&self) -> bool {
        self.system.nodes().exists()
    }

    /// Looks at all nodes that there are now.
    pub(super) fn look(&mut self) -> Result<Look, Error> {
        let mut look = Look::new();
        let mut before = std::mem::take(&mut self.open);
        self.unreadable.clear();
        for (topic, instance) in self.system.list_nodes()? {
            let Some(inode) = self.inode(&topic, instance) else { continue };
            let name = Name { topic, instance: instance.number() };
            // A node that gave way to another has left its name to it.
            let kept = before.remove(&name).filter(|open| open.inode == inode);
            let open = match kept {
                Some(open) => open,
                None => match look_at(&self.system, &name.topic, instance)? {
                    Looked::Open(node) => Open { node: *node, inode },
                    Looked::Gone => continue,
                    Looked::Unreadable(node) => {
                        self.unreadable.push(node);
                        continue;
                    }
                },
            };
            look.insert(name.clone(), open.seen());
            self.open.insert(name, open);
        }
        Ok(look)
    }

    /// The nodes that the last look could not read, of those that are meant.
    pub(super) fn unreadable(&self, selection: &Selection) -> Vec<&Unreadable> {
        self.unreadable.iter().filter(|node| selection.is_named(&node.topic)).collect()
    }

    fn inode(&self, topic: &str, instance: Instance) -> Option<u64> {
        let metadata = std::fs::metadata(self.system.node(topic, instance)).ok()?;
        Some(metadata.ino())
    }
}

impl Open {
    fn seen(&self) -> Seen {
        let at_us = now_us();
        let NodeStatus { published, lost, publishers, subscribers, queue_length, .. } =
            self.node.status();
        Seen {
            inode: self.inode,
            at_us,
            published,
            lost,
            publishers: publishers.len(),
            subscribers,
            queue_length: queue_length.map_or(0, |length| length.get()),
            size_bytes: self.node.identity.metadata.layout.size_bytes,
            stream: self.stream(),
        }
    }

    fn stream(&self) -> Stream {
        let ours = self.node.streams();
        Stream {
            followers: ours.len() as u64 + self.node.foreigners().subscribers,
            depth: ours.iter().map(|stream| stream.entry.depth).max().unwrap_or(0),
            lost: ours.iter().map(|stream| stream.lost).sum(),
        }
    }
}
