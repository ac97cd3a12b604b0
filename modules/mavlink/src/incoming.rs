//! What comes in: each message goes to the function that knows it.
//!
//! A message of ours that the dialect knows and nobody here does is ignored, as
//! PX4 does. What is addressed to another system, or to another component of
//! this one, is not ours.

mod trajectory;

use mavlink_core::Message;
use uorb_core::{Error, RawSubscription};

use crate::dialect::MavMessage;
use crate::frame::Packet;
use crate::link::Link;

/// What the incoming half of a link remembers.
#[derive(Debug)]
pub struct Incoming {}

impl Incoming {
    /// For a link that begins.
    ///
    /// # Errors
    ///
    /// As subscribing.
    pub fn new(_link: &Link) -> Result<Self, Error> {
        Ok(Self {})
    }

    /// Does what a message asks for.
    pub fn receive(&mut self, link: &mut Link, packet: &Packet) {
        if !is_for(link, &packet.message) {
            return;
        }
        match &packet.message {
            MavMessage::CA_TRAJECTORY_MSG(message) => trajectory::receive(link, message),
            _ => {}
        }
    }

    /// Does what is due, and takes what came in on `subscriptions`. Called
    /// whenever the link wakes.
    pub fn step(&mut self, _link: &mut Link, _now_us: u64) {}

    /// What wakes the link.
    pub fn subscriptions(&mut self) -> Vec<&mut RawSubscription> {
        Vec::new()
    }

    /// When `step` is due even if nothing comes.
    pub fn due_us(&self) -> u64 {
        u64::MAX
    }
}

/// Whether a message is addressed to us; one that is addressed to nobody is for all.
fn is_for(link: &Link, message: &MavMessage) -> bool {
    let is = |target: Option<u8>, ours: u8| target.is_none_or(|it| it == 0 || it == ours);
    is(message.target_system_id(), link.port.system_id())
        && is(message.target_component_id(), link.port.component_id())
}
