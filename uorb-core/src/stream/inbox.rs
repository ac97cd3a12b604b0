//! A subscriber's port to a stream, which tries again to connect to whom it missed.
//! The stream that it was opened on goes with each call.

use std::fmt;

use iceoryx2::port::subscriber::{Subscriber, SubscriberCreateError};
use iceoryx2::prelude::CallbackProgression;
use iceoryx2::sample::Sample;
use iceoryx2::service::port_factory::PortFactory as _;

use super::unconnected::Unconnected;
use super::{Ipc, Stream, UorbHeader};

/// A port that receives.
pub struct Inbox {
    subscriber: Subscriber<Ipc, [u8], UorbHeader>,
    unconnected: Unconnected,
}

impl fmt::Debug for Inbox {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Inbox").field("id", &self.subscriber.id()).finish_non_exhaustive()
    }
}

impl Inbox {
    /// Opens a port with a queue of `depth` messages for each publisher.
    ///
    /// # Errors
    ///
    /// What iceoryx2 says.
    pub fn open(stream: &Stream, depth: usize) -> Result<Self, SubscriberCreateError> {
        let unconnected = Unconnected::default();
        let subscriber = stream
            .subscriber_builder()
            .buffer_size(depth)
            .set_degradation_handler(unconnected.handler(|missed| missed.sender_port_id))
            .create()?;
        Ok(Self { subscriber, unconnected })
    }

    /// The next message that is there. None also where it could not be mapped, or
    /// where as many of its publisher's are borrowed as may be.
    #[inline]
    pub fn receive(&mut self, stream: &Stream) -> Option<Sample<Ipc, [u8], UorbHeader>> {
        if self.unconnected.any() {
            self.connect_again(stream);
        }
        self.subscriber.receive().unwrap_or_default()
    }

    /// Maps the ports that are new: what is sent there from now on outlives them.
    pub fn connect(&mut self, stream: &Stream) {
        // What cannot be mapped is noted.
        let _ = self.subscriber.has_samples();
        while self.is_connecting() {
            self.connect_again(stream);
            let _ = self.subscriber.has_samples();
            std::hint::spin_loop();
        }
    }

    /// Whether there is a port to which it is about to be connected.
    pub(crate) fn is_connecting(&self) -> bool {
        self.unconnected.any() && self.unconnected.is_hopeful()
    }

    #[cold]
    fn connect_again(&mut self, stream: &Stream) {
        let is_there = |port| {
            let mut is_there = false;
            stream.dynamic_config().list_publishers(|publisher| {
                is_there |= publisher.publisher_id.value() == port;
                CallbackProgression::Continue
            });
            is_there
        };
        if self.unconnected.is_due(is_there) {
            // The smallest there is. It comes and goes, and the subscriber looks again.
            let publisher = stream
                .publisher_builder()
                .initial_max_slice_len(1)
                .max_loaned_samples(1)
                .override_sample_preallocation(|_| 1)
                .set_degradation_handler(Unconnected::default().handler(|_| 0))
                .create();
            if publisher.is_ok() {
                self.unconnected.forget();
            }
        }
    }
}
