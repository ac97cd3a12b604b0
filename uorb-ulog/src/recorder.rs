//! Records a bus: every message of the topics that are chosen, into a log.
//!
//! It looks at all its subscriptions every 5 ms, as PX4's logger does, and
//! never sleeps on a bell: publishers make no system call for it. Their streams
//! keep 1,024 messages meanwhile. What is lost on a stream all the same, or finds
//! the memory before the disk full, is counted, and a dropout says for how long.

mod choice;
mod files;
mod pipe;

use std::io;
use std::path::PathBuf;
use std::thread::sleep;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use uorb_core::{Copied, Instance, Layout, RawSubscription, Session, StreamOptions, now_us};

pub use self::choice::{Choice, Rule};
pub use self::files::Place;

use self::choice::Rate;
use self::files::Files;
use self::pipe::Pipe;
use crate::writer::{Announced, Head, Level, Parameter, SeriesId, Value, Writer};

const TICK: Duration = Duration::from_millis(5);
const SEARCH_EVERY_US: u64 = 50_000;
const SYNC_EVERY_US: u64 = 500_000;
const PROGRESS_EVERY_US: u64 = 1_000_000;
/// So many messages of one series before it is the next one's turn, so that the
/// file is nearly in the order of time.
const TURN: usize = 32;

/// What to record, and how.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Which topics.
    pub choice: Choice,
    /// Where to.
    pub place: Place,
    /// Begins a new file when one is as long as this.
    pub max_size_bytes: Option<u64>,
    /// Begins a new file after this time.
    pub rotate_every: Option<Duration>,
    /// Ends after this time.
    pub duration: Option<Duration>,
    /// Whether `try_publish` waits for the recorder: it loses nothing then, and
    /// the disk decides how fast the bus is.
    pub back_pressure: bool,
    /// The memory between the bus and the disk.
    pub buffer_bytes: usize,
    /// The parameters of the vehicle.
    pub parameters: Vec<Parameter>,
    /// Topics that may appear, so that they need no new file.
    pub known: Vec<(String, Layout)>,
}

/// What has been recorded.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Since the beginning.
    pub seconds: f64,
    /// Messages written.
    pub messages: u64,
    /// Bytes written.
    pub bytes: u64,
    /// Messages lost, on the streams or before the disk.
    pub lost: u64,
    /// How often some were.
    pub dropouts: u64,
    /// The files, in their order.
    pub files: Vec<PathBuf>,
}

/// Why a recording has ended.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// Something of the bus.
    #[error(transparent)]
    Bus(#[from] uorb_core::Error),
    /// A file, or the disk under it.
    #[error("cannot write {}: {error}{}", path.display(), cure(error))]
    File {
        /// Which one.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// No thread can be made.
    #[error("cannot start the thread that writes: {0}")]
    Thread(io::Error),
}

fn cure(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "; free some space, or record elsewhere with -o. What was written can be read"
        }
        io::ErrorKind::AlreadyExists => "; remove it, or record elsewhere with -o",
        _ => "",
    }
}

impl From<(PathBuf, io::Error)> for RecordError {
    fn from((path, error): (PathBuf, io::Error)) -> Self {
        Self::File { path, error }
    }
}

/// Records until `stop` says so, the plan's time is over, or the system ends.
/// `tell` hears once a second how far it has come.
///
/// # Errors
///
/// [`RecordError`]. What was written until then can be read.
pub fn record(
    session: &Session,
    plan: &Plan,
    stop: &dyn Fn() -> bool,
    tell: &mut dyn FnMut(&Tally),
) -> Result<Tally, RecordError> {
    let pipe = Pipe::new(plan.buffer_bytes).map_err(RecordError::Thread)?;
    let tally = Recorder::begin(session, plan, &pipe)?.run(stop, tell)?;
    match pipe.end() {
        Some(failed) => Err(failed.into()),
        None => Ok(tally),
    }
}

struct Recorder<'a> {
    session: &'a Session,
    plan: &'a Plan,
    pipe: &'a Pipe,
    files: Files,
    writer: Writer<&'a Pipe>,
    followed: Vec<Followed>,
    tally: Tally,
    began_us: u64,
    file_began_us: u64,
    /// Messages in the files before this one.
    before_messages: u64,
    /// Bytes of the files before this one.
    before_bytes: u64,
    /// Since when there was no room.
    full_since_us: Option<u64>,
    /// Until when dropouts are noted already.
    noted_until_us: u64,
    /// What no log can hold, and was said.
    left_out: Vec<String>,
}

/// One instance of a topic.
struct Followed {
    subscription: RawSubscription,
    topic: String,
    layout: Layout,
    id: SeriesId,
    lost: u64,
    last_us: u64,
    last: Option<Copied>,
}

