//! `uorb info`: a topic's fields, its instances, and who uses them.
//!
//! The register of who asks and who sends, by name and process id. The rate is
//! taken from two looks at a node: so many messages between the publish times
//! of the two newest messages that were seen.

mod reach;
mod stream;
mod text;

use std::io::Write;
use std::thread::sleep;
use std::time::Duration;

use anyhow::bail;
use clap_complete::ArgValueCandidates;
use serde::Serialize;
use uorb_core::broker_side::{Node, NodeStatus, PeerInfo, Reply, Request, Role, Users};
use uorb_core::{Error, FieldType, Instance, Layout, Metadata, Session, now_us};

use self::reach::{Crossing, crossings};
use self::stream::StreamInfo;
use crate::completions::topic_names;
use crate::context::Context;
use crate::topics;

/// Show a topic's fields, its instances, and who uses them.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The topic
    #[arg(add = ArgValueCandidates::new(topic_names))]
    topic: String,

    /// Print one JSON object instead
    #[arg(long)]
    json: bool,

    /// How long to count messages for the rate; 0 counts none
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = 0.5,
        value_parser = window,
        allow_negative_numbers = true
    )]
    window: f64,
}

const EXAMPLES: &str = "\
Examples:
  uorb info sensor_accel
  uorb info sensor_accel --window 5     a rate from more messages
  uorb info sensor_accel --json | jq '.instances[].publishers'
  uorb info sensor_accel --json | jq '.instances[].stream.followers'

A topic that was compiled in has fields before anybody uses it.

An instance's stream is an iceoryx2 service with every message. Its followers
are subscribers that have a queue of their own there: how many messages it
holds, how many they have still to receive (pending; more than it holds will be
lost), and how many were lost. Foreign programs may follow it too; what they
publish there is dropped. `uorb status` says in which world of iceoryx2 it is.

Where a `reach` runs that brings the topic in from another machine, or sends it to
others, it is said how much crosses, and what was lost; this takes a second.";

fn window(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if (0.0..=3600.0).contains(&seconds) => Ok(seconds),
        _ => Err("it is not a number from 0 to 3600".into()),
    }
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Info {
    topic: String,
    message: String,
    size_bytes: u32,
    size_no_padding_bytes: u32,
    /// PX4's, in hexadecimal digits; none where the .msg text is not known.
    message_hash: Option<String>,
    queue_length: u32,
    /// Its messages are larger than a node takes: they live on the stream.
    is_large: bool,
    fields: Vec<FieldRow>,
    instances: Vec<InstanceInfo>,
}

#[derive(Debug, Serialize)]
struct FieldRow {
    /// The path, `[]` standing for all elements of an array of messages.
    name: String,
    #[serde(rename = "type")]
    ty: String,
    /// From the start of the outermost message; of the first element.
    offset_bytes: u32,
    unit: String,
}

#[derive(Debug, Serialize)]
struct InstanceInfo {
    instance: u8,
    advertised: bool,
    queue_length: u32,
    /// Of the newest publisher; none if there is none.
    priority: Option<u8>,
    published: u64,
    lost: u64,
    rate_hz: Option<f64>,
    last: Option<Last>,
    publishers: Vec<Publisher>,
    subscribers: Vec<Subscriber>,
    stream: StreamInfo,
    /// To and from other machines.
    reach: Vec<Crossing>,
}

/// The newest message.
#[derive(Debug, Serialize)]
struct Last {
    publish_time_us: u64,
    age_us: u64,
    #[serde(flatten)]
    process: Process,
}

#[derive(Debug, Serialize)]
struct Publisher {
    #[serde(flatten)]
    process: Process,
    priority: u8,
}

#[derive(Debug, Serialize)]
struct Subscriber {
    #[serde(flatten)]
    process: Process,
    subscriptions: u32,
}

#[derive(Clone, Debug, Serialize)]
struct Process {
    peer: u16,
    /// None: it is gone.
    name: Option<String>,
    pid: Option<u32>,
}

pub(crate) fn run(args: &Args, context: &Context, out: &mut dyn Write) -> anyhow::Result<()> {
    let session = context.session()?;
    let Some(metadata) = topics::describe(&session, &args.topic)? else {
        return Err(topics::unknown(context, &args.topic));
    };
    let instances = instances(args, context, &session)?;
    let info = Info::new(&metadata, instances);
    if args.json {
        writeln!(out, "{}", serde_json::to_string(&info)?)?;
        return Ok(());
    }
    text::print(&info, out)
}

