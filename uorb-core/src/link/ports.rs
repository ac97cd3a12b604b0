//! What a session has to do with streams: the process's membership of iceoryx2,
//! which it gets when it needs it, and the ports of its publications, which the
//! thread opens when the broker says that somebody follows.

use std::collections::HashMap;
use std::fs::File;
use std::sync::{Arc, MutexGuard, PoisonError};

use nix::fcntl::{FcntlArg, fcntl};
use nix::sys::resource::{Resource, getrlimit, setrlimit};

use super::Link;
use super::joining::{process_name, write_lock};
use crate::error::Error;
use crate::protocol::Request;
use crate::stream::Member;
use crate::stream::port::Streamable;

impl Link {
    /// This process as a member of the world of the system's streams.
    pub(crate) fn member(&self) -> Result<Arc<Member>, Error> {
        let mut member = self.member.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(member) = &*member {
            return Ok(member.clone());
        }
        raise_descriptor_limit();
        let joined = self.world.join(&format!("uorb-{}", self.peer));
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
