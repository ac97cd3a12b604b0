//! What is in a log when its recorder is killed, when the disk is slow or full,
//! and when the recorder itself is.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use nix::sys::ptrace;
use nix::sys::signal::Signal;
use nix::sys::wait::{WaitPidFlag, waitpid};
use nix::unistd::Pid;
use uorb_core::Instance;
use uorb_core::Publication;
use uorb_core::broker_side::{Node, Role};
use uorb_tests::{Actor, Bus, Plain, Stamped, eventually, program};

use crate::log_readers::{
    by_px4_ulog, by_pyulog, by_yule_log, count_by_pyulog, read_by_all, records,
};
use crate::recording::{Recording, Summary, has, values};

/// Some number.
fn random(below: u64) -> u64 {
    use std::hash::{BuildHasher, RandomState};
    RandomState::new().hash_one(0) % below
}

/// The count in a message of `stamped`, behind the timestamp that it has not.
fn count(message: &[u8]) -> u64 {
    u64::from_le_bytes(message[8..16].try_into().unwrap())
}

/// $UORB_KILLS times: 20, where nobody says otherwise.
#[test]
fn a_recorder_that_is_killed_leaves_all_that_it_had_written() {
    let kills = std::env::var("UORB_KILLS").map_or(20, |kills| kills.parse().expect("a number"));
    let mut bus = Bus::start();
    let mut stamped = bus.advertise::<Stamped>();
    let mut published = Vec::new();
    let mut publish = |published: &mut Vec<Instant>| {
        published.push(Instant::now());
        stamped.publish(&Stamped::new(published.len() as u64, 7)).unwrap();
    };
    let (mut logs, mut ends, mut oldest_lost) = (Vec::new(), Vec::new(), Duration::ZERO);
    for round in 0..kills {
        publish(&mut published);
        let first = published.len() as u64;
        let Recording { mut recorder, path } =
            Recording::begin(&bus, &format!("killed{round}.ulg"), &["--quiet"]);
        // What is published comes into the file by itself, without another word.
        let mut flushed = first;
        let contents = |path: &Path| fs::read(path).unwrap();
        for _ in 0..random(3) {
            let marked = Stamped::new(published.len() as u64, 7).check[0].to_le_bytes();
            eventually("it is written", || contents(&path).windows(8).any(|it| it == marked));
            flushed = published.len() as u64;
            (0..random(200)).for_each(|_| publish(&mut published));
        }
        let until = Instant::now() + Duration::from_micros(random(400_000));
        while Instant::now() < until {
            publish(&mut published);
            std::thread::sleep(Duration::from_micros(500));
        }
        recorder.kill();
        let killed = Instant::now();

        // What the kernel has of it is what counts.
        let bytes = contents(&path);
        let written = records(&bytes).iter().filter(|(kind, _)| *kind == 'D').count();
        let found = by_px4_ulog(&path);
        let counts: Vec<_> = found.of("stamped").iter().map(|it| count(it)).collect();
        assert_eq!((counts.len(), found.count()), (written, written), "round {round}");
        if let (Some(begun), Some(&newest)) = (counts.first(), counts.last()) {
            assert!((first..=newest).contains(begun), "round {round}");
            assert!(counts.iter().copied().eq(*begun..=newest), "round {round}: a hole");
            assert!(newest >= flushed, "round {round}: {newest} of {flushed}");
            let lost = published.get(newest as usize);
            let age = lost.map_or(Duration::ZERO, |published| killed - *published);
            oldest_lost = oldest_lost.max(age);
        } else {
            assert_eq!(flushed, first, "round {round}");
        }
        // yule_log fills a message that is cut off with zeros, and counts it.
        let more = by_yule_log(&path).count() - written;
        assert!(more <= usize::from(!found.is_whole), "round {round}: {more} more");
        logs.push(path);
        ends.push(written);
    }
    let theirs = by_pyulog(&logs);
    for (round, found) in theirs.iter().flatten().enumerate() {
        assert_eq!(count_by_pyulog(found), ends[round], "round {round}: {found}");
    }
    eprintln!(
        "{kills} kills, {} messages in the logs; the oldest lost one was {oldest_lost:?} old",
        ends.iter().sum::<usize>()
    );
}

