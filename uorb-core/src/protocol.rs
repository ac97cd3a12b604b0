//! The words between a process and the broker.
//!
//! A Unix socket of type SEQPACKET carries them: one packet, one message,
//! serialised by postcard. The process asks, each request with a number, and
//! the broker answers with the same number; besides, the broker speaks by
//! itself when something happens that a process waits for.
//!
//! Every request can be asked twice with the same result: a process whose
//! broker died before the answer came asks its successor again. What a process
//! holds has a handle, a number of its own choice, and (peer, handle) is the
//! key under which the broker knows it.

use std::fmt;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::layout::{Layout, LayoutFault};
use crate::stream::World;
use crate::topic::{Instance, Metadata, Priority, QueueLength};

/// The version of these words. A broker refuses a process of another one.
pub const PROTOCOL_VERSION: u32 = 2;

/// The largest packet, in bytes: two descriptions of the greatest length, as a
/// mismatch has them, and room for what stands around them. The kernel takes
/// packets up to about 208 KiB.
pub const PACKET_MAX_BYTES: usize = 192 * 1024;

/// The most bytes of a process's name that are kept.
pub const PROCESS_NAME_MAX_BYTES: usize = 32;

/// What a process asks of the broker.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request {
    /// The first request of a connection.
    Join(Join),
    /// All handles of a process that re-joins have been named again: forget
    /// those that were not.
    Rejoined,
    /// Become a publisher of a node.
    Advertise(Advertise),
    /// Stop being one.
    Unadvertise {
        /// The handle it was advertised with.
        handle: u32,
    },
    /// Follow a node.
    Subscribe(Subscribe),
    /// Stop following it.
    Unsubscribe {
        /// The handle it was subscribed with.
        handle: u32,
    },
    /// The queue of a stream subscription is there: publishers may send to it.
    Following {
        /// The subscription's handle.
        handle: u32,
    },
    /// The port of a publication is open, or could not be opened.
    Port {
        /// The publication's handle.
        handle: u32,
        /// Why not, where it could not.
        failure: Option<String>,
    },
    /// How is the broker?
    Status,
    /// Who is connected?
    Peers,
    /// Who publishes on a node, and who subscribes to it?
    Users {
        /// The topic.
        topic: String,
        /// Which of its nodes.
        instance: Instance,
    },
    /// End the system.
    Stop,
}

/// Introduces a process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Join {
    /// [`PROTOCOL_VERSION`] of the process. It stands first so that every
    /// version can read it.
    pub version: u32,
    /// The process's name, for people.
    pub name: String,
    /// The number and the system it had with a broker that died.
    pub rejoin: Option<Rejoin>,
}

/// What a process was before its broker died.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rejoin {
    /// The peer number it holds locked.
    pub peer: u16,
    /// The system it belongs to.
    pub system_id: u64,
}

/// Asks for a place among the publishers of a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Advertise {
    /// The process's own number for it.
    pub handle: u32,
    /// The topic.
    pub metadata: Metadata,
    /// Which of its nodes.
    pub claim: Claim,
    /// Carried for subscribers to choose by.
    pub priority: Priority,
    /// A longer queue than the .msg text asks for.
    pub queue_length: Option<QueueLength>,
}

/// Which instance a publisher wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Claim {
    /// This one, beside any other publishers of it.
    Shared(Instance),
    /// The lowest that nobody has advertised.
    Lowest,
}

/// Asks to follow a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Subscribe {
    /// The process's own number for it.
    pub handle: u32,
    /// The topic.
    pub subject: Subject,
    /// Which of its nodes.
    pub instance: Instance,
    /// Not only the node, but also the stream: every message.
    pub stream: Option<Wish>,
}

/// How to follow a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Wish {
    /// How many messages the queue holds.
    pub depth: u32,
    /// Whether `try_publish` is to fail while the queue is full.
    pub back_pressure: bool,
    /// The place among the node's streams that it had with a broker that died.
    pub place: Option<u8>,
}

