//! From two looks at the nodes to what happened between them.
//!
//! Nothing here knows where the nodes are or how they are shown.

use std::collections::BTreeMap;

use serde::Serialize;
use uorb_core::now_us;

/// Which node. In the order of the paths.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Name {
    pub(super) topic: String,
    pub(super) instance: u8,
}

/// What was seen of a node.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// Which file it was: another one under the same name is another node.
    pub(super) inode: u64,
    pub(super) at_us: u64,
    pub(super) published: u64,
    pub(super) lost: u64,
    pub(super) publishers: usize,
    pub(super) subscribers: u64,
    /// 0 before the first publisher.
    pub(super) queue_length: u32,
    pub(super) size_bytes: u32,
    pub(super) stream: Stream,
}

/// What was seen of a node's stream. JSON's members begin with `stream_`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct Stream {
    /// Who follows it, foreign programs included.
    #[serde(rename = "stream_followers")]
    pub(super) followers: u64,
    /// How many messages the deepest of their queues holds; 0 where there is
    /// none, and of foreign programs nobody knows.
    #[serde(rename = "stream_depth")]
    pub(super) depth: u32,
    /// Messages that those who follow it now have lost: part of what the node's
    /// subscriptions have lost.
    #[serde(rename = "stream_lost")]
    pub(super) lost: u64,
}

/// One look at all nodes.
#[derive(Debug)]
pub(super) struct Look {
    /// When it began.
    at_us: u64,
    nodes: BTreeMap<Name, Seen>,
}

impl Look {
    pub(super) fn new() -> Self {
        Self { at_us: now_us(), nodes: BTreeMap::new() }
    }

    pub(super) fn insert(&mut self, name: Name, seen: Seen) {
        self.nodes.insert(name, seen);
    }
}

/// One node in an update. `--json` prints it as it is here.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Row {
    pub(super) topic: String,
    pub(super) instance: u8,
    pub(super) subscribers: u64,
    /// Messages published, a second.
    pub(super) rate_hz: f64,
    /// Messages lost by all subscriptions together, a second.
    pub(super) lost_per_s: f64,
    pub(super) queue_length: u32,
    pub(super) size_bytes: u32,
    /// Thousands of bytes published, a second.
    pub(super) kb_per_s: f64,
    pub(super) publishers: usize,
    /// Messages published since the node was made.
    pub(super) published: u64,
    /// Messages lost since the node was made.
    pub(super) lost: u64,
    pub(super) advertised: bool,
    #[serde(flatten)]
    pub(super) stream: Stream,
}

/// What happened between two looks, node by node.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Update {
    /// The time between them, in seconds.
    pub(super) dt_s: f64,
    /// All nodes there are, or all that a filter lets through: more than are
    /// shown.
    pub(super) num_topics: usize,
    pub(super) topics: Vec<Row>,
}

impl Update {
    pub(super) fn between(before: &Look, after: &Look) -> Self {
        let topics: Vec<Row> = after
            .nodes
            .iter()
            .map(|(name, now)| {
                let then = before.nodes.get(name).filter(|then| then.inode == now.inode);
                // One that was not there before has published all since then.
                let (then_us, published, lost) = then
                    .map_or((before.at_us, 0, 0), |then| (then.at_us, then.published, then.lost));
                let dt_s = seconds(then_us, now.at_us);
                let per_second = |count: u64| if dt_s > 0.0 { count as f64 / dt_s } else { 0.0 };
                let rate_hz = per_second(now.published.saturating_sub(published));
                Row {
                    topic: name.topic.clone(),
                    instance: name.instance,
                    subscribers: now.subscribers,
                    rate_hz,
                    lost_per_s: per_second(now.lost.saturating_sub(lost)),
                    queue_length: now.queue_length,
                    size_bytes: now.size_bytes,
                    kb_per_s: rate_hz * f64::from(now.size_bytes) / 1e3,
                    publishers: now.publishers,
                    published: now.published,
                    lost: now.lost,
                    advertised: now.publishers > 0,
                    stream: now.stream,
                }
            })
            .collect();
        Self { dt_s: seconds(before.at_us, after.at_us), num_topics: topics.len(), topics }
    }

    /// Only what is to be shown.
    pub(super) fn select(mut self, selection: &Selection) -> Self {
        self.topics.retain(|row| selection.is_named(&row.topic));
        self.num_topics = self.topics.len();
        self.topics.retain(|row| selection.is_shown(row));
        self
    }
}

fn seconds(from_us: u64, to_us: u64) -> f64 {
    to_us.saturating_sub(from_us) as f64 / 1e6
}

/// Which nodes to show: those that publish, all, or all whose name has one of
/// these texts in it.
#[derive(Clone, Debug, Default)]
pub(super) struct Selection {
    pub(super) all: bool,
    pub(super) filters: Vec<String>,
}

impl Selection {
    pub(super) fn is_named(&self, topic: &str) -> bool {
        self.filters.is_empty() || self.filters.iter().any(|filter| topic.contains(&**filter))
    }

    fn is_shown(&self, row: &Row) -> bool {
        self.all || !self.filters.is_empty() || row.rate_hz > 0.0
    }
}

/// By what the rows are sorted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Column {
    Name,
    Rate,
    Lost,
    Subscribers,
}