/// The thread of a recorder that writes, held up as by a disk that does not
/// answer: the rest of the process goes on.
struct Stalled {
    thread: Pid,
}

impl Stalled {
    fn stall(recorder: &Actor) -> Self {
        let tasks = fs::read_dir(format!("/proc/{}/task", recorder.pid())).unwrap().flatten();
        let is_writer = |task: &PathBuf| {
            fs::read_to_string(task.join("comm")).is_ok_and(|name| name == "log_writer\n")
        };
        let task = tasks.map(|task| task.path()).find(is_writer).expect("it has a writer");
        let thread = task.file_name().unwrap().to_str().unwrap().parse().unwrap();
        let thread = Pid::from_raw(thread);
        ptrace::seize(thread, ptrace::Options::empty()).expect("a child can be traced");
        ptrace::interrupt(thread).expect("it is traced");
        waitpid(thread, Some(WaitPidFlag::__WALL)).expect("it stops");
        Self { thread }
    }

    fn go_on(self) {
        ptrace::detach(self.thread, None).expect("it is stopped");
    }
}

/// Publishes so many, no faster than the recorder takes them.
fn publish_for(bus: &Bus, stamped: &mut Publication<Stamped>, counts: std::ops::Range<u64>) {
    let node = Node::open(&bus.system, "stamped", Instance::FIRST, Role::Observer).unwrap();
    for count in counts {
        stamped.publish(&Stamped::new(count, 7)).unwrap();
        if count % 200 == 0 {
            eventually("it takes them", || node.streams().iter().all(|it| it.pending == 0));
        }
    }
    eventually("it takes them", || node.streams().iter().all(|it| it.pending == 0));
}

#[test]
fn what_a_slow_disk_does_not_take_is_a_dropout_of_the_right_length() {
    const LAST: u64 = 9_001;
    let mut bus = Bus::start();
    let mut stamped = bus.advertise::<Stamped>();
    stamped.publish(&Stamped::new(0, 7)).unwrap();
    let recording = Recording::begin(&bus, "slow.ulg", &["--buffer", "1"]);
    let is_written = |count: u64| {
        let check = Stamped::new(count, 7).check[0].to_le_bytes();
        fs::read(&recording.path).unwrap().windows(8).any(|bytes| bytes == check)
    };
    eventually("it is followed", || is_written(0) || fs::read(&recording.path).unwrap().len() > 0);
    publish_for(&bus, &mut stamped, 1..2);
    eventually("it is written", || is_written(1));

    let began = Instant::now();
    let stalled = Stalled::stall(&recording.recorder);
    // More than a MiB.
    publish_for(&bus, &mut stamped, 2..LAST);
    let full = Instant::now();
    while full.elapsed() < Duration::from_millis(300) {
        std::thread::yield_now();
    }
    let least = full.elapsed();
    stalled.go_on();
    eventually("it goes on", || {
        stamped.publish(&Stamped::new(LAST, 7)).unwrap();
        is_written(LAST)
    });
    let most = began.elapsed();
    let (found, summary) = recording.end();

    let counts: Vec<_> = found.of("stamped").iter().map(|it| count(it)).collect();
    let until = counts.partition_point(|count| *count < LAST);
    assert!(counts[..until].iter().copied().eq(0..until as u64), "{counts:?}");
    // Those that came again and again until one was there may be lost too.
    assert!(summary.lost >= LAST - until as u64 && summary.lost > 4_000, "{summary:?}");
    assert_eq!((summary.messages as usize, summary.dropouts), (counts.len(), 1));
    let [dropout_ms] = found.dropouts_ms[..] else { panic!("{:?}", found.dropouts_ms) };
    let dropout = Duration::from_millis(dropout_ms.into());
    assert!((least..=most).contains(&(dropout + Duration::from_millis(1))), "{dropout:?}");
}

