//! How the live view looks.

use ratatui::Frame;
use ratatui::layout::{Alignment, Constraint, Layout};
use ratatui::style::{Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Cell, Row as TableRow, Table};

use super::model::{Column, Row};
use super::screen::View;
use super::text::{NUMBERS, name_width, numbers, title, widths};

const HEAD: Style = Style::new().add_modifier(Modifier::REVERSED);
const SORTED: Style = Style::new().add_modifier(Modifier::BOLD);
const FAINT: Style = Style::new().add_modifier(Modifier::DIM);

/// Draws everything, and notes how many rows there was room for.
pub(super) fn draw(frame: &mut Frame<'_>, view: &mut View) {
    let [top, table, bottom] =
        Layout::vertical([Constraint::Length(1), Constraint::Fill(1), Constraint::Length(1)])
            .areas(frame.area());
    view.page = table.height.saturating_sub(1).into();
    frame.render_widget(first_line(view), top);
    frame.render_widget(rows(view), table);
    frame.render_widget(last_line(view), bottom);
}

fn first_line(view: &View) -> Line<'static> {
    let update = &view.update;
    // Not `sum`: of nothing, that is -0.
    let messages = update.topics.iter().fold(0.0, |sum, row| sum + row.rate_hz);
    let kilobytes = update.topics.iter().fold(0.0, |sum, row| sum + row.kb_per_s);
    let mut line = Line::from(title(update));
    if view.is_gone {
        line.push_span(Span::styled("   the system has ended", SORTED));
    } else {
        line.push_span(Span::styled(format!("   {messages:.0} msg/s, {kilobytes:.1} kB/s"), FAINT));
    }
    if view.unreadable > 0 {
        let words = format!("   unreadable: {} (uorb ls -l says why)", view.unreadable);
        line.push_span(Span::styled(words, SORTED));
    }
    line
}

fn rows(view: &View) -> Table<'static> {
    let mark = if view.is_turned { "▲" } else { "▼" };
    let head = |name: &str, is_sorted: bool| match is_sorted {
        false => Line::from(name.to_string()),
        true => Line::from(format!("{mark}{name}")).style(SORTED),
    };
    let name = std::iter::once(Cell::from(head("TOPIC NAME", view.by == Column::Name)));
    let number = NUMBERS.iter().map(|&name| {
        let is_sorted = match view.by {
            Column::Name => false,
            Column::Rate => name == "#MSG",
            Column::Lost => name == "#LOST",
            Column::Subscribers => name == "#SUB",
        };
        Cell::from(head(name, is_sorted).alignment(Alignment::Right))
    });
    let seen = view.update.topics.iter().skip(view.scrolled).take(view.page).map(row);
    let name_width = Constraint::Length(name_width(view.all_rows()) as u16);
    // Each with the blank before it, and room for the mark.
    let widths = widths(view.all_rows()).map(|width| Constraint::Length(width as u16));
    Table::new(seen, std::iter::once(name_width).chain(widths))
        .header(TableRow::new(name.chain(number)).style(HEAD))
        .column_spacing(0)
}

fn row(row: &Row) -> TableRow<'static> {
    let number = |number: String| Cell::from(Line::from(number).alignment(Alignment::Right));
    let name = std::iter::once(Cell::from(row.topic.clone()));
    let style = match (row.lost_per_s > 0.0, row.advertised) {
        (true, _) => SORTED,
        (false, true) => Style::new(),
        (false, false) => FAINT,
    };
    TableRow::new(name.chain(numbers(row).map(number))).style(style)
}

fn last_line(view: &View) -> Line<'static> {
    if let Some(text) = &view.typing {
        return Line::from(format!("/{text}█  Enter: keep, Esc: drop"));
    }
    let mut line =
        Line::styled("q quit  n r l s sort  a all  / filter  arrows, PgUp, PgDn scroll", FAINT);
    if !view.selection.filters.is_empty() {
        let filter = format!("   filter: {}", view.selection.filters.join(" "));
        line.push_span(Span::raw(filter));
    }
    line
}

#[cfg(test)]
mod tests {
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use super::super::model::tests::rows;
    use super::super::model::{Selection, Update};
    use super::*;

    fn view() -> View {
        let topics = rows(&[
            ("sensor_accel", 0, 3, 250.4, 0.0),
            ("sensor_accel", 1, 0, 249.6, 12.2),
            ("vehicle_acceleration", 0, 1, 1_000.0, 0.0),
            ("vehicle_imu", 0, 1, 200.0, 0.0),
        ]);
        let mut view = View::new(Selection::default());
        view.take(Update { dt_s: 1.0003, num_topics: 4, topics });
        view
    }

    fn drawn(view: &mut View, width: u16, height: u16) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, view)).unwrap();
        let buffer = terminal.backend().buffer();
        let line = |y| -> String { (0..width).map(|x| buffer[(x, y)].symbol()).collect() };
        (0..height).map(|y| line(y).trim_end().to_string() + "\n").collect()
    }

    #[test]
    fn the_view_has_the_columns_of_the_text() {
        assert_eq!(
            drawn(&mut view(), 80, 7),
            "\
update: 1s, num topics: 4   1700 msg/s, 81.6 kB/s
▼TOPIC NAME          INST #SUB #MSG #LOST #QSIZE  SIZE    kB/s #STR
sensor_accel            0    3  250     0      1    48    12.0    0
sensor_accel            1    0  250    12      1    48    12.0    0
vehicle_acceleration    0    1 1000     0      1    48    48.0    0
vehicle_imu             0    1  200     0      1    48     9.6    0
q quit  n r l s sort  a all  / filter  arrows, PgUp, PgDn scroll
"
        );
    }

    #[test]
    fn nodes_that_cannot_be_read_are_counted() {
        let mut view = view();
        view.unreadable = 2;
        let first = drawn(&mut view, 100, 4);
        assert!(first.contains(" 81.6 kB/s   unreadable: 2 (uorb ls -l says why)\n"), "{first}");
    }

    #[test]
    fn the_sorted_column_is_marked_and_a_small_screen_shows_a_part() {
        let mut view = view();
        drawn(&mut view, 80, 5);
        for key in ['l', 'l', 'r', '/', 'e', 'h'] {
            view.press(ratatui::crossterm::event::KeyCode::Char(key).into());
        }
        assert_eq!(
            drawn(&mut view, 69, 4),
            "\
update: 1s, num topics: 2   1200 msg/s, 57.6 kB/s
TOPIC NAME           INST #SUB▼#MSG #LOST #QSIZE  SIZE    kB/s #STR
vehicle_acceleration    0    1 1000     0      1    48    48.0    0
/eh█  Enter: keep, Esc: drop
"
        );
        // The name keeps the room that the longest of all names needs.
        assert!(drawn(&mut view, 69, 4).contains("NAME           INST"));
        // Neither a tiny one nor none at all is a reason to panic.
        for (width, height) in [(10, 3), (1, 1), (0, 0)] {
            drawn(&mut view, width, height);
        }
    }
}
