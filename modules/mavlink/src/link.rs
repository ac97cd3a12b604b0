//! A link: one partner, one thread, one loop.
//!
//! It sleeps until its transport has bytes, a topic has a message whose interval
//! is over, or something is due by the clock. In a turn it sends what is due and
//! takes a bounded number of packets, so that a partner who floods it with
//! garbage costs this thread's time and nothing else: other links have threads
//! of their own.

use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::time::Duration;

use mavlink_core::SigningData;
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::time::TimeSpec;
use uorb_core::{Error, Priority, Publication, Session, now_us};
use uorb_modules::Stop;
use uorb_msg::MavlinkStatus;

use crate::dialect::MavMessage;
use crate::frame::{Parser, Received};
use crate::incoming::Incoming;
use crate::outgoing::{Mode, Streams};
use crate::port::{Port, Transmitted};
use crate::publications::Publications;
use crate::transport::Transport;

/// The longest sleep without a look at [`Stop`] and at the system's end.
const SLEEP_MAX_US: u64 = 200_000;

/// How often rates are fitted, and the link's status is published.
const STATUS_EVERY_US: u64 = 1_000_000;

/// How often is received before a look at what is due.
const RECEIVES_A_TURN_MAX: usize = 64;

/// The largest datagram there is.
const BUFFER_BYTES: usize = 64 << 10;

/// What is known of a link before it begins.
#[derive(Debug)]
pub struct Settings {
    /// Our number in MAVLink, 1 and up.
    pub system_id: u8,
    /// What goes out.
    pub mode: Mode,
    /// How many bytes a second may go out.
    pub data_rate: u32,
}

/// Our component in MAVLink: an autopilot.
const COMPONENT_AUTOPILOT: u8 = 1;

/// What all that a link does needs.
#[derive(Debug)]
pub struct Link {
    /// The bus.
    pub session: Session,
    /// The way out.
    pub port: Port,
    /// What goes out by itself.
    pub streams: Streams,
    /// What came in, on its way to the bus.
    pub publications: Publications,
    settings: Settings,
    parser: Parser,
    is_signed: bool,
    heard_us: u64,
    status: StatusReport,
}

/// What `mavlink_status` is made of.
#[derive(Debug)]
struct StatusReport {
    publication: Publication<MavlinkStatus>,
    last_us: u64,
    received: Received,
    transmitted: Transmitted,
}

impl Link {
    /// A link of which nothing has been sent yet.
    ///
    /// # Errors
    ///
    /// [`Error::Refused`] where as many links are shown as a topic has instances: nobody
    /// would find this one, or end it. [`Error::NoBroker`].
    pub fn new(
        session: &Session,
        transport: Box<dyn Transport>,
        signing: Option<Arc<SigningData>>,
        settings: Settings,
    ) -> Result<Self, Error> {
        let status = StatusReport {
            publication: Publication::advertise_multi(session, Priority::DEFAULT)?,
            last_us: 0,
            received: Received::default(),
            transmitted: Transmitted::default(),
        };
        let parser = Parser::new(transport.delivery(), signing.clone());
        let is_signed = signing.is_some();
        Ok(Self {
            session: session.clone(),
            port: Port::new(transport, signing, settings.system_id, COMPONENT_AUTOPILOT),
            streams: Streams::new(session, settings.mode, settings.data_rate),
            publications: Publications::new(session),
            settings,
            parser,
            is_signed,
            heard_us: 0,
            status,
        })
    }

    /// How many bytes a second may go out.
    pub fn data_rate(&self) -> u32 {
        self.settings.data_rate
    }

    /// In words: where it is, and who its partner is.
    pub fn describe(&self) -> String {
        self.port.transport.describe()
    }

    /// Sends a message to the partner.
    pub fn send(&mut self, message: &MavMessage) {
        self.port.send(message);
    }

    /// Runs until it is to stop, or the system has ended.
    ///
    /// # Errors
    ///
    /// [`Error::Ended`], or what poll(2) says.
    pub fn run(mut self, mut incoming: Incoming, stop: &Stop) -> Result<(), Error> {
        let mut buffer = vec![0; BUFFER_BYTES];
        while !stop.requested() {
            if self.session.has_ended() {
                return Err(Error::Ended { path: self.session.system().dir() });
            }
            for _ in 0..RECEIVES_A_TURN_MAX {
                let received = self.port.transport.receive(&mut buffer);
                if self.port.transport.has_begun() {
                    self.parser.begin();
                    incoming.begin();
                }
                let Some(len) = received else { break };
                self.parser.push(&buffer[..len]);
                self.take_packets(&mut incoming);
            }
            let now_us = now_us();
            self.parser.give_up(now_us);
            self.take_packets(&mut incoming);
            self.streams.step(now_us, &mut self.port);
            incoming.step(&mut self, now_us);
            if now_us >= self.status.last_us + STATUS_EVERY_US {
                self.report(now_us);
            }
            self.sleep(&mut incoming)?;
        }
        Ok(())
    }

