//! A bus, as it goes: on the terminal, or gathered for a picture.
//!
//! Every message is drawn, so it is the stream that is followed. However the
//! view ends, the terminal is as it was, as with `uorb top`.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use uorb_core::{Error, RawSubscription, StreamOptions, now_us};

use super::draw::draw;
use super::lines::Lines;
use super::{Args, Wanted, svg};
use crate::context::Context;
use crate::exit::say;
use crate::interrupt::Interrupt;
use crate::listener::take;
use crate::topics;

/// From one picture to the next: as fast as an eye sees it move.
const FRAME: Duration = Duration::from_millis(50);

const KEYS: &str = "cannot read the keys";

/// Everything that is on the screen.
#[derive(Debug)]
pub(super) struct View {
    pub(super) title: String,
    pub(super) lines: Lines,
    /// The right end of the picture, in seconds of the machine's clock.
    pub(super) now_s: f64,
    pub(super) window_s: f64,
    pub(super) is_held: bool,
    pub(super) lost: u64,
    /// The system has ended.
    pub(super) is_gone: bool,
}

impl View {
    pub(super) fn new(title: String, lines: Lines, window_s: f64) -> Self {
        let (is_held, is_gone) = (false, false);
        Self { title, lines, now_s: 0.0, window_s, is_held, lost: 0, is_gone }
    }

    /// Returns whether to go on.
    fn press(&mut self, key: KeyEvent) -> bool {
        let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
        match key.code {
            _ if key.kind == KeyEventKind::Release => {}
            KeyCode::Char('c' | 'd') if is_control => return false,
            KeyCode::Char('q') | KeyCode::Esc => return false,
            KeyCode::Char('+' | '=') => self.window_s = (self.window_s * 2.0).min(3_600.0),
            KeyCode::Char('-') => self.window_s = (self.window_s / 2.0).max(0.01),
            KeyCode::Char(' ') => self.is_held = !self.is_held,
            _ => {}
        }
        true
    }
}

/// A topic that is followed.
struct Followed<'a> {
    wanted: &'a Wanted<'a>,
    subscription: RawSubscription,
    message: Vec<u8>,
}

/// The most messages that are taken before the picture is drawn again.
const TAKEN_MAX: usize = 1 << 16;

impl<'a> Followed<'a> {
    fn follow(
        args: &Args,
        context: &Context,
        wanted: &'a Wanted<'a>,
    ) -> anyhow::Result<(Self, View)> {
        let session = context.session()?;
        let Some(metadata) = topics::describe(&session, wanted.topic)? else {
            return Err(topics::unknown(context, wanted.topic));
        };
        let lines = Lines::new(wanted.topic, &metadata.layout, wanted.fields)?;
        let deepest = StreamOptions::default();
        let subscription =
            RawSubscription::subscribe_stream(&session, wanted.topic, args.instance, deepest)?;
        let title = format!("{}{}", wanted.topic, args.instance);
        let followed = Self { wanted, subscription, message: Vec::new() };
        Ok((followed, View::new(title, lines, args.seconds)))
    }

    /// Takes what has come.
    fn take(&mut self, view: &mut View) -> anyhow::Result<()> {
        match uorb_core::poll(&mut [&mut self.subscription], Some(Duration::ZERO)) {
            Err(Error::Ended { .. }) => view.is_gone = true,
            polled => _ = polled?,
        }
        // Whoever publishes first may do so with other fields than were known.
        if let Some(metadata) = self.subscription.metadata() {
            let layout = topics::typed(metadata.clone()).layout;
            if !view.lines.are_of(&layout) {
                view.lines = Lines::new(self.wanted.topic, &layout, self.wanted.fields)?;
            }
        }
        for _ in 0..TAKEN_MAX {
            let Some(copied) = take(&mut self.subscription, &mut self.message) else { break };
            view.lines.add(copied.publish_time_us as f64 / 1e6, &self.message);
        }
        view.lost = self.subscription.lost();
        Ok(())
    }
}

