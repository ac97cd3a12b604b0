//! What leaves: which topics of ours others are told of, and which of them somebody
//! wants.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::SystemTime;

use anyhow::Context;
use uorb_core::broker_side::{Node, Role};
use uorb_core::{QueueLength, Session, Topic, now_us};
use uorb_msg::ReachStatus;

use crate::communicator::{Advertised, Communicator};
use crate::counts::Counts;
use crate::keys::{Place, Source, Wish};
use crate::ledger::BroughtIn;
use crate::outgoing::{Order, Orders, Outgoing};
use crate::rules::{Crossing, Rules};
use crate::wire::About;

/// How often to look for new topics, whatever a directory's time says.
const LIST_EVERY_US: u64 = 200_000;

/// All of our topics that others may have.
pub(crate) struct Exports {
    session: Session,
    communicator: Arc<Communicator>,
    rules: Arc<Rules>,
    patient: Outgoing,
    prompt: Outgoing,
    topics: BTreeMap<Source, Export>,
    /// How much of what others want has been heard.
    heard: u64,
    must_order: bool,
    nodes_changed: Option<SystemTime>,
    list_at_us: u64,
}

/// One of them.
pub(crate) struct Export {
    node: Node,
    /// None: nobody publishes it, and has not for a while.
    advertised: Option<(About, Advertised)>,
    /// Nobody publishes it any more; and whether its last messages have left.
    ending: Option<Arc<AtomicBool>>,
    /// Those who want it.
    pub(crate) wanted_by: BTreeSet<Place>,
    newcomers: u32,
    pub(crate) counts: Arc<Counts>,
}

impl Exports {
    pub(crate) fn begin(
        session: &Session,
        communicator: &Arc<Communicator>,
        rules: &Arc<Rules>,
        (run, brought_in): (u32, &BroughtIn),
    ) -> anyhow::Result<Self> {
        let start = |name| {
            let started = Outgoing::start(name, session, communicator, (run, brought_in.clone()));
            started.context("cannot start a thread")
        };
        Ok(Self {
            session: session.clone(),
            communicator: communicator.clone(),
            rules: rules.clone(),
            patient: start("patient")?,
            prompt: start("prompt")?,
            topics: BTreeMap::new(),
            heard: 0,
            must_order: false,
            nodes_changed: None,
            list_at_us: 0,
        })
    }

    pub(crate) fn topics(&self) -> impl Iterator<Item = (&Source, &Export)> {
        self.topics.iter()
    }

    /// Looks at what there is here, and at who wants what.
    pub(crate) fn look(&mut self) -> anyhow::Result<()> {
        self.find_nodes()?;
        let ours = self.session.peer();
        for (source, export) in &mut self.topics {
            let about = export.about(ours);
            let was_ending = export.ending.is_some();
            let is_as_told = export.is_as_told(about.as_ref());
            self.must_order |= !is_as_told || was_ending != export.ending.is_some();
            if is_as_told {
                continue;
            }
            if let (Some(about), Some((told, _))) = (&about, &mut export.advertised)
                && about.revision() == told.revision()
            {
                // Another priority, which comes with the next message.
                self.communicator.describe(source, about);
                told.clone_from(about);
                continue;
            }
            export.advertised = None;
            if let Some(about) = about {
                let advertised = self.communicator.topic_advertised(source, &about)?;
                export.advertised = Some((about, advertised));
            }
        }
        self.hear_wishes();
        Ok(())
    }

    fn find_nodes(&mut self) -> anyhow::Result<()> {
        // One look at a directory, where a list is many. What comes and goes within
        // one tick of the file system's clock is found later.
        let changed = self.session.system().nodes_changed();
        if changed == self.nodes_changed && now_us() < self.list_at_us {
            return Ok(());
        }
        (self.nodes_changed, self.list_at_us) = (changed, now_us() + LIST_EVERY_US);
        let must_order = &mut self.must_order;
        self.topics.retain(|_, export| {
            let stays = export.node.ending().is_none();
            *must_order |= !stays;
            stays
        });
        for (topic, instance) in self.session.system().list_nodes()? {
            let source = Source { topic, instance };
            let is_ours = source.topic == ReachStatus::METADATA.name;
            let is_known = self.topics.contains_key(&source);
            if is_known || is_ours || self.rules.export(&source.topic, instance).is_none() {
                continue;
            }
            let node = Node::open(self.session.system(), &source.topic, instance, Role::Observer);
            // It may be gone again.
            let Ok(node) = node else { continue };
            let (wanted_by, counts) = (BTreeSet::new(), Arc::default());
            let (advertised, ending, newcomers) = (None, None, 0);
            let export = Export { node, advertised, ending, wanted_by, newcomers, counts };
            self.topics.insert(source, export);
        }
        Ok(())
    }

