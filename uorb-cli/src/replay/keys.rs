//! Keys that are pressed while a log is replayed.
//!
//! The terminal keeps its lines and its Ctrl-C: it only hands over each key as
//! it is pressed, and does not show it. However the replay ends, the terminal is
//! as it was, also by a signal.

use std::io::{self, IsTerminal};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use anyhow::Context as _;
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::termios::{LocalFlags, SetArg, Termios, tcgetattr, tcsetattr};
use nix::sys::time::TimeSpec;
use nix::unistd::{getpgrp, read, tcgetpgrp};
use signal_hook::consts::{SIGHUP, SIGTERM};

use crate::interrupt::Interrupt;

/// What a key asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Key {
    PauseOrGoOn,
    Step,
    Faster,
    Slower,
    Quit,
}

/// The keyboard, while this lives.
pub(super) struct Keys {
    /// How the terminal was; None: there is nobody who presses keys.
    before: Option<Termios>,
    /// Pressed and not asked for yet.
    pressed: Vec<Key>,
    /// The signal that ends us, once it has come.
    signal: Arc<AtomicUsize>,
    /// Becomes readable then.
    pipe: UnixStream,
}

impl Keys {
    /// Listens to the keys, if this process has a terminal to itself.
    pub(super) fn listen() -> anyhow::Result<Self> {
        Self::try_listen().context("cannot listen to the keys")
    }

    fn try_listen() -> anyhow::Result<Self> {
        let (pipe, write_end) = UnixStream::pair()?;
        let signal = Arc::new(AtomicUsize::new(0));
        let mut keys = Self { before: None, pressed: Vec::new(), signal, pipe };
        if !io::stdin().is_terminal() || !is_in_foreground() {
            return Ok(keys);
        }
        for number in [SIGHUP, SIGTERM] {
            signal_hook::flag::register_usize(number, keys.signal.clone(), number as usize)?;
            signal_hook::low_level::pipe::register(number, write_end.try_clone()?)?;
        }
        let before = tcgetattr(io::stdin())?;
        let mut by_key = before.clone();
        by_key.local_flags.remove(LocalFlags::ICANON | LocalFlags::ECHO);
        tcsetattr(io::stdin(), SetArg::TCSANOW, &by_key)?;
        keys.before = Some(before);
        Ok(keys)
    }

    /// Whether there is somebody who presses keys.
    pub(super) fn is_there(&self) -> bool {
        self.before.is_some()
    }

    /// The signal that ends us, other than Ctrl-C. Nobody is told before the
    /// terminal is in order.
    pub(super) fn signal(&self) -> Option<i32> {
        Some(self.signal.load(Ordering::Relaxed) as i32).filter(|&signal| signal != 0)
    }

    /// Waits until this moment (None: for ever), for a key, or for a signal.
    pub(super) fn wait_until(
        &mut self,
        moment: Option<Instant>,
        interrupt: &Interrupt,
    ) -> anyhow::Result<Option<Key>> {
        if !self.is_there() {
            interrupt.wait_until(moment)?;
            return Ok(None);
        }
        let rest = moment.map(|moment| moment.saturating_duration_since(Instant::now()));
        let stdin = io::stdin();
        if self.pressed.is_empty() && !interrupt.has_come() && self.signal().is_none() {
            let mut ready = [
                PollFd::new(stdin.as_fd(), PollFlags::POLLIN),
                PollFd::new(self.pipe.as_fd(), PollFlags::POLLIN),
                PollFd::new(interrupt.as_fd(), PollFlags::POLLIN),
            ];
            // In the background a key is pressed for somebody else, and to ask
            // for it would stop us.
            if !is_in_foreground() {
                ready[0].set_events(PollFlags::empty());
            }
            match ppoll(&mut ready, rest.map(TimeSpec::from_duration), None) {
                Ok(_) | Err(Errno::EINTR) => {}
                Err(errno) => return Err(errno).context("cannot wait"),
            }
            if ready[0].any() == Some(true) {
                self.hear()?;
            }
        }
        Ok(if self.pressed.is_empty() { None } else { Some(self.pressed.remove(0)) })
    }

    fn hear(&mut self) -> anyhow::Result<()> {
        let mut bytes = [0; 64];
        let length = read(io::stdin(), &mut bytes).or_else(|errno| match errno {
            Errno::EINTR | Errno::EAGAIN => Ok(usize::MAX),
            errno => Err(errno),
        });
        match length.context("cannot read the keys")? {
            // The terminal has gone.
            0 => self.pressed.push(Key::Quit),
            usize::MAX => {}
            length => self.pressed.extend(keys(&bytes[..length])),
        }
        Ok(())
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        if let Some(before) = &self.before {
            let _ = tcsetattr(io::stdin(), SetArg::TCSANOW, before);
        }
    }
}

fn is_in_foreground() -> bool {
    tcgetpgrp(io::stdin()).is_ok_and(|group| group == getpgrp())
}

/// The keys that a terminal sends as these bytes.
fn keys(mut bytes: &[u8]) -> Vec<Key> {
    let mut keys = Vec::new();
    while let [first, rest @ ..] = bytes {
        bytes = rest;
        keys.extend(match first {
            b' ' => Some(Key::PauseOrGoOn),
            b'.' | b's' => Some(Key::Step),
            b'+' | b'=' => Some(Key::Faster),
            b'-' => Some(Key::Slower),
            b'q' => Some(Key::Quit),
            // An arrow is ESC [ or ESC O, and a letter.
            0x1b => match rest {
                [b'[' | b'O', letter, rest @ ..] => {
                    bytes = rest;
                    (*letter == b'C').then_some(Key::Step)
                }
                _ => None,
            },
            _ => None,
        });
    }
    keys
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_what_a_terminal_sends() {
        let expected = [Key::PauseOrGoOn, Key::Step, Key::Step, Key::Step, Key::Step];
        assert_eq!(keys(b" .s\x1b[C\x1bOC"), expected);
        assert_eq!(keys(b"+=-q"), [Key::Faster, Key::Faster, Key::Slower, Key::Quit]);
        assert_eq!(keys(b"x\x1b[A\x1b\x1b[\xff"), []);
    }
}