/// A topic, as far as a subscriber knows it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Subject {
    /// Its description is compiled in.
    Described(Metadata),
    /// Only its name is known: whatever its layout is will do.
    Named(String),
}

impl Subject {
    /// The topic's name.
    pub fn name(&self) -> &str {
        match self {
            Self::Described(metadata) => &metadata.name,
            Self::Named(name) => name,
        }
    }

    /// The layout, if it is known.
    pub fn layout(&self) -> Option<&Layout> {
        match self {
            Self::Described(metadata) => Some(&metadata.layout),
            Self::Named(_) => None,
        }
    }
}

/// A request on its way.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ToBroker {
    /// The process's own number for it; the reply carries it back.
    pub number: u32,
    /// What is asked.
    pub request: Request,
}

/// What the broker says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum FromBroker {
    /// The answer to a request.
    Reply {
        /// The request's number.
        number: u32,
        /// The answer.
        reply: Reply,
    },
    /// A topic that a subscription by name waited for is there now.
    Described {
        /// The subscription's handle.
        handle: u32,
    },
    /// Somebody follows the stream of a publication's node: open its port.
    Streamed {
        /// The publication's handle.
        handle: u32,
    },
    /// The system has ended: somebody said `uorb stop`.
    Ended,
}

/// The broker's answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Reply {
    /// To [`Request::Join`].
    Welcome {
        /// The process's number: it locks the file of that name.
        peer: u16,
        /// The random number of this system.
        system_id: u64,
        /// Where its streams are.
        world: World,
    },
    /// To [`Request::Advertise`]: which instance it became.
    Advertised(Instance),
    /// To [`Request::Subscribe`]: the node is there.
    Subscribed,
    /// To [`Request::Subscribe`]: the node is there, and the stream.
    Streaming {
        /// The subscription's place among the node's streams.
        place: u8,
    },
    /// To [`Request::Subscribe`]: nobody has described the topic yet.
    Waiting,
    /// To requests that just succeed.
    Done,
    /// To [`Request::Status`].
    Status(BrokerStatus),
    /// To [`Request::Peers`].
    Peers(Vec<PeerInfo>),
    /// To [`Request::Users`].
    Users(Users),
    /// The request was understood and cannot be granted.
    Refused(Refusal),
}

/// How the broker is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BrokerStatus {
    /// The version of the program.
    pub version: String,
    /// Its process id.
    pub pid: u32,
    /// When it started, in microseconds of CLOCK_MONOTONIC.
    pub started_us: u64,
    /// The random number of the system; a restarted broker keeps it.
    pub system_id: u64,
    /// Processes connected.
    pub peers: u32,
    /// Topics that are described.
    pub topics: u32,
    /// Nodes, that is instances of all topics.
    pub nodes: u32,
    /// Nodes that have a publisher.
    pub advertised: u32,
    /// Where its streams are.
    pub world: World,
    /// Why there are none, where that is so.
    pub no_streams: Option<String>,
}

/// One process, as the broker knows it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PeerInfo {
    /// The process's number.
    pub peer: u16,
    /// Its process id; 0 where the kernel does not say.
    pub pid: u32,
    /// Its name.
    pub name: String,
    /// Whether it is connected. A process whose broker was restarted is known
    /// before it has re-joined.
    pub connected: bool,
    /// How many publications it holds.
    pub publications: u32,
    /// How many subscriptions it holds.
    pub subscriptions: u32,
}

/// Who uses a node: the register of seed 002's story, requesters and senders.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Users {
    /// Peer and priority of each publisher.
    pub publishers: Vec<(u16, Priority)>,
    /// Peer and number of its subscriptions.
    pub subscribers: Vec<(u16, u32)>,
}

