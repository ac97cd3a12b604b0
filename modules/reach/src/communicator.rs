//! The network, in the four words of PX4's uORBCommunicator: a topic is
//! advertised, a subscription is added, and removed, and a message is received.
//!
//! The first three are liveliness tokens of zenoh: they are there as long as the
//! process that has declared them can be reached, and vanish by themselves when it
//! dies or the link does. What is heard of others is kept as sets, which whoever
//! is interested compares with what there was: nothing queues up.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::anyhow;
use uorb_core::broker_side::PACKET_MAX_BYTES;
use uorb_core::now_us;
use zenoh::bytes::ZBytes;
use zenoh::handlers::Callback;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{Query, Reply};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Config, Session, Wait};

use crate::keys::{Place, Remote, Source, Wish};
use crate::rules::Crossing;
use crate::wire::About;

/// The most topics, and subscriptions, of others that are remembered: what comes
/// from the network has a bound.
const HEARD_MAX: usize = 100_000;

/// The longest description of a topic: the broker takes none that is longer.
const ABOUT_MAX_BYTES: usize = PACKET_MAX_BYTES;

/// How long an answer may take.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// A lock that a panic elsewhere does not take away.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// This machine on the network.
#[derive(Debug)]
pub(crate) struct Communicator {
    session: Session,
    pub(crate) place: Place,
    heard: Arc<Heard>,
}

/// What is known of others.
#[derive(Debug, Default)]
struct Heard {
    /// Counts what follows coming and going.
    changes: AtomicU64,
    /// Which topics they have, by revision.
    advertised: Mutex<BTreeSet<(Remote, u32)>>,
    /// Who subscribes to topics of ours.
    wanted: Mutex<BTreeSet<Wish>>,
    /// Answers to our questions about topics, while those are advertised.
    answers: Mutex<BTreeMap<Remote, Vec<u8>>>,
    /// What we answer about ours.
    ours: Mutex<BTreeMap<Source, Vec<u8>>>,
}

/// A topic of ours that others know of, until this is dropped.
#[derive(Debug)]
pub(crate) struct Advertised {
    _token: LivelinessToken,
    source: Source,
    heard: Arc<Heard>,
}

impl Drop for Advertised {
    fn drop(&mut self) {
        lock(&self.heard.ours).remove(&self.source);
    }
}

/// A subscription to a topic of another machine.
#[derive(Debug)]
pub(crate) struct Added {
    /// In this order: whoever sends hears first that nobody wants it.
    _token: LivelinessToken,
    _subscriber: Subscriber<()>,
}

/// What goes between us and zenoh's words.
fn words(error: zenoh::Error) -> anyhow::Error {
    anyhow!("{error}")
}

impl Communicator {
    pub(crate) fn open(config: Config, place: Place) -> anyhow::Result<Self> {
        let session = zenoh::open(config).wait().map_err(words)?;
        let communicator = Self { session, place, heard: Arc::default() };
        communicator.hear().map_err(words)?;
        Ok(communicator)
    }

    /// Listens to what others say, and answers what they ask, until the end.
    fn hear(&self) -> Result<(), zenoh::Error> {
        let (session, ours) = (&self.session, &self.place);
        let heard = self.heard.clone();
        let place = ours.clone();
        let hear = move |sample: Sample| {
            let token = Remote::parse_token(sample.key_expr());
            let token = token.filter(|(remote, _)| remote.place != place);
            heard.note(&heard.advertised, token.clone(), sample.kind());
            if let Some((remote, _)) = &token {
                let mut answers = lock(&heard.answers);
                if !heard.is_advertised(remote) {
                    answers.remove(remote);
                }
            }
        };
        let tokens = session.liveliness().declare_subscriber(Remote::ALL_TOKENS);
        tokens.history(true).callback(hear).background().wait()?;

        let heard = self.heard.clone();
        let place = ours.clone();
        let hear = move |sample: Sample| {
            let wish = Wish::parse(sample.key_expr()).filter(|wish| wish.place != place);
            heard.note(&heard.wanted, wish, sample.kind());
        };
        let wishes = session.liveliness().declare_subscriber(ours.all_wanted());
        wishes.history(true).callback(hear).background().wait()?;

        let heard = self.heard.clone();
        let answer = move |query: Query| {
            let asked = Remote::parse_about(query.key_expr());
            let about = asked.and_then(|remote| lock(&heard.ours).get(&remote.source).cloned());
            if let Some(about) = about {
                // Who has asked and is gone needs no answer.
                let _ = query.reply(query.key_expr().clone(), about).wait();
            }
        };
        session.declare_queryable(ours.all_about()).callback(answer).background().wait()?;

        let answer = |query: Query| {
            let now = now_us().to_le_bytes().to_vec();
            let _ = query.reply(query.key_expr().clone(), now).wait();
        };
        session.declare_queryable(ours.clock()).callback(answer).background().wait()
    }

    /// uORBCommunicator's `topic_advertised`: tells the others that there is a topic.
    pub(crate) fn topic_advertised(
        &self,
        source: &Source,
        about: &About,
    ) -> anyhow::Result<Advertised> {
        self.describe(source, about);
        let token = self.ours(source).token(about.revision());
        let token = self.session.liveliness().declare_token(token).wait().map_err(words)?;
        Ok(Advertised { _token: token, source: source.clone(), heard: self.heard.clone() })
    }

    /// Answers this from now on to who asks about a topic of ours.
    pub(crate) fn describe(&self, source: &Source, about: &About) {
        lock(&self.heard.ours).insert(source.clone(), about.encode());
    }

