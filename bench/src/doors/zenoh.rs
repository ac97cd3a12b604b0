//! zenoh with its shared memory: a session in each process, joined by a Unix
//! socket over which descriptors of the shared buffers go.

use std::fs;
use std::path::PathBuf;
use std::thread::sleep;
use std::time::Duration;

use uorb_core::System;
use uorb_tests::heard;
use zenoh::handlers::FifoChannelHandler;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::sample::Sample;
use zenoh::shm::{
    BlockOn, GarbageCollect, PosixShmProviderBackend, ShmProvider, ShmProviderBuilder,
};
use zenoh::{Config, Session, Wait};

use super::{Door, Side, WORDS};

/// A provider's memory, many times what is under way at once.
const POOL_BYTES: usize = 1 << 20;

/// A session that listens at the system, or joins the one that does.
pub fn session(system: &System, listens: bool) -> Session {
    let at = format!("[\"unixsock-stream/{}\"]", system.base().join("zenoh.sock").display());
    let mut config = Config::default();
    config.insert_json5("mode", "\"peer\"").expect("a mode");
    config.insert_json5("scouting/multicast/enabled", "false").expect("a switch");
    let (ours, others) = if listens { (&*at, "[]") } else { ("[]", &*at) };
    config.insert_json5("listen/endpoints", ours).expect("endpoints");
    config.insert_json5("connect/endpoints", others).expect("endpoints");
    zenoh::open(config).wait().expect("a session")
}

/// What zenoh has left in /dev/shm by now, where processes of this run are
/// killed; removed at its end.
pub struct Leftovers {
    others: Vec<PathBuf>,
}

impl Leftovers {
    pub fn of_others() -> Self {
        Self { others: Self::now() }
    }

    fn now() -> Vec<PathBuf> {
        let entries = fs::read_dir("/dev/shm").into_iter().flatten().flatten();
        let paths = entries.map(|entry| entry.path());
        paths.filter(|path| path.extension().is_some_and(|it| it == "zenoh")).collect()
    }
}

impl Drop for Leftovers {
    fn drop(&mut self) {
        for path in Self::now().iter().filter(|path| !self.others.contains(path)) {
            let _ = fs::remove_file(path);
        }
    }
}

/// A publisher, and the shared memory that it publishes.
pub struct Out {
    publisher: Publisher<'static>,
    memory: ShmProvider<PosixShmProviderBackend>,
    is_met: bool,
}

impl Out {
    pub fn declare(session: &Session, key: &'static str) -> Self {
        let publisher = session.declare_publisher(key).wait().expect("a publisher");
        let memory = ShmProviderBuilder::default_backend(POOL_BYTES).wait().expect("memory");
        Self { publisher, memory, is_met: false }
    }

    /// Waits until somebody has subscribed.
    pub fn meet(&mut self) {
        while !self.publisher.matching_status().wait().expect("a status").matching() {
            sleep(Duration::from_millis(1));
        }
        self.is_met = true;
    }

    pub fn put(&self, message: &[u8]) {
        let mut buffer = self
            .memory
            .alloc(message.len())
            .with_policy::<BlockOn<GarbageCollect>>()
            .wait()
            .expect("memory");
        buffer.copy_from_slice(message);
        self.publisher.put(buffer).wait().expect("put");
    }
}

/// One side's ends.
pub struct Ends {
    out: Out,
    from: Subscriber<FifoChannelHandler<Sample>>,
    _session: Session,
}

impl Ends {
    pub fn open(system: &System, side: Side) -> Self {
        let session = session(system, side == Side::Ping);
        let [out, from] = side.ways();
        let from = session.declare_subscriber(from).wait().expect("a subscriber");
        Self { out: Out::declare(&session, out), from, _session: session }
    }
}

impl Door for Ends {
    fn send(&mut self, sent_ns: u64) {
        if !self.out.is_met {
            self.out.meet();
        }
        let mut message = [0; WORDS * 8];
        message[..8].copy_from_slice(&sent_ns.to_ne_bytes());
        self.out.put(&message);
    }

    fn wait(&mut self) -> u64 {
        let sample = self.from.recv().expect("received");
        let bytes = sample.payload().to_bytes();
        u64::from_ne_bytes(*bytes.first_chunk().expect("it has 64 bytes"))
    }
}

/// The role of a subscriber that takes whatever comes.
pub fn subscriber(arguments: &[&str]) -> anyhow::Result<()> {
    let [key] = arguments else { anyhow::bail!("which key?") };
    let session = session(&System::from_env()?, false);
    let key = (*key).to_string();
    let subscriber = session.declare_subscriber(key).callback(drop).wait();
    let subscriber = subscriber.map_err(|error| anyhow::anyhow!("{error}"))?;
    println!("ready");
    heard();
    drop(subscriber);
    Ok(())
}
