//! The fixture of all whole-bus stories: a bus of one's own.
//!
//! A [`Bus`] is a private directory, a broker process in it, and the processes
//! that a story spawns. Dropping it ends them all by process id, those too that
//! went into the background, and removes the directory. Stories wait for lines
//! that processes print and for what the bus says, never for time to pass.

mod foreigner;
mod hearing;
mod hosts;
mod installed;
mod process;
mod python;
mod stranger;
mod tracing;

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use nix::sys::resource::{Resource, getrlimit, setrlimit};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use uorb_core::{
    Instance, Priority, Publication, RawSubscription, Session, StreamSubscription, Subscription,
    System, Topic, World, topic,
};

pub use self::foreigner::Foreigner;
pub use self::hearing::{heard, number};
pub use self::hosts::{Host, Link, Weather};
pub use self::installed::{Installed, Language, is_there};
pub use self::process::{Actor, Ended, is_running};
pub use self::python::Python;
pub use self::stranger::Stranger;
pub use self::tracing::calls_between_marks;
use crate::process::lock_holder;

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
    /// Too large for a node: 6 MiB.
    pub struct Image = "image" {
        /// Counts up.
        pub count: u64,
        /// What it shows.
        pub pixels: [u8; (6 << 20) - 8],
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
        raise_descriptor_limit();
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

    /// Follows the stream of instance 0.
    pub fn stream<T: Topic>(&mut self) -> StreamSubscription<T> {
        StreamSubscription::subscribe(&self.session()).expect("subscribed")
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

    /// The number that the broker has given to a process.
    pub fn peer_of(&self, pid: u32) -> u16 {
        let peers = fs::read_dir(self.system.peers()).into_iter().flatten().flatten();
        let mut its = peers.filter(|peer| lock_holder(&peer.path()) == Some(pid));
        let peer = its.next().expect("it is on this bus").file_name();
        peer.to_str().and_then(|name| name.parse().ok()).expect("its file is its number")
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
        World::of(&self.system).remove();
        // Those of other systems, too: a broker that a story has killed could not
        // remove its own.
        let names = fs::read_dir(&self.base).into_iter().flatten().flatten();
        let systems = names.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
        systems.for_each(|number| World::of(&System::new(&self.base, number)).remove());
        let _ = fs::remove_dir_all(&self.base);
    }
}

/// Stories hold more descriptors than the usual soft limit of 1,024 lets them.
pub fn raise_descriptor_limit() {
    let (_, hard) = getrlimit(Resource::RLIMIT_NOFILE).expect("there is a limit");
    setrlimit(Resource::RLIMIT_NOFILE, hard, hard).expect("up to the hard one");
}

/// Whether a process of ours may hold so many descriptors; says so if not.
pub fn may_hold(descriptors: u64) -> bool {
    let (_, hard) = getrlimit(Resource::RLIMIT_NOFILE).expect("there is a limit");
    // And those that it has for other things.
    let may = hard >= descriptors + 100;
    if !may {
        eprintln!("skipped: it needs {descriptors} descriptors, and the hard limit is {hard}");
    }
    may
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

/// Looks again and again until `is_so`: for what the broker does after an event
/// of the kernel, about which nobody else is told.
pub fn eventually(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !is_so() {
        assert!(Instant::now() < deadline, "it never came: {what}");
        std::thread::yield_now();
    }
}
