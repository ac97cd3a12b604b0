//! A process of a story about streams: it sends or follows, and says what it
//! saw. As `actor.rs`, it is told by lines, and dies with its test.

use std::io::{BufRead, BufReader, stdin};
use std::os::fd::AsFd;
use std::process::{Command, ExitCode, Stdio};
use std::time::Duration;

use nix::poll::{PollFd, PollFlags, PollTimeout};
use uorb_core::{
    Error, Instance, Publication, Session, StreamOptions, StreamSubscription, System, poll,
};
use uorb_tests::{Image, PATIENCE, Plain, Stamped, heard, number, program};

fn main() -> ExitCode {
    nix::sys::prctl::set_pdeathsig(nix::sys::signal::Signal::SIGKILL).expect("Linux has it");
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = match &arguments[..] {
        ["publish", count] => publish(number(count), false),
        ["try-publish", count] => publish(number(count), true),
        ["try-publish-for-ever"] => try_publish_for_ever(),
        ["follow", depth] => follow(number(depth) as u32, false),
        ["follow-and-press", depth] => follow(number(depth) as u32, true),
        ["follow-blindly"] => follow_blindly(),
        ["publish-blindly"] => publish_blindly(),
        ["hold-image"] => Session::connect().and_then(|session| hold_image(&session)),
        ["hold-image-and-stamped"] => hold_image_and_stamped(),
        ["small-memory"] => small_memory(),
        other => panic!("no such streamer: {other:?}"),
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

/// Whether the story has said something.
fn is_told() -> bool {
    let input = stdin();
    let mut ready = [PollFd::new(input.as_fd(), PollFlags::POLLIN)];
    nix::poll::poll(&mut ready, PollTimeout::ZERO).is_ok_and(|ready| ready > 0)
}

/// Follows `plain`, with no descriptor left at a time when a publisher comes, and
/// says how much it has received and lost up to 100.
fn follow_blindly() -> Result<(), Error> {
    let session = Session::connect()?;
    let mut stream = StreamSubscription::<Plain>::subscribe(&session)?;
    let next = |stream: &mut StreamSubscription<Plain>| loop {
        if let Some(plain) = stream.update() {
            return plain.value;
        }
        poll(&mut [stream], Some(PATIENCE)).expect("it is followed");
    };
    println!("follows from {}", next(&mut stream));
    heard();
    let found = without_descriptors(|| next(&mut stream));
    println!("was blind at {found}");
    let mut received = 0;
    while next(&mut stream) < 100 {
        received += 1;
    }
    println!("{received} before 100, {} lost", stream.lost());
    Ok(())
}

/// Publishes `plain`, with no descriptor left at a time when a follower comes.
fn publish_blindly() -> Result<(), Error> {
    let session = Session::connect()?;
    let mut plain = Publication::<Plain>::advertise(&session)?;
    let mut publish = |value| plain.publish(&Plain { value });
    publish(0)?;
    without_descriptors(|| {
        println!("is blind");
        heard();
        publish(1)
    })?;
    println!("is blind no more");
    heard();
    // It tries again at the next message, as soon as the pause is over that has
    // grown while it was blind.
    std::thread::sleep(Duration::from_millis(5));
    (2..=100).try_for_each(|value| publish(value).map(|_| ()))?;
    heard();
    Ok(())
}

/// Does something while this process can open nothing.
fn without_descriptors<T>(work: impl FnOnce() -> T) -> T {
    use nix::sys::resource::{Resource, getrlimit, setrlimit};
    let (soft, hard) = getrlimit(Resource::RLIMIT_NOFILE).expect("there is a limit");
    let limit = |soft| setrlimit(Resource::RLIMIT_NOFILE, soft, hard).expect("up to the hard one");
    limit(3);
    let done = work();
    limit(soft);
    done
}

/// Publishes a number of messages flat out, from `go` on; where it tries, each
/// until nobody's queue is full.
fn publish(count: u64, tries: bool) -> Result<(), Error> {
    let session = Session::connect()?;
    let mut stamped = Publication::<Stamped>::advertise(&session)?;
    println!("advertised");
    heard();
    let sender = std::process::id().into();
    let mut refused = 0_u64;
    for count in 0..count {
        let message = Stamped::new(count, sender);
        if !tries {
            stamped.publish(&message)?;
            continue;
        }
        loop {
            match stamped.try_publish(&message) {
                Ok(_) => break,
                Err(Error::QueueFull { .. }) => {
                    refused += 1;
                    std::thread::yield_now();
                }
                Err(error) => return Err(error),
            }
        }
    }
    println!("published, refused {refused}");
    heard();
    Ok(())
}

/// Publishes until it is killed, as fast as everybody follows.
fn try_publish_for_ever() -> Result<(), Error> {
    let session = Session::connect()?;
    let mut stamped = Publication::<Stamped>::advertise(&session)?;
    println!("advertised");
    let sender = std::process::id().into();
    for count in 0.. {
        while let Err(error) = stamped.try_publish(&Stamped::new(count, sender)) {
            if !matches!(error, Error::QueueFull { .. }) {
                return Err(error);
            }
            std::thread::yield_now();
        }
    }
    Ok(())
}

/// Follows the stream until its input has said something and all is received,
/// and checks every message: whole, and of a later generation than the one
/// before.
fn follow(depth: u32, back_pressure: bool) -> Result<(), Error> {
    let session = Session::connect()?;
    let options = StreamOptions { depth: Some(depth), back_pressure };
    let mut stream =
        StreamSubscription::<Stamped>::subscribe_with(&session, Instance::FIRST, options)?;
    println!("subscribed");
    let (mut received, mut torn, mut out_of_order) = (0_u64, 0_u64, 0_u64);
    let mut generation = None;
    let mut over = false;
    loop {
        over = over || is_told();
        if !over {
            poll(&mut [&mut stream], Some(Duration::from_millis(100)))?;
        }
        while let Some(message) = stream.update() {
            let whole = message.is_whole();
            let this = stream.last_copied().expect("just received").generation;
            received += 1;
            torn += u64::from(!whole);
            let first = generation.is_none_or(|last| (1..1 << 31).contains(&this.since(last)));
            out_of_order += u64::from(!first);
            generation = Some(this);
        }
        if over && stream.pending() == 0 {
            break;
        }
    }
    let (lost, pending) = (stream.lost(), stream.pending());
    println!("copied {received} lost {lost} pending {pending} torn {torn} disorder {out_of_order}");
    Ok(())
}

/// Publishes one large message, and holds its publication until it is ended.
fn hold_image(session: &Session) -> Result<(), Error> {
    let mut image = Publication::<Image>::advertise(session)?;
    publish_image(&mut image, 7)?;
    println!("published");
    heard();
    Ok(())
}

/// The same, and before it a number of ordinary messages.
fn hold_image_and_stamped() -> Result<(), Error> {
    let session = Session::connect()?;
    let mut stamped = Publication::<Stamped>::advertise(&session)?;
    for count in 0..100 {
        stamped.publish(&Stamped::new(count, 0))?;
    }
    hold_image(&session)
}

fn publish_image(image: &mut Publication<Image>, count: u64) -> Result<(), Error> {
    let mut loan = image.loan()?;
    loan.count = count;
    loan.pixels.fill(count as u8);
    loan.publish().map(|_| ())
}

/// A /dev/shm of 64 MiB and a broker in it: large messages stream there, or are
/// refused, and nothing dies. Prints how that went.
fn small_memory() -> Result<(), Error> {
    use nix::mount::{MsFlags, mount};
    use nix::sched::{CloneFlags, unshare};
    let none: Option<&str> = None;
    let private = unshare(CloneFlags::CLONE_NEWNS)
        .and_then(|()| mount(none, "/", none, MsFlags::MS_REC | MsFlags::MS_PRIVATE, none))
        .and_then(|()| {
            mount(Some("tmpfs"), "/dev/shm", Some("tmpfs"), MsFlags::empty(), Some("size=64m"))
        });
    if let Err(errno) = private {
        println!("skipped: no mount namespace can be made here: {errno}");
        return Ok(());
    }
    let system = System::from_env()?;
    std::fs::create_dir_all(system.base()).expect("an empty /dev/shm");
    let mut broker = Command::new(program("uorbd"))
        .args(["--ready-fd", "1"])
        .stdout(Stdio::piped())
        .spawn()
        .expect("uorbd starts");
    let mut line = String::new();
    let stdout = broker.stdout.as_mut().expect("piped");
    BufReader::new(stdout).read_line(&mut line).expect("a line");
    assert_eq!(line, "ready\n");
    let streamed = stream_in_small_memory();
    broker.kill().expect("it can be killed");
    broker.wait().expect("it is our child");
    streamed
}

fn stream_in_small_memory() -> Result<(), Error> {
    let session = Session::connect()?;
    let mut image = Publication::<Image>::advertise(&session)?;
    let mut stream = StreamSubscription::<Image>::subscribe(&session)?;
    for count in 1..=100 {
        publish_image(&mut image, count)?;
        let seen = stream.update().expect("it has just been published");
        assert_eq!((seen.count, seen.pixels[0]), (count, count as u8));
    }
    println!("streamed");
    // Somebody else fills what is left.
    let filler = "/dev/shm/filler";
    let filled = std::fs::write(filler, vec![1; 64 << 20]);
    println!("filled: {}", filled.expect_err("64 MiB do not fit"));
    // The memory that it has is enough for one who keeps up.
    for count in 101..=200 {
        publish_image(&mut image, count)?;
        assert_eq!(stream.update().map(|seen| seen.count), Some(count));
    }
    println!("still streamed");
    // It is not for several that do not.
    let mut late = Vec::new();
    let refused = loop {
        let options = StreamOptions { depth: None, back_pressure: true };
        let follower =
            StreamSubscription::<Image>::subscribe_with(&session, Instance::FIRST, options);
        match follower {
            Ok(follower) => late.push(follower),
            Err(error) => break error,
        }
        if let Err(error) = (0..20).try_for_each(|count| publish_image(&mut image, count)) {
            break error;
        }
    };
    println!("refused: {refused}");
    std::fs::remove_file(filler).expect("it can be removed");
    publish_image(&mut image, 300)?;
    println!("published again");
    Ok(())
}
