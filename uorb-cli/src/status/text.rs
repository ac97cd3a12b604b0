//! What `uorb status` prints for people.

use std::io::Write;

use super::{NodeRow, Status, Streams};

pub(super) fn print(status: &Status<'_>, all: bool, out: &mut dyn Write) -> anyhow::Result<()> {
    let Status { broker, streams, peers, nodes, unreadable } = status;
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
    let Streams { prefix, root, none_because } = streams;
    match none_because {
        None => writeln!(out, "streams: iceoryx2 with prefix {prefix} and root {root}")?,
        Some(why) => writeln!(out, "streams: none: {why}")?,
    }
    writeln!(out)?;
    let shown: Vec<&NodeRow> = nodes.iter().filter(|node| all || node.advertised).collect();
    if shown.is_empty() {
        writeln!(out, "No topics advertised")?;
    } else {
        // PX4's table, 2021 and later.
        let width = shown.iter().map(|node| node.topic.len()).max().unwrap_or(0).max(10);
        let size = |node: &&NodeRow| node.size_bytes.to_string().len();
        let size_width = shown.iter().map(size).max().unwrap_or(0).max(4);
        let name = format!("{:<1$}", "TOPIC NAME", width - 2);
        writeln!(out, "{name} INST #SUB #Q {:>size_width$} PATH", "SIZE")?;
        for node in shown {
            let NodeRow { topic, instance, subscribers, queue_length, size_bytes, path, .. } = node;
            writeln!(
                out,
                "{topic:<width$} {instance:2} {subscribers:4} {queue_length:2} \
                 {size_bytes:size_width$} {path}",
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
    use super::super::Broker;
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
            streams: Streams { prefix: "iox2_", root: "/tmp/iceoryx2".into(), none_because: None },
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
streams: iceoryx2 with prefix iox2_ and root /tmp/iceoryx2

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

    #[test]
    fn why_there_are_no_streams_is_said() {
        let mut status = status(Vec::new());
        status.streams.none_because = Some("choose a shorter UORB_DIR");
        let printed = printed(&status);
        assert!(printed.contains("\nstreams: none: choose a shorter UORB_DIR\n"), "{printed}");
    }

    #[test]
    fn the_size_of_a_large_topic_has_room() {
        let mut large = node("camera", 0, 0);
        large.size_bytes = 6_220_808;
        let printed = printed(&status(vec![large, node("orb_test", 0, 0)]));
        let table: Vec<_> = printed.lines().skip(4).take(3).collect();
        assert_eq!(
            table,
            [
                "TOPIC NAME INST #SUB #Q    SIZE PATH",
                "camera      0    3  1 6220808 /obj/camera0",
                "orb_test    0    3  1      48 /obj/orb_test0",
            ]
        );
    }
}
