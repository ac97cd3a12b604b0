//! A log on its way out: when each message goes, and what the keys change.

use std::time::Instant;

use anyhow::bail;
use indicatif::ProgressBar;
use uorb_ulog::{Source, Told, read};

use super::contents::Contents;
use super::keys::{Key, Keys};
use super::outlet::Outlet;
use super::pace::{Due, Pace};
use super::{Args, micros};
use crate::exit::Early;
use crate::interrupt::Interrupt;

pub(super) struct Replay<'a> {
    pub(super) args: &'a Args,
    pub(super) contents: &'a Contents,
    /// By the number of the series; None: not to be replayed.
    pub(super) outlets: Vec<Option<Outlet>>,
    pub(super) bar: ProgressBar,
    pub(super) keys: Keys,
    pub(super) interrupt: Interrupt,
    pub(super) pace: Pace,
    /// Where each round begins.
    pub(super) start_us: u64,
    /// How far we have come in the log.
    pub(super) position_us: u64,
    /// How much of the log was replayed in the rounds before this one.
    pub(super) played_us: u64,
    /// How often it was begun.
    pub(super) rounds: u64,
}

/// How far a log was replayed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Played {
    /// To the end of what is whole.
    ToItsEnd,
    /// As far as was asked for, by --duration or by a key.
    AsAsked,
}

/// Why the reading of a log ends before the log does.
#[derive(Debug, thiserror::Error)]
enum Enough {
    #[error("--duration is over")]
    Duration,
    #[error("q was pressed")]
    Quit,
}

impl Replay<'_> {
    /// Plays all rounds.
    pub(super) fn play(&mut self, source: &mut dyn Source) -> anyhow::Result<Played> {
        let mut played = Played::ToItsEnd;
        for _ in 0..self.args.rounds.unwrap_or(1) {
            let before = self.published();
            self.rounds += 1;
            self.played_us += self.position_us - self.start_us;
            self.position_us = self.start_us;
            self.pace.restart(self.start_us);
            played = match self.publish_all(source) {
                Ok(()) => Played::ToItsEnd,
                Err(error) => match error.downcast::<Enough>()? {
                    Enough::Duration => Played::AsAsked,
                    Enough::Quit => return Ok(Played::AsAsked),
                },
            };
            if self.published() == before {
                // Nor would there be anything in the next round.
                break;
            }
        }
        Ok(played)
    }

    fn published(&self) -> u64 {
        self.outlets.iter().flatten().map(|outlet| outlet.published).sum()
    }

    fn publish_all(&mut self, source: &mut dyn Source) -> anyhow::Result<()> {
        let end_us =
            self.args.duration.map(|duration| self.start_us.saturating_add(micros(duration)));
        let mut clock = self.contents.clock();
        let mut numbers = 0..;
        read(source, self.contents.until_byte, |told| {
            let Told::Message(message) = told else { return Ok(()) };
            let is_ahead = numbers.next().is_some_and(|number| self.contents.is_ahead(number));
            let position_us = clock.advance(message.timestamp_us, is_ahead);
            if position_us < self.start_us {
                return Ok(());
            }
            if end_us.is_some_and(|end_us| position_us >= end_us) {
                bail!(Enough::Duration);
            }
            if self.outlets[message.series].is_none() {
                return Ok(());
            }
            self.wait_for(position_us)?;
            self.position_us = position_us;
            self.pace.reach(position_us);
            self.bar.set_position(position_us);
            let Some(outlet) = &mut self.outlets[message.series] else { return Ok(()) };
            outlet.publish(message.bytes, self.args.back_pressure.then_some(&self.interrupt))
        })?;
        Ok(())
    }

    /// Waits until a message may go out that stands here, and does what the keys
    /// say meanwhile.
    fn wait_for(&mut self, position_us: u64) -> anyhow::Result<()> {
        loop {
            if self.interrupt.has_come() || self.keys.signal().is_some() {
                bail!(Early::Interrupted);
            }
            let until = match self.pace.due(position_us) {
                Due::Paused => None,
                Due::At(moment) => moment,
                Due::Now if !self.keys.is_there() => return Ok(()),
                Due::Now => Some(Instant::now()),
            };
            let now = Instant::now;
            match self.keys.wait_until(until, &self.interrupt)? {
                Some(Key::Quit) => bail!(Enough::Quit),
                Some(Key::PauseOrGoOn) => self.pace.pause_or_go_on(now()),
                Some(Key::Faster) => self.pace.faster(now()),
                Some(Key::Slower) => self.pace.slower(now()),
                Some(Key::Step) if self.pace.due(position_us) == Due::Paused => return Ok(()),
                Some(Key::Step) => {}
                None if until.is_some_and(|until| until <= now()) => return Ok(()),
                None => {}
            }
            self.show_pace();
        }
    }

    pub(super) fn show_pace(&self) {
        self.bar.set_message(format!(" {}", self.pace));
    }
}
