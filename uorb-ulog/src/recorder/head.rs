//! What stands at the head of a file: formats of all topics that are on the bus
//! or may come, and what is known of the machine.

use std::collections::HashSet;
use std::time::{SystemTime, UNIX_EPOCH};

use uorb_core::broker_side::{Reply, Request};
use uorb_core::{Layout, Session, Topic, now_us};

use super::run::written;
use super::words::Words;
use super::{Pipe, Plan, RecordError, ReplayReady};
use crate::writer::{Head, ParameterValue, Value, Writer};

/// Under this name PX4 has what `top` shows before the flight.
const PROCESSES: &str = "perf_top_preflight";

/// PX4's parameter of the local time, in minutes.
const UTC_OFFSET: &str = "SDLOG_UTC_OFFSET";

/// Name and layout of the chosen topics that have nodes.
pub(super) fn on_the_bus(
    session: &Session,
    plan: &Plan,
) -> Result<Vec<(String, Layout)>, RecordError> {
    let mut names: Vec<String> =
        session.system().list_nodes()?.into_iter().map(|(topic, _)| topic).collect();
    names.dedup();
    // One that has gone meanwhile is not there.
    let describe = |topic: String| Some((session.describe(&topic).ok()?.layout, topic));
    let found = names.into_iter().filter_map(describe);
    let mut found: Vec<_> = found.map(|(layout, topic)| (topic, layout.into_owned())).collect();
    found.retain(|(topic, layout)| is_logged(plan, topic, layout));
    Ok(found)
}

/// Whether a topic's messages are to stand in the log as such.
fn is_logged(plan: &Plan, topic: &str, layout: &Layout) -> bool {
    plan.choice.rate(topic).is_some()
        && topic != ReplayReady::METADATA.name
        && Words::of(topic, layout).is_none()
}

/// The processes on the bus, as a table. Empty where the broker does not say.
pub(super) fn processes(session: &Session) -> Vec<String> {
    let Ok(Reply::Peers(peers)) = session.ask(Request::Peers) else { return Vec::new() };
    let title = format!("{:>7} {:<24} {:>4} {:>4}\n", "PID", "PROCESS", "PUBS", "SUBS");
    let lines = peers.iter().map(|it| {
        format!("{:>7} {:<24} {:>4} {:>4}\n", it.pid, it.name, it.publications, it.subscriptions)
    });
    std::iter::once(title).chain(lines).collect()
}

/// Begins a file: the topics of the bus first, and then those that may come.
pub(super) fn begin_file<'a>(
    plan: &Plan,
    pipe: &'a Pipe,
    mut topics: Vec<(String, Layout)>,
    processes: &[String],
) -> Writer<&'a Pipe> {
    topics.extend(plan.known.iter().filter(|(name, it)| is_logged(plan, name, it)).cloned());
    let mut names = HashSet::new();
    topics.retain(|(topic, _)| names.insert(topic.clone()));
    let head = Head {
        timestamp_us: now_us(),
        infos: infos(plan),
        topics,
        parameters: plan.parameters.clone(),
        texts: vec![(PROCESSES.to_string(), processes.to_vec())],
    };
    let writer = written(Writer::begin(pipe, &head));
    pipe.hurry();
    writer
}

/// What is known of the machine. Times are UTC, unless the vehicle says how far
/// its clock is from that.
fn infos(plan: &Plan) -> Vec<(String, Value)> {
    let read = |path| std::fs::read_to_string(path).unwrap_or_default().trim().to_string();
    let text = |text: &str| Value::Text(text.to_string());
    let utc_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let machine = format!("LINUX_{}", std::env::consts::ARCH.to_uppercase());
    let offset = plan.parameters.iter().find(|parameter| parameter.name == UTC_OFFSET);
    let offset_min = match offset.map(|parameter| parameter.value) {
        Some(ParameterValue::Int32(minutes)) => minutes,
        Some(ParameterValue::Float(minutes)) => minutes as i32,
        None => 0,
    };
    let mut infos = vec![
        ("sys_name".to_string(), text("uORB")),
        ("ver_sw".to_string(), text(env!("CARGO_PKG_VERSION"))),
        ("ver_hw".to_string(), text(&machine)),
        ("sys_os_name".to_string(), text("Linux")),
        ("sys_os_ver".to_string(), text(&read("/proc/sys/kernel/osrelease"))),
        ("time_ref_utc".to_string(), Value::Int32(offset_min.saturating_mul(60))),
        ("time_utc_s".to_string(), Value::Uint32(utc_s as u32)),
    ];
    let uuid = read("/etc/machine-id");
    if !uuid.is_empty() {
        infos.push(("sys_uuid".to_string(), text(&uuid)));
    }
    infos
}
