//! What goes out: streams of messages, each made of topics at a rate of its own.
//!
//! A stream follows its topic with an interval, so the bus does the pacing: it
//! shows the newest message when the interval is over, and wakes the link then.
//! A stream that is not about one topic's updates, as the heartbeat, goes by the
//! clock. The table in `outgoing/table.rs` says which is which, and how often.
//!
//! A link has so many bytes a second. When its streams want more, all their
//! intervals are stretched by the same factor; and also when its transport has
//! had no room for a packet.

mod attitude;
mod battery;
mod modes;
mod newer;
mod position;
mod sensors;
pub(crate) mod source;
mod state;
pub(crate) mod table;
mod text;

use std::fmt;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use uorb_core::{RawSubscription, Session};

pub use self::modes::custom_mode;
use self::source::Source;
pub use self::table::{Mode, Rate, STREAMS, StreamDefinition};
use crate::ours;
use crate::port::{Port, Transmitted};

/// The least part of their rates that streams keep, however slow the link is.
const MULTIPLIER_MIN: f64 = 0.05;

/// How much the factor recovers in a second in which nothing was dropped.
const RECOVERY: f64 = 1.1;

/// The most messages that one stream sends in one turn: others wait.
const MESSAGES_A_TURN_MAX: usize = 16;

/// The streams of a link.
pub struct Streams {
    session: Session,
    all: Vec<Stream>,
    data_rate: u32,
    /// What the transport can take, as a factor.
    room: f64,
    /// By what rates are multiplied.
    multiplier: f64,
    /// What the link had sent when rates were looked at last.
    transmitted: Transmitted,
}

struct Stream {
    definition: &'static StreamDefinition,
    rate: Rate,
    default: Rate,
    /// Subscriptions are made when the stream is first wanted.
    source: Option<Box<dyn Source>>,
    /// By the clock: when it is due.
    due_us: u64,
    /// What one turn has sent lately.
    size_bytes: u64,
    /// What was sent since rates were looked at last.
    sent_bytes: u64,
}

impl fmt::Debug for Streams {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = self.all.iter().map(|stream| (stream.definition.name, stream.rate));
        f.debug_map().entries(names).finish()
    }
}

impl Streams {
    pub(crate) fn new(session: &Session, mode: Mode, data_rate: u32) -> Self {
        let all = STREAMS.iter().chain(ours::STREAMS).map(|definition| {
            let rate = definition.rate(mode);
            Stream {
                definition,
                rate,
                default: rate,
                source: None,
                due_us: 0,
                size_bytes: 0,
                sent_bytes: 0,
            }
        });
        let all = all.collect();
        Self {
            session: session.clone(),
            all,
            data_rate,
            room: 1.0,
            multiplier: 1.0,
            transmitted: Transmitted::default(),
        }
    }

    fn find(&mut self, message_id: u32) -> Option<&mut Stream> {
        self.all.iter_mut().find(|stream| stream.definition.message_id == message_id)
    }

    /// How often a message goes out. None: it is none of ours.
    pub fn rate(&self, message_id: u32) -> Option<Rate> {
        let stream = self.all.iter().find(|it| it.definition.message_id == message_id);
        stream.map(|stream| stream.rate)
    }

    /// Changes how often a message goes out; None: as the mode has it. False:
    /// it is none of ours.
    pub fn set_rate(&mut self, message_id: u32, rate: Option<Rate>) -> bool {
        let multiplier = self.multiplier;
        let Some(stream) = self.find(message_id) else { return false };
        stream.rate = rate.unwrap_or(stream.default);
        stream.due_us = 0;
        stream.pace(multiplier);
        true
    }

    /// Sends a message now, of what is newest. False: it is none of ours, or
    /// nothing was ever published that it could be made of.
    pub fn send_once(&mut self, message_id: u32, port: &mut Port) -> bool {
        let (session, multiplier) = (self.session.clone(), self.multiplier);
        let Some(stream) = self.find(message_id) else { return false };
        stream.open(&session, multiplier);
        stream.send(port) > 0
    }

    /// By how much rates are scaled down.
    pub fn multiplier(&self) -> f64 {
        self.multiplier
    }

    /// Sends what is due.
    pub(crate) fn step(&mut self, now_us: u64, port: &mut Port) {
        // All follow their topics before the first word goes out: whoever hears
        // it may publish something at once.
        for stream in self.all.iter_mut().filter(|stream| stream.rate != Rate::Off) {
            stream.open(&self.session, self.multiplier);
        }
        for stream in self.all.iter_mut().filter(|stream| stream.rate != Rate::Off) {
            stream.step(now_us, self.multiplier, port);
        }
    }

