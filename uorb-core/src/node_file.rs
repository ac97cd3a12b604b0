//! The file of a node: `obj/sensor_accel0`.
//!
//! Four sections, each on pages of its own, so that each has its own writers:
//!
//! | section | what is in it | who writes it |
//! |---|---|---|
//! | identity | name, instance, layout, which system and boot | the broker, once |
//! | counts | publishers, subscribers, streams, queue length, ended | the broker alone |
//! | doorbell | `asked`, messages lost, how far streams have come | subscribers |
//! | ring | `rung`, ports of publishers, order ring, slots | publishers |
//! | last | a large topic's message that outlived its publisher | the broker alone |
//!
//! A large topic's messages are on its stream; its slots have no payload, and
//! only its nodes have the last section.
//!
//! The identity is read into private memory and checked there; after that
//! nothing that another process writes says how large anything is. Every number
//! is in this machine's byte order: the file never leaves it.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;

use zerocopy::{FromBytes, Immutable, IntoBytes};

use crate::error::Error;
use crate::layout::Layout;
use crate::mapping::page_bytes;
use crate::ring::{Geometry, PUBLISHERS_MAX};
use crate::topic::{Instance, Metadata, QueueLength, is_topic_name};

/// The layout of node files that this build reads and writes.
pub const NODE_FILE_VERSION: u32 = 2;

/// The most bytes a topic's description may take in the node file.
pub(crate) const DESCRIPTION_MAX_BYTES: usize = 64 * 1024;

/// The generation before the first publish. Not 0, so that the ring always has
/// room for the generations before it; its low 32 bits, which programs see, are.
pub(crate) const FIRST_BASE: u64 = 1 << 32;

const MAGIC: [u8; 8] = *b"uORBnode";

/// The fixed head of the identity section. The description follows it.
#[derive(FromBytes, IntoBytes, Immutable)]
#[repr(C)]
struct Head {
    magic: [u8; 8],
    version: u32,
    page_bytes: u32,
    system_id: u64,
    boot_id: [u8; 16],
    base: u64,
    description_bytes: u32,
    instance: u32,
}

/// Who a node is: the part of its file that never changes, in private memory.
#[derive(Clone, Debug)]
pub struct Identity {
    /// The random number of the system that the node belongs to.
    pub system_id: u64,
    /// The machine's boot in which the node was made.
    pub boot_id: [u8; 16],
    /// Which of the topic's nodes it is.
    pub instance: Instance,
    /// The generation before the first publish.
    pub base: u64,
    /// Name, layout, and the queue length that the .msg text asks for.
    pub metadata: Metadata,
}

/// Where the sections of a node's file start, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Sections {
    pub(crate) counts: usize,
    pub(crate) doorbell: usize,
    pub(crate) last: usize,
    pub(crate) ring: usize,
}

impl Sections {
    fn behind(identity_bytes: usize, layout: &Layout) -> Self {
        let page = page_bytes();
        let counts = identity_bytes.next_multiple_of(page);
        let last = counts + 2 * page;
        // The ring is last in the file: its length is decided later.
        let ring = last + last_section::bytes(layout).next_multiple_of(page);
        Self { counts, doorbell: counts + page, last, ring }
    }
}

/// Words of the counts section.
pub(crate) mod counts {
    /// Not 0: the system has ended, or the node gave way to another layout.
    pub(crate) const ENDED: usize = 0;
    /// The queue length; 0 until the first publisher was admitted.
    pub(crate) const QUEUE_LENGTH: usize = 1;
    /// Publishers that are advertised.
    pub(crate) const PUBLISHERS: usize = 2;
    /// Subscriptions.
    pub(crate) const SUBSCRIBERS: usize = 3;
    /// Not 0: somebody follows the stream, so publishers send on it.
    pub(crate) const STREAMED: usize = 4;
    /// Streams that ask for back-pressure.
    pub(crate) const BACK_PRESSURE: usize = 5;
    /// Foreign programs that follow the stream, and that publish on it.
    pub(crate) const FOREIGN_SUBSCRIBERS: usize = 6;
    pub(crate) const FOREIGN_PUBLISHERS: usize = 7;
    /// One word a publisher: `handle << 32 | priority << 16 | peer`, 0: free.
    pub(crate) const ENTRIES: usize = 8;
    /// One word a stream subscription, see `StreamEntry`; 0: free.
    pub(crate) const STREAMS: usize = 32;
}

/// Words of the doorbell section, a cache line each.
pub(crate) mod doorbell {
    pub(crate) const ASKED: usize = 0;
    pub(crate) const LOST: usize = 8;
    /// Messages of foreign publishers that stream subscriptions have dropped.
    pub(crate) const FOREIGN: usize = 16;
    /// One a stream subscription: the generation up to which it has received,
    /// the messages that it has lost, and whether it has begun.
    pub(crate) const STREAMS: usize = 24;
    pub(crate) const STREAM_WORDS: usize = 8;
}

/// Words of the ring section.
pub(crate) mod ring_section {
    pub(crate) const RUNG: usize = 0;
    /// Counts up where the next publisher looks for a free entry of the table.
    pub(crate) const NEXT_PORT: usize = 1;
    /// Three words a port: whose it is (`handle << 16 | peer`, 0: free), and the
    /// two halves of its id. The id stays when the port is gone: messages of it
    /// may still be under way.
    pub(crate) const PORTS: usize = 8;
    pub(crate) const PORT_WORDS: usize = 3;
    /// Four generations of publishers, so that an id stays known for a while.
    pub(crate) const PORTS_MAX: usize = 4 * super::PUBLISHERS_MAX as usize;
    pub(crate) const TABLES: usize = PORTS + PORTS_MAX * PORT_WORDS;
}

