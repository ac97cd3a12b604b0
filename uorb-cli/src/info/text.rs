//! What `uorb info` prints for people.

use std::io::Write;

use uorb_core::NODE_MESSAGE_MAX_BYTES;

use super::{FieldRow, Info, InstanceInfo, Process, Publisher, Subscriber};

pub(super) fn print(info: &Info, out: &mut dyn Write) -> anyhow::Result<()> {
    writeln!(out, "TOPIC: {}", info.topic)?;
    let hash = info.message_hash.as_deref().unwrap_or("unknown");
    writeln!(
        out,
        "message {}, {} bytes ({} without padding), hash {hash}, queue length {}",
        info.message, info.size_bytes, info.size_no_padding_bytes, info.queue_length
    )?;
    if info.is_large {
        writeln!(
            out,
            "its messages live on the stream: they are larger than the {NODE_MESSAGE_MAX_BYTES} \
             bytes of a node"
        )?;
    }
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
    instance.stream.print(out)?;
    instance.reach.iter().try_for_each(|crossing| crossing.print(out))?;
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
    use uorb_core::Metadata;

    use super::super::Last;
    use super::super::stream::tests::quiet;
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
            stream: quiet(),
            reach: Vec::new(),
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
  stream     uorb/0/one_of_each/0, queues of up to 1024 messages
",
                info.size_bytes,
                info.message_hash.as_deref().unwrap(),
            )
        );
    }
}
