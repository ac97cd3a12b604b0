//! What only the broker does with a node: makes it, counts, ends it.

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::os::unix::fs::{FileExt, OpenOptionsExt};
use std::path::Path;
use std::sync::PoisonError;

use nix::errno::Errno;
use nix::fcntl::{FallocateFlags, fallocate};
use nix::sys::stat::Mode;
use nix::unistd::mkfifo;

use super::{Ending, Node, PublisherEntry, Role};
use crate::error::Error;
use crate::node_file::{FIRST_BASE, Identity, counts};
use crate::ring::PUBLISHERS_MAX;
use crate::sync::Ordering;
use crate::system::System;
use crate::topic::QueueLength;

impl Node {
    /// Makes the files of a node, bell first, complete before they have their
    /// names, and with all the memory that they will ever take.
    ///
    /// # Errors
    ///
    /// [`Error::NoSpace`], with the sum, where shared memory is full.
    pub fn create(system: &System, identity: Identity) -> Result<Self, Error> {
        let (topic, instance) = (&identity.metadata.name, identity.instance);
        let (path, bell_path) = (system.node(topic, instance), system.bell(topic, instance));
        let unfinished = system.unfinished().join(format!("{topic}{instance}"));
        let _ = std::fs::remove_file(&unfinished);

        let (bytes, sections) = identity.to_bytes()?;
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create_new(true)
            .mode(0o600)
            .custom_flags(libc::O_CLOEXEC)
            .open(&unfinished)
            .map_err(|error| Error::io("make", &unfinished, error))?;
        let file_bytes = identity.file_bytes(sections, identity.metadata.queue_length);
        let unfinished_bell = system.unfinished().join(format!("{topic}{instance}.bell"));
        let _ = std::fs::remove_file(&unfinished_bell);
        let made = allocate(&file, file_bytes, &path).and_then(|()| {
            fail_point!("node.allocated");
            let rename = |from: &Path, to: &Path| {
                std::fs::rename(from, to).map_err(|error| Error::io("name", to, error))
            };
            file.write_all_at(&bytes, 0).map_err(|error| Error::io("write", &path, error))?;
            mkfifo(&unfinished_bell, Mode::from_bits_truncate(0o600))
                .map_err(|errno| Error::io("make the bell", &bell_path, errno.into()))?;
            rename(&unfinished_bell, &bell_path)?;
            fail_point!("node.bell_named");
            rename(&unfinished, &path)
        });
        if let Err(error) = made {
            let _ = std::fs::remove_file(&unfinished);
            let _ = std::fs::remove_file(&unfinished_bell);
            return Err(error);
        }
        fail_point!("node.named");
        Self::map(system, identity, sections, file, Role::Broker)
    }

    /// Gives the node its ring, with at least the queue length asked for. The
    /// first publisher's asking decides; later ones find the ring as it is.
    ///
    /// # Errors
    ///
    /// [`Error::NoSpace`] where a longer queue does not fit.
    pub fn make_ring(&self, queue_length: QueueLength) -> Result<(), Error> {
        if self.ring.get().is_some() || self.queue_length().is_some() {
            return Ok(());
        }
        let queue_length = queue_length.max(self.identity.metadata.queue_length);
        let file_bytes = self.identity.file_bytes(self.sections, queue_length);
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(open) = file.as_ref() else { return Ok(()) };
        allocate(open, file_bytes, self.name().as_ref())?;
        fail_point!("ring.allocated");
        let mapped = self.ring_in(open, queue_length, file_bytes)?;
        mapped.ring.format();
        fail_point!("ring.formatted");
        let _ = self.ring.set(mapped);
        *file = None;
        // Pairs with the load in `mapped_ring`.
        self.counts.words()[counts::QUEUE_LENGTH]
            .store(queue_length.get().into(), Ordering::SeqCst);
        fail_point!("ring.there");
        Ok(())
    }

    /// Writes who publishes and how many subscribe.
    pub fn set_counts(&self, publishers: &[PublisherEntry], subscribers: u64) {
        let words = self.counts.words();
        let entries = &words[counts::ENTRIES..][..PUBLISHERS_MAX as usize];
        for (index, word) in entries.iter().enumerate() {
            let entry = publishers.get(index).map_or(0, |entry| entry.to_word());
            word.store(entry, Ordering::Release);
        }
        words[counts::SUBSCRIBERS].store(subscribers, Ordering::Release);
        words[counts::PUBLISHERS].store(publishers.len() as u64, Ordering::Release);
    }

    /// Gives back the slots and ports of a peer that is proven dead.
    pub fn free_slots_of(&self, peer: u16) {
        if let Some(mapped) = self.ring() {
            mapped.ring.free_slots_of(peer);
            self.leave_ports_of(peer);
        }
    }

    /// Gives back the slots and ports of everybody who does not live: what a
    /// broker that starts finds. The counts do not name them all, if the broker
    /// before it died in the middle of a burial.
    pub fn free_slots_of_the_dead(&self, lives: impl Fn(u16) -> bool) {
        let holders = self.slot_holders().into_iter().chain(self.port_holders());
        let dead: BTreeSet<u16> = holders.filter(|peer| !lives(*peer)).collect();
        dead.into_iter().for_each(|peer| self.free_slots_of(peer));
    }

    /// Marks the node as ended: handles of it say so.
    pub fn end(&self, why: Ending) {
        self.counts.words()[counts::ENDED].store(why as u64, Ordering::SeqCst);
    }

    /// Wakes every subscription that sleeps on the node.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] where the bell cannot be opened.
    pub fn ring_bell(&self) -> Result<(), Error> {
        self.open_bell().map(|bell| _ = bell.ring())
    }
}

/// Takes the memory of a whole file now, so that a full /dev/shm is an error
/// here and never a SIGBUS in a publish.
fn allocate(file: &File, size_bytes: usize, path: &Path) -> Result<(), Error> {
    match fallocate(file, FallocateFlags::empty(), 0, size_bytes as i64) {
        Ok(()) => Ok(()),
        Err(Errno::ENOSPC) => {
            Err(Error::NoSpace { path: path.into(), needed_bytes: size_bytes as u64 })
        }
        Err(errno) => Err(Error::io("take memory for", path, errno.into())),
    }
}

/// The base of a new node's generations. Nodes of PX4's own test topic start
/// near the wrap of 32 bits, for which its test needs a hook.
pub fn base_of(topic: &str, queue_length: QueueLength) -> u64 {
    match topic {
        "orb_test_medium_wrap_around" => (2 << 32) - u64::from(queue_length.get()) / 2,
        _ => FIRST_BASE,
    }
}
