//! A publish while others are blocked in `poll`: what it takes, and the system
//! calls that it makes.
//!
//! The floor is one `write` to a FIFO that wakes as many processes, each asleep
//! in an epoll of its own. Sleepers say in shared memory how far they have come,
//! so that everybody sleeps again before the next one is timed.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags, EpollTimeout};
use nix::sys::stat::Mode;
use nix::unistd::{getppid, mkfifo};
use uorb_core::{Publication, Session, Subscription, System, poll};
use uorb_tests::{Actor, Bus, calls_between_marks, heard, number};

use super::Run;
use super::hot::Bytes64;
use crate::doors::WORDS;
use crate::doors::line::shared_words;
use crate::figures::Contestant;
use crate::role::{on, play};
use crate::times::Times;

/// How many are blocked.
pub const BLOCKED: [usize; 3] = [1, 4, 16];

/// From the word of one who sleeps to that of the next.
const APART: usize = 8;

/// What a sleeper takes from its word to its sleep, many times over.
const FALLS_ASLEEP: Duration = Duration::from_micros(500);

pub fn setting(blocked: usize) -> String {
    format!("{blocked} blocked")
}

pub fn measure(run: &mut Run, bus: &mut Bus) {
    for blocked in BLOCKED {
        publish(run, bus, blocked);
        calls(run, bus, blocked);
    }
}

/// Those who are woken, and how often each of them was.
struct Sleepers {
    _actors: Vec<Actor>,
    woken: Vec<&'static AtomicU64>,
    expected: u64,
}

impl Sleepers {
    fn start(run: &Run, bus: &Bus, role: &str, count: usize) -> Self {
        let name = format!("{role}{count}");
        let words = shared_words(&bus.system, &name);
        let core = on(run.cores.other());
        let actors = (0..count).map(|index| {
            let mut actor = play(Some(bus), &[role, &core, &name, &index.to_string()]);
            actor.expect("ready");
            actor
        });
        let actors = actors.collect();
        let woken = (0..count).map(|index| &words[index * APART]).collect();
        Self { _actors: actors, woken, expected: 0 }
    }

    /// Times what wakes all of them.
    fn time(&mut self, times: u32, mut wake: impl FnMut()) -> Times {
        let mut took = Times::none();
        for _ in 0..times {
            sleep(FALLS_ASLEEP);
            let began = Instant::now();
            wake();
            took.add_ns(began.elapsed().as_nanos() as f64);
            self.expected += 1;
            while self.woken.iter().any(|woken| woken.load(Ordering::Acquire) < self.expected) {
                std::thread::yield_now();
            }
        }
        took
    }
}

fn publish(run: &mut Run, bus: &mut Bus, blocked: usize) {
    let publishes = run.figures.effort.wakes / 8 + 10;
    let mut publication = bus.advertise::<Bytes64>();
    let mut pollers = Sleepers::start(run, bus, "sleeper", blocked);
    let fifo = fifo(&bus.system);
    let mut listeners = Sleepers::start(run, bus, "listen-to-pipe", blocked);
    let message = Bytes64 { words: [1; WORDS] };
    run.alone(|figures| {
        let ours = Contestant::new("uorb", || {
            pollers.time(publishes, || {
                publication.publish(&message).expect("published");
            })
        });
        let mut floor = || {
            listeners.time(publishes, || {
                (&fifo).write_all(&[0]).expect("written");
            })
        };
        let row = ("publish, others blocked", &*setting(blocked));
        figures.measure(row, ("one write", &mut floor), vec![ours]);
    });
}

fn calls(run: &mut Run, bus: &mut Bus, blocked: usize) {
    let mut publisher = play(Some(bus), &["publish-when-told", &on(run.cores.alone())]);
    publisher.expect("ready");
    let mut pollers = Sleepers::start(run, bus, "sleeper", blocked);
    let mut most = 0;
    pollers.time(5, || most = calls_between_marks(&mut publisher, "go").len().max(most));
    let row = ("system calls of a publish", &*setting(blocked));
    run.figures.note_value(row, "uorb", most as f64, "calls");
}

/// The role of one who is blocked in `poll`.
pub fn sleeper(arguments: &[&str]) -> anyhow::Result<()> {
    let woken = word(arguments);
    let mut subscription = Subscription::<Bytes64>::subscribe(&Session::connect()?)?;
    subscription.skip();
    woken.store(0, Ordering::Release);
    println!("ready");
    loop {
        poll(&mut [&mut subscription], None)?;
        if subscription.update().is_some() {
            woken.fetch_add(1, Ordering::Release);
        }
    }
}

/// The role of one who is blocked in an epoll with a FIFO in it.
pub fn listen_to_pipe(arguments: &[&str]) -> anyhow::Result<()> {
    let woken = word(arguments);
    let fifo = fifo(&System::from_env()?);
    let epoll = Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC)?;
    epoll.add(&fifo, EpollEvent::new(EpollFlags::EPOLLIN | EpollFlags::EPOLLET, 0))?;
    let mut events = [EpollEvent::empty()];
    // What others have written before.
    epoll.wait(&mut events, EpollTimeout::ZERO)?;
    woken.store(0, Ordering::Release);
    println!("ready");
    loop {
        epoll.wait(&mut events, EpollTimeout::NONE)?;
        woken.fetch_add(1, Ordering::Release);
    }
}

/// The role of one who publishes once between two marks.
pub fn publish_when_told() -> anyhow::Result<()> {
    let mut publication = Publication::<Bytes64>::advertise(&Session::connect()?)?;
    println!("ready");
    while heard().is_some() {
        getppid();
        publication.publish(&Bytes64 { words: [1; WORDS] })?;
        getppid();
    }
    Ok(())
}

fn word(arguments: &[&str]) -> &'static AtomicU64 {
    let system = System::from_env().expect("the bus is in the environment");
    &shared_words(&system, arguments[0])[number(arguments[1]) as usize * APART]
}

fn fifo(system: &System) -> File {
    let path = system.base().join("pipe");
    // Whoever comes first makes it.
    let _ = mkfifo(&path, Mode::S_IRUSR | Mode::S_IWUSR);
    let mut options = OpenOptions::new();
    options.read(true).write(true).custom_flags(libc::O_NONBLOCK);
    options.open(path).expect("the FIFO is there")
}