    fn take_packets(&mut self, incoming: &mut Incoming) {
        while let Some(packet) = self.parser.next_packet() {
            let ours = (u32::from(self.port.system_id()), self.port.component_id());
            // Our own words, come back on a loop.
            if (packet.header.system_id, packet.header.component_id) == ours {
                continue;
            }
            self.port.transport.spoke();
            self.heard_us = now_us();
            incoming.receive(self, &packet);
        }
    }

    /// Sleeps until there is something to do.
    fn sleep(&mut self, incoming: &mut Incoming) -> Result<(), Error> {
        let due_us = self.streams.due_us().min(incoming.due_us());
        let due_us = due_us.min(self.status.last_us + STATUS_EVERY_US);
        let rest_us = due_us.saturating_sub(now_us()).min(SLEEP_MAX_US);

        let subscriptions = incoming.subscriptions();
        let subscriptions = subscriptions.into_iter().map(|it| (*it).as_fd());
        let mut wakers: Vec<PollFd> =
            self.streams.descriptors().chain(subscriptions).map(readable).collect();
        let transport = self.port.transport.descriptors();
        wakers.extend(transport.into_iter().map(|(fd, events)| PollFd::new(fd, events)));
        let rest = TimeSpec::from_duration(Duration::from_micros(rest_us));
        match ppoll(&mut wakers, Some(rest), None) {
            Ok(_) | Err(Errno::EINTR) => Ok(()),
            Err(errno) => {
                Err(Error::Io { action: "wait on", path: "a link".into(), source: errno.into() })
            }
        }
    }

    /// Once a second: fits the rates, and says how it goes.
    fn report(&mut self, now_us: u64) {
        let (received, transmitted) = (*self.parser.received(), *self.port.transmitted());
        let before = std::mem::replace(&mut self.status.last_us, now_us);
        let elapsed_us = now_us - before;
        self.streams.fit(elapsed_us, transmitted);

        let last_received = std::mem::replace(&mut self.status.received, received);
        let last_transmitted = std::mem::replace(&mut self.status.transmitted, transmitted);
        let a_second = |bytes: u64| (bytes as f64 * 1e6 / elapsed_us as f64) as f32;
        let mut status = MavlinkStatus {
            timestamp: now_us,
            mode: self.settings.mode as u8,
            system_id: self.port.system_id(),
            component_id: self.port.component_id(),
            is_signed: self.is_signed.into(),
            data_rate: self.settings.data_rate,
            rate_multiplier: self.streams.multiplier() as f32,
            tx_rate: a_second(transmitted.bytes - last_transmitted.bytes),
            rx_rate: a_second(received.bytes - last_received.bytes),
            tx_messages: transmitted.messages,
            tx_dropped: transmitted.dropped,
            rx_messages: received.messages,
            rx_lost: received.lost,
            rx_bad_checksum: received.bad_checksum,
            rx_bad_signature: received.bad_signature,
            rx_unknown: received.unknown,
            rx_garbage_bytes: received.garbage_bytes,
            heard: self.heard_us,
            ..MavlinkStatus::default()
        };
        let words = self.describe();
        let len = words.len().min(status.link.len() - 1);
        status.link[..len].copy_from_slice(&words.as_bytes()[..len]);
        // A system that has ended ends the link in its next turn.
        let _ = self.status.publication.publish(&status);
    }
}

fn readable(fd: BorrowedFd<'_>) -> PollFd<'_> {
    PollFd::new(fd, PollFlags::POLLIN)
}

const _: () = assert!(Mode::Normal as u8 == MavlinkStatus::MODE_NORMAL);
const _: () = assert!(Mode::Onboard as u8 == MavlinkStatus::MODE_ONBOARD);
const _: () = assert!(Mode::Minimal as u8 == MavlinkStatus::MODE_MINIMAL);
const _: () = assert!(Mode::Custom as u8 == MavlinkStatus::MODE_CUSTOM);
