//! What comes in: topics of other machines, which are published here while they are
//! there, and asked for while somebody here subscribes.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};

use uorb_core::broker_side::{Node, Role};
use uorb_core::{
    AdvertiseOptions, Claim, Instance, RawPublication, RawSubscription, Session, now_us,
};
use uorb_modules::say;

use crate::clock::Clock;
use crate::communicator::{Added, Communicator, lock};
use crate::counts::Counts;
use crate::exports::to_mhz;
use crate::imported::{Incoming, Inheritance, Translation};
use crate::keys::{Place, Remote};
use crate::ledger::{Entry, Ledger, Mark};
use crate::rules::Rules;
use crate::translate::Timestamps;
use crate::wire::{About, NotSound};

/// How often something that failed is tried again.
const TRY_AGAIN_US: u64 = 1_000_000;

/// The most topics of others that are had here at once, those that are gone included: half
/// as many as the broker has room for.
const IMPORTS_MAX: usize = 4_096;

/// How often another machine is asked what time it is; and at first.
const CLOCK_EVERY_US: u64 = 1_000_000;
const CLOCK_AT_FIRST_US: u64 = 100_000;
const FIRST_ANSWERS: u32 = 10;

/// All topics of others that we may have.
pub(crate) struct Imports {
    session: Session,
    communicator: Arc<Communicator>,
    rules: Arc<Rules>,
    translates_time: bool,
    topics: BTreeMap<Remote, Import>,
    machines: BTreeMap<Place, Machine>,
    advertised: BTreeSet<(Remote, u32)>,
    /// How much of what others have has been heard.
    heard: u64,
    ledger: Ledger,
    /// Whether it has said that there is no room for more topics.
    is_full: bool,
    /// What is in the ledger, of each topic.
    marks: Vec<Option<Mark>>,
}

/// One of them.
pub(crate) struct Import {
    /// What the other machine has announced. None: it is gone.
    revision: Option<u32>,
    /// When it went.
    gone_us: u64,
    incoming: Arc<Mutex<Incoming>>,
    pub(crate) counts: Arc<Counts>,
    /// What of it there is here, for as long as it is published.
    here: Option<Here>,
    /// Where it was published last: it gets its instance back, if it can.
    last_instance: Option<Instance>,
    try_at_us: u64,
    /// Why it cannot be published here.
    pub(crate) refused: Option<String>,
}

struct Here {
    node: Node,
    about: About,
    /// None: nobody here wants it.
    added: Option<Added>,
}

/// Another machine.
#[derive(Default)]
pub(crate) struct Machine {
    pub(crate) clock: Arc<Mutex<Clock>>,
    asked: u32,
    ask_at_us: u64,
    pub(crate) is_there: bool,
}

/// How an import is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum State {
    Idle,
    Crossing,
    Gone,
    Refused,
}

impl Imports {
    pub(crate) fn new(
        session: &Session,
        communicator: &Arc<Communicator>,
        rules: &Arc<Rules>,
        translates_time: bool,
        ledger: Ledger,
    ) -> Self {
        Self {
            session: session.clone(),
            communicator: communicator.clone(),
            rules: rules.clone(),
            translates_time,
            topics: BTreeMap::new(),
            machines: BTreeMap::new(),
            advertised: BTreeSet::new(),
            heard: 0,
            ledger,
            is_full: false,
            marks: Vec::new(),
        }
    }

    pub(crate) fn topics(&self) -> impl Iterator<Item = (&Remote, &Import)> {
        self.topics.iter()
    }

    pub(crate) fn machines(&self) -> impl Iterator<Item = (&Place, &Machine)> {
        self.machines.iter()
    }

    /// Looks at what others have, and at who wants it here.
    pub(crate) fn look(&mut self) -> anyhow::Result<()> {
        self.hear();
        self.ask_clocks()?;
        for (remote, import) in &mut self.topics {
            let Some(revision) = import.revision else {
                import.leave_if_over(&self.communicator);
                continue;
            };
            if import.here.as_ref().is_some_and(|here| here.node.ending().is_some()) {
                import.leave(&self.communicator);
            }
            if import.here.is_none() {
                let clock = self.machines.get(&remote.place).map(|machine| machine.clock.clone());
                let clock = clock.filter(|_| self.translates_time);
                import.arrive(&self.session, &self.communicator, (remote, revision), clock)?;
            }
            let rule = self.rules.import(
                &remote.place.machine,
                &remote.source.topic,
                remote.source.instance,
            );
            let rate_mhz = rule.and_then(|rule| rule.rate_hz).map(to_mhz);
            import.follow_demand(&self.communicator, remote, rate_mhz)?;
            import.follow_priority(&self.session);
        }
        self.note();
        Ok(())
    }

    /// Leaves to the next reach what it is to know.
    fn note(&mut self) {
        let marks = self.topics.values().map(Import::mark).collect();
        if marks == self.marks {
            return;
        }
        self.marks = marks;
        let entries = self.topics.iter().filter_map(Import::entry).collect();
        let known: BTreeSet<String> = self.topics.keys().map(Remote::key).collect();
        self.ledger.note(entries, &known);
    }

