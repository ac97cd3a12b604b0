//! Where the streams of a system live: a world of iceoryx2, which is a prefix of
//! names and a folder. Programs of different worlds never meet.
//!
//! The default directory uses iceoryx2's default world, so that foreign programs
//! find its streams without any configuration. A directory that `UORB_DIR` names
//! has a world of its own: its folder is inside, and its names in /dev/shm begin
//! with a prefix that is made from its path. The broker tells each process.

use std::fmt;
use std::fs;
use std::path::PathBuf;

use iceoryx2::config::Config;
use iceoryx2::node::{NodeState, NodeView};
use iceoryx2::prelude::{
    CallbackProgression, FileName, Node, NodeBuilder, NodeName, SemanticString, SignalHandlingMode,
};
use serde::{Deserialize, Serialize};

use super::Ipc;
use crate::system::System;

/// iceoryx2 makes file names of a prefix, a root and 136 characters more, of
/// which no file system takes more than 255 together.
const LENGTH_MAX_BYTES: usize = 119;

/// Where iceoryx2 has its files.
pub(super) const SHM: &str = "/dev/shm";

/// A world of iceoryx2.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct World {
    /// How its names in /dev/shm begin.
    pub prefix: String,
    /// Its folder.
    pub root: PathBuf,
}

impl World {
    /// The world of a system, as its broker finds it. The directory exists.
    pub fn of(system: &System) -> Self {
        let base = fs::canonicalize(system.base()).unwrap_or_else(|_| system.base().into());
        if base == System::default_base() {
            let config = Config::default();
            return Self {
                prefix: config.global.prefix.to_string(),
                root: PathBuf::from(config.global.root_path().to_string()),
            };
        }
        let dir = base.join(system.number().to_string());
        // FNV-1a: the same in every build, unlike the standard library's.
        let hash =
            dir.as_os_str().as_encoded_bytes().iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
                (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3_u64)
            });
        Self {
            prefix: format!("uorb_{:08x}_", (hash >> 32) ^ (hash & 0xffff_ffff)),
            root: dir.join(super::world::FOLDER),
        }
    }

    /// Whether it belongs to one system alone.
    pub fn is_private(&self) -> bool {
        self.root.file_name().is_some_and(|name| name == FOLDER)
    }

    /// Becomes a member of the world as a process of the system, by its number.
    pub(crate) fn join_as(&self, peer: u16) -> Result<Member, String> {
        self.join(&format!("{OF_PEER}{peer}"))
    }

    /// Becomes a member of the world, under a name for people.
    ///
    /// # Errors
    ///
    /// What iceoryx2 says.
    pub fn join(&self, name: &str) -> Result<Member, String> {
        let length = self.prefix.len() + self.root.as_os_str().len() + 1;
        if length > LENGTH_MAX_BYTES {
            return Err(format!(
                "streams cannot live in {}: with {} its path is {length} bytes long, and iceoryx2 \
                 takes {LENGTH_MAX_BYTES}; choose a shorter UORB_DIR",
                self.root.display(),
                self.prefix,
            ));
        }
        let failed = |why: &dyn fmt::Debug| {
            format!(
                "cannot join iceoryx2 in {}: it says {why:?}; is the folder another user's?",
                self.root.display()
            )
        };
        let mut config = Config::default();
        config.global.prefix = FileName::new(self.prefix.as_bytes()).map_err(|why| failed(&why))?;
        let root = format!("{}/", self.root.display());
        let root = iceoryx2::prelude::Path::new(root.as_bytes()).map_err(|why| failed(&why))?;
        config.global.set_root_path(&root);
        // The broker cleans up after the dead; here it would take milliseconds.
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        let name = NodeName::new(name).map_err(|why| failed(&why))?;
        let node = NodeBuilder::new()
            .name(&name)
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>()
            .map_err(|why| failed(&why))?;
        Ok(Member { node })
    }

    /// What the world has in shared memory.
    pub(super) fn names(&self) -> impl Iterator<Item = PathBuf> {
        let entries = fs::read_dir(SHM).into_iter().flatten().flatten();
        let is_ours = |entry: &fs::DirEntry| {
            entry.file_name().as_encoded_bytes().starts_with(self.prefix.as_bytes())
        };
        entries.filter(is_ours).map(|entry| entry.path())
    }

    /// Removes all that a private world has left: nobody uses it any more, or
    /// whoever does has mapped what it needs.
    pub fn remove(&self) {
        if !self.is_private() {
            return;
        }
        let _ = fs::remove_dir_all(&self.root);
        self.names().for_each(|path| _ = fs::remove_file(path));
    }
}

/// The folder of a private world, in the system's directory.
pub(crate) const FOLDER: &str = "iox2";

/// A process as a member of a world.
#[derive(Debug)]
pub struct Member {
    /// What iceoryx2 calls a node.
    pub node: Node<Ipc>,
}

/// What stands before the number of a process in its name as a member.
const OF_PEER: &str = "uorb-";

impl Member {
    /// Cleans up after the members that are dead, but for the processes of the
    /// system that are to be spared, by number and process id.
    pub fn clean_up(&self, mut is_spared: impl FnMut(u16, u32) -> bool) {
        // What fails now is done at the next time.
        let _ = Node::<Ipc>::list(self.node.config(), |member| {
            if let NodeState::Dead(dead) = member {
                let peer = dead.details().as_ref().and_then(|details| peer_in(details.name()));
                let pid = dead.id().pid::<Ipc>().ok().map(|pid| pid.value() as u32);
                if !peer.zip(pid).is_some_and(|(peer, pid)| is_spared(peer, pid)) {
                    let _ = dead.try_remove_stale_resources();
                }
            }
            CallbackProgression::Continue
        });
    }
}

fn peer_in(name: &NodeName) -> Option<u16> {
    name.as_str().strip_prefix(OF_PEER)?.parse().ok()
}
