//! A process of a story: it does one thing on the bus, and says so in lines.
//!
//! The story speaks to it by lines too: `go` starts what waits, the end of the
//! input ends it. An actor dies with the test that spawned it.

use std::alloc::{GlobalAlloc, Layout, System as SystemAllocator};
use std::cell::Cell;
use std::fs::File;
use std::io::{BufRead, BufReader, Write, stdin};
use std::os::fd::AsFd;
use std::path::Path;
use std::process::{Command, ExitCode, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use nix::mount::{MsFlags, mount};
use nix::poll::{PollFd, PollFlags, PollTimeout};
use uorb_core::{
    AdvertiseOptions, Claim, Error, Instance, Layout as MessageLayout, Metadata, Priority,
    Publication, QueueLength, RawPublication, RawSubscription, Session, StreamSubscription,
    Subscription, System, poll, topic,
};
use uorb_msg::SensorAccel;
use uorb_tests::{PATIENCE, Plain, Stamped, heard, number, program, raise_descriptor_limit};

fn main() -> ExitCode {
    nix::sys::prctl::set_pdeathsig(nix::sys::signal::Signal::SIGKILL).expect("Linux has it");
    raise_descriptor_limit();
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = match &arguments[..] {
        ["publish", count, queue] => publish(number(count), number(queue) as u32),
        ["publish-for-ever", queue] => publish_for_ever(number(queue) as u32),
        ["follow"] => follow(false),
        ["follow-by-descriptor"] => follow(true),
        ["claim", priority] => claim(number(priority) as u8),
        ["hold-other-layout"] => hold_other_layout(),
        ["follow-name", topic] => follow_name(topic),
        ["hold-plain-descriptor"] => hold_plain_descriptor(),
        ["few-descriptors"] => few_descriptors(),
        ["fork-and-hold"] => fork_and_hold(),
        ["fork-and-drop"] => fork_and_drop(),
        ["wait-and-hold", count] => wait_and_hold(number(count)),
        ["hold-and-drop", count] => hold_and_drop(number(count)),
        ["hot-path"] => hot_path(),
        ["wait-between-marks"] => wait_between_marks(),
        ["hot-path-of-a-stream"] => hot_path_of_a_stream(),
        ["publish-accel"] => publish_accel(),
        ["fill-small-memory"] => fill_small_memory(),
        ["write-into-the-ring"] => write_into_the_ring(),
        ["little-address-space"] => little_address_space(),
        other => panic!("no such actor: {other:?}"),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        // Part of some stories: they want to know which.
        Err(error) => {
            println!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn advertise(session: &Session, queue: u32) -> Result<Publication<Stamped>, Error> {
    let queue_length = QueueLength::new(queue);
    let options = AdvertiseOptions { queue_length, ..AdvertiseOptions::default() };
    Publication::advertise_with(session, options)
}

/// Publishes a number of messages flat out, from `go` on.
fn publish(count: u64, queue: u32) -> Result<(), Error> {
    let session = Session::connect()?;
    let mut stamped = advertise(&session, queue)?;
    println!("advertised");
    heard();
    let sender = std::process::id().into();
    for count in 0..count {
        stamped.publish(&Stamped::new(count, sender))?;
    }
    println!("published");
    heard();
    Ok(())
}

/// Publishes until it is killed, or its input ends.
fn publish_for_ever(queue: u32) -> Result<(), Error> {
    let session = Session::connect()?;
    let mut stamped = advertise(&session, queue)?;
    println!("advertised");
    let input = stdin();
    let sender = std::process::id().into();
    for count in 0.. {
        stamped.publish(&Stamped::new(count, sender))?;
        if count % 1_000 == 0 {
            let mut ready = [PollFd::new(input.as_fd(), PollFlags::POLLIN)];
            if nix::poll::poll(&mut ready, PollTimeout::ZERO).is_ok_and(|ready| ready > 0) {
                println!("published {}", count + 1);
                break;
            }
        }
    }
    Ok(())
}

/// Copies until its input has said something and all is copied, and checks
/// every message: whole, and of a later generation than the one before.
fn follow(by_descriptor: bool) -> Result<(), Error> {
    let session = Session::connect()?;
    let mut stamped = Subscription::<Stamped>::subscribe(&session)?;
    if by_descriptor {
        stamped.open_descriptor()?;
    }
    println!("subscribed");
    let (mut copied, mut torn, mut out_of_order) = (0_u64, 0_u64, 0_u64);
    let mut generation = None;
    let input = stdin();
    let mut over = false;
    loop {
        // The story says that all is published before it says so to us.
        let mut ready = [
            PollFd::new(input.as_fd(), PollFlags::POLLIN),
            PollFd::new(stamped.as_fd(), PollFlags::POLLIN),
        ];
        if by_descriptor && !over {
            let _ = nix::poll::poll(&mut ready, PollTimeout::NONE);
        } else {
            let _ = nix::poll::poll(&mut ready[..1], PollTimeout::ZERO);
        }
        over = over || ready[0].any() == Some(true);
        if !by_descriptor && !over {
            poll(&mut [&mut stamped], Some(Duration::from_millis(100)))?;
        }
        while let Some(message) = stamped.update() {
            let copy = stamped.last_copied().expect("just copied").generation;
            copied += 1;
            torn += u64::from(!message.is_whole());
            let first = generation.is_none_or(|last| (1..1 << 31).contains(&copy.since(last)));
            out_of_order += u64::from(!first);
            generation = Some(copy);
        }
        if over {
            break;
        }
    }
    let (lost, pending) = (stamped.lost(), stamped.pending());
    println!("copied {copied} lost {lost} pending {pending} torn {torn} disorder {out_of_order}");
    Ok(())
}

/// Claims an instance at `go`, says which, and holds it.
fn claim(priority: u8) -> Result<(), Error> {
    let session = Session::connect()?;
    println!("ready");
    heard();
    let options = AdvertiseOptions {
        claim: Claim::Lowest,
        priority: Priority(priority),
        ..AdvertiseOptions::default()
    };
    let mut stamped = Publication::<Stamped>::advertise_with(&session, options)?;
    println!("instance {}", stamped.instance());
    while let Some(line) = heard() {
        let count = line.trim().parse().unwrap_or(0);
        stamped.publish(&Stamped::new(count, std::process::id().into()))?;
        println!("published");
    }
    Ok(())
}

topic! {
    /// Topic `stamped` as a program has it that was built from other text.
    pub struct OtherStamped = "stamped" { pub other: u64 }
}

/// Subscribes to a topic by another layout than the stories have.
fn hold_other_layout() -> Result<(), Error> {
    let session = Session::connect()?;
    let _other = Subscription::<OtherStamped>::subscribe(&session)?;
    println!("subscribed");
    heard();
    Ok(())
}

/// Follows a topic that it knows by name only, and says what it copies.
fn follow_name(topic: &str) -> Result<(), Error> {
    let session = Session::connect()?;
    let mut subscription = RawSubscription::subscribe(&session, topic, Instance::FIRST)?;
    println!("subscribed");
    loop {
        poll(&mut [&mut subscription], None)?;
        let mut message = Vec::new();
        while subscription.updated() && subscription.copy(&mut message) {
            println!("{} bytes", message.len());
        }
    }
}

/// Opens the descriptor of a subscription to `plain`.
fn hold_plain_descriptor() -> Result<(), Error> {
    let session = Session::connect()?;
    let plain = Subscription::<Plain>::subscribe(&session)?;
    plain.open_descriptor()?;
    println!("open");
    heard();
    Ok(())
}

/// Runs out of descriptors, twice: where a subscription asks for its own, and
/// where a topic that it waited for is there.
fn few_descriptors() -> Result<(), Error> {
    use nix::sys::resource::{Resource, getrlimit, setrlimit};
    let (_, hard) = getrlimit(Resource::RLIMIT_NOFILE).expect("there is a limit");
    let limit = |soft| setrlimit(Resource::RLIMIT_NOFILE, soft, hard).expect("up to the hard one");
    let session = Session::connect()?;
    let subscriptions: Vec<_> =
        (0..100).filter_map(|_| Subscription::<Stamped>::subscribe(&session).ok()).collect();
    limit(64);
    let refused = subscriptions.iter().find_map(|one| one.open_descriptor().err());
    println!("{}", refused.expect("sixty-four are not enough"));
    limit(hard);

    let mut waiting = RawSubscription::subscribe(&session, "plain", Instance::FIRST)?;
    poll(&mut [&mut waiting], Some(Duration::ZERO))?;
    Publication::<Plain>::advertise(&session)?.publish(&Plain { value: 1 })?;
    limit(3);
    let refused = poll(&mut [&mut waiting], Some(PATIENCE));
    limit(hard);
    println!("{}", refused.expect_err("it cannot be followed"));
    assert_eq!(poll(&mut [&mut waiting], Some(PATIENCE))?, 1);
    println!("followed at last");
    Ok(())
}

/// Advertises, forks, and lets parent and child live until they are killed. The
/// child says what its handles say.
fn fork_and_hold() -> Result<(), Error> {
    let session = Session::connect()?;
    let mut stamped = Publication::<Stamped>::advertise(&session)?;
    let mut followed = Subscription::<Stamped>::subscribe(&session)?;
    stamped.publish(&Stamped::new(7, 1))?;
    // SAFETY: the child does nothing that needs the threads it does not have:
    // the library's handles are made for this, and printing takes a lock that
    // nobody holds.
    #[allow(unsafe_code)]
    let fork = unsafe { nix::unistd::fork() };
    if fork.expect("a process more").is_child() {
        // With the story, not with the parent.
        let forked = |result: Result<(), Error>| matches!(result, Err(Error::Forked));
        let publish = forked(stamped.publish(&Stamped::new(8, 1)).map(|_| ()));
        let advertise = forked(Publication::<Stamped>::advertise(&session).map(|_| ()));
        let subscribe = forked(Subscription::<Stamped>::subscribe(&session).map(|_| ()));
        let copies = followed.updated() && followed.copy().is_some_and(|copy| copy.count == 7);
        let wait = forked(poll(&mut [&mut followed], Some(Duration::ZERO)).map(|_| ()));
        println!("child {publish} {advertise} {subscribe} {copies} {wait}");
        println!("{}", std::process::id());
    }
    heard();
    Ok(())
}

/// Forks; the child copies, drops all it has inherited, and ends. Then the
/// parent goes on with what it has.
fn fork_and_drop() -> Result<(), Error> {
    let session = Session::connect()?;
    let mut stamped = Publication::<Stamped>::advertise(&session)?;
    let mut followed = Subscription::<Stamped>::subscribe(&session)?;
    followed.open_descriptor()?;
    stamped.publish(&Stamped::new(7, 1))?;
    // SAFETY: as in `fork_and_hold`.
    #[allow(unsafe_code)]
    let fork = unsafe { nix::unistd::fork() };
    match fork.expect("a process more") {
        nix::unistd::ForkResult::Child => {
            assert!(followed.updated() && followed.copy().is_some());
            drop((stamped, followed, session));
            std::process::exit(0);
        }
        nix::unistd::ForkResult::Parent { child } => {
            nix::sys::wait::waitpid(child, None).expect("our child ends");
        }
    }
    let mut ready = [PollFd::new(followed.as_fd(), PollFlags::POLLIN)];
    let readable = nix::poll::poll(&mut ready, PollTimeout::ZERO).expect("poll(2) works") == 1;
    let copied = followed.update().is_some();
    let advertised = Publication::<OtherStamped>::advertise(&session).is_err_and(|error| {
        // Of another layout, which only the broker can know.
        matches!(error, Error::LayoutMismatch(_))
    });
    println!("readable {readable} copied {copied} answered {advertised}");
    Ok(())
}

/// Waits for topic `plain` by name, with so many other subscriptions to name
/// again after a broker's restart.
fn wait_and_hold(count: u64) -> Result<(), Error> {
    let session = Session::connect()?;
    let mut waiting = RawSubscription::subscribe(&session, "plain", Instance::FIRST)?;
    let _others = (0..count)
        .map(|_| Subscription::<Stamped>::subscribe(&session))
        .collect::<Result<Vec<_>, _>>()?;
    println!("subscribed");
    while poll(&mut [&mut waiting], Some(PATIENCE))? == 0 {}
    println!("described");
    heard();
    Ok(())
}

/// Advertises, and holds so many subscriptions that wait for a topic. At `go`
/// it drops its publication.
fn hold_and_drop(count: u64) -> Result<(), Error> {
    let session = Session::connect()?;
    let stamped = Publication::<Stamped>::advertise(&session)?;
    let _waiting = (0..count)
        .map(|_| RawSubscription::subscribe(&session, "plain", Instance::FIRST))
        .collect::<Result<Vec<_>, _>>()?;
    println!("ready");
    heard();
    drop(stamped);
    println!("dropped");
    heard();
    Ok(())
}

/// Publishes an acceleration each millisecond until its input ends. Those of no
/// interest have number 0. Where it hears a number, so many of the next are
/// numbered from 1; where it hears `marks` and a number, it publishes so many
/// flat out between two marks that a tracer can see.
fn publish_accel() -> Result<(), Error> {
    const PERIOD: Duration = Duration::from_millis(1);
    let session = Session::connect()?;
    let mut publication = Publication::<SensorAccel>::advertise(&session)?;
    println!("advertised");
    let (mut next, mut last) = (1, 0);
    let mut due = Instant::now();
    let input = stdin();
    loop {
        due += PERIOD;
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        let this = if next <= last { next } else { 0 };
        next += u64::from(this > 0);
        publication.publish(&accel(this))?;
        if this > 0 && this == last {
            println!("published {last}");
        }
        let mut ready = [PollFd::new(input.as_fd(), PollFlags::POLLIN)];
        if nix::poll::poll(&mut ready, PollTimeout::ZERO).is_ok_and(|ready| ready == 0) {
            continue;
        }
        let Some(line) = heard() else { return Ok(()) };
        match line.trim().split_once(' ') {
            None => (next, last) = (1, number(line.trim())),
            Some((_, count)) => {
                nix::unistd::getppid();
                for _ in 0..number(count) {
                    publication.publish(&accel(0))?;
                }
                nix::unistd::getppid();
            }
        }
    }
}

/// The message of this number. All of it but the time follows from the number,
/// so that a torn message cannot look whole; `tests/foreign/actor.py` knows it.
fn accel(number: u64) -> SensorAccel {
    let float = |i: u64| ((number * 31 + i * 7_919) % (1 << 20)) as f32;
    let raw = |i: u64| ((number * 3 + i * 101) % (1 << 15)) as i16;
    SensorAccel {
        timestamp: uorb_core::now_us(),
        integral_dt: number.wrapping_mul(0x9e37_79b9_7f4a_7c15),
        error_count: number,
        x: float(0),
        y: float(1),
        z: float(2),
        x_integral: float(3),
        y_integral: float(4),
        z_integral: float(5),
        temperature: float(6),
        range_m_s2: float(7),
        scaling: float(8),
        device_id: number.wrapping_mul(2_654_435_761) as u32,
        x_raw: raw(0),
        y_raw: raw(1),
        z_raw: raw(2),
        temperature_raw: raw(3),
    }
}

/// Counts what is allocated, for `hot-path`.
struct CountingAllocator;

static ALLOCATIONS: AtomicU64 = AtomicU64::new(0);

thread_local! {
    /// Whether this thread's count: what the session's thread has to do for a
    /// newcomer is not on the hot path.
    static IS_COUNTED: Cell<bool> = const { Cell::new(false) };
}

// SAFETY: everything is left to the system's allocator.
#[allow(unsafe_code)]
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(u64::from(IS_COUNTED.get()), Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { SystemAllocator.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { SystemAllocator.dealloc(memory, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Waits a hundred times, between two marks, for what another thread publishes
/// as soon as it does.
fn wait_between_marks() -> Result<(), Error> {
    let session = Session::connect()?;
    let mut stamped = Publication::<Stamped>::advertise(&session)?;
    let mut subscription = Subscription::<Stamped>::subscribe(&session)?;
    // What a process before this one has published last.
    subscription.copy();
    let waits = Arc::new(AtomicU64::new(0));
    let waited = waits.clone();
    let publisher = thread::spawn(move || {
        for count in 0..100 {
            while waited.load(Ordering::Acquire) == count {
                thread::yield_now();
            }
            stamped.publish(&Stamped::new(count, 1)).expect("the system has not ended");
        }
    });
    println!("ready");
    heard();
    nix::unistd::getppid();
    for count in 0..100 {
        waits.store(count + 1, Ordering::Release);
        assert_eq!(poll(&mut [&mut subscription], None)?, 1);
        assert_eq!(subscription.copy().map(|message| message.count), Some(count));
    }
    nix::unistd::getppid();
    publisher.join().expect("it did not panic");
    Ok(())
}

/// Publishes, looks and copies between two marks that a tracer can see: two
/// calls of getppid(2). Says how much it allocated in between.
fn hot_path() -> Result<(), Error> {
    let session = Session::connect()?;
    let mut stamped = Publication::<Stamped>::advertise(&session)?;
    let mut subscription = Subscription::<Stamped>::subscribe(&session)?;
    let mut message = Stamped::new(0, 0);
    let mut round = |count: u64| -> Result<(), Error> {
        stamped.publish(&Stamped::new(count, 1))?;
        assert!(subscription.updated() && subscription.copy_into(&mut message));
        assert!(!subscription.updated() && subscription.copy().is_some());
        Ok(())
    };
    round(0)?;
    println!("ready");
    heard();
    IS_COUNTED.set(true);
    let before = ALLOCATIONS.load(Ordering::Relaxed);
    nix::unistd::getppid();
    for count in 1..=1_000 {
        round(count)?;
    }
    nix::unistd::getppid();
    println!("allocations {}", ALLOCATIONS.load(Ordering::Relaxed) - before);
    Ok(())
}

/// Publishes while a thread begins to follow the stream, then to that follower;
/// the marks are as in `hot_path`, around each of the two.
fn hot_path_of_a_stream() -> Result<(), Error> {
    let session = Session::connect()?;
    let mut stamped = Publication::<Stamped>::advertise(&session)?;
    let message = Stamped::new(0, 1);
    stamped.publish(&message)?;
    let may_join = AtomicBool::new(false);
    std::thread::scope(|threads| {
        let follower = threads.spawn(|| {
            while !may_join.load(Ordering::Relaxed) {
                std::thread::yield_now();
            }
            StreamSubscription::<Stamped>::subscribe(&session)
        });
        println!("ready");
        heard();
        nix::unistd::getppid();
        may_join.store(true, Ordering::Relaxed);
        while !follower.is_finished() {
            stamped.publish(&message)?;
        }
        stamped.publish(&message)?;
        nix::unistd::getppid();
        let mut follower = follower.join().expect("it does not panic")?;
        while follower.update().is_some() {}
        // What its first message from a port makes it note, it notes once.
        stamped.publish(&message)?;
        assert!(follower.update().is_some());
        println!("joined");
        heard();
        IS_COUNTED.set(true);
        let before = ALLOCATIONS.load(Ordering::Relaxed);
        nix::unistd::getppid();
        for _ in 0..1_000 {
            stamped.publish(&message)?;
            assert!(follower.update().is_some_and(Stamped::is_whole));
        }
        nix::unistd::getppid();
        println!("allocations {}", ALLOCATIONS.load(Ordering::Relaxed) - before);
        Ok(())
    })
}

/// In a mount namespace of its own, with 64 MiB of memory for the bus: makes
/// topics until they do not fit, and publishes on all that did.
fn fill_small_memory() -> Result<(), Error> {
    use nix::sched::{CloneFlags, unshare};
    let system = System::from_env()?;
    let none: Option<&str> = None;
    let private = unshare(CloneFlags::CLONE_NEWNS)
        .and_then(|()| mount(none, "/", none, MsFlags::MS_REC | MsFlags::MS_PRIVATE, none))
        .and_then(|()| {
            mount(Some("tmpfs"), system.base(), Some("tmpfs"), MsFlags::empty(), Some("size=64m"))
        });
    if let Err(errno) = private {
        println!("skipped: no mount namespace can be made here: {errno}");
        return Ok(());
    }
    let mut broker = Command::new(program("uorbd"))
        .args(["--ready-fd", "1"])
        .stdout(Stdio::piped())
        .spawn()
        .expect("uorbd starts");
    let mut line = String::new();
    let stdout = broker.stdout.as_mut().expect("piped");
    BufReader::new(stdout).read_line(&mut line).expect("a line");
    let filled = fill(&system);
    broker.kill().expect("it can be killed");
    broker.wait().expect("it is our child");
    assert_eq!(line, "ready\n");
    filled
}

fn fill(system: &System) -> Result<(), Error> {
    let session = Session::connect()?;
    let mut publications = Vec::new();
    let refused = loop {
        let name = format!("large{}", publications.len());
        let metadata = Metadata {
            layout: std::borrow::Cow::Owned(MessageLayout::untyped(name.clone(), 65_528)),
            name: name.into(),
            queue_length: QueueLength::ONE,
        };
        match RawPublication::advertise(&session, &metadata, AdvertiseOptions::default()) {
            Ok(publication) => publications.push(publication),
            Err(error) => break error,
        }
    };
    println!("{refused}");
    for publication in &mut publications {
        for _ in 0..100 {
            publication.publish(&[7; 65_528])?;
        }
    }
    // What did not fit has left nothing behind, and a small topic still fits.
    let unfinished = std::fs::read_dir(system.unfinished()).expect("it is there").count();
    drop(Publication::<Stamped>::advertise(&session));
    println!("{} topics, {unfinished} unfinished", publications.len());
    // A broker that starts, in memory of its own that nobody else gives back.
    let other = system.base().join("other");
    std::fs::create_dir(&other).expect("a new directory");
    mount(Some("tmpfs"), &other, Some("tmpfs"), MsFlags::empty(), Some("size=64k"))
        .expect("as the first one");
    fill_to_the_brim(&other);
    let start = format!("--dir {} start", other.display());
    for command in ["status", "listener large0 1", "pub large0", "pub orb_test val=1", &start] {
        // Whoever has ended may have given some back.
        fill_to_the_brim(system.base());
        let uorb = Command::new(program("uorb")).args(command.split(' ')).output();
        let Output { status, stdout, stderr } = uorb.expect("it runs");
        let said = [stdout, stderr].concat();
        let said = String::from_utf8_lossy(&said).replace('\n', " ");
        let said = &said[..said.floor_char_boundary(400)];
        let name = if command == start { "start" } else { command };
        println!("{name}: {} {said}", status.code().expect("it was not killed"));
    }
    let left = std::fs::read_dir(&other).expect("it is there").flatten();
    let left: Vec<_> = left.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    println!("left: {}.", left.join(" "));
    Ok(())
}

/// Follows, and then writes into the ring, which subscribers may only read.
fn write_into_the_ring() -> Result<(), Error> {
    let session = Session::connect()?;
    let mut stamped = Subscription::<Stamped>::subscribe(&session)?;
    stamped.copy();
    let maps = std::fs::read_to_string("/proc/self/maps").expect("proc is mounted");
    let largest = maps.lines().filter(|line| line.contains("/obj/stamped0")).filter_map(|line| {
        let (start, end) = line.split(' ').next()?.split_once('-')?;
        let parse = |digits| usize::from_str_radix(digits, 16).ok();
        Some((parse(end)? - parse(start)?, parse(start)?))
    });
    let (_, ring) = largest.max().expect("the ring is mapped");
    println!("writes");
    // SAFETY: there is a mapping at this address. That it may not be written is
    // what the story is about.
    #[allow(unsafe_code)]
    unsafe {
        std::ptr::write_volatile(ring as *mut u64, 0);
    }
    println!("has written");
    Ok(())
}

/// Uses the bus while mmap(2) says ENOMEM, and again when it does not.
fn little_address_space() -> Result<(), Error> {
    use nix::sys::resource::{Resource, getrlimit, setrlimit};
    /// What the heap may still take: the queue below takes 17 MiB.
    const ROOM: u64 = 8 << 20;
    let session = Session::connect()?;
    // An answer: the session's thread has begun. Rust aborts a process that cannot
    // give a new thread its signal stack.
    session.process(session.peer())?;
    let metadata = Metadata {
        layout: std::borrow::Cow::Owned(MessageLayout::untyped("wide".to_string(), 65_528)),
        name: "wide".into(),
        queue_length: QueueLength::new(128).expect("a power of two"),
    };
    let (_, hard) = getrlimit(Resource::RLIMIT_AS).expect("there is a limit");
    let statm = std::fs::read_to_string("/proc/self/statm").expect("proc is mounted");
    let pages: u64 = statm.split(' ').next().expect("the first number").parse().expect("a number");
    setrlimit(Resource::RLIMIT_AS, pages * 4_096 + ROOM, hard).expect("below the hard one");
    let advertise = || RawPublication::advertise(&session, &metadata, AdvertiseOptions::default());
    println!("{}", advertise().expect_err("it does not fit"));
    let another = Session::connect_to(session.system()).map(|_| ());
    println!("another session: {another:?}");
    let mut plain = Publication::<Plain>::advertise(&session)?;
    plain.publish(&Plain { value: 7 })?;
    setrlimit(Resource::RLIMIT_AS, hard, hard).expect("up to the hard one");
    advertise()?.publish(&[7; 65_528])?;
    println!("published");
    Ok(())
}

/// Takes what memory there is left, to the last page.
fn fill_to_the_brim(dir: &Path) {
    let brim = File::options().create(true).append(true).open(dir.join("brim"));
    let mut brim = brim.expect("an empty file takes nothing");
    while brim.write_all(&[1; 4_096]).is_ok() {}
}
