//! The processes of a story: what they print, what they hear, how they end.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::MetadataExt;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Instant;

use nix::poll::{PollFd, PollFlags, PollTimeout};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use crate::{PATIENCE, eventually};

/// How a command has ended.
#[derive(Debug)]
pub struct Ended {
    /// Its exit code.
    pub code: i32,
    /// What it has printed since.
    pub out: String,
    /// What it has said on stderr since.
    pub words: String,
}

impl Ended {
    /// Checks that it went well, and returns what it printed.
    #[track_caller]
    pub fn fine(self) -> String {
        assert_eq!((self.code, &*self.words), (0, ""), "{}", self.out);
        self.out
    }

    /// Checks that it failed, printed nothing, and said all of this.
    #[track_caller]
    pub fn failed(&self, words: &[&str]) {
        assert_eq!((self.code, &*self.out), (1, ""), "{}", self.words);
        for expected in words {
            assert!(self.words.contains(expected), "no {expected:?} in: {}", self.words);
        }
    }
}

/// A process that a story has spawned. Killed when it is dropped.
#[derive(Debug)]
pub struct Actor {
    child: Child,
    stdin: Option<ChildStdin>,
    stdout: Option<BufReader<ChildStdout>>,
    stderr: Option<BufReader<ChildStderr>>,
}

impl Actor {
    /// Spawns a command with its input and its output piped. What it says on
    /// stderr is heard if that was piped, too.
    pub fn spawn(mut command: Command) -> Self {
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("{command:?} does not start: {error}"));
        let stdin = child.stdin.take();
        let stdout = child.stdout.take().map(BufReader::new);
        let stderr = child.stderr.take().map(BufReader::new);
        Self { child, stdin, stdout, stderr }
    }

    /// The next line it prints. None at its end.
    pub fn line(&mut self) -> Option<String> {
        next_line(self.stdout.as_mut().expect("its output is open"))
    }

    /// The next line it says on stderr. None at its end.
    pub fn word(&mut self) -> Option<String> {
        next_line(self.stderr.as_mut().expect("its stderr is piped"))
    }

    /// Waits for a line.
    #[track_caller]
    pub fn expect(&mut self, expected: &str) {
        assert_eq!(self.line().as_deref(), Some(expected));
    }

    /// Waits for these lines.
    #[track_caller]
    pub fn expect_all(&mut self, expected: &str) {
        expected.lines().for_each(|line| self.expect(line));
    }

    /// Reads on until a line has all of this in it, and returns it.
    #[track_caller]
    pub fn until(&mut self, words: &[&str]) -> String {
        let mut seen = Vec::new();
        let deadline = Instant::now() + PATIENCE;
        while let Some(line) = self.line() {
            if words.iter().all(|word| line.contains(word)) {
                return line;
            }
            seen.push(line);
            assert!(Instant::now() < deadline, "it goes on without a line of {words:?}: {seen:?}");
        }
        panic!("it ended without a line of {words:?}: {seen:?}");
    }

    /// Says a line to it.
    pub fn say(&mut self, line: &str) {
        let stdin = self.stdin.as_mut().expect("its input is open");
        // In one write: it may act on half a line and be gone before the rest.
        if stdin.write_all(format!("{line}\n").as_bytes()).is_err() {
            let said: Vec<_> = std::iter::from_fn(|| self.line()).collect();
            panic!("it has ended and said {said:?}");
        }
    }

    /// Reads its output no more, as `head` does that has seen enough.
    pub fn stop_reading(&mut self) {
        self.stdout = None;
    }

    /// Closes its input, waits for its end, and returns what it printed since.
    pub fn finish(&mut self) -> Vec<String> {
        self.stdin = None;
        let lines = std::iter::from_fn(|| self.line()).collect();
        let status = self.child.wait().expect("it is our child");
        assert!(status.success(), "an actor failed: {status}");
        lines
    }

    /// Waits for its end, however that is.
    pub fn end(&mut self) -> Ended {
        let out = self.stdout.as_mut().map(rest).unwrap_or_default();
        let words = self.stderr.as_mut().map(rest).unwrap_or_default();
        let status = self.child.wait().expect("it is our child");
        let code = status.code().unwrap_or_else(|| panic!("it was killed: {status}"));
        Ended { code, out, words }
    }

    /// Waits for its end. The signal that it died of, if it did.
    pub fn signal_of_death(&mut self) -> Option<i32> {
        self.child.wait().expect("it is our child").signal()
    }

    /// Presses Ctrl-C, and waits for its end.
    pub fn interrupt(&mut self) -> Ended {
        self.signal(Signal::SIGINT);
        self.end()
    }

    /// Its process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Sends it a signal.
    pub fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.child.id() as i32), signal).expect("it lives");
    }

    /// Stops it, until it gets SIGCONT.
    pub fn stop(&self) {
        self.signal(Signal::SIGSTOP);
        eventually("it has stopped", || state(self.child.id()) == Some('T'));
    }

    /// Ends it with SIGKILL.
    pub fn kill(&mut self) {
        self.child.kill().expect("it can be killed");
        self.child.wait().expect("it is our child");
    }
}

impl Drop for Actor {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The next line of a pipe. None at its end.
fn next_line<P: Read + AsFd>(pipe: &mut BufReader<P>) -> Option<String> {
    let mut line = String::new();
    wait_for(pipe);
    let length = pipe.read_line(&mut line).expect("the pipe can be read");
    (length > 0).then(|| line.trim_end().to_string())
}

/// All lines of a pipe, up to its end.
fn rest<P: Read + AsFd>(pipe: &mut BufReader<P>) -> String {
    let mut lines = String::new();
    loop {
        wait_for(pipe);
        if pipe.read_line(&mut lines).expect("the pipe can be read") == 0 {
            return lines;
        }
    }
}

/// Waits until there is something to read, but not for ever.
fn wait_for<P: Read + AsFd>(pipe: &BufReader<P>) {
    if pipe.buffer().contains(&b'\n') {
        return;
    }
    let timeout = PollTimeout::try_from(PATIENCE).expect("it is not that long");
    let mut ready = [PollFd::new(pipe.get_ref().as_fd(), PollFlags::POLLIN)];
    let ready = nix::poll::poll(&mut ready, timeout).expect("the pipe can be polled");
    assert!(ready > 0, "it says nothing");
}

/// Whether a process of this id runs. One that has ended and that nobody has
/// waited for does not.
pub fn is_running(pid: u32) -> bool {
    state(pid).is_some_and(|state| state != 'Z')
}

/// The state of a process in one letter, as proc(5) has it.
fn state(pid: u32) -> Option<char> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // 4711 (uorbd) S 1 ..., and the name may have anything in it.
    stat.rsplit(") ").next()?.chars().next()
}

/// The process that has a record lock on this file. Read in /proc: to open the
/// file and close it again would let go of a lock that this process has on it.
pub(crate) fn lock_holder(path: &Path) -> Option<u32> {
    let inode = fs::metadata(path).ok()?.ino().to_string();
    let locks = fs::read_to_string("/proc/locks").ok()?;
    locks.lines().find_map(|line| {
        // 1: POSIX  ADVISORY  WRITE 4711 00:18:12345 0 EOF
        let words: Vec<&str> = line.split_whitespace().collect();
        let &[_, "POSIX", _, "WRITE", pid, file, ..] = &words[..] else { return None };
        (file.rsplit(':').next() == Some(&*inode)).then(|| pid.parse().ok())?
    })
}
