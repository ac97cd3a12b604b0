//! The figures as pictures: one SVG a question.

use std::path::Path;

use plotters::prelude::*;

use crate::figures::{Figures, Measured};
use crate::rows::hot;

type Drawn = anyhow::Result<()>;

/// One line of a plot.
struct Line {
    who: String,
    points: Vec<(f64, f64)>,
}

pub fn draw(figures: &Figures, dir: &Path) -> Drawn {
    lines(
        &dir.join("publish.svg"),
        "A publish of 64 bytes",
        ("idle subscribers (+1)", "ns"),
        &by_subscribers(figures),
    )?;
    for row in ["publish, by size", "copy, by size"] {
        let file = format!("{}.svg", row.replace(", ", "-").replace(' ', "-"));
        lines(&dir.join(file), row, ("bytes", "ns"), &by_size(figures, row))?;
    }
    for place in ["one core", "two cores awake", "unpinned"] {
        let file = format!("wake-{}.svg", place.replace(' ', "-"));
        let title = format!("One-way wake, {place}");
        let lines_of = by_quantile(figures, place);
        lines(&dir.join(file), &title, ("slower than 1 - 1/x of all", "us"), &lines_of)?;
    }
    Ok(())
}

fn by_subscribers(figures: &Figures) -> Vec<Line> {
    let mut found = Vec::new();
    for subscribers in hot::IDLE {
        let setting = hot::setting(subscribers);
        let at = subscribers as f64 + 1.0;
        collect(&mut found, figures, |row, it| row == "publish, beside peers" && it == setting, at);
    }
    found
}

fn by_size(figures: &Figures, row: &str) -> Vec<Line> {
    let mut found = Vec::new();
    for bytes in [16, 64, 256, 1_024, 4_096, 16_384, 65_528] {
        let setting = format!("{bytes} B");
        collect(&mut found, figures, |it, with| it == row && with == setting, f64::from(bytes));
    }
    found
}

fn collect(
    lines: &mut Vec<Line>,
    figures: &Figures,
    is_wanted: impl Fn(&str, &str) -> bool,
    at: f64,
) {
    for figure in figures.all.iter().filter(|it| is_wanted(&it.row, &it.setting)) {
        let point = (at, figure.middle());
        match lines.iter_mut().find(|line| line.who == figure.who) {
            Some(line) => line.points.push(point),
            None => lines.push(Line { who: figure.who.clone(), points: vec![point] }),
        }
    }
}

/// From the median to the slowest of a thousand.
fn by_quantile(figures: &Figures, place: &str) -> Vec<Line> {
    let wakes = figures.all.iter().filter(|it| it.row == "one-way wake" && it.setting == place);
    wakes
        .filter_map(|figure| {
            let Measured::Times(times) = &figure.measured else { return None };
            let point = |one_in: f64| (one_in, times.at_ns(1.0 - 1.0 / one_in) / 1e3);
            let points = (0..=30).map(|step| point(2.0 * 10_f64.powf(f64::from(step) * 0.09)));
            Some(Line { who: figure.who.clone(), points: points.collect() })
        })
        .collect()
}

fn lines(path: &Path, title: &str, (x, y): (&str, &str), lines: &[Line]) -> Drawn {
    let all = || lines.iter().flat_map(|line| &line.points);
    let (Some(right), Some(top)) = (
        all().map(|point| point.0).max_by(f64::total_cmp),
        all().map(|point| point.1).max_by(f64::total_cmp),
    ) else {
        return Ok(());
    };
    let left = all().map(|point| point.0).fold(right, f64::min);
    let bottom = all().map(|point| point.1).fold(top, f64::min);
    let area = SVGBackend::new(path, (900, 560)).into_drawing_area();
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&area)
        .caption(title, ("sans-serif", 22))
        .margin(14)
        .x_label_area_size(44)
        .y_label_area_size(64)
        .build_cartesian_2d(
            (left..right.max(left * 1.1)).log_scale(),
            (bottom * 0.8..top * 1.3).log_scale(),
        )?;
    chart.configure_mesh().x_desc(x).y_desc(y).light_line_style(TRANSPARENT).draw()?;
    for (index, line) in lines.iter().enumerate() {
        let color = Palette99::pick(index).to_rgba();
        let drawn = LineSeries::new(line.points.clone(), color.stroke_width(2)).point_size(3);
        chart
            .draw_series(drawn)?
            .label(&line.who)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    Ok(area.present()?)
}
