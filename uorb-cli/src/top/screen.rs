//! The live view on a terminal: what the keys do, and when it is drawn.
//!
//! However it ends, the terminal is as it was: by a key, by a signal, and by a
//! panic, for which ratatui hangs a hook of its own.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use super::INTERVAL;
use super::draw::draw;
use super::model::{Column, Look, Row, Selection, Update, sort};
use super::nodes::Nodes;

/// How long a signal may go unnoticed.
const LOOK_AGAIN: Duration = Duration::from_millis(200);

const KEYS: &str = "cannot read the keys";

/// Everything that is on the screen.
#[derive(Debug)]
pub(super) struct View {
    pub(super) update: Update,
    pub(super) selection: Selection,
    /// How many nodes could not be read.
    pub(super) unreadable: usize,
    /// The system has ended; another may come.
    pub(super) is_gone: bool,
    pub(super) by: Column,
    pub(super) is_turned: bool,
    /// The filter that is being typed.
    pub(super) typing: Option<String>,
    /// How many rows are above the first that is seen.
    pub(super) scrolled: usize,
    /// How many rows the screen had room for when it was drawn last.
    pub(super) page: usize,
    /// All nodes, unsorted.
    all: Update,
}

/// What a key means for the loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Key {
    Quit,
    Stay,
}

pub(super) fn show(nodes: &mut Nodes, selection: Selection) -> anyhow::Result<()> {
    let signal = Arc::new(AtomicUsize::new(0));
    for number in [SIGHUP, SIGINT, SIGTERM] {
        signal_hook::flag::register_usize(number, signal.clone(), number as usize)
            .context("cannot catch signals")?;
    }
    let mut terminal = ratatui::try_init().context("cannot draw on this terminal")?;
    let ended = follow(&mut terminal, nodes, selection, &signal);
    ratatui::restore();
    // The cursor is shown again when it is dropped, and a signal ends us first.
    drop(terminal);
    ended?;
    match signal.load(Ordering::Relaxed) {
        0 => Ok(()),
        // The terminal is in order: end as anybody else who gets this signal.
        number => Ok(signal_hook::low_level::emulate_default_handler(number as i32)?),
    }
}

fn follow(
    terminal: &mut ratatui::DefaultTerminal,
    nodes: &mut Nodes,
    selection: Selection,
    signal: &AtomicUsize,
) -> anyhow::Result<()> {
    let mut view = View::new(selection);
    let mut before = nodes.look()?;
    // The first update comes soon, though it is coarse: nobody likes to look at
    // an empty screen.
    let mut next = Instant::now() + INTERVAL / 5;
    loop {
        terminal.draw(|frame| draw(frame, &mut view))?;
        let rest = next.saturating_duration_since(Instant::now());
        if event::poll(rest.min(LOOK_AGAIN)).context(KEYS)? {
            if let Event::Key(key) = event::read().context(KEYS)?
                && view.press(key) == Key::Quit
            {
                return Ok(());
            }
        } else if Instant::now() >= next {
            next += INTERVAL;
            before = view.look(nodes, before)?;
        }
        if signal.load(Ordering::Relaxed) != 0 {
            return Ok(());
        }
    }
}

impl View {
    pub(super) fn new(selection: Selection) -> Self {
        let nothing = Update { dt_s: 1.0, num_topics: 0, topics: Vec::new() };
        Self {
            update: nothing.clone(),
            selection,
            unreadable: 0,
            is_gone: false,
            by: Column::Name,
            is_turned: false,
            typing: None,
            scrolled: 0,
            page: 0,
            all: nothing,
        }
    }

    fn look(&mut self, nodes: &mut Nodes, before: Look) -> anyhow::Result<Look> {
        let after = nodes.look()?;
        self.is_gone = !nodes.exist();
        self.unreadable = nodes.unreadable(&self.selection).len();
        self.take(Update::between(&before, &after));
        Ok(after)
    }

    pub(super) fn take(&mut self, all: Update) {
        self.all = all;
        self.arrange();
    }

    /// All nodes, those that are not shown too.
    pub(super) fn all_rows(&self) -> &[Row] {
        &self.all.topics
    }

    /// Selects and sorts anew.
    fn arrange(&mut self) {
        self.update = self.all.clone().select(&self.selection);
        sort(&mut self.update.topics, self.by, self.is_turned);
        self.scroll_to(self.scrolled);
    }

    fn scroll_to(&mut self, row: usize) {
        let last = self.update.topics.len().saturating_sub(self.page.max(1));
        self.scrolled = row.min(last);
    }

