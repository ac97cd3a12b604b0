//! A subscription that follows the stream too: it begins with the node's newest
//! message, and from then on has every one.

use std::time::{Duration, Instant};

use super::{Copied, RawSubscription};
use crate::clock::now_us;
use crate::error::Error;
use crate::generation::Generation;
use crate::node::Node;
use crate::protocol::{Subject, Subscribe, Wish};
use crate::stream::depth_max;
use crate::stream::reader::{Next, Reader, Skips};
use crate::stream_subscription::StreamOptions;

/// How long a newcomer waits for publishers to open their ports, and for the
/// newest large message. Whoever is stopped does not come in time, and then the
/// node has its messages.
const PORTS_TIMEOUT: Duration = Duration::from_millis(100);

impl RawSubscription {
    /// Begins to follow the stream of `node`, if that was asked for or is the
    /// only way to have a message.
    pub(super) fn open_reader(&mut self, node: &Node) -> Result<(), Error> {
        let layout = &node.identity.metadata.layout;
        let deepest = depth_max(layout.size_bytes);
        let options = match self.stream {
            Some(options) => options,
            // It has the node's queue on the stream.
            None if layout.is_large() => {
                let depth = node.identity.metadata.queue_length.get().min(deepest);
                StreamOptions { depth: Some(depth), back_pressure: false }
            }
            None => return Ok(()),
        };
        let depth = options.depth.unwrap_or(deepest);
        if !(1..=deepest).contains(&depth) {
            let bytes = layout.size_bytes;
            let what = format!("a queue of {depth}: with {bytes} bytes each it is 1 to {deepest}");
            return Err(Error::stream(node.name(), what));
        }
        let wish = Wish { depth, back_pressure: options.back_pressure, place: None };
        let place = self.session.stream(Subscribe {
            handle: self.handle,
            subject: Subject::Named(self.topic.clone()),
            instance: self.instance,
            stream: Some(wish),
        })?;
        let member = self.session.member()?;
        let mut reader = Reader::open(&member, self.session.system(), node, wish, place.into())?;
        fail_point!("follow.queued");
        self.session.follows(self.handle);
        self.wait_until(node, PORTS_TIMEOUT, || node.has_all_ports())?;
        node.wait_for_publishes_under_way();
        self.cursor = node.cursor_of_newcomer();
        node.begin_stream(reader.index(), self.cursor);
        fail_point!("follow.begun");
        if node.has_newer(self.cursor) {
            let (newest, is_large) = (self.cursor + 1, layout.is_large());
            let timeout = if is_large { PORTS_TIMEOUT } else { Duration::ZERO };
            let mut first = Next::NotYet;
            self.wait_until(node, timeout, || {
                first = reader.begin(node, newest);
                matches!(first, Next::Found(_))
            })?;
            // It was overwritten since we have looked, and is not the newest any more.
            if let (Next::AllLost(older), false) = (first, is_large) {
                self.cursor = older;
                reader.pass_over(node, older);
            }
        }
        self.reader = Some(Box::new(reader));
        Ok(())
    }

    /// Sleeps on the node's bell until something is so, or for this time.
    fn wait_until(
        &self,
        node: &Node,
        timeout: Duration,
        mut is_so: impl FnMut() -> bool,
    ) -> Result<(), Error> {
        let deadline = Instant::now() + timeout;
        let descriptor = self.descriptor_for(node)?;
        loop {
            descriptor.ask(node, self.cursor);
            let rest = deadline.saturating_duration_since(Instant::now());
            if is_so() || rest.is_zero() {
                return Ok(());
            }
            // A signal is as good a reason to look again.
            let _ = descriptor.wait(Some(rest));
        }
    }

    /// Whether the next message is there: one that is committed may still be on
    /// its way. It is the current one then.
    #[inline]
    pub(super) fn look_ahead(&mut self, skips: Skips) -> bool {
        let (Some(reader), Some(node)) = (&mut self.reader, &self.node) else { return false };
        loop {
            match reader.look(node, self.cursor, skips) {
                Ok(Next::Found(found)) => {
                    // What is lost before it has been counted.
                    self.cursor = found.generation - 1;
                    return true;
                }
                Ok(Next::AllLost(generation)) => self.cursor = generation,
                Ok(Next::NotYet) => return false,
                Err(_) => {
                    self.is_corrupt = true;
                    return false;
                }
            }
        }
    }

    /// What is not there any more was not wanted where there is an interval.
    pub(super) fn skips(&self) -> Skips {
        if self.pace.is_some() { Skips::AreWanted } else { Skips::AreLost }
    }

    /// Takes the next message. False: there is nothing new.
    #[inline]
    pub(crate) fn advance(&mut self) -> bool {
        let found = self.look_ahead(self.skips());
        if found {
            fail_point!("receive.found");
            self.take_ahead();
        }
        if self.descriptor.get().is_some() {
            self.settle();
        }
        found
    }

    #[inline]
    /// Makes the newest message that has come the current one.
    pub(super) fn skip_on_stream(&mut self) {
        while self.pending() > 0 {
            if self.look_ahead(Skips::AreWanted) {
                self.take_ahead();
            } else if let (Some(reader), Some(node)) = (&self.reader, &self.node)
                && node.has_newer(self.cursor)
            {
                // It is on its way, and others may have overtaken it.
                self.cursor += 1;
                reader.pass_over(node, self.cursor);
            }
            if self.is_corrupt {
                break;
            }
        }
        self.settle();
    }

    fn take_ahead(&mut self) {
        let (Some(reader), Some(node)) = (&mut self.reader, &self.node) else { return };
        let Some(found) = reader.take(node) else { return };
        self.cursor = found.generation;
        self.last = Some(Copied {
            generation: Generation::from_wide(found.generation),
            publish_time_us: found.stamp.publish_time_us,
            peer: found.stamp.publisher as u16,
        });
        if let Some(pace) = &mut self.pace {
            pace.copied(now_us());
        }
    }

    /// The message that was found last.
    pub(crate) fn current(&self) -> Option<&[u8]> {
        self.reader.as_ref()?.current()
    }
}