/// Sorts rows that are in the order of their names: those that are equal stay
/// in it, and so do those that look equal, or they would change places with
/// every update. Numbers come largest first, unless it is turned round.
pub(super) fn sort(rows: &mut [Row], by: Column, is_turned: bool) {
    rows.sort_by(|a, b| {
        let order = match by {
            Column::Name => (&a.topic, a.instance).cmp(&(&b.topic, b.instance)),
            Column::Rate => b.rate_hz.round().total_cmp(&a.rate_hz.round()),
            Column::Lost => b.lost_per_s.round().total_cmp(&a.lost_per_s.round()),
            Column::Subscribers => b.subscribers.cmp(&a.subscribers),
        };
        if is_turned { order.reverse() } else { order }
    });
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    fn seen(at_us: u64, published: u64, lost: u64) -> Seen {
        Seen {
            inode: 1,
            at_us,
            published,
            lost,
            publishers: 1,
            subscribers: 2,
            queue_length: 4,
            size_bytes: 48,
            stream: Stream { followers: 3, depth: 1_024, lost: 5 },
        }
    }

    fn look(at_us: u64, nodes: &[(&str, u8, Seen)]) -> Look {
        let named = |&(topic, instance, seen): &(&str, u8, Seen)| {
            (Name { topic: topic.to_string(), instance }, seen)
        };
        Look { at_us, nodes: nodes.iter().map(named).collect() }
    }

    /// Rows as the drawing wants them: topic, instance, subscribers, rate, lost.
    pub(in super::super) fn rows(described: &[(&str, u8, u64, f64, f64)]) -> Vec<Row> {
        let row =
            |&(topic, instance, subscribers, rate_hz, lost_per_s): &(&str, u8, u64, f64, f64)| {
                Row {
                    topic: topic.to_string(),
                    instance,
                    subscribers,
                    rate_hz,
                    lost_per_s,
                    queue_length: 1,
                    size_bytes: 48,
                    kb_per_s: rate_hz * 0.048,
                    publishers: 1,
                    published: 1_000,
                    lost: 0,
                    advertised: true,
                    stream: Stream::default(),
                }
            };
        described.iter().map(row).collect()
    }

    #[test]
    fn rates_are_what_was_counted_in_the_time_it_took() {
        let before = look(1_000_000, &[("a", 0, seen(1_000_100, 1_000, 7))]);
        let after = look(2_500_000, &[("a", 0, seen(2_500_100, 1_375, 10))]);
        let update = Update::between(&before, &after);
        assert_eq!((update.dt_s, update.num_topics), (1.5, 1));
        let Row { rate_hz, lost_per_s, kb_per_s, published, lost, advertised, stream, .. } =
            update.topics[0];
        assert_eq!((rate_hz, lost_per_s, kb_per_s), (250.0, 2.0, 12.0));
        assert_eq!(stream, Stream { followers: 3, depth: 1_024, lost: 5 });
        assert_eq!((published, lost, advertised), (1_375, 10, true));
    }

    #[test]
    fn a_node_that_is_new_or_another_counts_from_0() {
        let other = Seen { inode: 2, ..seen(2_000_000, 50, 0) };
        let before = look(1_000_000, &[("a", 0, seen(1_000_000, 1_000, 0))]);
        let after = look(2_000_000, &[("a", 0, other), ("b", 3, seen(2_000_000, 20, 5))]);
        let update = Update::between(&before, &after);
        let found: Vec<_> = update
            .topics
            .iter()
            .map(|row| (&*row.topic, row.instance, row.rate_hz, row.lost_per_s))
            .collect();
        assert_eq!(found, [("a", 0, 50.0, 0.0), ("b", 3, 20.0, 5.0)]);
    }

    #[test]
    fn no_time_between_two_looks_is_no_rate() {
        let before = look(5, &[]);
        let after = look(5, &[("a", 0, seen(5, 1, 0))]);
        assert_eq!(Update::between(&before, &after).topics[0].rate_hz, 0.0);
    }

    #[test]
    fn what_publishes_is_shown_or_all_or_what_a_filter_names() {
        let update = Update {
            dt_s: 1.0,
            num_topics: 3,
            topics: rows(&[
                ("sensor_accel", 0, 0, 10.0, 0.0),
                ("sensor_baro", 0, 1, 0.0, 0.0),
                ("vehicle_imu", 0, 0, 5.0, 0.0),
            ]),
        };
        let shown = |all, filters: &[&str]| {
            let filters = filters.iter().map(|filter| filter.to_string()).collect();
            let update = update.clone().select(&Selection { all, filters });
            let topics: Vec<_> = update.topics.iter().map(|row| row.topic.clone()).collect();
            (update.num_topics, topics.join(" "))
        };
        assert_eq!(shown(false, &[]), (3, "sensor_accel vehicle_imu".into()));
        assert_eq!(shown(true, &[]), (3, "sensor_accel sensor_baro vehicle_imu".into()));
        assert_eq!(shown(false, &["sensor"]), (2, "sensor_accel sensor_baro".into()));
        assert_eq!(shown(false, &["baro", "imu"]), (2, "sensor_baro vehicle_imu".into()));
    }

    #[test]
    fn rows_are_sorted_by_a_column_and_by_name_where_it_is_equal() {
        let mut all =
            rows(&[("a", 0, 1, 9.98, 0.0), ("b", 0, 3, 10.02, 2.0), ("b", 1, 2, 99.0, 0.0)]);
        let mut order = |by, is_turned| {
            sort(&mut all, Column::Name, false);
            sort(&mut all, by, is_turned);
            all.iter()
                .map(|row| format!("{}{}", row.topic, row.instance))
                .collect::<Vec<_>>()
                .join(" ")
        };
        assert_eq!(order(Column::Name, false), "a0 b0 b1");
        assert_eq!(order(Column::Name, true), "b1 b0 a0");
        assert_eq!(order(Column::Rate, false), "b1 a0 b0");
        assert_eq!(order(Column::Rate, true), "a0 b0 b1");
        assert_eq!(order(Column::Lost, false), "b0 a0 b1");
        assert_eq!(order(Column::Subscribers, false), "b0 b1 a0");
    }
}
