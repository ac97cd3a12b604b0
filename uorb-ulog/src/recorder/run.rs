//! The thread that follows the bus: it takes what there is, a few of each series
//! in turn, and begins new files.

use std::io;
use std::thread::sleep;
use std::time::{Duration, SystemTime};

use uorb_core::{RawSubscription, Session, now_us};

use super::files::Files;
use super::follow::{Followed, Standing};
use super::head::{begin_file, on_the_bus, processes};
use super::{Pipe, Plan, RecordError, Tally};
use crate::writer::{Announced, Level, Writer};

const TICK: Duration = Duration::from_millis(5);
/// Where nothing says that a node is new.
const SEARCH_EVERY_US: u64 = 50_000;
const SYNC_EVERY_US: u64 = 500_000;
const PROGRESS_EVERY_US: u64 = 1_000_000;
/// So many messages of one series before it is the next one's turn, so that the
/// file is nearly in the order of time.
const TURN: usize = 32;
/// How long the end waits for the disk to take what is queued.
const LAST_MESSAGES_US: u64 = 5_000_000;

pub(super) struct Recorder<'a> {
    pub(super) session: &'a Session,
    pub(super) plan: &'a Plan,
    pipe: &'a Pipe,
    files: Files,
    /// Who was on the bus when it began.
    processes: Vec<String>,
    pub(super) writer: Writer<&'a Pipe>,
    pub(super) followed: Vec<Followed>,
    /// Of replays, whether all is followed.
    pub(super) questions: Vec<RawSubscription>,
    /// Whether what is found from now on is new on the bus.
    pub(super) has_searched: bool,
    /// Until when nothing new was on the bus.
    pub(super) searched_us: u64,
    /// When nodes had come last, before the last search.
    pub(super) nodes_changed: Option<SystemTime>,
    tally: Tally,
    began_us: u64,
    file_began_us: u64,
    /// Messages in the files before this one.
    before_messages: u64,
    /// Bytes of the files before this one.
    before_bytes: u64,
    /// Whether messages stay in their queues while there is no room.
    waits_for_room: bool,
    /// Since when there was no room.
    full_since_us: Option<u64>,
    /// Until when dropouts are noted already.
    noted_until_us: u64,
    /// What no log can hold, and was said.
    pub(super) left_out: Vec<String>,
}

impl<'a> Recorder<'a> {
    pub(super) fn begin(
        session: &'a Session,
        plan: &'a Plan,
        pipe: &'a Pipe,
    ) -> Result<Self, RecordError> {
        let mut files = Files::new(plan.place.clone());
        let topics = on_the_bus(session, plan)?;
        let (path, file) = files.next()?;
        pipe.next_file(path.clone(), file);
        let began_us = now_us();
        let processes = processes(session);
        let writer = begin_file(plan, pipe, topics, &processes);
        let mut recorder = Self {
            session,
            plan,
            pipe,
            files,
            processes,
            writer,
            followed: Vec::new(),
            questions: Vec::new(),
            has_searched: false,
            searched_us: began_us,
            nodes_changed: None,
            tally: Tally { files: vec![path], ..Tally::default() },
            began_us,
            file_began_us: began_us,
            before_messages: 0,
            before_bytes: 0,
            waits_for_room: plan.back_pressure,
            full_since_us: None,
            noted_until_us: 0,
            left_out: Vec::new(),
        };
        recorder.search()?;
        Ok(recorder)
    }