    /// Compares what is advertised with what was.
    fn hear(&mut self) {
        let changes = self.communicator.changes();
        if changes == self.heard {
            return;
        }
        self.heard = changes;
        let advertised = self.communicator.advertised();
        let mut revisions: BTreeMap<&Remote, ((bool, bool), u32)> = BTreeMap::new();
        for (remote, revision) in &advertised {
            let Remote { place, source } = remote;
            if self.rules.import(&place.machine, &source.topic, source.instance).is_some() {
                // Of two the one is right that came later: the other is that of a reach
                // which was killed, and not given up yet.
                let is_new = !self.advertised.contains(&(remote.clone(), *revision));
                let known = self.topics.get(remote).and_then(|import| import.revision);
                let candidate = ((is_new, known == Some(*revision)), *revision);
                let best = revisions.entry(remote).or_insert(candidate);
                *best = candidate.max(*best);
            }
        }
        for (remote, import) in &mut self.topics {
            let revision = revisions.remove(remote).map(|(_, revision)| revision);
            if import.revision != revision {
                // Of one that is gone the last messages may be on their way.
                if revision.is_some_and(|revision| !import.is_here_as(revision)) {
                    import.leave(&self.communicator);
                }
                import.gone_us = now_us();
                (import.revision, import.refused, import.try_at_us) = (revision, None, 0);
            }
        }
        if self.topics.len() + revisions.len() > IMPORTS_MAX {
            // What is gone makes room: the ledger has from where it counted.
            self.topics.retain(|_, import| import.revision.is_some() || import.here.is_some());
        }
        let mut is_full = false;
        for (remote, (_, revision)) in revisions {
            if self.topics.len() >= IMPORTS_MAX {
                if !is_full && !self.is_full {
                    say(&format_args!(
                        "{remote} is refused: {IMPORTS_MAX} topics of others are here, and no more"
                    ));
                }
                is_full = true;
                continue;
            }
            let mut import = Import::new(revision);
            if let Some(Entry { mark, .. }) = self.ledger.entry(remote) {
                import.continue_from(&self.session, remote, *mark);
            }
            self.topics.insert(remote.clone(), import);
        }
        self.is_full = is_full;
        let places: BTreeSet<&Place> = self.topics.keys().map(|remote| &remote.place).collect();
        self.machines.retain(|place, _| places.contains(place));
        self.machines.values_mut().for_each(|machine| machine.is_there = false);
        for (remote, import) in &self.topics {
            if import.revision.is_some() {
                self.machines.entry(remote.place.clone()).or_default().is_there = true;
            }
        }
        self.advertised = advertised;
    }

    fn ask_clocks(&mut self) -> anyhow::Result<()> {
        let now_us = now_us();
        for (place, machine) in &mut self.machines {
            if !machine.is_there || now_us < machine.ask_at_us {
                continue;
            }
            let is_first = machine.asked < FIRST_ANSWERS;
            machine.ask_at_us = now_us + if is_first { CLOCK_AT_FIRST_US } else { CLOCK_EVERY_US };
            machine.asked = machine.asked.saturating_add(1);
            let clock = machine.clock.clone();
            self.communicator.ask_clock(place, move |asked_us, theirs_us, answered_us| {
                lock(&clock).learn(asked_us, theirs_us, answered_us);
            })?;
        }
        Ok(())
    }
}

impl Import {
    fn new(revision: u32) -> Self {
        let counts: Arc<Counts> = Arc::default();
        Self {
            revision: Some(revision),
            gone_us: 0,
            incoming: Arc::new(Mutex::new(Incoming::new(counts.clone()))),
            counts,
            here: None,
            last_instance: None,
            try_at_us: 0,
            refused: None,
        }
    }

    /// Counts on where a reach before us was killed.
    fn continue_from(&mut self, session: &Session, remote: &Remote, mark: Mark) {
        let at = mark.instance;
        self.last_instance = Some(at);
        let topic = &remote.source.topic;
        // Where the node is another one by now, there is nothing to count on from.
        let Ok(node) = Node::open(session.system(), topic, at, Role::Observer) else { return };
        let published = mark.published_since(&node);
        let mut newest = Vec::new();
        if let Ok(mut subscription) = RawSubscription::subscribe(session, topic, at) {
            subscription.copy(&mut newest);
        }
        lock(&self.incoming).count_from(mark, Inheritance { published, newest });
    }

    fn mark(&self) -> Option<Mark> {
        lock(&self.incoming).mark()
    }

    /// What the next reach is to know of it.
    fn entry((remote, import): (&Remote, &Self)) -> Option<Entry> {
        Some(Entry { key: remote.key(), mark: import.mark()? })
    }