/// Words of the last section.
pub(crate) mod last_section {
    use crate::layout::Layout;

    /// The generation that is there; 0 while it is written, or none is.
    pub(crate) const GENERATION: usize = 0;
    pub(crate) const PUBLISH_TIME: usize = 1;
    pub(crate) const PUBLISHER: usize = 2;
    pub(crate) const PAYLOAD: usize = 3;

    pub(crate) fn bytes(layout: &Layout) -> usize {
        let words = PAYLOAD + (layout.size_bytes as usize).div_ceil(size_of::<u64>());
        if layout.is_large() { words * size_of::<u64>() } else { 0 }
    }
}

impl Identity {
    /// The geometry of the node's ring with a queue of this length.
    pub(crate) fn geometry(&self, queue_length: QueueLength) -> Geometry {
        let layout = &self.metadata.layout;
        let slot_bytes = if layout.is_large() { 0 } else { layout.size_bytes };
        Geometry::new(queue_length.get(), PUBLISHERS_MAX, slot_bytes)
    }

    /// The bytes of the node's whole file with a queue of this length.
    pub(crate) fn file_bytes(&self, sections: Sections, queue_length: QueueLength) -> usize {
        let words = ring_section::TABLES + self.geometry(queue_length).words();
        sections.ring + (words * size_of::<u64>()).next_multiple_of(page_bytes())
    }

    /// The bytes of the identity section, and where the others go.
    pub(crate) fn to_bytes(&self) -> Result<(Vec<u8>, Sections), Error> {
        let description = postcard::to_stdvec(&self.metadata).expect("plain data serialises");
        if description.len() > DESCRIPTION_MAX_BYTES {
            return Err(Error::DescriptionTooLong {
                topic: self.metadata.name.to_string(),
                size_bytes: description.len(),
            });
        }
        let head = Head {
            magic: MAGIC,
            version: NODE_FILE_VERSION,
            page_bytes: page_bytes() as u32,
            system_id: self.system_id,
            boot_id: self.boot_id,
            base: self.base,
            description_bytes: description.len() as u32,
            instance: self.instance.number().into(),
        };
        let mut bytes = head.as_bytes().to_vec();
        bytes.extend_from_slice(&description);
        let sections = Sections::behind(bytes.len(), &self.metadata.layout);
        Ok((bytes, sections))
    }

    /// Reads and checks the identity of a node's file.
    ///
    /// # Errors
    ///
    /// [`Error::NodeVersion`] where another build wrote it, and
    /// [`Error::CorruptNode`] where it is not what a broker writes.
    pub(crate) fn read(file: &File, path: &Path) -> Result<(Self, Sections), Error> {
        let corrupt = |what: &str| Error::CorruptNode { path: path.into(), what: what.into() };
        let mut bytes = [0; size_of::<Head>()];
        file.read_exact_at(&mut bytes, 0).map_err(|_| corrupt("it is too short"))?;
        let head: Head = zerocopy::transmute!(bytes);
        if head.magic != MAGIC {
            return Err(corrupt("it does not begin as one"));
        }
        if head.version != NODE_FILE_VERSION {
            return Err(Error::NodeVersion { path: path.into(), found: head.version });
        }
        if head.page_bytes as usize != page_bytes() {
            return Err(corrupt("it was made with another page size"));
        }
        let description_bytes = head.description_bytes as usize;
        if description_bytes > DESCRIPTION_MAX_BYTES {
            return Err(corrupt("its description is too long"));
        }
        let mut description = vec![0; description_bytes];
        file.read_exact_at(&mut description, size_of::<Head>() as u64)
            .map_err(|_| corrupt("its description is cut off"))?;
        let metadata: Metadata = postcard::from_bytes(&description)
            .map_err(|_| corrupt("its description cannot be read"))?;
        if !is_topic_name(&metadata.name) {
            return Err(corrupt("its name is not a topic's"));
        }
        metadata.layout.check().map_err(|fault| corrupt(&fault.to_string()))?;
        // Room below for the ring that is formatted with the generations before
        // it, and above for nine years of messages.
        if !(FIRST_BASE / 2..1 << 40).contains(&head.base) {
            return Err(corrupt("its first generation is out of range"));
        }
        let instance = u8::try_from(head.instance).ok().and_then(Instance::new);
        let identity = Self {
            system_id: head.system_id,
            boot_id: head.boot_id,
            instance: instance.ok_or_else(|| corrupt("its instance is out of range"))?,
            base: head.base,
            metadata,
        };
        let identity_bytes = size_of::<Head>() + description_bytes;
        let sections = Sections::behind(identity_bytes, &identity.metadata.layout);
        Ok((identity, sections))
    }
}

/// The machine's current boot, as 16 bytes.
pub fn boot_id() -> Result<[u8; 16], Error> {
    let path = Path::new("/proc/sys/kernel/random/boot_id");
    let text = std::fs::read_to_string(path).map_err(|error| Error::io("read", path, error))?;
    let digits: String = text.chars().filter(char::is_ascii_hexdigit).collect();
    let number = u128::from_str_radix(&digits, 16).unwrap_or(0);
    Ok(number.to_be_bytes())
}