    pub(super) fn run(
        mut self,
        stop: &dyn Fn() -> bool,
        tell: &mut dyn FnMut(&Tally),
    ) -> Result<Tally, RecordError> {
        let (mut synced_us, mut told_us) = (self.began_us, 0);
        loop {
            let now_us = now_us();
            let after_us = |time: Duration| self.began_us.saturating_add(time.as_micros() as u64);
            let is_over = stop()
                || self.session.has_ended()
                || self.plan.duration.is_some_and(|duration| now_us >= after_us(duration));
            if is_over {
                self.finish()?;
            } else {
                let is_asked = self.questions.iter_mut().any(RawSubscription::updated);
                let is_due = now_us >= self.searched_us + SEARCH_EVERY_US;
                if is_asked || is_due || self.nodes_changed != self.session.system().nodes_changed()
                {
                    self.search()?;
                    self.searched_us = now_us;
                }
                self.drain();
            }
            self.check_file()?;
            if now_us >= synced_us + SYNC_EVERY_US {
                synced_us = now_us;
                written(self.writer.sync());
            }
            self.tally.seconds = now_us.saturating_sub(self.began_us) as f64 / 1e6;
            self.tally.bytes = self.before_bytes + self.writer.written_bytes();
            (self.tally.topics, self.tally.buffered_bytes) =
                (self.followed.len(), self.pipe.buffered_bytes());
            if is_over {
                return Ok(self.tally);
            }
            if now_us >= told_us + PROGRESS_EVERY_US {
                told_us = now_us;
                tell(&self.tally);
            }
            if self.is_file_full(now_us) {
                self.next_file()?;
            }
            sleep(TICK);
        }
    }

    /// Why the file cannot be written, if it cannot.
    fn check_file(&self) -> Result<(), RecordError> {
        self.pipe.failed().map_or(Ok(()), |failed| Err(failed.into()))
    }

    /// Takes all that is published by now. What the disk does not take in time is
    /// lost.
    fn finish(&mut self) -> Result<(), RecordError> {
        self.waits_for_room = true;
        let deadline_us = now_us() + LAST_MESSAGES_US;
        let mut left: Vec<_> =
            self.followed.iter().map(|it| (it.is_whole, end_of(&it.subscription))).collect();
        let mut message = Vec::new();
        loop {
            let mut has_taken = false;
            for (index, (is_left, end)) in left.iter_mut().enumerate() {
                for _ in 0..TURN {
                    *is_left &= missing(&self.followed[index].subscription, *end) > 0;
                    if !*is_left || !self.take(index, &mut message) {
                        break;
                    }
                    has_taken = true;
                }
            }
            self.check_file()?;
            if !left.iter().any(|(is_left, _)| *is_left) || now_us() >= deadline_us {
                break;
            }
            if !has_taken {
                sleep(Duration::from_millis(1));
            }
        }
        for (index, (is_left, end)) in left.into_iter().enumerate() {
            if is_left {
                let it = &self.followed[index];
                let (missing, last_us) = (missing(&it.subscription, end), it.last_us);
                self.count_lost(missing, last_us, now_us());
            }
        }
        if let Some(since_us) = self.full_since_us.take() {
            self.note_dropout(since_us, now_us());
        }
        Ok(())
    }

    /// Begins a new file, for all topics that are on the bus by now; the same one
    /// anew, if no message is in it yet.
    pub(super) fn next_file(&mut self) -> Result<(), RecordError> {
        let mut topics: Vec<_> = (self.followed.iter())
            .filter(|it| matches!(it.standing, Standing::Messages(_)))
            .map(|it| (it.topic.clone(), it.layout.clone()))
            .collect();
        topics.extend(on_the_bus(self.session, self.plan)?);
        self.file_began_us = now_us();
        if self.tally.messages == self.before_messages {
            self.pipe.same_file_anew();
        } else {
            let (path, file) = self.files.next()?;
            self.before_messages = self.tally.messages;
            self.before_bytes += self.writer.written_bytes();
            self.pipe.next_file(path.clone(), file);
            self.tally.files.push(path);
        }
        self.writer = begin_file(self.plan, self.pipe, topics, &self.processes);
        for it in &mut self.followed {
            let Standing::Messages(id) = &mut it.standing else { continue };
            let number = it.subscription.instance().number();
            if let Ok(Announced::As(new)) =
                written(self.writer.announce(&it.topic, number, &it.layout))
            {
                *id = new;
            }
        }
        Ok(())
    }

