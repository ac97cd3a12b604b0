//! What a stream is made of: topics, and how they become messages.

use uorb_core::{RawSubscription, Topic};

use crate::dialect::MavMessage;
use crate::followed::Followed;

/// Where a stream's messages go.
pub(crate) type Send<'a> = &'a mut dyn FnMut(MavMessage);

/// Makes messages of topics.
pub(crate) trait Source: std::marker::Send {
    /// The topic whose updates are sent. None: the stream goes by the clock.
    fn lead(&mut self) -> Option<&mut RawSubscription>;

    /// Makes the message of what is newest; none, or several, where that is so.
    fn compose(&mut self, send: Send<'_>);
}

/// A stream that follows a topic.
struct OnUpdate<T: Topic, F> {
    lead: Followed<T>,
    compose: F,
}

impl<T, F> Source for OnUpdate<T, F>
where
    T: Topic,
    F: FnMut(T::Message, Send<'_>) + std::marker::Send,
{
    fn lead(&mut self) -> Option<&mut RawSubscription> {
        self.lead.raw()
    }

    fn compose(&mut self, send: Send<'_>) {
        if let Some(message) = self.lead.copy() {
            (self.compose)(message, send);
        }
    }
}

/// A stream that goes by the clock.
struct OnClock<F>(F);

impl<F: FnMut(Send<'_>) + std::marker::Send> Source for OnClock<F> {
    fn lead(&mut self) -> Option<&mut RawSubscription> {
        None
    }

    fn compose(&mut self, send: Send<'_>) {
        (self.0)(send);
    }
}

/// Sends each update of `lead`, as often as the rate allows.
pub(crate) fn on_update<T: Topic + 'static>(
    lead: Followed<T>,
    compose: impl FnMut(T::Message, Send<'_>) + std::marker::Send + 'static,
) -> Box<dyn Source> {
    Box::new(OnUpdate { lead: lead.with_descriptor(), compose })
}

/// Sends at the rate, whatever is new.
pub(crate) fn on_clock(
    compose: impl FnMut(Send<'_>) + std::marker::Send + 'static,
) -> Box<dyn Source> {
    Box::new(OnClock(compose))
}
