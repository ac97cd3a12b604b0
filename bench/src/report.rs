//! What a run leaves: a table for people, and files for whoever wants to look
//! again.
//!
//! `results.csv` has every figure, `histograms.csv` every time that a figure was
//! made of, `machine.txt` where it was.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

use crate::figures::{Figure, Figures, Measured};

pub fn print(figures: &Figures, out: &mut dyn Write) -> io::Result<()> {
    let mut row = "";
    for figure in &figures.all {
        if figure.row != row {
            row = &figure.row;
            writeln!(out, "\n{row}")?;
        }
        writeln!(out, "  {}", line(figure))?;
    }
    Ok(())
}

fn line(figure: &Figure) -> String {
    let name = format!("{:<52} {:<28}", figure.setting, figure.who);
    let floor = figure.floor.as_ref().map_or(String::new(), |floor| {
        format!("   {:>8.2}x {} ({})", floor.ratio, floor.name, ns(floor.median_ns))
    });
    match &figure.measured {
        Measured::Value(value) => format!("{name} {value:>10.3} {}", figure.unit),
        Measured::Times(times) => {
            let [p50, p99, max] = [times.median_ns(), times.at_ns(0.99), times.max_ns()].map(ns);
            format!("{name} p50 {p50:>9}  p99 {p99:>9}  max {max:>9}{floor}")
        }
    }
}

/// A time with a unit that suits it.
pub fn ns(time_ns: f64) -> String {
    match time_ns {
        time if time < 1e3 => format!("{time:.1} ns"),
        time if time < 1e6 => format!("{:.2} us", time / 1e3),
        time => format!("{:.2} ms", time / 1e6),
    }
}

pub fn write(figures: &Figures, machine: &str, dir: &Path) -> anyhow::Result<()> {
    fs::write(dir.join("machine.txt"), machine)?;
    results(figures, File::create(dir.join("results.csv"))?)?;
    histograms(figures, File::create(dir.join("histograms.csv"))?)?;
    Ok(())
}

fn results(figures: &Figures, file: File) -> anyhow::Result<()> {
    let mut csv = csv::Writer::from_writer(file);
    csv.write_record([
        "row",
        "setting",
        "who",
        "unit",
        "count",
        "p50",
        "p99",
        "p99.9",
        "max",
        "floor",
        "floor_p50",
        "ratio",
    ])?;
    for figure in &figures.all {
        let mut record: Vec<String> =
            [&figure.row, &figure.setting, &figure.who].map(String::clone).into();
        record.push(figure.unit.into());
        match &figure.measured {
            Measured::Value(value) => {
                record.extend(["1".into(), value.to_string()]);
                record.extend([const { String::new() }; 3]);
            }
            Measured::Times(times) => {
                record.push(times.count().to_string());
                record.extend([0.5, 0.99, 0.999].map(|at| times.at_ns(at).to_string()));
                record.push(times.max_ns().to_string());
            }
        }
        record.extend(match &figure.floor {
            None => [const { String::new() }; 3],
            Some(floor) => {
                [floor.name.clone(), floor.median_ns.to_string(), floor.ratio.to_string()]
            }
        });
        csv.write_record(record)?;
    }
    Ok(csv.flush()?)
}

fn histograms(figures: &Figures, file: File) -> anyhow::Result<()> {
    let mut csv = csv::Writer::from_writer(file);
    csv.write_record(["row", "setting", "who", "ns", "count"])?;
    for figure in &figures.all {
        let Measured::Times(times) = &figure.measured else { continue };
        for bin in times.picoseconds.iter_recorded() {
            let time_ns = (bin.value_iterated_to() as f64 / 1e3).to_string();
            let count = bin.count_at_value().to_string();
            csv.write_record([&figure.row, &figure.setting, &figure.who, &time_ns, &count])?;
        }
    }
    Ok(csv.flush()?)
}
