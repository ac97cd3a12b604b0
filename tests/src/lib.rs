//! The fixture of all whole-bus stories: a bus of one's own.
//!
//! A [`Bus`] is a private directory, a broker process in it, and the processes
//! that a story spawns. Dropping it ends them all by process id, those too that
//! went into the background, and removes the directory. Stories wait for lines
//! that processes print and for what the bus says, never for time to pass.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, PollTimeout};
use nix::sys::signal::{Signal, kill};
use nix::sys::socket::{
    AddressFamily, MsgFlags, SockFlag, SockType, UnixAddr, connect, recv, send, socket,
};
use nix::unistd::Pid;
use uorb_core::broker_side::{
    FromBroker, Join, PACKET_MAX_BYTES, PROTOCOL_VERSION, Reply, Request, ToBroker, decode, encode,
};
use uorb_core::{
    Instance, Priority, Publication, RawSubscription, Session, Subscription, System, Topic, topic,
};

topic! {
    /// What actors exchange: a number, who sent it, and a check of both, spread
    /// over enough words that a torn message cannot look whole.
    pub struct Stamped = "stamped" {
        /// Counts up in each publisher.
        pub count: u64,
        /// The publisher's process id.
        pub sender: u64,
        /// `count` times a large odd number plus `sender`, in every word.
        pub check: [u64; 30],
    }
}

topic! {
    /// A number.
    pub struct Plain = "plain" {
        /// The value.
        pub value: u32,
    }
}

impl Stamped {
    /// A message that can be checked.
    pub fn new(count: u64, sender: u64) -> Self {
        Self { count, sender, check: [Self::check_of(count, sender); 30] }
    }

    /// Whether it is one message, whole.
    pub fn is_whole(&self) -> bool {
        self.check == [Self::check_of(self.count, self.sender); 30]
    }

    fn check_of(count: u64, sender: u64) -> u64 {
        count.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(sender)
    }
}

/// How long a story waits for what must come before it calls it missing. Never
/// a measure of speed: loaded machines take their time.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// A private system.
#[derive(Debug)]
pub struct Bus {
    /// Where it lives.
    pub system: System,
    base: PathBuf,
    broker: Option<Child>,
    session: Option<Session>,
}

impl Bus {
    /// A directory of one's own and a broker in it.
    pub fn start() -> Self {
        let mut bus = Self::without_broker();
        bus.start_broker();
        bus
    }

