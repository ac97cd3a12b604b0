//! How the live view looks.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line as TextLine, Span};
use ratatui::widgets::{Axis, Chart, Dataset, GraphType};

use super::live::View;

const FAINT: Style = Style::new().add_modifier(Modifier::DIM);
const BOLD: Style = Style::new().add_modifier(Modifier::BOLD);
const COLORS: [Color; 6] =
    [Color::Cyan, Color::Yellow, Color::Magenta, Color::Green, Color::Red, Color::Blue];

pub(super) fn draw(frame: &mut Frame<'_>, view: &View) {
    let [top, middle, bottom] =
        Layout::vertical([Constraint::Length(1), Constraint::Fill(1), Constraint::Length(1)])
            .areas(frame.area());
    frame.render_widget(legend(view), top);
    let segments: Vec<_> = (view.lines.lines.iter().enumerate())
        .flat_map(|(number, line)| line.segments().into_iter().map(move |it| (number, it)))
        .collect();
    frame.render_widget(chart(view, &segments), middle);
    frame.render_widget(
        TextLine::styled("q quit  + - a longer or a shorter time  space hold", FAINT),
        bottom,
    );
}

/// The lines by their colors, with their newest values.
fn legend(view: &View) -> TextLine<'static> {
    let mut legend = TextLine::from(Span::styled(view.title.clone(), BOLD));
    for (number, line) in view.lines.lines.iter().enumerate() {
        let value = line.points.back().map_or("-".to_string(), |point| number_text(point.1));
        let unit = if line.unit.is_empty() { "" } else { " " };
        let text = format!("  {} {value}{unit}{}", line.path, line.unit);
        legend.push_span(Span::styled(text, COLORS[number % COLORS.len()]));
    }
    if view.is_gone {
        legend.push_span(Span::styled("   the system has ended", BOLD));
    } else if view.is_held {
        legend.push_span(Span::styled("   held", BOLD));
    }
    if view.lost > 0 {
        legend.push_span(Span::styled(format!("   {} lost", view.lost), BOLD));
    }
    legend
}

fn chart<'a>(view: &View, segments: &'a [(usize, Vec<(f64, f64)>)]) -> Chart<'a> {
    let (from, to) = (view.now_s - view.window_s, view.now_s);
    let (low, high) = view.lines.y_range(from, to).unwrap_or((0.0, 1.0));
    let datasets = segments.iter().map(|(number, points)| {
        Dataset::default()
            .marker(Marker::Braille)
            .graph_type(GraphType::Line)
            .style(COLORS[number % COLORS.len()])
            .data(points)
    });
    let middle = low / 2.0 + high / 2.0;
    let x_labels = [format!("-{} s", view.window_s), "now".to_string()];
    Chart::new(datasets.collect())
        .legend_position(None)
        .x_axis(Axis::default().style(FAINT).bounds([from, to]).labels(x_labels))
        .y_axis(
            Axis::default()
                .style(FAINT)
                .bounds([low, high])
                .labels([low, middle, high].map(number_text))
                .title(view.lines.unit().to_string()),
        )
}

/// Four digits or so.
fn number_text(value: f64) -> String {
    match value.abs() {
        _ if value.is_nan() => "nan".to_string(),
        size if size != 0.0 && !(1e-3..1e6).contains(&size) => format!("{value:.3e}"),
        size if size >= 1e3 => format!("{value:.1}"),
        _ => format!("{value:.4}"),
    }
}

#[cfg(test)]
mod tests {
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use super::super::lines::tests::lines;
    use super::*;

    fn drawn(view: &View, width: u16, height: u16) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, view)).unwrap();
        let buffer = terminal.backend().buffer();
        let line = |y| -> String { (0..width).map(|x| buffer[(x, y)].symbol()).collect() };
        (0..height).map(|y| line(y).trim_end().to_string() + "\n").collect()
    }

    #[test]
    fn the_view_has_a_legend_with_values_and_both_axes() {
        let ramp: Vec<(f64, f64)> =
            (0..=100).map(|n| (f64::from(n) / 10.0, f64::from(n))).collect();
        let lines = lines(&[("x", "m", &ramp), ("y", "m", &[(0.0, 1.5), (9.0, f64::NAN)])]);
        let mut view = View::new("sensor_accel0".into(), lines, 10.0);
        view.now_s = 10.0;
        let text = drawn(&view, 70, 12);
        let rows: Vec<&str> = text.lines().collect();
        assert_eq!(rows[0], "sensor_accel0  x 100.0000 m  y nan m");
        assert!(rows[1].contains("105.0000"), "{text}");
        assert!(rows[8].contains("-5.0000") && rows[10].contains("-10 s"), "{text}");
        assert!(rows[10].ends_with("now"), "{text}");
        // A ramp goes from the one corner to the other.
        let dots = |row: &str| row.chars().any(|it| ('\u{2801}'..='\u{28ff}').contains(&it));
        assert!(dots(rows[1]) && dots(rows[5]) && dots(rows[8]), "{text}");
        for (width, height) in [(10, 3), (1, 1), (0, 0)] {
            drawn(&view, width, height);
        }
    }
}
