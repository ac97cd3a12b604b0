//! A program on a terminal of its own.

use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::process::{Child, Stdio};

use nix::poll::{PollFd, PollFlags, PollTimeout};
use nix::pty::{Winsize, openpty};
use nix::sys::signal::{Signal, kill};
use nix::sys::termios::{Termios, tcgetattr};
use nix::unistd::Pid;
use uorb_tests::{Bus, PATIENCE, program};

pub(crate) struct Terminal {
    child: Child,
    master: File,
    slave: Option<OwnedFd>,
    before: Termios,
}

impl Terminal {
    /// Starts the `uorb` command as a shell does it: the terminal is its own, and
    /// it is in the foreground.
    pub(crate) fn uorb(bus: &Bus, arguments: &[&str]) -> Self {
        let size = Winsize { ws_row: 24, ws_col: 100, ws_xpixel: 0, ws_ypixel: 0 };
        let pty = openpty(&size, None).unwrap();
        let before = tcgetattr(&pty.slave).unwrap();
        let own = || Stdio::from(pty.slave.try_clone().unwrap());
        let mut command = bus.command(Path::new("setsid"));
        // It becomes what it is told to run: its process id is that of `uorb`.
        command.arg("--ctty").arg(program("uorb")).args(arguments).env("TERM", "xterm");
        let child = command.stdin(own()).stdout(own()).stderr(own()).spawn().unwrap();
        Self { child, master: File::from(pty.master), slave: Some(pty.slave), before }
    }

    /// Whether the terminal is as it was.
    pub(crate) fn is_as_before(&self) -> bool {
        tcgetattr(self.slave.as_ref().unwrap()).unwrap() == self.before
    }

    pub(crate) fn press(&mut self, keys: &str) {
        self.master.write_all(keys.as_bytes()).unwrap();
    }

    pub(crate) fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.child.id() as i32), signal).unwrap();
    }

    /// Waits until this is written on it; returns all that was.
    pub(crate) fn until(&mut self, words: &str) -> String {
        read(&mut self.master, Some(words))
    }

    /// Waits for its end. Its exit code, if it was not killed, and the rest of what
    /// was written.
    pub(crate) fn end(&mut self) -> (Option<i32>, String) {
        let code = self.child.wait().unwrap().code();
        assert!(self.is_as_before(), "the terminal is not as it was");
        self.slave = None;
        (code, read(&mut self.master, None))
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads until this was written; None: until nobody has the terminal any more.
fn read(master: &mut File, until: Option<&str>) -> String {
    let mut seen = Vec::new();
    let mut bytes = [0; 4_096];
    loop {
        let text = String::from_utf8_lossy(&seen).into_owned();
        if until.is_some_and(|until| text.contains(until)) {
            return text;
        }
        let mut ready = [PollFd::new(master.as_fd(), PollFlags::POLLIN)];
        let timeout = PollTimeout::try_from(PATIENCE).unwrap();
        assert!(nix::poll::poll(&mut ready, timeout).unwrap() > 0, "no {until:?} in {text:?}");
        match master.read(&mut bytes) {
            Ok(read) => seen.extend(&bytes[..read]),
            // EIO: the last one has closed it.
            Err(_) => return text,
        }
    }
}
