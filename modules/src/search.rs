//! Finding the instances of a topic as they come.
//!
//! A subscription makes the node if there is none. So whoever wants all
//! instances of a topic does not subscribe to ten of them, but looks now and
//! then for those that were advertised meanwhile.

use uorb_core::{Error, Instance, Session, Subscription, Topic, now_us};

const INTERVAL_US: u64 = 1_000_000;

/// When to look next: at once, and then once a second.
#[derive(Debug, Default)]
pub struct Search {
    next_us: u64,
}

impl Search {
    /// Subscribes to the instances that have a publisher and are not known yet.
    ///
    /// # Errors
    ///
    /// As [`Subscription::subscribe_instance`]; but a broker that is gone is
    /// none, it is asked again the next time.
    pub fn subscribe_new<T: Topic>(
        &mut self,
        session: &Session,
        is_known: impl Fn(Instance) -> bool,
    ) -> Result<Vec<Subscription<T>>, Error> {
        let mut new = Vec::new();
        if now_us() < self.next_us {
            return Ok(new);
        }
        self.next_us = now_us() + INTERVAL_US;
        for instance in Instance::all().filter(|instance| !is_known(*instance)) {
            if !session.exists(&T::METADATA.name, instance)? {
                continue;
            }
            match Subscription::subscribe_instance(session, instance) {
                Ok(subscription) => new.push(subscription),
                Err(Error::NoBroker { .. } | Error::NoAnswer { .. }) => break,
                Err(error) => return Err(error),
            }
        }
        Ok(new)
    }
}