fn instances(
    args: &Args,
    context: &Context,
    session: &Session,
) -> anyhow::Result<Vec<InstanceInfo>> {
    let mut nodes = Vec::new();
    for instance in Instance::all() {
        match Node::open(&context.system, &args.topic, instance, Role::Observer) {
            Ok(node) => nodes.push(node),
            Err(Error::NoNode { .. }) => {}
            Err(error) => bail!(error),
        }
    }
    let before: Vec<NodeStatus> = nodes.iter().map(Node::status).collect();
    if !nodes.is_empty() {
        // Nothing to wait on: a subscription would be counted as one.
        sleep(Duration::from_secs_f64(args.window));
    }
    let Reply::Peers(peers) = session.ask(Request::Peers)? else {
        bail!("the broker did not say who is connected");
    };
    let mut crossings = crossings(session, &args.topic)?;
    let mut instances = Vec::new();
    for (node, before) in nodes.iter().zip(before) {
        let (topic, instance) = (args.topic.clone(), node.identity.instance);
        let Reply::Users(users) = session.ask(Request::Users { topic, instance })? else {
            bail!("the broker did not say who uses {}", node.name());
        };
        let stream = StreamInfo::new(&context.system, node, &peers);
        let now = node.status();
        let reach = crossings.extract_if(.., |it| it.is_of(instance)).collect();
        let info = InstanceInfo::new(instance, [&before, &now], &users, &peers, stream);
        instances.push(InstanceInfo { reach, ..info });
    }
    Ok(instances)
}

impl Info {
    fn new(metadata: &Metadata, instances: Vec<InstanceInfo>) -> Self {
        let layout = &metadata.layout;
        let mut fields = Vec::new();
        push_fields(&mut fields, "", 0, layout);
        Self {
            topic: metadata.name.to_string(),
            message: layout.name.to_string(),
            size_bytes: layout.size_bytes,
            size_no_padding_bytes: layout.size_no_padding_bytes(),
            message_hash: (layout.message_hash != 0)
                .then(|| format!("{:#010x}", layout.message_hash)),
            queue_length: metadata.queue_length.get(),
            is_large: layout.is_large(),
            fields,
            instances,
        }
    }
}

fn push_fields(rows: &mut Vec<FieldRow>, prefix: &str, base_bytes: u32, layout: &Layout) {
    for field in layout.fields.iter() {
        let name = format!("{prefix}{}", field.name);
        let offset_bytes = base_bytes + field.offset_bytes;
        if let FieldType::Message(nested) = &field.ty {
            let elements = if field.array_length.is_some() { "[]" } else { "" };
            push_row(rows, name.clone(), field.msg_type(), offset_bytes, &field.unit);
            push_fields(rows, &format!("{name}{elements}."), offset_bytes, nested);
        } else {
            push_row(rows, name, field.msg_type(), offset_bytes, &field.unit);
        }
    }
}

fn push_row(rows: &mut Vec<FieldRow>, name: String, ty: String, offset_bytes: u32, unit: &str) {
    rows.push(FieldRow { name, ty, offset_bytes, unit: unit.to_string() });
}

impl InstanceInfo {
    fn new(
        instance: Instance,
        [before, now]: [&NodeStatus; 2],
        users: &Users,
        peers: &[PeerInfo],
        stream: StreamInfo,
    ) -> Self {
        let process = |peer| Process::of(peer, peers);
        let now_us = now_us();
        Self {
            instance: instance.number(),
            advertised: !now.publishers.is_empty(),
            queue_length: now.queue_length.map_or(0, |length| length.get()),
            priority: now.publishers.last().map(|entry| entry.priority.0),
            published: now.published,
            lost: now.lost,
            rate_hz: rate_hz(before, now),
            last: now.newest.map(|(publish_time_us, peer, _)| Last {
                publish_time_us,
                age_us: now_us.saturating_sub(publish_time_us),
                process: process(peer),
            }),
            publishers: users
                .publishers
                .iter()
                .map(|(peer, priority)| Publisher { process: process(*peer), priority: priority.0 })
                .collect(),
            subscribers: users
                .subscribers
                .iter()
                .map(|(peer, subscriptions)| Subscriber {
                    process: process(*peer),
                    subscriptions: *subscriptions,
                })
                .collect(),
            stream,
            reach: Vec::new(),
        }
    }
}

impl Process {
    fn of(peer: u16, peers: &[PeerInfo]) -> Self {
        let known = peers.iter().find(|known| known.peer == peer);
        let pid = known.map(|known| known.pid).filter(|pid| *pid != 0);
        Self { peer, name: known.map(|known| known.name.clone()), pid }
    }
}

/// Messages a second between two looks: as many as were published from the
/// newest message of the first look to that of the second. None where that was
/// none, or where nothing had been published before.
fn rate_hz(before: &NodeStatus, now: &NodeStatus) -> Option<f64> {
    let ((from_us, ..), (to_us, ..)) = (before.newest?, now.newest?);
    let messages = now.published.checked_sub(before.published)?;
    let time_us = to_us.checked_sub(from_us)?;
    (messages > 0 && time_us > 0).then(|| messages as f64 * 1e6 / time_us as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_is_counted_between_two_messages() {
        let look = |published, newest_us: u64| NodeStatus {
            published,
            lost: 0,
            publishers: Vec::new(),
            subscribers: 0,
            queue_length: None,
            newest: (newest_us > 0).then_some((newest_us, 1, 1)),
        };
        assert_eq!(rate_hz(&look(10, 1_000_000), &look(15, 1_500_000)), Some(10.0));
        assert_eq!(rate_hz(&look(10, 1_000_000), &look(10, 1_000_000)), None);
        assert_eq!(rate_hz(&look(0, 0), &look(3, 1_000_000)), None);
    }
}