impl<'a> Recorder<'a> {
    fn begin(session: &'a Session, plan: &'a Plan, pipe: &'a Pipe) -> Result<Self, RecordError> {
        let mut files = Files::new(plan.place.clone());
        let topics = on_the_bus(session, plan)?;
        let (path, file) = files.next()?;
        pipe.next_file(path.clone(), file);
        let began_us = now_us();
        let writer = begin_file(plan, pipe, topics);
        let mut recorder = Self {
            session,
            plan,
            pipe,
            files,
            writer,
            followed: Vec::new(),
            tally: Tally { files: vec![path], ..Tally::default() },
            began_us,
            file_began_us: began_us,
            before_messages: 0,
            before_bytes: 0,
            full_since_us: None,
            noted_until_us: 0,
            left_out: Vec::new(),
        };
        recorder.search()?;
        Ok(recorder)
    }

    fn run(
        mut self,
        stop: &dyn Fn() -> bool,
        tell: &mut dyn FnMut(&Tally),
    ) -> Result<Tally, RecordError> {
        let (mut searched_us, mut synced_us, mut told_us) = (self.began_us, self.began_us, 0);
        loop {
            let now_us = now_us();
            let after_us = |time: Duration| self.began_us.saturating_add(time.as_micros() as u64);
            let is_over = stop()
                || self.session.has_ended()
                || self.plan.duration.is_some_and(|duration| now_us >= after_us(duration));
            if let Some(failed) = self.pipe.failed() {
                return Err(failed.into());
            }
            if now_us >= searched_us + SEARCH_EVERY_US && !is_over {
                searched_us = now_us;
                self.search()?;
            }
            self.drain()?;
            if now_us >= synced_us + SYNC_EVERY_US {
                synced_us = now_us;
                written(self.writer.sync());
            }
            if self.is_file_full(now_us) {
                self.next_file()?;
            }
            self.tally.seconds = now_us.saturating_sub(self.began_us) as f64 / 1e6;
            self.tally.bytes = self.before_bytes + self.writer.written_bytes();
            if now_us >= told_us + PROGRESS_EVERY_US {
                told_us = now_us;
                tell(&self.tally);
            }
            if is_over {
                if let Some(since_us) = self.full_since_us.take() {
                    self.note_dropout(since_us, now_us);
                }
                return Ok(self.tally);
            }
            sleep(TICK);
        }
    }

    /// Follows what has appeared, and lets go of what gave way.
    fn search(&mut self) -> Result<(), RecordError> {
        self.followed.retain(|it| it.subscription.check().is_ok());
        for (topic, instance) in self.session.system().list_nodes()? {
            let is_known =
                |it: &Followed| it.topic == topic && it.subscription.instance() == instance;
            let Some(rate) = self.plan.choice.rate(&topic) else { continue };
            if self.followed.iter().any(is_known) || self.left_out.contains(&topic) {
                continue;
            }
            // It may have gone since.
            let Ok(metadata) = self.session.describe(&topic) else { continue };
            let layout = metadata.layout.into_owned();
            if let Some(id) = self.announce(&topic, instance, &layout)? {
                self.follow(topic, instance, rate, layout, id)?;
            }
        }
        Ok(())
    }

    fn follow(
        &mut self,
        topic: String,
        instance: Instance,
        rate: Rate,
        layout: Layout,
        id: SeriesId,
    ) -> Result<(), RecordError> {
        let subscription = match rate {
            Rate::EveryMessage => {
                let back_pressure = self.plan.back_pressure;
                let options = StreamOptions { back_pressure, ..StreamOptions::default() };
                RawSubscription::subscribe_stream(self.session, &topic, instance, options)?
            }
            Rate::Hz(hz) => {
                let mut subscription = RawSubscription::subscribe(self.session, &topic, instance)?;
                subscription.set_interval(Duration::from_secs_f64(1.0 / hz));
                subscription
            }
        };
        let (lost, last_us, last) = (0, now_us(), None);
        self.followed.push(Followed { subscription, topic, layout, id, lost, last_us, last });
        Ok(())
    }

    /// Announces an instance, in a new file if need be. None: no log can hold it.
    fn announce(
        &mut self,
        topic: &str,
        instance: Instance,
        layout: &Layout,
    ) -> Result<Option<SeriesId>, RecordError> {
        let number = instance.number();
        let mut announced = written(self.writer.announce(topic, number, layout));
        if announced == Ok(Announced::NeedsNewFile) {
            self.next_file()?;
            announced = written(self.writer.announce(topic, number, layout));
        }
        let why = match announced {
            Ok(Announced::As(id)) => return Ok(Some(id)),
            Ok(Announced::NeedsNewFile) => "it does not fit beside the other topics".to_string(),
            Err(why) => why.to_string(),
        };
        let words = format!("{topic} is not recorded: {why}");
        written(self.writer.text(Level::Warning, now_us(), &words));
        self.left_out.push(topic.to_string());
        Ok(None)
    }

