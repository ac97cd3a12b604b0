//! Machines of a story: a bus each, a network namespace each, and links between
//! them that are as bad as one likes.
//!
//! A link is two TUN devices and the threads that carry packets from one to the
//! other: late, not all of them, and not too many a second, as `tc netem` does where
//! the kernel has it. A namespace lives as long as a process of ours that waits for
//! the end of its input; nothing is left of it.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::os::fd::AsFd;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sched::{CloneFlags, setns};
use nix::sys::time::TimeSpec;
use tun_rs::{DeviceBuilder, SyncDevice};

use crate::{Actor, Bus, program};

/// A machine.
#[derive(Debug)]
pub struct Host {
    /// Its bus.
    pub bus: Bus,
    namespace: Child,
}

/// How a link is.
#[derive(Clone, Copy, Debug)]
pub struct Weather {
    /// How long a packet takes, each way.
    pub delay: Duration,
    /// How many of a thousand packets are lost.
    pub lost_of_1000: u32,
    /// How many bits a second it carries, each way.
    pub bits_per_second: u64,
    /// Whether it carries anything at all.
    pub is_cut: bool,
}

impl Weather {
    /// As good as it gets.
    pub const FINE: Self = Self {
        delay: Duration::ZERO,
        lost_of_1000: 0,
        bits_per_second: 1_000_000_000,
        is_cut: false,
    };
    /// No link.
    pub const CUT: Self = Self { is_cut: true, ..Self::FINE };
}

/// A link between two machines.
#[derive(Debug)]
pub struct Link {
    weather: Arc<Mutex<Weather>>,
    has_ended: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

/// The longest packet that a TUN device gives.
const PACKET_MAX_BYTES: usize = 2_048;

/// What a link keeps for its turn: so much is under way before packets are lost.
const BACKLOG_MAX: Duration = Duration::from_millis(500);

/// How long a thread sleeps before it looks whether the link has ended.
const LOOK_AGAIN: Duration = Duration::from_millis(50);

impl Host {
    /// A machine with no link yet, whose CLOCK_MONOTONIC is ahead by so many seconds.
    /// None: this process may not make one, and has said so.
    pub fn start(clock_ahead_s: u64) -> Option<Self> {
        let mut command = Command::new("unshare");
        command.arg("--net");
        if clock_ahead_s > 0 {
            command.args(["--time", "--monotonic", &clock_ahead_s.to_string()]);
        }
        let spawned = command
            .arg("cat")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn();
        let Ok(mut namespace) = spawned else {
            println!("skipped: there is no unshare(1) here (util-linux)");
            return None;
        };
        // `cat` says what it hears once the namespace is made.
        let _ = namespace.stdin.as_mut().expect("piped").write_all(b"\n");
        let mut line = String::new();
        let said = BufReader::new(namespace.stdout.as_mut().expect("piped")).read_line(&mut line);
        let host = Self { bus: Bus::start(), namespace };
        let is_made = said.is_ok_and(|bytes| bytes > 0)
            && host.ip(&["link", "set", "lo", "up"])
            && Path::new("/dev/net/tun").exists();
        if !is_made {
            println!("skipped: it needs network namespaces (root), ip(8), and /dev/net/tun");
        }
        is_made.then_some(host)
    }

    /// Spawns one of our programs on this machine, what it says on stderr piped, too.
    pub fn spawn(&self, name: &str, arguments: &[&str]) -> Actor {
        let mut command = self.command("nsenter");
        command.arg("--").arg(program(name)).args(arguments).stderr(Stdio::piped());
        Actor::spawn(command)
    }

    fn ip(&self, arguments: &[&str]) -> bool {
        let mut command = self.command("nsenter");
        let ran = command.args(["--", "ip"]).args(arguments).stderr(Stdio::null()).status();
        ran.is_ok_and(|status| status.success())
    }

    /// `nsenter`, into all that this machine has of its own. It becomes the program
    /// that follows.
    fn command(&self, nsenter: &str) -> Command {
        let mut command = self.bus.command(Path::new(nsenter));
        command.args(["--net", "--time", "--target", &self.pid().to_string()]);
        command
    }

    /// `cat`, which `unshare` has become or, where there is a clock, waits for.
    fn pid(&self) -> u32 {
        let pid = self.namespace.id();
        let children = std::fs::read_to_string(format!("/proc/{pid}/task/{pid}/children"));
        let child = children.ok().and_then(|pids| pids.split_whitespace().next()?.parse().ok());
        child.unwrap_or(pid)
    }