/// Why the broker does not grant a request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum Refusal {
    /// The broker is of another version.
    #[error(
        "the broker speaks protocol {broker}, this program {}: \
         install both from one build, then restart the broker",
        PROTOCOL_VERSION
    )]
    Version {
        /// The broker's version.
        broker: u32,
    },
    /// The system that the process belonged to has ended, and this is another.
    #[error("the system has ended, and another one has started in its place")]
    OtherSystem,
    /// The topic has ten advertised instances.
    #[error("topic {topic} has all its {} instances advertised", crate::topic::INSTANCES_MAX)]
    InstancesTaken {
        /// The topic.
        topic: String,
    },
    /// The node has as many publishers as it takes.
    #[error("{topic} instance {instance} has all the {limit} publishers that a node takes")]
    PublishersTaken {
        /// The topic.
        topic: String,
        /// Its instance.
        instance: Instance,
        /// How many a node takes.
        limit: u32,
    },
    /// A live process uses the topic with another layout.
    #[error("topic {} is in use with another layout", .0.topic)]
    LayoutMismatch(Box<Mismatch>),
    /// The name cannot be a topic's.
    #[error(
        "{topic:?} is not a topic's name: letters, digits and _, at most {} of them",
        crate::topic::TOPIC_NAME_MAX_BYTES
    )]
    BadName {
        /// The name.
        topic: String,
    },
    /// The layout contradicts itself.
    #[error(transparent)]
    BadLayout(#[from] LayoutFault),
    /// Shared memory is full.
    #[error("no room for {}: it needs {needed_bytes} bytes", path.display())]
    NoSpace {
        /// The file that did not fit.
        path: PathBuf,
        /// What it needs, in bytes.
        needed_bytes: u64,
    },
    /// The stream cannot be followed.
    #[error("{what}")]
    NoStream {
        /// Why, as iceoryx2 said it.
        what: String,
    },
    /// A limit of the broker is reached.
    #[error("the broker's limit of {limit} {what} is reached")]
    Limit {
        /// What there are too many of.
        what: String,
        /// The limit.
        limit: u32,
    },
    /// The request makes no sense here, as a second `Join`.
    #[error("the broker did not expect this request now: {what}")]
    OutOfOrder {
        /// What was asked.
        what: String,
    },
    /// The broker could not do it.
    #[error("the broker could not do it: {what}")]
    Failed {
        /// What went wrong, as the system said it.
        what: String,
    },
}

/// Two layouts of one topic, and who uses the other one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mismatch {
    /// The topic.
    pub topic: String,
    /// The layout of the process that asked.
    pub ours: Layout,
    /// The layout that is in use.
    pub theirs: Layout,
    /// Who uses it: `sensors (pid 4711)`.
    pub users: Vec<String>,
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "topic {} is in use with another layout", self.topic)?;
        for (whose, layout) in [("this program", &self.ours), ("in use", &self.theirs)] {
            let bytes = layout.size_bytes;
            let hash = match layout.message_hash {
                0 => "no hash".into(),
                hash => format!("hash {hash:#010x}"),
            };
            if layout.is_untyped() {
                writeln!(f, "  {whose}: {bytes} bytes, no field list")?;
                continue;
            }
            writeln!(f, "  {whose}: {hash}, {bytes} bytes: {}", layout.o_fields())?;
            // The difference may be inside a message that both contain.
            for nested in layout.nested() {
                writeln!(f, "    {}: {}", nested.name, nested.o_fields())?;
            }
        }
        writeln!(f, "  used by: {}", self.users.join(", "))?;
        write!(f, "  rebuild one of the two, or stop the other before this one starts")
    }
}

/// A packet's bytes.
pub fn encode<T: Serialize>(message: &T) -> Vec<u8> {
    // Plain data and a growing buffer: there is nothing that could fail.
    postcard::to_stdvec(message).expect("plain data serialises")
}

/// A packet's message. None where the other side does not speak this protocol.
pub fn decode<'b, T: Deserialize<'b>>(packet: &'b [u8]) -> Option<T> {
    let (message, rest) = postcard::take_from_bytes(packet).ok()?;
    rest.is_empty().then_some(message)
}

/// How a packet begins, where all of it cannot be read: a join of another
/// version has its number, its kind and its version where ours has them.
pub fn decode_beginning(packet: &[u8]) -> Option<(u32, u32, u32)> {
    postcard::take_from_bytes(packet).ok().map(|(beginning, _)| beginning)
}
