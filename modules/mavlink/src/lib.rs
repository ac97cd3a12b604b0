//! The bridge between the bus and MAVLink: what the program `mavlink` is made of.
//!
//! | | |
//! |---|---|
//! | `dialect` | the messages, made of XML |
//! | `frame`, `signing` | bytes to messages, and what is refused |
//! | `transport`, `port` | UDP, TCP, serial; the way out |
//! | `link` | one partner, one thread, one loop |
//! | `outgoing` | streams of messages, made of topics |
//! | `incoming` | messages to topics, and answers |
//! | `ours` | messages of our own, a line each |
//! | `followed`, `publications` | the bus, seen from a link |
//! | `parameter_file` | where parameters are kept |

pub mod dialect;
pub mod followed;
pub mod frame;
pub mod incoming;
pub mod link;
mod ours;
pub mod outgoing;
pub mod parameter_file;
pub mod port;
pub mod publications;
pub mod signing;
pub mod transport;
