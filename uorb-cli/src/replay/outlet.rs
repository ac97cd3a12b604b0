//! Where the messages of one series go: an instance of a topic on the bus.

use std::borrow::Cow;
use std::time::Duration;

use anyhow::{anyhow, bail};
use uorb_core::{
    AdvertiseOptions, Claim, Error, Instance, Metadata, QueueLength, RawPublication, Session,
    is_topic_name,
};
use uorb_ulog::Series;

use super::Args;
use crate::exit::Early;
use crate::interrupt::Interrupt;
use crate::topics::compiled_in;

/// How long to wait for room in a follower's queue before one looks again.
const QUEUE_FULL_PAUSE: Duration = Duration::from_millis(1);

/// Where the messages of one series go.
pub(super) struct Outlet {
    pub(super) publication: RawPublication,
    /// A message with the padding at its end, which a log does not have.
    message: Vec<u8>,
    pub(super) published: u64,
}

impl Outlet {
    /// `topic` is the name under which it is published.
    pub(super) fn open(
        session: &Session,
        series: &Series,
        topic: &str,
        args: &Args,
    ) -> anyhow::Result<Self> {
        let Series { instance, layout, .. } = series;
        let file = args.file.display();
        if !is_topic_name(topic) {
            bail!("{file} has a topic {topic:?}, which is no name for one");
        }
        let Some(instance) = Instance::new(*instance) else {
            bail!("{file} has an instance {instance} of {topic}; a topic has 0 to 9 (--instance)");
        };
        let metadata = Metadata {
            name: topic.to_string().into(),
            layout: Cow::Owned(layout.clone()),
            // A log does not say how many messages a topic keeps.
            queue_length: compiled_in(topic).map_or(QueueLength::ONE, |ours| ours.queue_length),
        };
        let options = AdvertiseOptions {
            claim: Claim::Shared(instance),
            queue_length: args.queue.map(QueueLength::at_least),
            ..AdvertiseOptions::default()
        };
        let publication =
            RawPublication::advertise(session, &metadata, options).map_err(|error| {
                let cure = match error {
                    Error::LayoutMismatch(_) => format!(
                        ",\n  or leave it out of the replay with --exclude {0}, or choose \
                         others with --topic, or publish it as another with --remap {0}=NAME",
                        series.topic
                    ),
                    _ => String::new(),
                };
                anyhow!("cannot advertise {topic}{instance}: {error}{cure}")
            })?;
        Ok(Self { publication, message: vec![0; layout.size_bytes as usize], published: 0 })
    }

    /// Publishes a message of the log. With an interrupt it waits for followers that
    /// ask for it, until that comes.
    pub(super) fn publish(
        &mut self,
        bytes: &[u8],
        back_pressure: Option<&Interrupt>,
    ) -> anyhow::Result<()> {
        self.message[..bytes.len()].copy_from_slice(bytes);
        let Some(interrupt) = back_pressure else {
            self.publication.publish(&self.message)?;
            self.published += 1;
            return Ok(());
        };
        while let Err(error) = self.publication.try_publish(&self.message) {
            match error {
                Error::QueueFull { .. } if interrupt.has_come() => bail!(Early::Interrupted),
                Error::QueueFull { .. } => std::thread::sleep(QUEUE_FULL_PAUSE),
                error => return Err(error.into()),
            }
        }
        self.published += 1;
        Ok(())
    }
}

pub(super) fn publications(outlets: &[Option<Outlet>]) -> impl Iterator<Item = &RawPublication> {
    outlets.iter().flatten().map(|outlet| &outlet.publication)
}
