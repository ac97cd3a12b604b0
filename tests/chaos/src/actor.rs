//! A process that may die at any instruction: it publishes, or copies, and notes
//! in the ledger what it has done.

#![allow(unsafe_code)]

use std::fs::File;
use std::os::fd::AsFd;
use std::os::unix::fs::FileExt;
use std::time::Duration;

use nix::poll::{PollFd, PollFlags, PollTimeout};
use nix::sys::signal::{SaFlags, SigAction, SigHandler, SigSet, Signal, sigaction};
use uorb_core::{
    AdvertiseOptions, Claim, Error, Instance, Metadata, Priority, RawPublication, RawSubscription,
    Session, StreamOptions, now_us, poll,
};
use uorb_tests::Stamped;

use crate::ledger::{Cell, Late, LateWhat, Ledger, Phase, Word};
use crate::random::Random;
use crate::shared_topic::{self, bytes_of, is_large, is_pressed, metadata, read};

/// The topic of which every claimer has an instance.
pub(crate) const CLAIMED: &str = "chaos_claimed";

/// The topic whose layout every changer changes.
const CHANGING: &str = "chaos_changing";

/// What takes this long is noted.
const NOTED_US: u64 = 50_000;

/// A waiter looks by itself after this long: far more than it may take to wake
/// it, so that a wake which never comes shows.
const POLL: Duration = Duration::from_millis(400);

/// Pauses of those who wait for the others.
const PAUSE: Duration = Duration::from_micros(100);

pub(crate) fn run(
    ledger: Ledger,
    cell: Cell,
    sender: u64,
    kind: &str,
    topic: &str,
    storm_us: u64,
) -> bool {
    nix::sys::prctl::set_pdeathsig(Signal::SIGKILL).expect("Linux has it");
    install_handler();
    if storm_us > 0 {
        storm(storm_us);
    }
    let actor = Actor {
        cell,
        sender,
        random: Random::new(sender),
        topic: metadata(topic),
        schedstat: File::open("/proc/thread-self/schedstat").ok(),
        off_cpu_us: 0,
        ledger,
    };
    let ran = match kind {
        "publisher" => actor.publish(false),
        "claimer" => actor.publish(true),
        "changer" => actor.change(),
        "subscriber" => actor.subscribe(Way::Poll),
        "descriptor" => actor.subscribe(Way::Descriptor),
        "follower" => actor.subscribe(Way::Stream),
        other => panic!("no such actor: {other}"),
    };
    if let Err(error) = &ran {
        cell.fail(&format!("{error:?}"));
    }
    ran.is_ok()
}

/// Publishes and notes nothing: for stories that know where it dies.
pub(crate) fn publish_until_killed(topic: &str) -> std::process::ExitCode {
    nix::sys::prctl::set_pdeathsig(Signal::SIGKILL).expect("Linux has it");
    let session = Session::connect().expect("a broker runs");
    let options = AdvertiseOptions::default();
    let mut publication =
        RawPublication::advertise(&session, &metadata(topic), options).expect("advertised");
    for count in 0.. {
        let message = bytes_of(&Stamped::new(count, 1), publication.metadata());
        publication.publish(&message).expect("the system has not ended");
        std::thread::sleep(PAUSE);
    }
    std::process::ExitCode::SUCCESS
}

/// Follows the stream of a topic, and says of each message what its count is, and
/// how many were lost up to there.
pub(crate) fn follow_until_killed(topic: &str) -> std::process::ExitCode {
    nix::sys::prctl::set_pdeathsig(Signal::SIGKILL).expect("Linux has it");
    let session = Session::connect().expect("a broker runs");
    let options = StreamOptions::default();
    let mut stream =
        RawSubscription::subscribe_stream(&session, topic, Instance::FIRST, options).unwrap();
    let mut bytes = Vec::new();
    loop {
        poll(&mut [&mut stream], None).expect("the system has not ended");
        while stream.updated() && stream.copy(&mut bytes) {
            let count = shared_topic::read(&bytes).expect("one of ours").count;
            println!("message {count}, lost {}", stream.lost());
        }
    }
}

/// Signals end waits, and do nothing else.
fn install_handler() {
    extern "C" fn nothing(_: libc::c_int) {}
    let action = SigAction::new(SigHandler::Handler(nothing), SaFlags::empty(), SigSet::empty());
    for signal in [Signal::SIGUSR1, Signal::SIGALRM] {
        // SAFETY: the handler does nothing at all.
        unsafe { sigaction(signal, &action) }.expect("it can be handled");
    }
}

/// Interrupts every system call of the process that waits, this often.
fn storm(period_us: u64) {
    let period = libc::timeval { tv_sec: 0, tv_usec: period_us as libc::suseconds_t };
    let timer = libc::itimerval { it_interval: period, it_value: period };
    // SAFETY: plain numbers go in.
    let set = unsafe { libc::setitimer(libc::ITIMER_REAL, &timer, std::ptr::null_mut()) };
    assert_eq!(set, 0);
}

