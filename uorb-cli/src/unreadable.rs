//! Looking at a node, where one that cannot be read must not hide the others.

use std::fmt;

use serde::Serialize;
use uorb_core::broker_side::{Node, Role};
use uorb_core::{Error, Instance, System};

/// What came of looking at a node.
pub(crate) enum Looked {
    Open(Box<Node>),
    /// It gave way to another while we looked.
    Gone,
    Unreadable(Unreadable),
}

/// A node whose file is not what this program can read. `--json` prints it as
/// it is here.
#[derive(Debug, Serialize)]
pub(crate) struct Unreadable {
    pub(crate) topic: String,
    instance: u8,
    /// Why.
    error: String,
}

/// Looks at a node.
///
/// # Errors
///
/// What is not the node's fault: this process has no descriptors left.
pub(crate) fn look_at(system: &System, topic: &str, instance: Instance) -> Result<Looked, Error> {
    match Node::open(system, topic, instance, Role::Observer) {
        Ok(node) => Ok(Looked::Open(Box::new(node))),
        Err(Error::NoNode { .. }) => Ok(Looked::Gone),
        Err(error @ Error::NoDescriptors { .. }) => Err(error),
        Err(error) => Ok(Looked::Unreadable(Unreadable {
            topic: topic.into(),
            instance: instance.number(),
            error: error.to_string(),
        })),
    }
}

impl fmt::Display for Unreadable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}: {}", self.topic, self.instance, self.error)
    }
}
