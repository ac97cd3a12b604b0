//! What the project has promised, beside what was seen. Nobody edits this table
//! by hand, and nothing asserts it: a machine may be busy.

use std::io::{self, Write};

use crate::figures::Figures;
use crate::rows::{blocked, flat_out, hot, scale, streams, wakes};

/// One promise: less is better.
struct Promise {
    what: String,
    must: f64,
    aim: f64,
    unit: &'static str,
    seen: Option<f64>,
}

pub fn print(figures: &Figures, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "\n{:<72} {:>10} {:>10} {:>10}", "promise", "must", "aim", "seen")?;
    for Promise { what, must, aim, unit, seen } in promises(figures) {
        let verdict = match seen {
            None => "not measured",
            Some(seen) if seen <= aim => "aim met",
            Some(seen) if seen <= must => "met",
            Some(_) => "MISSED",
        };
        let seen = seen.map_or("-".into(), |seen| format!("{seen:.3}"));
        let limits = [must, aim].map(|limit| format!("{limit:.2}{unit}"));
        writeln!(out, "{what:<72} {:>10} {:>10} {seen:>10} {verdict}", limits[0], limits[1])?;
    }
    Ok(())
}

fn promises(figures: &Figures) -> Vec<Promise> {
    let ratio = |row: &str, setting: &str, who: &str| {
        Some(figures.find(row, setting, who)?.floor.as_ref()?.ratio)
    };
    let value = |(row, setting): (&str, &str)| Some(figures.find(row, setting, "uorb")?.middle());
    // Each beside its own floor of the same moment.
    let beside = |row: &str, setting: &str, ours: &str, peer: &str| {
        Some(ratio(row, setting, ours)? / ratio(row, setting, peer)?)
    };
    let worst = |seen: Vec<Option<f64>>| {
        seen.into_iter().collect::<Option<Vec<_>>>()?.into_iter().max_by(f64::total_cmp)
    };
    let mut all = Vec::new();
    let mut promise = |what: &str, (must, aim): (f64, f64), unit, seen| {
        all.push(Promise { what: what.into(), must, aim, unit, seen });
    };

    let publish = hot::IDLE.map(|idle| ratio("publish", &hot::setting(idle), "uorb"));
    let clock_reads = " clock";
    promise("publish, whatever is idle", (1.9, 1.4), clock_reads, worst(publish.into()));
    promise("copy", (0.45, 0.25), clock_reads, ratio("copy", "64 B", "uorb"));
    promise("updated", (0.05, 0.02), clock_reads, ratio("updated, it is not", "64 B", "uorb"));
    promise("poll with data ready", (1.0, 0.3), clock_reads, ratio("poll, ready", "64 B", "uorb"));
    for (idle, limits) in [(1, (4.0, 6.0)), (16, (10.0, 20.0))] {
        let seen = beside("publish, beside peers", &hot::setting(idle), "uorb", "iceoryx2");
        let what = format!("publish by iceoryx2's, {idle} idle");
        promise(&what, (1.0 / limits.0, 1.0 / limits.1), "", seen);
    }
    let places = ["one core", "two cores awake", "unpinned"];
    for who in ["uorb, poll", "uorb, epoll"] {
        for place in places {
            let what = format!("one-way wake by eventfd and poll, {place}: {who}");
            promise(&what, (1.3, 1.1), "x", ratio("one-way wake", place, who));
        }
    }
    for who in ["uorb, poll", "uorb, epoll"] {
        for (place, limits) in [(places[0], (0.5, 1.0 / 3.0)), (places[1], (1.0, 1.0 / 1.2))] {
            let what = format!("one-way wake by iceoryx2's, {place}: {who}");
            let seen = beside("one-way wake", place, who, "iceoryx2 with event");
            promise(&what, limits, "x", seen);
        }
    }
    for blocked in blocked::BLOCKED {
        let setting = blocked::setting(blocked);
        let seen = value(("system calls of a publish", &setting));
        promise(&format!("system calls of a publish, {setting}"), (1.0, 1.0), "", seen);
    }
    let seen = ratio("publish, others blocked", &blocked::setting(16), "uorb");
    promise("publish with 16 blocked by one bare write", (1.2, 1.05), "x", seen);
    let seen = ratio(wakes::SPINNING, "two cores awake", "uorb, poll");
    promise("spinning poll, one way, by a cache line", (2.0, 1.3), "x", seen);
    let seen = beside(streams::WRITTEN, "4194304 B", "uorb", "iceoryx2");
    promise("stream of 4 MiB by plain iceoryx2's", (1.2, 1.0), "x", seen);
    for (what, limits, unit) in [
        ("time to advertise all", (3.0, 1.0), " s"),
        ("memory of the broker", (64.0, 32.0), " MiB"),
        ("one refresh of top, CPU time", (50.0, 10.0), " ms"),
    ] {
        let seen = value((scale::NODES_ROW, what));
        promise(&format!("1,000 nodes: {what}"), limits, unit, seen);
    }
    promise("broker's CPU, 200 topics at 250 Hz", (0.5, 0.1), " %", value(scale::BROKER));
    let setting = format!("{}, p99.9 by median", flat_out::FOUR.1);
    let seen = value((flat_out::FOUR.0, &setting));
    promise("4 publishers on one instance, p99.9 by median", (100.0, 20.0), "x", seen);
    all
}
