//! What of the bus is followed: all that is chosen, as soon as it appears, until
//! it gives way to another layout.

use std::thread::sleep;
use std::time::Duration;

use uorb_core::broker_side::{Node, Role};
use uorb_core::{
    Copied, Error, Instance, Layout, RawSubscription, Session, StreamOptions, Topic, now_us,
};

use super::choice::Rate;
use super::run::{Recorder, written};
use super::words::Words;
use super::{RecordError, ReplayReady};
use crate::writer::{Announced, Level, SeriesId};

/// How long a message may still be on its way to somebody who is about to go.
const ON_ITS_WAY_US: u64 = 20_000;

/// One instance of a topic.
pub(super) struct Followed {
    pub(super) subscription: RawSubscription,
    pub(super) topic: String,
    pub(super) layout: Layout,
    pub(super) standing: Standing,
    pub(super) lost: u64,
    /// Until when nothing of it is missing.
    pub(super) last_us: u64,
    pub(super) last: Option<Copied>,
    /// Whether it loses nothing: it has no rate.
    pub(super) is_whole: bool,
}

/// How messages stand in the log.
#[derive(Clone, Copy, Debug)]
pub(super) enum Standing {
    Messages(SeriesId),
    Text(Words),
}

impl Recorder<'_> {
    /// Follows what has appeared, and lets go of what gave way.
    pub(super) fn search(&mut self) -> Result<(), RecordError> {
        // In this order: what was advertised before a question came is found.
        let is_asked: Vec<bool> = self.questions.iter_mut().map(RawSubscription::updated).collect();
        self.nodes_changed = self.session.system().nodes_changed();
        for index in (0..self.followed.len()).rev() {
            if self.followed[index].subscription.check().is_err() {
                self.let_go(index);
            }
        }
        for (topic, instance) in self.session.system().list_nodes()? {
            let is_known =
                |it: &Followed| it.topic == topic && it.subscription.instance() == instance;
            if topic == ReplayReady::METADATA.name {
                self.hear_questions(instance)?;
                continue;
            }
            let Some(rate) = self.plan.choice.rate(&topic) else { continue };
            if self.followed.iter().any(is_known) || self.left_out.contains(&topic) {
                continue;
            }
            // It may have gone since.
            let Ok(metadata) = self.session.describe(&topic) else { continue };
            let layout = metadata.layout.into_owned();
            let standing = match Words::of(&topic, &layout) {
                Some(words) => Some(Standing::Text(words)),
                None => self.announce(&topic, instance, &layout)?.map(Standing::Messages),
            };
            let Some(standing) = standing else { continue };
            match subscribe(self.session, &topic, instance, rate, self.plan.back_pressure) {
                Ok(subscription) => self.follow(subscription, layout, standing, rate),
                Err(error) if is_temporary(&error) => {}
                Err(error) => self.leave_out(&topic, &error.to_string()),
            }
        }
        self.has_searched = true;
        for (question, is_asked) in self.questions.iter_mut().zip(is_asked) {
            if is_asked {
                question.copy(&mut Vec::new());
            }
        }
        Ok(())
    }

    fn follow(
        &mut self,
        subscription: RawSubscription,
        layout: Layout,
        standing: Standing,
        rate: Rate,
    ) {
        let topic = subscription.topic().to_string();
        // What was there when the recording began is not missing in it.
        if self.has_searched && rate == Rate::EveryMessage {
            let lost = published_before(self.session, &subscription);
            self.count_lost(lost, self.searched_us, now_us());
        }
        self.followed.push(Followed {
            subscription,
            topic,
            layout,
            standing,
            lost: 0,
            last_us: now_us(),
            last: None,
            is_whole: rate == Rate::EveryMessage,
        });
    }

    /// Hears the questions of replays, of each in turn.
    fn hear_questions(&mut self, instance: Instance) -> Result<(), RecordError> {
        let is_heard = self.questions.iter().any(|question| question.instance() == instance);
        if !is_heard && self.plan.back_pressure {
            let topic = &ReplayReady::METADATA.name;
            match subscribe(self.session, topic, instance, Rate::EveryMessage, true) {
                Ok(question) => self.questions.push(question),
                Err(error) if is_temporary(&error) => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    /// Takes what is left of a node that gave way; what does not come is lost.
    fn let_go(&mut self, index: usize) {
        let deadline_us = now_us() + ON_ITS_WAY_US;
        let mut message = Vec::new();
        while self.followed[index].subscription.pending() > 0 && now_us() < deadline_us {
            if !self.take(index, &mut message) {
                sleep(Duration::from_millis(1));
            }
        }
        let gone = self.followed.remove(index);
        if gone.is_whole {
            self.count_lost(gone.subscription.pending(), gone.last_us, now_us());
        }
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
        self.leave_out(topic, &why);
        Ok(None)
    }

    fn leave_out(&mut self, topic: &str, why: &str) {
        let words = format!("{topic} is not recorded: {why}");
        written(self.writer.text(Level::Warning, now_us(), &words));
        self.left_out.push(topic.to_string());
    }
}

fn subscribe(
    session: &Session,
    topic: &str,
    instance: Instance,
    rate: Rate,
    back_pressure: bool,
) -> Result<RawSubscription, Error> {
    match rate {
        Rate::EveryMessage => {
            let options = StreamOptions { back_pressure, ..StreamOptions::default() };
            RawSubscription::subscribe_stream(session, topic, instance, options)
        }
        Rate::Hz(hz) => {
            let mut subscription = RawSubscription::subscribe(session, topic, instance)?;
            subscription.set_interval(Duration::from_secs_f64(1.0 / hz));
            Ok(subscription)
        }
    }
}

/// Whether the next search may come further: the broker is away, or the system
/// is about to end.
fn is_temporary(error: &Error) -> bool {
    matches!(error, Error::NoBroker { .. } | Error::NoAnswer { .. } | Error::Ended { .. })
}

/// How many messages a node had before those that this subscription will copy.
fn published_before(session: &Session, subscription: &RawSubscription) -> u64 {
    let (topic, instance) = (subscription.topic(), subscription.instance());
    // One that is gone already gave way, and is let go of soon.
    let node = Node::open(session.system(), topic, instance, Role::Observer);
    node.map_or(0, |node| {
        subscription.generation().get().wrapping_sub(node.identity.base as u32).into()
    })
}
