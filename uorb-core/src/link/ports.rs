//! What a session has to do with streams: the process's membership of iceoryx2,
//! which it gets when it needs it, and the ports of its publications, which the
//! thread opens when the broker says that somebody follows. A port outlives its
//! publication until all who follow have received what was sent there, or for a
//! second: what they have not yet looked at goes with it.

use std::collections::HashMap;
use std::fs::File;
use std::sync::{Arc, MutexGuard, PoisonError};

use nix::fcntl::{FcntlArg, fcntl};
use nix::sys::resource::{Resource, getrlimit, setrlimit};

use super::Link;
use super::joining::{process_name, write_lock};
use crate::clock::now_us;
use crate::error::Error;
use crate::protocol::Request;
use crate::stream::Member;
use crate::stream::port::Streamable;

/// How long a port waits for those who follow, when its publication is gone.
const LINGER_US: u64 = 1_000_000;

/// How many such ports a process has: they take places from other publishers.
const LINGERING_MAX: usize = 4;

/// A port whose publication is gone.
#[derive(Debug)]
pub(super) struct Lingering {
    port: Streamable,
    /// The last generation that may have been sent there.
    last: u64,
    until_us: u64,
}

impl Lingering {
    fn is_over(&self) -> bool {
        self.port.node.has_received(self.last) || now_us() > self.until_us
    }
}

impl Drop for Lingering {
    fn drop(&mut self) {
        let (peer, handle) = self.port.publisher;
        self.port.node.leave_port(peer, handle);
    }
}

impl Link {
    /// Takes the port of a publication that is about to go.
    pub(crate) fn linger(&self, port: Streamable, last: u64) {
        let is_open = port.cell.get().is_some();
        let until_us = if is_open { now_us() + LINGER_US } else { 0 };
        let lingering = Lingering { port, last, until_us };
        if !lingering.is_over() {
            let mut all = self.lingering();
            if all.len() == LINGERING_MAX {
                all.remove(0);
            }
            all.push(lingering);
        }
    }

    /// Gives up the ports that nobody needs any more. Whether there are others.
    pub(crate) fn has_lingering_ports(&self) -> bool {
        let mut all = self.lingering();
        all.retain(|lingering| !lingering.is_over());
        !all.is_empty()
    }

    fn lingering(&self) -> MutexGuard<'_, Vec<Lingering>> {
        self.lingering.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// This process as a member of the world of the system's streams.
    pub(crate) fn member(&self) -> Result<Arc<Member>, Error> {
        let mut member = self.member.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(member) = &*member {
            return Ok(member.clone());
        }
        raise_descriptor_limit();
        let joined = self.world.join_as(self.peer);
        let joined = joined.map_err(|what| Error::stream(self.system.to_string(), what))?;
        Ok(member.insert(Arc::new(joined)).clone())
    }

    /// In the child of a fork: the membership is the parent's, and what it would
    /// clean up, too.
    pub(crate) fn forget_member(&self) {
        if let Ok(mut member) = self.member.try_lock() {
            std::mem::forget(member.take());
        }
    }

    /// Notes a publication, so that its port can be opened when it is needed.
    pub(crate) fn add_streamable(&self, handle: u32, streamable: Streamable) {
        self.streamables().insert(handle, streamable);
    }

    pub(crate) fn remove_streamable(&self, handle: u32) {
        self.streamables().remove(&handle);
    }

    fn streamables(&self) -> MutexGuard<'_, HashMap<u32, Streamable>> {
        self.streamables.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Opens the port of a publication, and tells the broker how that went.
    pub(crate) fn open_port(&self, handle: u32) -> Result<(), Error> {
        let Some(streamable) = self.streamables().get(&handle).cloned() else { return Ok(()) };
        let Streamable { cell, node, publisher } = streamable;
        let opened =
            self.member().and_then(|member| cell.open(&member, &self.system, &node, publisher));
        let failure = opened.as_ref().err().map(ToString::to_string);
        self.tell(Request::Port { handle, failure });
        fail_point!("port.told");
        opened
    }

    /// A process of this system by name and process id, for people. Its own file
    /// must not be opened: closing it again would let go of the lock.
    pub(crate) fn describe_process(&self, peer: u16) -> String {
        if peer == self.peer {
            return format!("{} (pid {})", process_name(), std::process::id());
        }
        let path = self.system.peer(peer);
        let name = match std::fs::read_to_string(&path) {
            Ok(name) if !name.is_empty() => name,
            _ => "a process".into(),
        };
        let mut lock = write_lock();
        let file = File::options().read(true).write(true).open(&path);
        let asked = file.map(|file| fcntl(&file, FcntlArg::F_GETLK(&mut lock)));
        match asked {
            Ok(Ok(_)) if lock.l_pid > 0 => format!("{name} (pid {})", lock.l_pid),
            _ => name,
        }
    }
}

/// A stream takes some descriptors: the soft limit of 1,024 would be the first
/// to be reached.
fn raise_descriptor_limit() {
    if let Ok((_, hard)) = getrlimit(Resource::RLIMIT_NOFILE) {
        let _ = setrlimit(Resource::RLIMIT_NOFILE, hard, hard);
    }
}