    fn is_file_full(&self, now_us: u64) -> bool {
        let is_long = |max: u64| self.writer.written_bytes() >= max;
        let is_old =
            |every: Duration| now_us.saturating_sub(self.file_began_us) >= every.as_micros() as u64;
        self.plan.max_size_bytes.is_some_and(is_long) || self.plan.rotate_every.is_some_and(is_old)
    }

    /// Takes what there is, a few of each in turn.
    fn drain(&mut self) {
        let mut message = Vec::new();
        let mut has_more = true;
        // A publisher without a pause does not keep us from all else.
        for _ in 0..64 {
            if !std::mem::take(&mut has_more) {
                break;
            }
            for index in 0..self.followed.len() {
                for turn in 0..TURN {
                    if !self.take(index, &mut message) {
                        break;
                    }
                    has_more |= turn + 1 == TURN;
                }
            }
        }
    }

    /// Takes the next message of a series. False: there is none.
    pub(super) fn take(&mut self, index: usize, message: &mut Vec<u8>) -> bool {
        let it = &mut self.followed[index];
        let bytes = it.record_bytes();
        if self.waits_for_room && !self.pipe.has_room(bytes) {
            return false;
        }
        if !it.subscription.updated() || !it.subscription.copy(message) {
            return false;
        }
        let copied = it.subscription.last_copied().filter(|copied| Some(*copied) != it.last);
        let Some(copied) = copied else { return false };
        it.last = Some(copied);
        let published_us = copied.publish_time_us;
        let last_us = std::mem::replace(&mut it.last_us, published_us);
        let lost = it.subscription.lost() - std::mem::replace(&mut it.lost, it.subscription.lost());
        let standing = it.standing;
        if !self.pipe.has_room(bytes) {
            self.full_since_us.get_or_insert(now_us());
            self.tally.lost += 1 + lost;
            return true;
        }
        if let Some(since_us) = self.full_since_us.take() {
            self.note_dropout(since_us, now_us());
        }
        self.count_lost(lost, last_us, published_us);
        match standing {
            Standing::Messages(id) => written(self.writer.message(id, published_us, message)),
            Standing::Text(words) => {
                let (level, said_us, text) =
                    words.read(message).unwrap_or((Level::Info, None, String::new()));
                written(self.writer.text(level, said_us.unwrap_or(published_us), &text));
            }
        }
        self.tally.messages += 1;
        true
    }

    /// Counts messages that are missing, and notes for how long.
    pub(super) fn count_lost(&mut self, lost: u64, from_us: u64, to_us: u64) {
        if lost > 0 {
            self.tally.lost += lost;
            self.note_dropout(from_us, to_us);
        }
    }

    /// Notes that messages are missing, for the time that is not noted yet:
    /// several series may have lost some at once.
    fn note_dropout(&mut self, from_us: u64, to_us: u64) {
        let from_us = from_us.max(self.noted_until_us);
        if to_us > from_us {
            self.noted_until_us = to_us;
            let length = Duration::from_micros(to_us - from_us);
            self.tally.dropouts += 1;
            self.tally.dropped += length;
            written(self.writer.dropout(length));
        }
    }
}

impl Followed {
    /// What a message takes in the pipe, and a dropout before it.
    fn record_bytes(&self) -> usize {
        Writer::<&Pipe>::message_bytes(self.layout.size_bytes as usize) + 64
    }
}

/// The low half of the newest generation.
fn end_of(subscription: &RawSubscription) -> u32 {
    subscription.generation().get().wrapping_add(subscription.pending() as u32)
}

/// How many messages up to this generation were not copied yet.
fn missing(subscription: &RawSubscription, end: u32) -> u64 {
    let missing = end.wrapping_sub(subscription.generation().get());
    // More than half of all: it is beyond.
    if missing > u32::MAX / 2 { 0 } else { missing.into() }
}

/// The pipe is memory, and takes whatever it is given.
pub(super) fn written<T>(result: io::Result<T>) -> T {
    result.expect("a record is shorter than 2^16, and memory takes it")
}
