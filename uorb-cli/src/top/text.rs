//! An update as text: PX4's table of 2016 to 2019, with three columns more.

use std::io::{self, Write};

use super::model::{Row, Update};

/// The columns behind the name, as the table and the screen head them.
pub(super) const NUMBERS: [&str; COLUMNS] =
    ["INST", "#SUB", "#MSG", "#LOST", "#QSIZE", "SIZE", "kB/s", "#STR"];

const COLUMNS: usize = 8;

/// How wide they are at least, with the blank before. As in PX4, the first
/// reaches two letters into the name.
const WIDTHS: [usize; COLUMNS] = [5, 5, 5, 6, 7, 6, 8, 5];

/// How wide the columns of these rows are: a large topic needs more room than
/// PX4 had to give.
pub(super) fn widths(rows: &[Row]) -> [usize; COLUMNS] {
    rows.iter().map(numbers).fold(WIDTHS, |widths, numbers| {
        std::array::from_fn(|column| widths[column].max(numbers[column].len() + 1))
    })
}

/// What stands in them.
pub(super) fn numbers(row: &Row) -> [String; COLUMNS] {
    [
        row.instance.to_string(),
        row.subscribers.to_string(),
        format!("{:.0}", row.rate_hz),
        format!("{:.0}", row.lost_per_s),
        row.queue_length.to_string(),
        row.size_bytes.to_string(),
        format!("{:.1}", row.kb_per_s),
        row.stream.followers.to_string(),
    ]
}

/// The first line of an update.
pub(super) fn title(update: &Update) -> String {
    format!("update: {:.0}s, num topics: {}", update.dt_s.max(1.0), update.num_topics)
}

/// How wide the names are: all have room, and the heading too.
pub(super) fn name_width(rows: &[Row]) -> usize {
    rows.iter().map(|row| row.topic.len()).max().unwrap_or(0).max("TOPIC NAME".len() + 2)
}

pub(super) fn print(update: &Update, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "{}", title(update))?;
    let name_width = name_width(&update.topics) - 2;
    let widths = widths(&update.topics);
    let line = |out: &mut dyn Write, name: &str, numbers: [&str; COLUMNS]| {
        write!(out, "{name:<name_width$}")?;
        let mut over = name.len().saturating_sub(name_width);
        for (number, width) in numbers.iter().zip(widths) {
            write!(out, " {number:>0$}", width - 1 - over)?;
            over = 0;
        }
        writeln!(out)
    };
    line(out, "TOPIC NAME", NUMBERS)?;
    for row in &update.topics {
        line(out, &row.topic, numbers(row).each_ref().map(String::as_str))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::model::tests::rows;
    use super::*;

    #[test]
    fn the_table_is_px4s() {
        let topics = rows(&[
            ("sensor_accel", 0, 3, 250.4, 0.0),
            ("sensor_accel", 1, 0, 249.6, 12.2),
            ("vehicle_acceleration", 0, 1, 1_000.0, 0.0),
        ]);
        let mut out = Vec::new();
        print(&Update { dt_s: 1.0003, num_topics: 77, topics }, &mut out).unwrap();
        assert_eq!(
            String::from_utf8(out).unwrap(),
            "\
update: 1s, num topics: 77
TOPIC NAME         INST #SUB #MSG #LOST #QSIZE  SIZE    kB/s #STR
sensor_accel          0    3  250     0      1    48    12.0    0
sensor_accel          1    0  250    12      1    48    12.0    0
vehicle_acceleration  0    1 1000     0      1    48    48.0    0
"
        );
    }

    #[test]
    fn the_numbers_of_a_large_topic_have_room() {
        let mut topics = rows(&[("camera", 0, 1, 30.0, 0.0), ("orb_test", 0, 1, 30.0, 0.0)]);
        (topics[0].size_bytes, topics[0].kb_per_s) = (268_435_456, 8_053_063.7);
        topics[0].stream.followers = 2;
        let mut out = Vec::new();
        print(&Update { dt_s: 1.0, num_topics: 2, topics }, &mut out).unwrap();
        assert_eq!(
            String::from_utf8(out).unwrap(),
            "\
update: 1s, num topics: 2
TOPIC NAME INST #SUB #MSG #LOST #QSIZE      SIZE      kB/s #STR
camera        0    1   30     0      1 268435456 8053063.7    2
orb_test      0    1   30     0      1        48       1.4    0
"
        );
    }

    #[test]
    fn a_table_of_nothing_has_a_head() {
        let mut out = Vec::new();
        print(&Update { dt_s: 1.0, num_topics: 0, topics: Vec::new() }, &mut out).unwrap();
        assert_eq!(
            String::from_utf8(out).unwrap(),
            "update: 1s, num topics: 0\n\
             TOPIC NAME INST #SUB #MSG #LOST #QSIZE  SIZE    kB/s #STR\n"
        );
    }
}