    /// Publishes it here, as soon as it is known what its messages are.
    fn arrive(
        &mut self,
        session: &Session,
        communicator: &Communicator,
        (remote, revision): (&Remote, u32),
        clock: Option<Arc<Mutex<Clock>>>,
    ) -> anyhow::Result<()> {
        if clock.as_ref().is_some_and(|clock| lock(clock).difference(now_us()).is_none()) {
            return Ok(());
        }
        if let Some(answer) = communicator.about(remote) {
            let arrived = match About::decode(&answer, &remote.source.topic, revision) {
                Ok(about) => {
                    self.publish(session, (about, remote.source.instance), revision, clock)
                }
                Err(NotSound::Revision) => return Ok(()),
                Err(error) => Err(error.into()),
            };
            match arrived {
                Ok(()) => self.refused = None,
                Err(why) => self.refuse(remote, &why.to_string()),
            }
        } else if now_us() >= self.try_at_us {
            self.try_at_us = now_us() + TRY_AGAIN_US;
            communicator.ask_about(remote)?;
        }
        Ok(())
    }

    fn publish(
        &mut self,
        session: &Session,
        (about, far): (About, Instance),
        revision: u32,
        clock: Option<Arc<Mutex<Clock>>>,
    ) -> anyhow::Result<()> {
        let topic = &about.metadata.name;
        // The instance it had, or has over there, if nobody here has that one.
        let wished = self.last_instance.unwrap_or(far);
        let is_free = !session.exists(topic, wished)?;
        let claim = if is_free { Claim::Shared(wished) } else { Claim::Lowest };
        let queue_length = Some(about.metadata.queue_length);
        let options = AdvertiseOptions { claim, priority: about.priority, queue_length };
        let publication = RawPublication::advertise(session, &about.metadata, options)?;
        let instance = publication.instance();
        let node = Node::open(session.system(), topic, instance, Role::Observer)?;
        let timestamps = Timestamps::of(about.layout());
        let translation = clock.map(|clock| Translation { timestamps, clock });
        lock(&self.incoming).open(publication, (revision, about.priority), translation);
        self.here = Some(Here { node, about, added: None });
        self.last_instance = Some(instance);
        Ok(())
    }

    /// Says so, the first time.
    fn refuse(&mut self, remote: &Remote, why: &str) {
        if self.refused.as_deref() != Some(why) {
            say(&format_args!("{remote} is refused: {why}"));
            self.refused = Some(why.to_string());
        }
    }

    fn is_here_as(&self, revision: u32) -> bool {
        self.here.as_ref().is_some_and(|here| here.about.revision() == revision)
    }

    /// It is gone over there, and no message of it can come any more.
    fn leave_if_over(&mut self, communicator: &Communicator) {
        let Some(here) = &self.here else { return };
        if here.added.is_none() || lock(&self.incoming).is_over(self.gone_us) {
            self.leave(communicator);
        }
    }

    /// It has no publisher here any more.
    fn leave(&mut self, communicator: &Communicator) {
        if let Some(here) = self.here.take()
            && let Some(added) = here.added
        {
            communicator.remove_subscription(added);
        }
        // Outside of the lock: it waits for the broker, and a message may be coming.
        let publication = lock(&self.incoming).close();
        drop(publication);
    }

    /// Asks for it while somebody here subscribes.
    fn follow_demand(
        &mut self,
        communicator: &Communicator,
        remote: &Remote,
        rate_mhz: Option<u32>,
    ) -> anyhow::Result<()> {
        let Some(here) = &mut self.here else { return Ok(()) };
        let is_wanted = here.node.status().subscribers > 0;
        if is_wanted && here.added.is_none() {
            let incoming = self.incoming.clone();
            let receive = move |bytes: Option<&[u8]>| match bytes {
                Some(bytes) => lock(&incoming).process_received_message(bytes),
                None => lock(&incoming).end(),
            };
            here.added = Some(communicator.add_subscription(remote, rate_mhz, receive)?);
        } else if !is_wanted {
            if let Some(added) = here.added.take() {
                communicator.remove_subscription(added);
            }
            lock(&self.incoming).rest();
        }
        Ok(())
    }

    /// Publishes it with the priority that it has over there by now: by a publication
    /// beside the old one, so that no message comes in between. Where there is no room
    /// for one more, the old one stays.
    fn follow_priority(&mut self, session: &Session) {
        let Some(here) = &mut self.here else { return };
        let priority = lock(&self.incoming).priority();
        if priority == here.about.priority {
            return;
        }
        here.about.priority = priority;
        let claim = Claim::Shared(here.node.identity.instance);
        let options = AdvertiseOptions { claim, priority, queue_length: None };
        if let Ok(new) = RawPublication::advertise(session, &here.about.metadata, options) {
            let old = lock(&self.incoming).publish_with(new);
            // Outside of the lock, as in `leave`.
            drop(old);
        }
    }

    pub(crate) fn state(&self) -> State {
        match (&self.here, self.revision) {
            (_, None) => State::Gone,
            (Some(Here { added: Some(_), .. }), _) => State::Crossing,
            (None, _) if self.refused.is_some() => State::Refused,
            _ => State::Idle,
        }
    }

    /// Where it is, or was, published here.
    pub(crate) fn instance(&self) -> Option<Instance> {
        self.last_instance
    }
}