    /// Begins a new file, for all topics that are on the bus by now; the same one
    /// anew, if no message is in it yet.
    fn next_file(&mut self) -> Result<(), RecordError> {
        let mut topics: Vec<_> =
            self.followed.iter().map(|it| (it.topic.clone(), it.layout.clone())).collect();
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
        self.writer = begin_file(self.plan, self.pipe, topics);
        for it in &mut self.followed {
            let number = it.subscription.instance().number();
            let announced = written(self.writer.announce(&it.topic, number, &it.layout));
            if let Ok(Announced::As(id)) = announced {
                it.id = id;
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
    fn drain(&mut self) -> Result<(), RecordError> {
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
        Ok(())
    }

    /// Takes the next message of a series. False: there is none.
    fn take(&mut self, index: usize, message: &mut Vec<u8>) -> bool {
        let it = &mut self.followed[index];
        let bytes = Writer::<&Pipe>::message_bytes(it.layout.size_bytes as usize) + 64;
        if self.plan.back_pressure && !self.pipe.has_room(bytes) {
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
        let id = it.id;
        if !self.pipe.has_room(bytes) {
            self.full_since_us.get_or_insert(now_us());
            self.tally.lost += 1 + lost;
            return true;
        }
        if let Some(since_us) = self.full_since_us.take() {
            self.note_dropout(since_us, now_us());
        }
        if lost > 0 {
            self.tally.lost += lost;
            self.note_dropout(last_us, published_us);
        }
        written(self.writer.message(id, published_us, message));
        self.tally.messages += 1;
        true
    }

    /// Notes that messages are missing, for the time that is not noted yet:
    /// several series may have lost some at once.
    fn note_dropout(&mut self, from_us: u64, to_us: u64) {
        let from_us = from_us.max(self.noted_until_us);
        if to_us > from_us {
            self.noted_until_us = to_us;
            self.tally.dropouts += 1;
            written(self.writer.dropout(Duration::from_micros(to_us - from_us)));
        }
    }
}

/// Name and layout of the chosen topics that have nodes.
fn on_the_bus(session: &Session, plan: &Plan) -> Result<Vec<(String, Layout)>, RecordError> {
    let mut names: Vec<String> =
        session.system().list_nodes()?.into_iter().map(|(topic, _)| topic).collect();
    names.dedup();
    names.retain(|topic| plan.choice.rate(topic).is_some());
    // One that has gone meanwhile is not there.
    let describe = |topic: String| Some((session.describe(&topic).ok()?.layout, topic));
    let found = names.into_iter().filter_map(describe);
    Ok(found.map(|(layout, topic)| (topic, layout.into_owned())).collect())
}

/// The head of a file: the topics of the bus first, and then those that may come.
fn begin_file<'a>(plan: &Plan, pipe: &'a Pipe, topics: Vec<(String, Layout)>) -> Writer<&'a Pipe> {
    let known = plan.known.iter().filter(|(topic, _)| plan.choice.rate(topic).is_some());
    let mut all = topics;
    all.extend(known.cloned());
    let mut names = std::collections::HashSet::new();
    all.retain(|(topic, _)| names.insert(topic.clone()));
    let head = Head {
        timestamp_us: now_us(),
        infos: infos(),
        topics: all,
        parameters: plan.parameters.clone(),
        texts: Vec::new(),
    };
    written(Writer::begin(pipe, &head))
}

/// What is known of the machine. There is no time zone: times are UTC.
fn infos() -> Vec<(String, Value)> {
    let read = |path| std::fs::read_to_string(path).unwrap_or_default().trim().to_string();
    let text = |text: &str| Value::Text(text.to_string());
    let utc_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let machine = format!("LINUX_{}", std::env::consts::ARCH.to_uppercase());
    let mut infos = vec![
        ("sys_name".to_string(), text("uORB")),
        ("ver_sw".to_string(), text(env!("CARGO_PKG_VERSION"))),
        ("ver_hw".to_string(), text(&machine)),
        ("sys_os_name".to_string(), text("Linux")),
        ("sys_os_ver".to_string(), text(&read("/proc/sys/kernel/osrelease"))),
        ("time_ref_utc".to_string(), Value::Int32(0)),
        ("time_utc_s".to_string(), Value::Uint32(utc_s as u32)),
    ];
    let uuid = read("/etc/machine-id");
    if !uuid.is_empty() {
        infos.push(("sys_uuid".to_string(), text(&uuid)));
    }
    infos
}

/// The pipe is memory, and takes whatever it is given.
fn written<T>(result: io::Result<T>) -> T {
    result.expect("a record is shorter than 2^16, and memory takes it")
}