    /// A TUN device in this machine, `tun<number>` with this address.
    fn device(&self, number: u8, address: &str) -> SyncDevice {
        let name = format!("tun{number}");
        let namespace = File::open(format!("/proc/{}/ns/net", self.pid())).expect("it runs");
        let its = name.clone();
        // A thread of its own, which is in the namespace and ends.
        let made = std::thread::spawn(move || {
            setns(namespace, CloneFlags::CLONE_NEWNET).expect("it is ours");
            DeviceBuilder::new().name(its).build_sync().expect("a device")
        });
        let device = made.join().expect("it is made");
        device.set_nonblocking(true).expect("it can be set");
        assert!(self.ip(&["address", "add", address, "dev", &name]));
        assert!(self.ip(&["link", "set", &name, "up"]));
        device
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        // Both it and, where there is one, its child hear that the input has ended.
        drop(self.namespace.stdin.take());
        let _ = self.namespace.wait();
    }
}

impl Link {
    /// Links two machines: the first is `10.9.<number>.1` for the second, the second
    /// `10.9.<number>.2` for the first. Which packets are lost depends on the seed.
    pub fn between(hosts: [&Host; 2], number: u8, seed: u64, weather: Weather) -> Self {
        let address = |end: u8| format!("10.9.{number}.{end}/24");
        let [a, b] = [(hosts[0], 1), (hosts[1], 2)]
            .map(|(host, end)| Arc::new(host.device(number, &address(end))));
        let weather = Arc::new(Mutex::new(weather));
        let has_ended = Arc::new(AtomicBool::new(false));
        let threads =
            [(&a, &b), (&b, &a)].into_iter().zip([seed, !seed]).map(|((from, to), seed)| {
                let carrier = Carrier {
                    from: from.clone(),
                    to: to.clone(),
                    weather: weather.clone(),
                    has_ended: has_ended.clone(),
                    random: seed | 1,
                    free_at: Instant::now(),
                    under_way: VecDeque::new(),
                };
                std::thread::spawn(move || carrier.run())
            });
        Self { weather: weather.clone(), has_ended: has_ended.clone(), threads: threads.collect() }
    }

    /// Changes how it is.
    pub fn set(&self, weather: Weather) {
        *self.weather.lock().unwrap_or_else(PoisonError::into_inner) = weather;
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.has_ended.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Carries packets one way.
struct Carrier {
    from: Arc<SyncDevice>,
    to: Arc<SyncDevice>,
    weather: Arc<Mutex<Weather>>,
    has_ended: Arc<AtomicBool>,
    random: u64,
    /// When the link has sent all that it has accepted.
    free_at: Instant,
    under_way: VecDeque<(Instant, Vec<u8>)>,
}

impl Carrier {
    fn run(mut self) {
        let mut packet = [0; PACKET_MAX_BYTES];
        while !self.has_ended.load(Ordering::Relaxed) {
            self.wait();
            while let Ok(length) = self.from.recv(&mut packet) {
                self.accept(&packet[..length]);
            }
            let now = Instant::now();
            while self.under_way.front().is_some_and(|(due, _)| *due <= now) {
                let (_, packet) = self.under_way.pop_front().expect("it is there");
                // A device that is full loses a packet, as devices do.
                let _ = self.to.send(&packet);
            }
        }
    }

    /// Until a packet comes, or one is due.
    fn wait(&self) {
        let rest = self.under_way.front().map_or(LOOK_AGAIN, |(due, _)| {
            due.saturating_duration_since(Instant::now()).min(LOOK_AGAIN)
        });
        let mut ready = [PollFd::new(self.from.as_fd(), PollFlags::POLLIN)];
        let _ = ppoll(&mut ready, Some(TimeSpec::from_duration(rest)), None);
    }

    fn accept(&mut self, packet: &[u8]) {
        let weather = *self.weather.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        let begins = self.free_at.max(now);
        let is_lost = weather.is_cut
            || self.roll() % 1_000 < weather.lost_of_1000.into()
            || begins - now > BACKLOG_MAX;
        if is_lost {
            return;
        }
        let bits = packet.len() as u64 * 8;
        self.free_at =
            begins + Duration::from_nanos(bits * 1_000_000_000 / weather.bits_per_second);
        self.under_way.push_back((self.free_at + weather.delay, packet.to_vec()));
    }

    /// xorshift64.
    fn roll(&mut self) -> u64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.random >> 11
    }
}