    /// uORBCommunicator's `add_subscription`: asks for a topic of another machine, at
    /// this rate at most (None: for every message). `received` is called on a thread of
    /// zenoh's, and is not to wait. None: it was the last message for now.
    pub(crate) fn add_subscription(
        &self,
        remote: &Remote,
        rate_mhz: Option<u32>,
        received: impl Fn(Option<&[u8]>) + Send + Sync + 'static,
    ) -> anyhow::Result<Added> {
        let receive = move |sample: Sample| match sample.kind() {
            SampleKind::Put => received(Some(&sample.payload().to_bytes())),
            SampleKind::Delete => received(None),
        };
        let subscriber =
            self.session.declare_subscriber(remote.key()).with(Callback::from(receive)).wait();
        // In this order: who sends finds somebody who receives.
        let subscriber = subscriber.map_err(words)?;
        let token = remote.wanted(&self.place, rate_mhz);
        let token = self.session.liveliness().declare_token(token).wait().map_err(words)?;
        Ok(Added { _token: token, _subscriber: subscriber })
    }

    /// uORBCommunicator's `remove_subscription`.
    pub(crate) fn remove_subscription(&self, added: Added) {
        drop(added);
    }

    /// uORBCommunicator's `send_message`, as often as one likes.
    pub(crate) fn sender(
        &self,
        source: &Source,
        crossing: Crossing,
    ) -> anyhow::Result<Publisher<'static>> {
        // Each kind has a queue of its own in zenoh, so what is dropped where there is no
        // room goes before what waits. Of those that wait each waits for the one before it.
        let (priority, congestion) = match crossing {
            Crossing::BestEffort => (Priority::DataHigh, CongestionControl::Drop),
            Crossing::Reliable => (Priority::Data, CongestionControl::Block),
            Crossing::Express => (Priority::InteractiveHigh, CongestionControl::Drop),
        };
        let publisher = self.session.declare_publisher(self.ours(source).key());
        let publisher = publisher.priority(priority).congestion_control(congestion);
        publisher.express(crossing == Crossing::Express).wait().map_err(words)
    }

    /// Asks what the messages of a topic are. The answer is [`Communicator::about`].
    pub(crate) fn ask_about(&self, remote: &Remote) -> anyhow::Result<()> {
        let (heard, key) = (self.heard.clone(), remote.clone());
        self.ask(&remote.about(), move |answer| {
            let mut answers = lock(&heard.answers);
            if answer.len() <= ABOUT_MAX_BYTES && heard.is_advertised(&key) {
                answers.insert(key.clone(), answer.to_vec());
            }
        })
    }

    /// The answer to a question, once.
    pub(crate) fn about(&self, remote: &Remote) -> Option<Vec<u8>> {
        lock(&self.heard.answers).remove(remote)
    }

    /// Asks another machine what time it is; `answered` hears when we asked, its time,
    /// and when its answer was here, all in microseconds.
    pub(crate) fn ask_clock(
        &self,
        place: &Place,
        answered: impl Fn(u64, u64, u64) + Send + Sync + 'static,
    ) -> anyhow::Result<()> {
        let asked_us = now_us();
        self.ask(&place.clock(), move |answer| {
            if let Ok(theirs_us) = answer.try_into().map(u64::from_le_bytes) {
                answered(asked_us, theirs_us, now_us());
            }
        })
    }

    fn ask(
        &self,
        key: &str,
        answered: impl Fn(&[u8]) + Send + Sync + 'static,
    ) -> anyhow::Result<()> {
        let hear = move |reply: Reply| {
            if let Ok(sample) = reply.result() {
                answered(&sample.payload().to_bytes());
            }
        };
        let question = self.session.get(key).timeout(ANSWER_TIMEOUT).with(Callback::from(hear));
        question.wait().map_err(words)
    }

    /// Changes whenever what follows does.
    pub(crate) fn changes(&self) -> u64 {
        self.heard.changes.load(Ordering::Acquire)
    }

    /// The topics that others have now.
    pub(crate) fn advertised(&self) -> BTreeSet<(Remote, u32)> {
        lock(&self.heard.advertised).clone()
    }

    /// The subscriptions of others to topics of ours.
    pub(crate) fn wanted(&self) -> BTreeSet<Wish> {
        lock(&self.heard.wanted).clone()
    }

    fn ours(&self, source: &Source) -> Remote {
        Remote { place: self.place.clone(), source: source.clone() }
    }
}

impl Heard {
    fn is_advertised(&self, remote: &Remote) -> bool {
        let advertised = lock(&self.advertised);
        let mut its = advertised.range((remote.clone(), u32::MIN)..);
        its.next().is_some_and(|(first, _)| first == remote)
    }

    /// Keeps a set as tokens come and go.
    fn note<T: Ord>(&self, set: &Mutex<BTreeSet<T>>, token: Option<T>, kind: SampleKind) {
        let Some(token) = token else { return };
        let mut set = lock(set);
        match kind {
            SampleKind::Put if set.len() < HEARD_MAX => _ = set.insert(token),
            SampleKind::Put => {}
            SampleKind::Delete => _ = set.remove(&token),
        }
        self.changes.fetch_add(1, Ordering::Release);
    }
}

/// Sends a message that is encoded already. What has no room is counted by who
/// receives the next one.
pub(crate) fn send_message(sender: &Publisher<'_>, message: ZBytes) {
    let _ = sender.put(message).wait();
}

/// Says behind the last message that it was the last. Word of a token would be there
/// before it.
pub(crate) fn send_end(sender: &Publisher<'_>) {
    let _ = sender.delete().wait();
}