    /// A directory of one's own.
    pub fn without_broker() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let base = PathBuf::from(format!("/dev/shm/uorb-test-{}-{count}", std::process::id()));
        fs::create_dir(&base).expect("a new directory in /dev/shm");
        Self { system: System::new(&base, 0), base, broker: None, session: None }
    }

    /// Starts the broker and waits until it is ready.
    pub fn start_broker(&mut self) {
        let (child, line) = self.try_start_broker();
        assert_eq!(line, "ready", "uorbd says how it started");
        self.broker = Some(child);
    }

    /// Starts a broker process. Returns it and the line it starts with.
    pub fn try_start_broker(&self) -> (Child, String) {
        let mut command = Command::new(program("uorbd"));
        command.args(["--ready-fd", "1", "--dir"]).arg(&self.base);
        let mut child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("uorbd starts");
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().expect("piped")).read_line(&mut line).expect("a line");
        (child, line.trim_end().to_string())
    }

    /// Ends the broker with SIGKILL.
    pub fn kill_broker(&mut self) {
        let mut broker = self.broker.take().expect("a broker runs");
        broker.kill().expect("it can be killed");
        broker.wait().expect("it is our child");
    }

    /// Takes over a broker that a story has started by itself.
    pub fn adopt_broker(&mut self, broker: Child) {
        self.broker = Some(broker);
    }

    /// The same bus, of which this process holds nothing any more.
    pub fn without_session(mut self) -> Self {
        self.session = None;
        self
    }

    /// The broker's process id.
    pub fn broker_pid(&self) -> u32 {
        self.broker.as_ref().expect("a broker runs").id()
    }

    /// Ends the system as `uorb stop` does, and waits for the broker's exit.
    pub fn stop(&mut self) {
        let mut broker = self.broker.take().expect("a broker runs");
        kill(Pid::from_raw(broker.id() as i32), Signal::SIGTERM).expect("it can be signalled");
        assert!(broker.wait().expect("it is our child").success());
    }

    /// This process's session.
    pub fn session(&mut self) -> Session {
        let system = &self.system;
        let connect = || Session::connect_to(system).expect("the broker takes us");
        self.session.get_or_insert_with(connect).clone()
    }

    /// Becomes a publisher of instance 0.
    pub fn advertise<T: Topic>(&mut self) -> Publication<T> {
        Publication::advertise(&self.session()).expect("advertised")
    }

    /// Claims an instance.
    pub fn advertise_multi<T: Topic>(&mut self) -> Publication<T> {
        Publication::advertise_multi(&self.session(), Priority::DEFAULT).expect("advertised")
    }

    /// Follows instance 0.
    pub fn subscribe<T: Topic>(&mut self) -> Subscription<T> {
        Subscription::subscribe(&self.session()).expect("subscribed")
    }

    /// Follows an instance.
    pub fn subscribe_instance<T: Topic>(&mut self, number: u8) -> Subscription<T> {
        Subscription::subscribe_instance(&self.session(), instance(number)).expect("subscribed")
    }

    /// Follows a topic by name.
    pub fn subscribe_by_name(&mut self, topic: &str) -> RawSubscription {
        RawSubscription::subscribe(&self.session(), topic, Instance::FIRST).expect("subscribed")
    }

    /// Whether instance 0 of a topic has a publisher.
    pub fn is_advertised(&mut self, topic: &str) -> bool {
        self.session().exists(topic, Instance::FIRST).expect("the node can be read")
    }

    /// Spawns an actor (see `actor.rs`) on this bus.
    pub fn spawn(&self, arguments: &[&str]) -> Actor {
        self.spawn_program(&program("actor"), arguments)
    }

    /// Spawns one of our programs on this bus, its output piped.
    pub fn spawn_program(&self, program: &Path, arguments: &[&str]) -> Actor {
        let mut command = self.command(program);
        command.args(arguments);
        Actor::spawn(command)
    }

    /// Spawns the `uorb` command on this bus.
    pub fn spawn_uorb(&self, arguments: &[&str]) -> Actor {
        self.spawn_heard("uorb", arguments)
    }

    /// Spawns one of our programs on this bus, what it says on stderr piped, too.
    pub fn spawn_heard(&self, name: &str, arguments: &[&str]) -> Actor {
        let mut command = self.command(&program(name));
        command.args(arguments).stderr(Stdio::piped());
        Actor::spawn(command)
    }

    /// Runs the `uorb` command on this bus to its end.
    pub fn uorb(&self, arguments: &[&str]) -> Ended {
        self.spawn_uorb(arguments).end()
    }

    /// Starts the broker as `uorb start` does: in the background, as nobody's
    /// child. Returns its process id.
    pub fn start_by_command(&self) -> u32 {
        let started = self.uorb(&["start"]);
        assert_eq!(started.code, 0, "{}", started.words);
        self.running_broker().expect("it is ready")
    }

    /// The process that has the broker's lock.
    pub fn running_broker(&self) -> Option<u32> {
        lock_holder(&self.system.lock())
    }

    /// The processes that are on this bus, whoever has started them.
    pub fn processes(&self) -> Vec<u32> {
        let peers = fs::read_dir(self.system.peers()).into_iter().flatten();
        peers.filter_map(|peer| lock_holder(&peer.ok()?.path())).collect()
    }

    /// A command with this bus in its environment.
    pub fn command(&self, program: &Path) -> Command {
        let mut command = Command::new(program);
        command.env("UORB_DIR", &self.base).env_remove("UORB_SYSTEM").env_remove("UORB_LOG");
        command
    }
}