    pub(super) fn press(&mut self, key: KeyEvent) -> Key {
        let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
        if key.kind == KeyEventKind::Release {
            return Key::Stay;
        }
        if is_control && matches!(key.code, KeyCode::Char('c' | 'd')) {
            return Key::Quit;
        }
        if self.typing.is_some() {
            self.type_filter(key.code);
            return Key::Stay;
        }
        let page = self.page.saturating_sub(1).max(1);
        match key.code {
            KeyCode::Char('q') | KeyCode::Esc => return Key::Quit,
            KeyCode::Char('n') => self.sort_by(Column::Name),
            KeyCode::Char('r') => self.sort_by(Column::Rate),
            KeyCode::Char('l') => self.sort_by(Column::Lost),
            KeyCode::Char('s') => self.sort_by(Column::Subscribers),
            KeyCode::Char('a') => {
                self.selection.all = !self.selection.all;
                self.arrange();
            }
            KeyCode::Char('/') => self.typing = Some(self.selection.filters.join(" ")),
            KeyCode::Up => self.scroll_to(self.scrolled.saturating_sub(1)),
            KeyCode::Down => self.scroll_to(self.scrolled + 1),
            KeyCode::PageUp => self.scroll_to(self.scrolled.saturating_sub(page)),
            KeyCode::PageDown => self.scroll_to(self.scrolled + page),
            KeyCode::Home => self.scroll_to(0),
            KeyCode::End => self.scroll_to(usize::MAX),
            _ => {}
        }
        Key::Stay
    }

    fn sort_by(&mut self, by: Column) {
        self.is_turned = self.by == by && !self.is_turned;
        self.by = by;
        self.arrange();
    }

    /// What is typed takes effect at once.
    fn type_filter(&mut self, key: KeyCode) {
        let Some(text) = &mut self.typing else { return };
        match key {
            KeyCode::Char(letter) => text.push(letter),
            KeyCode::Backspace => {
                text.pop();
            }
            KeyCode::Enter => return self.typing = None,
            KeyCode::Esc => text.clear(),
            _ => return,
        }
        self.selection.filters = text.split_whitespace().map(str::to_string).collect();
        if key == KeyCode::Esc {
            self.typing = None;
        }
        self.arrange();
    }
}

#[cfg(test)]
mod tests {
    use super::super::model::tests::rows;
    use super::*;

    fn view() -> View {
        let topics = rows(&[
            ("sensor_accel", 0, 1, 250.0, 0.0),
            ("sensor_baro", 0, 0, 0.0, 0.0),
            ("sensor_gyro", 0, 2, 1_000.0, 5.0),
            ("vehicle_imu", 0, 0, 100.0, 0.0),
        ]);
        let mut view = View::new(Selection::default());
        view.page = 2;
        view.take(Update { dt_s: 1.0, num_topics: 4, topics });
        view
    }

    fn press(view: &mut View, keys: &[KeyCode]) -> Key {
        keys.iter().map(|&code| view.press(code.into())).last().unwrap()
    }

    fn shown(view: &View) -> String {
        let names: Vec<_> = view.update.topics.iter().map(|row| row.topic.clone()).collect();
        names.join(" ")
    }

    #[test]
    fn keys_sort_and_turn_round() {
        let mut view = view();
        press(&mut view, &[KeyCode::Char('r')]);
        assert_eq!(shown(&view), "sensor_gyro sensor_accel vehicle_imu");
        press(&mut view, &[KeyCode::Char('r')]);
        assert_eq!(shown(&view), "vehicle_imu sensor_accel sensor_gyro");
        press(&mut view, &[KeyCode::Char('s')]);
        assert_eq!(shown(&view), "sensor_gyro sensor_accel vehicle_imu");
        press(&mut view, &[KeyCode::Char('n'), KeyCode::Char('a')]);
        assert_eq!(shown(&view), "sensor_accel sensor_baro sensor_gyro vehicle_imu");
    }

    #[test]
    fn a_filter_works_while_it_is_typed() {
        let mut view = view();
        press(&mut view, &[KeyCode::Char('/'), KeyCode::Char('q'), KeyCode::Backspace]);
        press(&mut view, &[KeyCode::Char('b'), KeyCode::Char('a')]);
        assert_eq!(shown(&view), "sensor_baro");
        // As on the command line, it shows what does not publish too.
        press(&mut view, &[KeyCode::Enter]);
        assert_eq!((shown(&view), view.typing.clone()), ("sensor_baro".into(), None));
        press(&mut view, &[KeyCode::Char('/'), KeyCode::Esc]);
        assert_eq!(shown(&view), "sensor_accel sensor_gyro vehicle_imu");
    }

    #[test]
    fn one_scrolls_no_further_than_to_the_last_page() {
        let mut view = view();
        let mut after = |key| {
            press(&mut view, &[key]);
            view.scrolled
        };
        assert_eq!(after(KeyCode::Up), 0);
        assert_eq!(after(KeyCode::Down), 1);
        assert_eq!(after(KeyCode::Down), 1);
        assert_eq!(after(KeyCode::Home), 0);
        assert_eq!(after(KeyCode::End), 1);
        assert_eq!(after(KeyCode::PageUp), 0);
    }

    #[test]
    fn three_keys_quit() {
        for code in [KeyCode::Char('q'), KeyCode::Esc] {
            assert_eq!(press(&mut view(), &[code]), Key::Quit);
        }
        let control_c = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        assert_eq!(view().press(control_c), Key::Quit);
        let mut view = view();
        press(&mut view, &[KeyCode::Char('/')]);
        assert_eq!(view.press(control_c), Key::Quit);
        assert_eq!(press(&mut view, &[KeyCode::Char('c')]), Key::Stay);
    }
}
