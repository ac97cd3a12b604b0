//! The way out: messages get our ids, their number and their signature here.

use std::fmt;
use std::sync::Arc;

use mavlink_core::{MAVLinkV2MessageRaw, MavHeader, SigningData};

use crate::dialect::MavMessage;
use crate::transport::{Sent, Transport};

/// What has gone out, since the link began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Transmitted {
    /// Bytes of messages.
    pub bytes: u64,
    /// Messages.
    pub messages: u64,
    /// Messages that there was no room for.
    pub dropped: u64,
}

/// Where a link sends from.
pub struct Port {
    pub(crate) transport: Box<dyn Transport>,
    signing: Option<Arc<SigningData>>,
    header: MavHeader,
    transmitted: Transmitted,
}

impl fmt::Debug for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Port")
            .field("transport", &self.transport.describe())
            .field("header", &self.header)
            .finish_non_exhaustive()
    }
}

impl Port {
    /// Sends as this system and component, signed if there is a key.
    pub fn new(
        transport: Box<dyn Transport>,
        signing: Option<Arc<SigningData>>,
        system_id: u8,
        component_id: u8,
    ) -> Self {
        let header = MavHeader { system_id: system_id.into(), component_id, sequence: 0 };
        Self { transport, signing, header, transmitted: Transmitted::default() }
    }

    /// Our number in MAVLink.
    pub fn system_id(&self) -> u8 {
        self.header.system_id as u8
    }

    /// Our component's number in MAVLink.
    pub fn component_id(&self) -> u8 {
        self.header.component_id
    }

    /// What has gone out so far.
    pub fn transmitted(&self) -> &Transmitted {
        &self.transmitted
    }

    /// Sends a message to the partner. What has gone out is in [`Port::transmitted`].
    pub fn send(&mut self, message: &MavMessage) -> Sent {
        let mut raw = MAVLinkV2MessageRaw::new();
        match &self.signing {
            Some(signing) => {
                raw.serialize_message_for_signing(self.header, message);
                signing.sign_message(&mut raw);
            }
            None => raw.serialize_message(self.header, message),
        }
        let packet = raw.raw_bytes();
        let sent = self.transport.send(packet);
        match sent {
            Sent::Whole => {
                self.transmitted.messages += 1;
                self.transmitted.bytes += packet.len() as u64;
                self.header.sequence = self.header.sequence.wrapping_add(1);
            }
            // The partner is to see in the numbers that one is missing.
            Sent::Dropped => {
                self.transmitted.dropped += 1;
                self.header.sequence = self.header.sequence.wrapping_add(1);
            }
            Sent::Nobody => {}
        }
        sent
    }
}