#[derive(Clone, Copy, PartialEq)]
enum Way {
    Poll,
    Descriptor,
    Stream,
}

struct Actor {
    ledger: Ledger,
    cell: Cell,
    sender: u64,
    random: Random,
    topic: Metadata,
    schedstat: Option<File>,
    off_cpu_us: u64,
}

impl Actor {
    /// How long this thread was ready to run and had no core, until now.
    fn off_cpu_us(&self) -> u64 {
        let mut text = [0; 64];
        let read = self.schedstat.as_ref().and_then(|file| file.read_at(&mut text, 0).ok());
        let text = String::from_utf8_lossy(&text[..read.unwrap_or(0)]);
        text.split(' ').nth(1).and_then(|delay| delay.parse().ok()).unwrap_or(0) / 1_000
    }

    fn note(&self, what: LateWhat, from_us: u64) {
        let to_us = now_us();
        if to_us.saturating_sub(from_us) > NOTED_US {
            let off_cpu_us = self.off_cpu_us().saturating_sub(self.off_cpu_us);
            self.cell.late(Late { what, from_us, to_us, off_cpu_us });
        }
    }

    /// Asks something of the broker, and notes how long that took.
    fn request<T>(
        &mut self,
        what: LateWhat,
        ask: impl FnOnce(&Metadata) -> Result<T, Error>,
    ) -> Result<T, Error> {
        // Whoever uses a large topic needs its stream.
        let what = if is_large(&self.topic.name) { LateWhat::StreamRequest } else { what };
        self.off_cpu_us = self.off_cpu_us();
        let from_us = now_us();
        let answer = ask(&self.topic);
        self.note(what, from_us);
        self.cell.add(Word::Requests, 1);
        let took_us = (now_us() - from_us).max(self.cell.get(Word::SlowestRequest));
        self.cell.set(Word::SlowestRequest, took_us);
        answer
    }

    /// Waits until the next round if it is time to. True: it has waited.
    fn pause(&self, from: Phase) -> bool {
        let (round, phase) = self.ledger.phase();
        if phase == Phase::Run || (from == Phase::Drain && phase == Phase::Quiet) {
            return false;
        }
        self.cell.set(Word::PausedIn, round + 1);
        // The next round may come and pause while this process has no core.
        while matches!(self.ledger.phase(), (now, phase) if now == round && phase != Phase::Run) {
            std::thread::sleep(PAUSE);
        }
        true
    }

    fn publish(mut self, claims: bool) -> Result<(), Error> {
        let session = self.request(LateWhat::Request, |_| Session::connect())?;
        let mut publication = None;
        loop {
            self.pause(Phase::Quiet);
            self.off_cpu_us = self.off_cpu_us();
            let mut held = match publication.take() {
                Some(held) => held,
                None => self.advertise(&session, claims)?,
            };
            for _ in 0..1 + self.random.below(8) {
                if self.cell.is_full() {
                    break;
                }
                self.publish_one(&mut held)?;
            }
            if !claims && self.random.once_in(150) {
                self.cell.set(Word::State, 0);
                self.request(LateWhat::Request, |_| {
                    drop(held);
                    Ok(())
                })?;
            } else {
                publication = Some(held);
            }
            match self.random.below(4) {
                0 => std::thread::yield_now(),
                _ => std::thread::sleep(Duration::from_micros(50 + self.random.below(400))),
            }
        }
    }

    /// Advertises one topic with one layout, then with another: a node that nobody
    /// uses gives way.
    fn change(mut self) -> Result<(), Error> {
        let session = self.request(LateWhat::Request, |_| Session::connect())?;
        loop {
            self.cell.set(Word::State, 1);
            self.pause(Phase::Quiet);
            self.off_cpu_us = self.off_cpu_us();
            let mut changed = metadata(CHANGING);
            changed.layout.to_mut().message_hash = self.random.below(3) as u32;
            let advertised = self.request(LateWhat::Request, |_| {
                RawPublication::advertise(&session, &changed, AdvertiseOptions::default())
            });
            match advertised {
                Ok(mut held) => {
                    _ = held.publish(&bytes_of(&Stamped::new(0, self.sender), &changed))?
                }
                // Somebody else uses it as it is.
                Err(Error::LayoutMismatch { .. }) => {}
                Err(error) => return Err(error),
            }
            std::thread::sleep(PAUSE);
        }
    }