    /// Has the threads carry out what is wanted, if that has changed.
    fn hear_wishes(&mut self) {
        let changes = self.communicator.changes();
        if changes == self.heard && !self.must_order {
            return;
        }
        let wishes = self.communicator.wanted();
        for (source, export) in &mut self.topics {
            let its = wishes.iter().filter(|wish| wish.source == *source);
            let wanted_by: BTreeSet<Place> = its.map(|wish| wish.place.clone()).collect();
            let newcomers = wanted_by.difference(&export.wanted_by).count();
            export.newcomers = export.newcomers.wrapping_add(newcomers as u32);
            export.wanted_by = wanted_by;
        }
        let orders: Orders = self.orders(&wishes).collect();
        let (patient, prompt) =
            orders.into_iter().partition(|(_, order)| order.crossing == Crossing::Reliable);
        self.patient.order(patient);
        self.prompt.order(prompt);
        (self.heard, self.must_order) = (changes, false);
    }

    fn orders(&self, wishes: &BTreeSet<Wish>) -> impl Iterator<Item = (Source, Order)> {
        let wanted = self.topics.iter().filter(|(_, export)| !export.wanted_by.is_empty());
        wanted.filter_map(|(source, export)| {
            let (about, _) = export.advertised.as_ref()?;
            let rule = self.rules.export(&source.topic, source.instance)?;
            let rates = wishes.iter().filter(|wish| wish.source == *source).map(|it| it.rate_mhz);
            let order = Order {
                revision: about.revision(),
                queue_length: about.metadata.queue_length,
                priority: about.priority,
                crossing: rule.crossing,
                rate_mhz: highest(rates, rule.rate_hz.map(to_mhz)),
                newcomers: export.newcomers,
                ending: export.ending.clone(),
                counts: export.counts.clone(),
            };
            Some((source.clone(), order))
        })
    }
}

impl Export {
    /// What others are to know of it. None: nobody publishes it but we ourselves, who
    /// have it from another machine.
    fn about(&self, ours: u16) -> Option<About> {
        let status = self.node.status();
        let publisher = status.publishers.iter().rfind(|entry| entry.peer != ours)?;
        let identity = &self.node.identity;
        let mut metadata = identity.metadata.clone();
        metadata.queue_length = status.queue_length.unwrap_or(QueueLength::ONE);
        let counts_from = (identity.system_id, identity.base);
        Some(About { metadata, priority: publisher.priority, counts_from })
    }

    /// Whether others know of it what there is to know. That its publisher has gone
    /// is told when its last messages have left, to those who want them.
    fn is_as_told(&mut self, about: Option<&About>) -> bool {
        if about.is_some() || self.advertised.is_none() {
            self.ending = None;
            return about == self.advertised.as_ref().map(|(about, _)| about);
        }
        let have_left = self.ending.get_or_insert_default().load(Ordering::Relaxed);
        !have_left && !self.wanted_by.is_empty()
    }

    pub(crate) fn is_advertised(&self) -> bool {
        self.advertised.is_some()
    }
}

/// The highest rate of all, but not above the limit. None: every message.
fn highest(rates: impl Iterator<Item = Option<u32>>, limit: Option<u32>) -> Option<u32> {
    let wanted = rates.map(|rate| rate.unwrap_or(u32::MAX)).max().unwrap_or(u32::MAX);
    Some(wanted.min(limit.unwrap_or(u32::MAX))).filter(|rate| *rate < u32::MAX)
}

/// Thousandths of a hertz, as tokens have it.
pub(crate) fn to_mhz(rate_hz: f64) -> u32 {
    (rate_hz * 1e3).round().clamp(1.0, f64::from(u32::MAX - 1)) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_highest_rate_that_anybody_wants_is_sent_but_not_above_the_rule_s() {
        let wanted = |rates: &[Option<u32>], limit| highest(rates.iter().copied(), limit);
        assert_eq!(wanted(&[Some(10), Some(50)], None), Some(50));
        assert_eq!(wanted(&[Some(10), None], None), None);
        assert_eq!(wanted(&[Some(10), None], Some(20)), Some(20));
        assert_eq!(wanted(&[Some(10)], Some(20)), Some(10));
        assert_eq!(to_mhz(0.001), 1);
    }
}