#[test]
fn what_overruns_a_recorder_that_is_stopped_is_a_dropout() {
    const FIRST: u32 = 0xfeed_beef;
    let mut bus = Bus::start();
    let mut plain = bus.advertise::<Plain>();
    plain.publish(&Plain { value: FIRST }).unwrap();
    let recording = Recording::begin(&bus, "overrun.ulg", &[]);
    eventually("it is followed", || has(&recording.path, FIRST));
    recording.recorder.stop();
    for value in 0..3_000 {
        plain.publish(&Plain { value }).unwrap();
    }
    recording.recorder.signal(Signal::SIGCONT);
    eventually("it goes on", || has(&recording.path, 2_999));
    let (found, summary) = recording.end();

    assert_eq!(summary.messages + summary.lost, 3_001);
    assert!(summary.lost > 1_900, "{summary:?}");
    assert_eq!((summary.dropouts, found.dropouts_ms.len()), (1, 1));
    let values = values(&found.of("plain")[1..]);
    assert!(values.is_sorted() && values.ends_with(&[2_998, 2_999]));
}

#[test]
fn on_a_full_disk_a_recorder_says_so_and_leaves_what_can_be_read() {
    let mut bus = Bus::start();
    let (small, kept) = (bus.system.base().join("small"), bus.system.base().join("kept.ulg"));
    fs::create_dir(&small).unwrap();
    let script = r#"mount -t tmpfs -o size=256k tmpfs "$1" || exit 77
        echo mounted
        "$2" record -o "$1/full.ulg"
        code=$?
        cp "$1/full.ulg" "$3"
        exit $code"#;
    let mut command = bus.command(Path::new("unshare"));
    command.args(["--mount", "sh", "-c", script, "sh"]).args([&small, &program("uorb"), &kept]);
    command.stderr(std::process::Stdio::piped());
    let is_there = Command::new("unshare").args(["--mount", "true"]).output();
    if !is_there.is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: no mount namespace can be made here");
        return;
    }
    let mut recorder = Actor::spawn(command);
    recorder.expect("mounted");
    let mut stamped = bus.advertise::<Stamped>();
    let mut published = 0;
    // It ends by itself, and then its copy is there.
    eventually("it is full", || {
        stamped.publish(&Stamped::new(published, 7)).unwrap();
        published += 1;
        std::thread::sleep(Duration::from_micros(100));
        kept.exists()
    });
    let ended = recorder.end();
    assert_eq!(ended.code, 1, "{}", ended.words);
    for word in ["cannot write", "small/full.ulg", "free some space, or record elsewhere with -o"] {
        assert!(ended.words.contains(word), "{}", ended.words);
    }
    let found = by_px4_ulog(&kept);
    let counts: Vec<_> = found.of("stamped").iter().map(|it| count(it)).collect();
    assert!(counts.len() > 100, "{}", counts.len());
    assert!(counts.iter().copied().eq(counts[0]..=*counts.last().unwrap()));
    for theirs in by_pyulog(&[kept]).iter().flatten() {
        assert_eq!(count_by_pyulog(theirs), counts.len());
    }
}

#[test]
fn a_recorder_outlives_the_broker() {
    let mut bus = Bus::start();
    let mut plain = bus.advertise::<Plain>();
    plain.publish(&Plain { value: 0xfeed_beef }).unwrap();
    let recording = Recording::begin(&bus, "broker.ulg", &[]);
    eventually("it is followed", || has(&recording.path, 0xfeed_beef));
    bus.kill_broker();
    (0..100).for_each(|value| _ = plain.publish(&Plain { value }).unwrap());
    eventually("it goes on", || has(&recording.path, 99));
    bus.start_broker();
    let mut stamped = bus.advertise::<Stamped>();
    stamped.publish(&Stamped::new(0xfeed_feed, 7)).unwrap();
    eventually("it finds what is new", || has(&recording.path, 0xfeed_feed));
    let path = recording.path.clone();
    let (_, summary) = recording.end();
    assert_eq!(summary, Summary { messages: 102, lost: 0, dropouts: 0 });
    assert_eq!(read_by_all(&path).of("plain").len(), 101);
}