impl Drop for Bus {
    fn drop(&mut self) {
        self.session = None;
        if let Some(mut broker) = self.broker.take() {
            let _ = broker.kill();
            let _ = broker.wait();
        }
        // Whoever is left went into the background. The directory is ours alone,
        // and so are they.
        let ours = std::process::id();
        for pid in self.running_broker().into_iter().chain(self.processes()) {
            if pid != ours {
                let _ = kill(Pid::from_raw(pid as i32), Signal::SIGKILL);
            }
        }
        let _ = fs::remove_dir_all(&self.base);
    }
}

/// The process that has a record lock on this file. Read in /proc: to open the
/// file and close it again would let go of a lock that this process has on it.
fn lock_holder(path: &Path) -> Option<u32> {
    let inode = fs::metadata(path).ok()?.ino().to_string();
    let locks = fs::read_to_string("/proc/locks").ok()?;
    locks.lines().find_map(|line| {
        // 1: POSIX  ADVISORY  WRITE 4711 00:18:12345 0 EOF
        let words: Vec<&str> = line.split_whitespace().collect();
        let &[_, "POSIX", _, "WRITE", pid, file, ..] = &words[..] else { return None };
        (file.rsplit(':').next() == Some(&*inode)).then(|| pid.parse().ok())?
    })
}

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

/// A connection to the broker that says what it likes.
#[derive(Debug)]
pub struct Stranger {
    socket: OwnedFd,
}

impl Stranger {
    /// Connects, and says nothing yet.
    pub fn connect(system: &System) -> Self {
        let address = UnixAddr::new(&system.socket()).expect("a short path");
        let flags = SockFlag::SOCK_CLOEXEC;
        let socket =
            socket(AddressFamily::Unix, SockType::SeqPacket, flags, None).expect("a socket");
        connect(socket.as_raw_fd(), &address).expect("the broker listens");
        Self { socket }
    }

    /// Sends a packet. False: the broker has hung up.
    pub fn send(&self, packet: &[u8]) -> bool {
        send(self.socket.as_raw_fd(), packet, MsgFlags::MSG_NOSIGNAL).is_ok()
    }

    /// Waits for what the broker says. None: it has hung up.
    pub fn hear(&self) -> Option<FromBroker> {
        let mut packet = vec![0; PACKET_MAX_BYTES];
        let length = recv(self.socket.as_raw_fd(), &mut packet, MsgFlags::empty()).ok()?;
        decode(&packet[..length])
    }

    /// Asks, and waits for the answer. None: the broker has hung up.
    pub fn ask(&self, request: Request) -> Option<Reply> {
        self.send(&encode(&ToBroker { number: 1, request }));
        match self.hear()? {
            FromBroker::Reply { reply, .. } => Some(reply),
            _ => None,
        }
    }

    /// Joins under a name.
    pub fn join(&self, name: &str) -> Option<Reply> {
        let (version, name) = (PROTOCOL_VERSION, name.to_string());
        self.ask(Request::Join(Join { version, name, rejoin: None }))
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

/// The instance of this number.
pub fn instance(number: u8) -> Instance {
    Instance::new(number).expect("0 to 9")
}

/// A program of this workspace, from the directory that tests are built into.
pub fn program(name: &str) -> PathBuf {
    let test = std::env::current_exe().expect("every program has a file");
    // target/debug/deps/stories-0123 or target/debug/actor
    let built = test.ancestors().map(|dir| dir.join(name)).find(|path| path.is_file());
    built.unwrap_or_else(|| panic!("{name} is not built: run `cargo build --workspace` first"))
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

/// Looks again and again until `is_so`: for what the broker does after an event
/// of the kernel, about which nobody else is told.
pub fn eventually(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !is_so() {
        assert!(Instant::now() < deadline, "it never came: {what}");
        std::thread::yield_now();
    }
}