    fn advertise(&mut self, session: &Session, claims: bool) -> Result<RawPublication, Error> {
        let options = AdvertiseOptions {
            claim: if claims { Claim::Lowest } else { Claim::Shared(Instance::FIRST) },
            priority: Priority::DEFAULT,
            queue_length: None,
        };
        let held = self.request(LateWhat::Request, |topic| {
            let claimed = metadata(CLAIMED);
            RawPublication::advertise(session, if claims { &claimed } else { topic }, options)
        })?;
        self.cell.set(Word::Instance, u64::from(held.instance().number()) + 1);
        self.cell.set(Word::State, 1);
        Ok(held)
    }

    fn publish_one(&mut self, publication: &mut RawPublication) -> Result<(), Error> {
        let count = self.cell.get(Word::Begun);
        let message = bytes_of(&Stamped::new(count, self.sender), publication.metadata());
        self.cell.set(Word::Begun, count + 1);
        let from_us = now_us();
        let published = match is_pressed(&self.topic.name) {
            true => publication.try_publish(&message),
            false => publication.publish(&message),
        };
        if let Err(Error::QueueFull { .. }) = published {
            self.cell.set(Word::Begun, count);
            return Ok(());
        }
        let generation = published?;
        self.cell.log(generation.get().into(), self.sender, count);
        self.cell.set(Word::Done, count + 1);
        self.note(LateWhat::Publish, from_us);
        Ok(())
    }

    fn subscribe(mut self, way: Way) -> Result<(), Error> {
        let session = self.request(LateWhat::Request, |_| Session::connect())?;
        loop {
            let what = if way == Way::Stream { LateWhat::StreamRequest } else { LateWhat::Request };
            let subscription = self.request(what, |topic| match way {
                Way::Stream => {
                    let options = StreamOptions {
                        depth: (!topic.layout.is_large()).then_some(512),
                        back_pressure: is_pressed(&topic.name),
                    };
                    RawSubscription::subscribe_stream(
                        &session,
                        &topic.name,
                        Instance::FIRST,
                        options,
                    )
                }
                _ => RawSubscription::subscribe_described(&session, topic, Instance::FIRST),
            })?;
            if way == Way::Descriptor {
                subscription.open_descriptor()?;
            }
            self.cell.set(Word::First, subscription.generation().get().into());
            self.cell.set(Word::LostBefore, 0);
            self.cell.set(Word::Lost, 0);
            self.cell.set(Word::Copied, 0);
            // What follows in the log is of another subscription.
            self.cell.log(0, 0, 0);
            self.cell.set(Word::State, 1);
            self.follow(subscription, way)?;
        }
    }

    /// Copies until it has had enough of this subscription.
    fn follow(&mut self, mut subscription: RawSubscription, way: Way) -> Result<(), Error> {
        let mut looks = 0_u64;
        // A new subscription begins with what is there, however old it is.
        let mut is_new = true;
        loop {
            self.off_cpu_us = self.off_cpu_us();
            let (_, phase) = self.ledger.phase();
            if phase != Phase::Drain {
                self.wait(&mut subscription, way)?;
            }
            let mut is_first = true;
            while let Some(message) = next(&mut subscription, way) {
                let copied = subscription.last_copied().expect("it was just copied");
                if is_first && !is_new {
                    self.note(LateWhat::Copy, copied.publish_time_us);
                }
                (is_first, is_new) = (false, false);
                self.cell.add(Word::Torn, u64::from(!message.is_whole()));
                let generation = copied.generation.get().into();
                self.cell.log(generation, message.sender, message.count);
                self.cell.add(Word::Copied, 1);
                self.cell.set(Word::Seen, generation);
            }
            self.cell.set(Word::Lost, subscription.lost());
            self.cell.set(Word::Pending, subscription.pending());
            if phase == Phase::Drain && subscription.pending() == 0 {
                self.pause(Phase::Drain);
            }
            looks += 1;
            // Between two rounds it would be missing from the sums.
            if looks > 40 && self.random.once_in(60) && self.ledger.phase().1 == Phase::Run {
                self.cell.set(Word::State, 0);
                return Ok(());
            }
        }
    }

    fn wait(&self, subscription: &mut RawSubscription, way: Way) -> Result<(), Error> {
        if way != Way::Descriptor {
            return poll(&mut [subscription], Some(POLL)).map(|_| ());
        }
        if !subscription.updated() {
            let timeout = PollTimeout::try_from(POLL).expect("it is short");
            let mut ready = [PollFd::new(subscription.as_fd(), PollFlags::POLLIN)];
            let _ = nix::poll::poll(&mut ready, timeout);
        }
        subscription.check()
    }
}

/// The next message, if there is one.
fn next(subscription: &mut RawSubscription, way: Way) -> Option<Stamped> {
    if way == Way::Stream {
        return read(subscription.borrow_update()?);
    }
    let mut bytes = Vec::new();
    let copied = subscription.updated() && subscription.copy(&mut bytes);
    copied.then(|| read(&bytes)).flatten()
}
