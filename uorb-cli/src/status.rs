//! `uorb status`: how the broker is, the nodes, and what was lost.

mod text;

use std::borrow::Cow;
use std::fs::File;
use std::io::Write;

use anyhow::bail;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;
use serde::Serialize;
use uorb_core::broker_side::{BrokerStatus, Node, NodeStatus, PeerInfo, Reply, Request};
use uorb_core::{Error, System, now_us};

use crate::context::Context;
use crate::unreadable::{Looked, Unreadable, look_at};

/// Show the broker, the processes, the nodes, and what was lost.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// Show all nodes in the table, not only those that are advertised
    #[arg(short, long)]
    all: bool,

    /// Print one JSON object instead, with all nodes
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  uorb status
  uorb status --json | jq .broker.pid
  uorb status --json | jq .streams      # for a foreign program's configuration

The table is PX4's: instance, subscriptions, queue length, size of a message in
bytes, and the node. Lost messages are those that were overwritten before a
subscription had copied them, since the system was started.

The streams are in a world of iceoryx2: whoever uses its prefix and its root can
follow them.";

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Status<'s> {
    broker: Broker<'s>,
    streams: Streams<'s>,
    peers: Vec<Peer<'s>>,
    nodes: Vec<NodeRow>,
    /// Nodes whose files cannot be read.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    unreadable: Vec<Unreadable>,
}

#[derive(Debug, Serialize)]
struct Broker<'s> {
    version: &'s str,
    pid: u32,
    uptime_us: u64,
    directory: String,
    /// In hexadecimal digits, as in broker.lock: too long for many readers.
    system_id: String,
    topics: u32,
    nodes: u32,
    advertised: u32,
}

/// The world of iceoryx2 in which the streams are.
#[derive(Debug, Serialize)]
struct Streams<'s> {
    prefix: &'s str,
    root: Cow<'s, str>,
    /// Why there are none, where that is so.
    none_because: Option<&'s str>,
}

#[derive(Debug, Serialize)]
struct Peer<'s> {
    peer: u16,
    name: &'s str,
    pid: u32,
    connected: bool,
    publications: u32,
    subscriptions: u32,
}

#[derive(Debug, Serialize)]
struct NodeRow {
    topic: String,
    instance: u8,
    advertised: bool,
    publishers: usize,
    subscribers: u64,
    /// 0 before the first publisher.
    queue_length: u32,
    size_bytes: u32,
    published: u64,
    lost: u64,
    path: String,
}

pub(crate) fn run(args: &Args, context: &Context, out: &mut dyn Write) -> anyhow::Result<()> {
    match show(args, context, out) {
        Err(error) if matches!(error.downcast_ref(), Some(Error::NoAnswer { .. })) => {
            match lock_holder(&context.system) {
                Some(pid) => bail!("the broker, pid {pid}, does not answer: it may be stopped"),
                None => Err(error),
            }
        }
        shown => shown,
    }
}

/// Who has the broker's lock: a broker that does not answer has a pid, too.
fn lock_holder(system: &System) -> Option<libc::pid_t> {
    let file = File::options().read(true).write(true).open(system.lock()).ok()?;
    let mut lock = libc::flock {
        l_type: libc::F_WRLCK as libc::c_short,
        l_whence: libc::SEEK_SET as libc::c_short,
        l_start: 0,
        l_len: 0,
        l_pid: 0,
    };
    fcntl(&file, FcntlArg::F_GETLK(&mut lock)).ok()?;
    (lock.l_type != libc::F_UNLCK as libc::c_short).then_some(lock.l_pid)
}

fn show(args: &Args, context: &Context, out: &mut dyn Write) -> anyhow::Result<()> {
    let session = context.session()?;
    let Reply::Status(broker) = session.ask(Request::Status)? else {
        bail!("the broker did not say how it is");
    };
    let Reply::Peers(mut peers) = session.ask(Request::Peers)? else {
        bail!("the broker did not say who is connected");
    };
    // This command is not what was asked about.
    peers.retain(|peer| peer.peer != session.peer());
    let (nodes, unreadable) = nodes(&context.system)?;
    let status = Status {
        broker: Broker::new(&broker, &context.system),
        streams: Streams::new(&broker),
        peers: peers.iter().map(Peer::new).collect(),
        nodes,
        unreadable,
    };
    if args.json {
        writeln!(out, "{}", serde_json::to_string(&status)?)?;
        return Ok(());
    }
    text::print(&status, args.all, out)
}

fn nodes(system: &System) -> Result<(Vec<NodeRow>, Vec<Unreadable>), Error> {
    let (mut rows, mut unreadable) = (Vec::new(), Vec::new());
    for (topic, instance) in system.list_nodes()? {
        match look_at(system, &topic, instance)? {
            Looked::Open(node) => rows.push(NodeRow::new(&node)),
            Looked::Gone => {}
            Looked::Unreadable(node) => unreadable.push(node),
        }
    }
    Ok((rows, unreadable))
}

impl NodeRow {
    fn new(node: &Node) -> Self {
        let NodeStatus { published, lost, publishers, subscribers, queue_length, .. } =
            node.status();
        Self {
            topic: node.identity.metadata.name.to_string(),
            instance: node.identity.instance.number(),
            advertised: !publishers.is_empty(),
            publishers: publishers.len(),
            subscribers,
            queue_length: queue_length.map_or(0, |length| length.get()),
            size_bytes: node.identity.metadata.layout.size_bytes,
            published,
            lost,
            path: format!("/obj/{}", node.name()),
        }
    }
}

impl<'s> Broker<'s> {
    fn new(status: &'s BrokerStatus, system: &System) -> Self {
        let BrokerStatus { version, pid, started_us, system_id, topics, nodes, advertised, .. } =
            status;
        Self {
            version,
            pid: *pid,
            uptime_us: now_us().saturating_sub(*started_us),
            directory: system.to_string(),
            system_id: format!("{system_id:016x}"),
            topics: *topics,
            nodes: *nodes,
            advertised: *advertised,
        }
    }
}

impl<'s> Streams<'s> {
    fn new(BrokerStatus { world, no_streams, .. }: &'s BrokerStatus) -> Self {
        Self {
            prefix: &world.prefix,
            // The default world's ends in a slash, which others do without.
            root: world.root.components().as_path().to_string_lossy(),
            none_because: no_streams.as_deref(),
        }
    }
}

impl<'s> Peer<'s> {
    fn new(info: &'s PeerInfo) -> Self {
        let PeerInfo { peer, pid, name, connected, publications, subscriptions } = info;
        Self {
            peer: *peer,
            name,
            pid: *pid,
            connected: *connected,
            publications: *publications,
            subscriptions: *subscriptions,
        }
    }
}