/// Shows it until somebody has seen enough.
pub(super) fn show(args: &Args, context: &Context, wanted: &Wanted<'_>) -> anyhow::Result<()> {
    let (mut followed, mut view) = Followed::follow(args, context, wanted)?;
    let signal = Arc::new(AtomicUsize::new(0));
    for number in [SIGHUP, SIGINT, SIGTERM] {
        signal_hook::flag::register_usize(number, signal.clone(), number as usize)
            .context("cannot catch signals")?;
    }
    let mut terminal = ratatui::try_init().context("cannot draw on this terminal")?;
    let ended = look(&mut terminal, &mut followed, &mut view, &signal);
    ratatui::restore();
    // The cursor is shown again when it is dropped, and a signal ends us first.
    drop(terminal);
    ended?;
    match signal.load(Ordering::Relaxed) {
        0 => Ok(()),
        number => Ok(signal_hook::low_level::emulate_default_handler(number as i32)?),
    }
}

fn look(
    terminal: &mut ratatui::DefaultTerminal,
    followed: &mut Followed<'_>,
    view: &mut View,
    signal: &AtomicUsize,
) -> anyhow::Result<()> {
    while signal.load(Ordering::Relaxed) == 0 {
        let next = Instant::now() + FRAME;
        followed.take(view)?;
        if !view.is_held {
            view.now_s = now_us() as f64 / 1e6;
            view.lines.forget_before(view.now_s - view.window_s);
        }
        terminal.draw(|frame| draw(frame, view))?;
        while event::poll(next.saturating_duration_since(Instant::now())).context(KEYS)? {
            if let Event::Key(key) = event::read().context(KEYS)?
                && !view.press(key)
            {
                return Ok(());
            }
        }
    }
    Ok(())
}

/// Gathers it for so long, or until Ctrl-C, and writes a picture.
pub(super) fn gather(
    args: &Args,
    context: &Context,
    wanted: &Wanted<'_>,
    file: &Path,
) -> anyhow::Result<()> {
    let (mut followed, mut view) = Followed::follow(args, context, wanted)?;
    let interrupt = Interrupt::catch()?;
    let end = Instant::now() + Duration::from_secs_f64(args.seconds);
    // A node has its newest message, from before we came.
    let begun_s = now_us() as f64 / 1e6;
    while !view.is_gone && !interrupt.wait_until(Some(end.min(Instant::now() + FRAME)))? {
        followed.take(&mut view)?;
        if Instant::now() >= end {
            break;
        }
    }
    // What came between the last look and the end.
    followed.take(&mut view)?;
    view.lines.forget_before(begun_s);
    if view.lines.are_empty() {
        let (topic, seconds) = (&view.title, args.seconds);
        bail!("no message of {topic} was published in {seconds} s: gather longer, with --seconds");
    }
    view.lines.begin_at(begun_s);
    svg::write(file, &view.title, "seconds", &view.lines)?;
    if view.lost > 0 {
        say(format_args!("{} messages were lost", view.lost));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::lines::tests::lines;
    use super::*;

    #[test]
    fn keys_change_what_is_seen() {
        let mut view = View::new(String::new(), lines(&[]), 10.0);
        let mut press =
            |code: KeyCode| view.press(code.into()).then_some((view.window_s, view.is_held));
        assert_eq!(press(KeyCode::Char('+')), Some((20.0, false)));
        assert_eq!(press(KeyCode::Char('-')), Some((10.0, false)));
        assert_eq!(press(KeyCode::Char(' ')), Some((10.0, true)));
        assert_eq!(press(KeyCode::Char('c')), Some((10.0, true)));
        assert_eq!(press(KeyCode::Char('q')), None);
        assert_eq!(press(KeyCode::Esc), None);
        assert!(!view.press(KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL)));
    }
}
