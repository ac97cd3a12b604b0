//! The newest message of every instance, for a look at a topic.

use std::time::Duration;

use uorb_core::{Copied, Instance, Metadata, RawSubscription};

use super::take;
use crate::topics;

/// The newest message of an instance.
pub(super) struct Newest {
    pub(super) metadata: Metadata,
    pub(super) instance: Instance,
    pub(super) bytes: Vec<u8>,
    pub(super) copied: Copied,
    pub(super) lost: u64,
}

/// The newest message of every instance that has one now.
pub(super) fn newest_of_each(subscriptions: &mut [RawSubscription]) -> anyhow::Result<Vec<Newest>> {
    let mut found = Vec::new();
    for subscription in subscriptions {
        // Not `updated`: of a node that is broken this says so.
        while uorb_core::poll(&mut [subscription], Some(Duration::ZERO))? > 0 {
            let mut bytes = Vec::new();
            let copied = take(subscription, &mut bytes);
            let Some((copied, metadata)) = copied.zip(subscription.metadata().cloned()) else {
                continue;
            };
            let (instance, lost) = (subscription.instance(), subscription.lost());
            let metadata = topics::typed(metadata);
            found.push(Newest { metadata, instance, bytes, copied, lost });
            break;
        }
    }
    Ok(found)
}