    /// When the next stream is due by the clock.
    pub(crate) fn due_us(&mut self) -> u64 {
        let by_clock = self.all.iter_mut().filter(|stream| stream.rate != Rate::Off);
        let due = by_clock.filter_map(|stream| stream.lead().is_none().then_some(stream.due_us));
        due.min().unwrap_or(u64::MAX)
    }

    /// What wakes the link: the topics of streams that go by topic.
    pub(crate) fn descriptors(&mut self) -> impl Iterator<Item = BorrowedFd<'_>> {
        let on = self.all.iter_mut().filter(|stream| stream.rate != Rate::Off);
        on.filter_map(|stream| stream.lead()).map(|lead| (*lead).as_fd())
    }

    /// Once a second: fits rates to what the link can carry.
    pub(crate) fn fit(&mut self, elapsed_us: u64, transmitted: Transmitted) {
        let seconds = (elapsed_us as f64 / 1e6).max(1e-3);
        let before = std::mem::replace(&mut self.transmitted, transmitted);
        // Answers and parameters are what no stream has sent.
        let streamed: u64 = self.all.iter().map(|stream| stream.sent_bytes).sum();
        let mut fixed = (transmitted.bytes - before.bytes - streamed) as f64 / seconds;
        let mut scaled = 0.0;
        for stream in &mut self.all {
            let sent = std::mem::take(&mut stream.sent_bytes) as f64 / seconds;
            match stream.rate {
                Rate::Hz(hz) if stream.definition.is_scaled => {
                    scaled += stream.size_bytes as f64 * f64::from(hz);
                }
                Rate::Hz(hz) => fixed += stream.size_bytes as f64 * f64::from(hz),
                Rate::Every => fixed += sent,
                Rate::Off => {}
            }
        }
        self.room = match transmitted.dropped > before.dropped {
            true => self.room / 2.0,
            false => self.room * RECOVERY,
        };
        self.room = self.room.clamp(MULTIPLIER_MIN, 1.0);
        let budget = (f64::from(self.data_rate) - fixed).max(0.0);
        let wanted = if scaled > budget { budget / scaled } else { 1.0 };
        let multiplier = wanted.min(self.room).max(MULTIPLIER_MIN);
        // Each new interval begins anew: not for a hair's breadth.
        let is_news = (multiplier / self.multiplier - 1.0).abs() > 0.02;
        if is_news || multiplier == 1.0 && self.multiplier < 1.0 {
            self.multiplier = multiplier;
            self.all.iter_mut().for_each(|stream| stream.pace(multiplier));
        }
    }
}

impl Stream {
    fn lead(&mut self) -> Option<&mut RawSubscription> {
        self.source.as_mut()?.lead()
    }

    fn open(&mut self, session: &Session, multiplier: f64) {
        if self.source.is_none() {
            self.source = Some((self.definition.make)(session));
            self.pace(multiplier);
        }
    }

    fn interval_us(&self, multiplier: f64) -> u64 {
        let multiplier = if self.definition.is_scaled { multiplier } else { 1.0 };
        match self.rate {
            Rate::Hz(hz) => (1e6 / (f64::from(hz) * multiplier)) as u64,
            Rate::Every | Rate::Off => 0,
        }
    }

    fn pace(&mut self, multiplier: f64) {
        let interval = Duration::from_micros(self.interval_us(multiplier));
        if let Some(lead) = self.lead() {
            lead.set_interval(interval);
        }
    }

    fn step(&mut self, now_us: u64, multiplier: f64, port: &mut Port) {
        if self.lead().is_none() {
            if now_us >= self.due_us {
                self.send(port);
                let interval_us = self.interval_us(multiplier).max(1_000);
                // A beat that was missed is not made up for.
                let is_late = now_us - self.due_us > interval_us;
                self.due_us = if is_late { now_us } else { self.due_us } + interval_us;
            }
            return;
        }
        for _ in 0..MESSAGES_A_TURN_MAX {
            if !self.lead().is_some_and(|lead| lead.updated()) {
                break;
            }
            self.send(port);
        }
    }

    fn send(&mut self, port: &mut Port) -> u64 {
        let before = port.transmitted().bytes;
        if let Some(source) = &mut self.source {
            source.compose(&mut |message| {
                port.send(&message);
            });
        }
        let sent_bytes = port.transmitted().bytes - before;
        if sent_bytes > 0 {
            self.size_bytes = sent_bytes;
            self.sent_bytes += sent_bytes;
        }
        sent_bytes
    }
}
