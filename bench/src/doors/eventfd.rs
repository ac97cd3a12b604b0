//! The floor of a wake: eventfd(2) and poll(2).
//!
//! The message is the counter's value, so nothing else has to be handed over.

use std::os::fd::{AsFd, AsRawFd, BorrowedFd};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::eventfd::{EfdFlags, EventFd};

use super::Door;

/// Two counters, which both sides inherit.
#[derive(Debug)]
pub struct Counters {
    _both: [EventFd; 2],
    arguments: [Vec<String>; 2],
}

impl Counters {
    pub fn new() -> Self {
        // Not closed by exec: that is how the sides get them.
        let both = [(); 2].map(|()| EventFd::from_flags(EfdFlags::empty()).expect("an eventfd"));
        let [ping, pong] = [0, 1].map(|index: usize| both[index].as_fd().as_raw_fd().to_string());
        let arguments = [vec![ping.clone(), pong.clone()], vec![pong, ping]];
        Self { _both: both, arguments }
    }

    /// What each side is told: its ways out and in.
    pub fn arguments(&self) -> [&[String]; 2] {
        [&self.arguments[0], &self.arguments[1]]
    }
}

/// One side's ways out and in.
#[derive(Debug)]
pub struct Pair {
    out: BorrowedFd<'static>,
    from: BorrowedFd<'static>,
}

impl Pair {
    #[allow(unsafe_code)]
    pub fn inherit(arguments: &[&str]) -> Self {
        let descriptor = |index: usize| {
            let number = arguments[index].parse().expect("a descriptor");
            // SAFETY: who started us left it open, and nobody here closes it.
            unsafe { BorrowedFd::borrow_raw(number) }
        };
        Self { out: descriptor(0), from: descriptor(1) }
    }
}

impl Door for Pair {
    fn send(&mut self, sent_ns: u64) {
        nix::unistd::write(self.out, &sent_ns.to_ne_bytes()).expect("written");
    }

    fn wait(&mut self) -> u64 {
        let mut ready = [PollFd::new(self.from, PollFlags::POLLIN)];
        poll(&mut ready, PollTimeout::NONE).expect("it can be polled");
        let mut value = [0; 8];
        nix::unistd::read(self.from, &mut value).expect("read");
        u64::from_ne_bytes(value)
    }
}
