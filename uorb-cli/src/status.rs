//! `uorb status`: how the broker is, the nodes, and what was lost.

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

The table is PX4's: instance, subscriptions, queue length, size of a message in
bytes, and the node. Lost messages are those that were overwritten before a
subscription had copied them, since the system was started.";

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Status<'s> {
    broker: Broker<'s>,
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
        peers: peers.iter().map(Peer::new).collect(),
        nodes,
        unreadable,
    };
    if args.json {
        writeln!(out, "{}", serde_json::to_string(&status)?)?;
        return Ok(());
    }
    print(&status, args.all, out)
}

fn print(status: &Status<'_>, all: bool, out: &mut dyn Write) -> anyhow::Result<()> {
    let Status { broker, peers, nodes, unreadable } = status;
    writeln!(
        out,
        "uorbd {}, pid {}, up {}, at {}",
        broker.version,
        broker.pid,
        duration(broker.uptime_us),
        broker.directory
    )?;
    writeln!(
        out,
        "processes: {}, topics: {}, nodes: {}, advertised: {}",
        peers.len(),
        broker.topics,
        broker.nodes,
        broker.advertised
    )?;
    writeln!(out)?;
    let shown: Vec<&NodeRow> = nodes.iter().filter(|node| all || node.advertised).collect();
    if shown.is_empty() {
        writeln!(out, "No topics advertised")?;
    } else {
        // PX4's table, 2021 and later.
        let width = shown.iter().map(|node| node.topic.len()).max().unwrap_or(0).max(10);
        writeln!(out, "{:<1$} INST #SUB #Q SIZE PATH", "TOPIC NAME", width - 2)?;
        for node in shown {
            let NodeRow { topic, instance, subscribers, queue_length, size_bytes, path, .. } = node;
            writeln!(
                out,
                "{topic:<width$} {instance:2} {subscribers:4} {queue_length:2} {size_bytes:4} \
                 {path}",
            )?;
        }
    }
    for node in unreadable {
        writeln!(out, "{node}")?;
    }
    writeln!(out)?;
    // The seeds' status: what was lost, or that nothing was.
    let losers: Vec<&NodeRow> = nodes.iter().filter(|node| node.lost > 0).collect();
    if losers.is_empty() {
        writeln!(out, "No lost messages")?;
    } else {
        writeln!(out, "TOPIC, NR LOST MSGS")?;
    }
    for node in losers {
        writeln!(out, "{}{}: {}", node.topic, node.instance, node.lost)?;
    }
    Ok(())
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

/// A duration in the two largest units that it has: `3 d 4 h`, `12 s`.
fn duration(time_us: u64) -> String {
    let seconds = time_us / 1_000_000;
    let (minutes, hours, days) = (seconds / 60, seconds / 3_600, seconds / 86_400);
    match (days, hours, minutes) {
        (0, 0, 0) => format!("{seconds} s"),
        (0, 0, _) => format!("{minutes} min {} s", seconds % 60),
        (0, ..) => format!("{hours} h {} min", minutes % 60),
        _ => format!("{days} d {} h", hours % 24),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(topic: &str, instance: u8, lost: u64) -> NodeRow {
        NodeRow {
            topic: topic.into(),
            instance,
            advertised: true,
            publishers: 1,
            subscribers: 3,
            queue_length: 1,
            size_bytes: 48,
            published: 1_000,
            lost,
            path: format!("/obj/{topic}{instance}"),
        }
    }

    fn status(nodes: Vec<NodeRow>) -> Status<'static> {
        Status {
            broker: Broker {
                version: "0.1.0",
                pid: 4711,
                uptime_us: 3_725_000_000,
                directory: "/dev/shm/uorb-1000/0".into(),
                system_id: "0123456789abcdef".into(),
                topics: 2,
                nodes: 2,
                advertised: 2,
            },
            peers: Vec::new(),
            nodes,
            unreadable: Vec::new(),
        }
    }

    fn printed(status: &Status<'_>) -> String {
        let mut out = Vec::new();
        print(status, false, &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn the_table_is_px4s() {
        let mut gone = node("sensor_gyro", 0, 1);
        gone.advertised = false;
        let status = status(vec![node("sensor_mag", 0, 20), gone, node("vehicle_attitude", 1, 0)]);
        assert_eq!(
            printed(&status),
            "\
uorbd 0.1.0, pid 4711, up 1 h 2 min, at /dev/shm/uorb-1000/0
processes: 0, topics: 2, nodes: 2, advertised: 2

TOPIC NAME     INST #SUB #Q SIZE PATH
sensor_mag        0    3  1   48 /obj/sensor_mag0
vehicle_attitude  1    3  1   48 /obj/vehicle_attitude1

TOPIC, NR LOST MSGS
sensor_mag0: 20
sensor_gyro0: 1
"
        );
    }

    #[test]
    fn a_quiet_bus_says_so() {
        let printed = printed(&status(Vec::new()));
        assert!(printed.ends_with("\nNo topics advertised\n\nNo lost messages\n"), "{printed}");
    }
}
