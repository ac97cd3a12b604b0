//! Lines as an SVG picture, which any browser shows.

use std::fs;
use std::ops::Range;
use std::path::Path;

use anyhow::{Context as _, anyhow};
use plotters::prelude::*;

use super::lines::Lines;

const WIDTH: u32 = 960;
const HEIGHT: u32 = 540;

/// Writes the picture.
pub(super) fn write(path: &Path, title: &str, x_axis: &str, lines: &Lines) -> anyhow::Result<()> {
    let svg = picture(title, x_axis, lines)?;
    fs::write(path, svg).with_context(|| format!("cannot write {}", path.display()))
}

fn picture(title: &str, x_axis: &str, lines: &Lines) -> anyhow::Result<String> {
    let (x, y) = ranges(lines);
    let mut svg = String::new();
    draw(&mut svg, title, x_axis, lines, x, y).map_err(|error| anyhow!("cannot draw: {error}"))?;
    Ok(svg)
}

fn ranges(lines: &Lines) -> (Range<f64>, Range<f64>) {
    let (left, right) = lines.x_range().unwrap_or((0.0, 1.0));
    let (bottom, top) = lines.y_range(left, right).unwrap_or((0.0, 1.0));
    // One point alone still has a place.
    let right = if right > left { right } else { left + 1.0 };
    (left..right, bottom..top)
}

fn draw(
    svg: &mut String,
    title: &str,
    x_axis: &str,
    lines: &Lines,
    x: Range<f64>,
    y: Range<f64>,
) -> Result<(), Box<dyn std::error::Error>> {
    let area = SVGBackend::with_string(svg, (WIDTH, HEIGHT)).into_drawing_area();
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&area)
        .caption(title, ("sans-serif", 20))
        .margin(14)
        .x_label_area_size(44)
        .y_label_area_size(72)
        .build_cartesian_2d(x.clone(), y)?;
    let value = |value: &f64| match value.abs() {
        size if size != 0.0 && !(1e-3..1e6).contains(&size) => format!("{value:.2e}"),
        _ => format!("{}", (value * 1e4).round() / 1e4),
    };
    chart
        .configure_mesh()
        .x_desc(x_axis)
        .y_desc(lines.unit())
        .y_label_formatter(&value)
        .light_line_style(TRANSPARENT)
        .draw()?;
    for (number, line) in lines.lines.iter().enumerate() {
        let color = Palette99::pick(number).to_rgba();
        for (part, segment) in line.segments().into_iter().enumerate() {
            let thinned = thinned(&segment, &x);
            // A point with gaps on both sides is no line, and still is to be seen.
            let size = if segment.len() == 1 { 2 } else { 0 };
            let drawn = LineSeries::new(thinned, color.stroke_width(1)).point_size(size);
            let drawn = chart.draw_series(drawn)?;
            if part == 0 {
                drawn.label(line.label()).legend(move |(x, y)| {
                    PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2))
                });
            }
        }
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    area.present()?;
    Ok(())
}

/// Points that look like all of them: of those that share a column of the
/// picture the first and the last, the lowest and the highest.
fn thinned(points: &[(f64, f64)], x: &Range<f64>) -> Vec<(f64, f64)> {
    let column =
        |point: &(f64, f64)| ((point.0 - x.start) / (x.end - x.start) * f64::from(WIDTH)) as i64;
    let mut thinned = Vec::new();
    for shared in points.chunk_by(|a, b| column(a) == column(b)) {
        let lowest = (0..shared.len()).min_by(|&a, &b| shared[a].1.total_cmp(&shared[b].1));
        let highest = (0..shared.len()).max_by(|&a, &b| shared[a].1.total_cmp(&shared[b].1));
        let mut kept: Vec<usize> =
            [Some(0), lowest, highest, shared.len().checked_sub(1)].into_iter().flatten().collect();
        kept.sort_unstable();
        kept.dedup();
        thinned.extend(kept.into_iter().map(|number| shared[number]));
    }
    thinned
}

#[cfg(test)]
mod tests {
    use super::super::lines::tests::lines;
    use super::*;

    #[test]
    fn a_picture_has_a_title_axes_and_a_legend() {
        let lines = lines(&[
            ("x", "m/s^2", &[(0.0, 1.0), (1.0, f64::NAN), (2.0, 3.0), (3.0, 1.0)]),
            ("y", "m/s^2", &[(0.0, 2.0), (3.0, -2.0)]),
        ]);
        let svg = picture("a <title>", "seconds", &lines).unwrap();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{svg}");
        for words in ["a &lt;title&gt;", "seconds", "m/s^2", "x [m/s^2]", "y [m/s^2]"] {
            assert!(svg.lines().any(|line| line.trim() == words), "no {words:?} in {svg}");
        }
        // The lines: two parts of which one is a point, and one of the other; two
        // in the legend, and more of axes.
        assert!(svg.matches("<polyline").count() >= 4, "{svg}");
        assert!(svg.contains("<circle"), "{svg}");
    }

    #[test]
    fn nothing_and_what_is_endless_are_pictures_too() {
        for points in [
            &[][..],
            &[(0.0, f64::NAN)],
            &[(5.0, 7.0)],
            &[(0.0, f64::MAX), (1.0, f64::MIN)],
            &[(0.0, 1e17), (1.0, 1e17 + 16.0)],
        ] {
            picture("", "", &lines(&[("x", "", points)])).unwrap();
        }
    }

    #[test]
    fn a_spike_survives_when_points_are_thinned() {
        let mut points: Vec<_> = (0..100_000).map(|n| (f64::from(n), 0.0)).collect();
        points[41_234].1 = 9.0;
        points[41_235].1 = -9.0;
        let thinned = thinned(&points, &(0.0..99_999.0));
        assert!(thinned.len() <= 4 * (WIDTH as usize + 1), "{}", thinned.len());
        assert!(thinned.contains(&(41_234.0, 9.0)) && thinned.contains(&(41_235.0, -9.0)));
        assert!(thinned.is_sorted_by(|a, b| a.0 <= b.0));
        assert_eq!((thinned.first(), thinned.last()), (points.first(), points.last()));
    }
}
