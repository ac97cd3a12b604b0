//! `uorb info`: a topic's fields, its instances, and who uses them.
//!
//! The register of who asks and who sends, by name and process id. The rate is
//! taken from two looks at a node: so many messages between the publish times
//! of the two newest messages that were seen.

use std::io::Write;
use std::thread::sleep;
use std::time::Duration;

use anyhow::bail;
use clap_complete::ArgValueCandidates;
use serde::Serialize;
use uorb_core::broker_side::{Node, NodeStatus, PeerInfo, Reply, Request, Role, Users};
use uorb_core::{Error, FieldType, Instance, Layout, Metadata, Session, now_us};

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
    #[arg(long, value_name = "SECONDS", default_value_t = 0.5, value_parser = window)]
    window: f64,
}

const EXAMPLES: &str = "\
Examples:
  uorb info sensor_accel
  uorb info sensor_accel --window 5     a rate from more messages
  uorb info sensor_accel --json | jq '.instances[].publishers'

A topic that was compiled in has fields before anybody uses it.";

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
    print(&info, out)
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
    let mut instances = Vec::new();
    for (node, before) in nodes.iter().zip(before) {
        let (topic, instance) = (args.topic.clone(), node.identity.instance);
        let Reply::Users(users) = session.ask(Request::Users { topic, instance })? else {
            bail!("the broker did not say who uses {}", node.name());
        };
        instances.push(InstanceInfo::new(instance, &before, &node.status(), &users, &peers));
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
        before: &NodeStatus,
        now: &NodeStatus,
        users: &Users,
        peers: &[PeerInfo],
    ) -> Self {
        let process = |peer: u16| {
            let known = peers.iter().find(|known| known.peer == peer);
            let pid = known.map(|known| known.pid).filter(|pid| *pid != 0);
            Process { peer, name: known.map(|known| known.name.clone()), pid }
        };
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
        }
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

fn print(info: &Info, out: &mut dyn Write) -> anyhow::Result<()> {
    writeln!(out, "TOPIC: {}", info.topic)?;
    let hash = info.message_hash.as_deref().unwrap_or("unknown");
    writeln!(
        out,
        "message {}, {} bytes ({} without padding), hash {hash}, queue length {}",
        info.message, info.size_bytes, info.size_no_padding_bytes, info.queue_length
    )?;
    writeln!(out)?;
    print_fields(info, out)?;
    writeln!(out)?;
    if info.instances.is_empty() {
        writeln!(out, "no instance: nobody has advertised it or subscribed to it")?;
    }
    for instance in &info.instances {
        print_instance(instance, out)?;
    }
    Ok(())
}

fn print_fields(info: &Info, out: &mut dyn Write) -> anyhow::Result<()> {
    if info.fields.is_empty() {
        writeln!(out, "untyped: nobody who uses it gave a field list")?;
        return Ok(());
    }
    let width = |of: fn(&FieldRow) -> &str, least| {
        info.fields.iter().map(|row| of(row).chars().count()).max().unwrap_or(0).max(least)
    };
    let name_width = width(|row| &row.name, 5);
    let type_width = width(|row| &row.ty, 4);
    let head = format!("OFFSET {:type_width$} {:name_width$} UNIT", "TYPE", "FIELD");
    writeln!(out, "{head}")?;
    for FieldRow { name, ty, offset_bytes, unit } in &info.fields {
        let row = format!("{offset_bytes:6} {ty:type_width$} {name:name_width$} {unit}");
        writeln!(out, "{}", row.trim_end())?;
    }
    Ok(())
}

fn print_instance(instance: &InstanceInfo, out: &mut dyn Write) -> anyhow::Result<()> {
    let InstanceInfo { advertised, priority, published, lost, queue_length, .. } = instance;
    write!(out, "instance {}: ", instance.instance)?;
    match priority {
        Some(priority) if *advertised => write!(out, "advertised, priority {priority}")?,
        _ => write!(out, "not advertised")?,
    }
    write!(out, ", queue length {queue_length}, published {published}, lost {lost}")?;
    match instance.rate_hz {
        Some(rate_hz) => writeln!(out, ", {rate_hz:.1} Hz")?,
        None => writeln!(out)?,
    }
    if let Some(last) = &instance.last {
        let seconds = last.age_us as f64 / 1e6;
        writeln!(out, "  last message {seconds:.6} seconds ago by {}", last.process)?;
    }
    for Publisher { process, priority } in &instance.publishers {
        writeln!(out, "  publisher  {process}, priority {priority}")?;
    }
    for Subscriber { process, subscriptions } in &instance.subscribers {
        match subscriptions {
            1 => writeln!(out, "  subscriber {process}")?,
            several => writeln!(out, "  subscriber {process}, {several} subscriptions")?,
        }
    }
    Ok(())
}

impl std::fmt::Display for Process {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (&self.name, self.pid) {
            (Some(name), Some(pid)) => write!(f, "{name} (pid {pid})"),
            (Some(name), None) => write!(f, "{name}"),
            (None, _) => write!(f, "a process that is gone"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fields::samples;

    fn process(name: &str, pid: u32) -> Process {
        Process { peer: 1, name: Some(name.into()), pid: Some(pid) }
    }

    #[test]
    fn a_topic_is_shown_with_its_users() {
        let (layout, _) = samples::one_of_each();
        let metadata = Metadata {
            name: "one_of_each".into(),
            layout: std::borrow::Cow::Owned(layout),
            queue_length: uorb_core::QueueLength::ONE,
        };
        let mut info = Info::new(&metadata, Vec::new());
        info.fields.retain(|row| row.name.starts_with("point") || row.name == "timestamp");
        info.fields[0].unit = "us".into();
        info.instances.push(InstanceInfo {
            instance: 0,
            advertised: true,
            queue_length: 1,
            priority: Some(100),
            published: 1_234,
            lost: 5,
            rate_hz: Some(249.96),
            last: Some(Last {
                publish_time_us: 1,
                age_us: 4_361,
                process: process("sensor_sim", 4711),
            }),
            publishers: vec![Publisher { process: process("sensor_sim", 4711), priority: 100 }],
            subscribers: vec![
                Subscriber { process: process("sensors", 4712), subscriptions: 1 },
                Subscriber { process: process("logger", 4713), subscriptions: 2 },
            ],
        });
        let mut out = Vec::new();
        print(&info, &mut out).unwrap();
        assert_eq!(
            String::from_utf8(out).unwrap(),
            format!(
                "\
TOPIC: one_of_each
message one_of_each, {} bytes ({0} without padding), hash {}, queue length 1

OFFSET TYPE     FIELD      UNIT
     0 uint64   timestamp  us
    70 point    point
    70 int32    point.x
    74 uint8    point.y
    75 point[2] points
    75 int32    points[].x
    79 uint8    points[].y

instance 0: advertised, priority 100, queue length 1, published 1234, lost 5, 250.0 Hz
  last message 0.004361 seconds ago by sensor_sim (pid 4711)
  publisher  sensor_sim (pid 4711), priority 100
  subscriber sensors (pid 4712)
  subscriber logger (pid 4713), 2 subscriptions
",
                info.size_bytes,
                info.message_hash.as_deref().unwrap(),
            )
        );
    }

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
