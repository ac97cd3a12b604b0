//! Where a system lives: one directory, one broker.
//!
//! `/dev/shm/uorb-<uid>/<number>` by default. `UORB_DIR` names another directory
//! to stand in for `/dev/shm/uorb-<uid>`, and `UORB_SYSTEM` another number, as
//! `-i` does for PX4 SITL. Everything of a system is in its directory, so that
//! there is one thing to look into and one to remove.

use std::env;
use std::fmt;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use crate::error::Error;
use crate::topic::{INSTANCES_MAX, Instance};

/// The environment variable that names the directory of all systems.
pub const DIR_VARIABLE: &str = "UORB_DIR";
/// The environment variable that names the number of the system.
pub const SYSTEM_VARIABLE: &str = "UORB_SYSTEM";

/// The place of one system in the file system.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct System {
    base: PathBuf,
    number: u32,
}

impl System {
    /// System `number` in the directory `base`.
    pub fn new(base: impl Into<PathBuf>, number: u32) -> Self {
        Self { base: base.into(), number }
    }

    /// The system that the environment names: `UORB_DIR` and `UORB_SYSTEM`,
    /// else `/dev/shm/uorb-<uid>` and 0.
    ///
    /// # Errors
    ///
    /// [`Error::BadEnvironment`] where `UORB_SYSTEM` is not a number.
    pub fn from_env() -> Result<Self, Error> {
        let number = match env::var(SYSTEM_VARIABLE) {
            Err(_) => 0,
            Ok(text) => text.trim().parse().map_err(|_| Error::BadEnvironment {
                variable: SYSTEM_VARIABLE,
                value: text.clone(),
                expected: "a number, 0 and up",
            })?,
        };
        Ok(Self::new(Self::base_from_env(), number))
    }

    /// The directory of all systems that the environment names.
    pub fn base_from_env() -> PathBuf {
        match env::var_os(DIR_VARIABLE) {
            Some(dir) if !dir.is_empty() => PathBuf::from(dir),
            _ => Self::default_base(),
        }
    }

    /// The directory of all systems where `UORB_DIR` is not set.
    pub fn default_base() -> PathBuf {
        PathBuf::from(format!("/dev/shm/uorb-{}", nix::unistd::getuid()))
    }

    /// The directory of all systems.
    pub fn base(&self) -> &Path {
        &self.base
    }

    /// The system's number.
    pub fn number(&self) -> u32 {
        self.number
    }

    /// The system's directory.
    pub fn dir(&self) -> PathBuf {
        self.base.join(self.number.to_string())
    }

    /// The broker's socket, a Unix socket of type SEQPACKET.
    pub fn socket(&self) -> PathBuf {
        self.dir().join("broker.sock")
    }

    /// The file that the running broker holds locked.
    pub fn lock(&self) -> PathBuf {
        self.dir().join("broker.lock")
    }

    /// Whether a broker that ended the system has begun to remove it, or somebody
    /// has removed it without one: the socket goes first, the lock last. A broker
    /// that starts makes its socket anew, so it may be missing for a moment.
    pub(crate) fn is_removed(&self) -> bool {
        is_missing(&self.socket()) || self.is_unlocked()
    }

    /// Whether there is no lock file, which is so from the end of a system on.
    pub(crate) fn is_unlocked(&self) -> bool {
        is_missing(&self.lock())
    }

    /// Why nobody answers here: no broker runs, or it is not for us.
    #[doc(hidden)]
    pub fn no_broker(&self) -> Error {
        self.other_user().unwrap_or_else(|| Error::NoBroker { path: self.socket() })
    }

    /// That the system belongs to another user, if it does.
    pub(crate) fn other_user(&self) -> Option<Error> {
        // What is in another user's directory may be hidden, the directory is not.
        let seen = [self.dir(), self.base.clone()].into_iter();
        let (owner, path) =
            seen.flat_map(|path| Some((path.metadata().ok()?.uid(), path))).next()?;
        let us = nix::unistd::geteuid().as_raw();
        (owner != us).then_some(Error::OtherUser { path, owner, us })
    }

    /// The broker's log.
    pub fn log(&self) -> PathBuf {
        self.dir().join("broker.log")
    }

    /// The directory of the nodes: what `ls /obj` lists.
    pub fn nodes(&self) -> PathBuf {
        self.dir().join("obj")
    }

    /// The directory of the bells.
    pub fn bells(&self) -> PathBuf {
        self.dir().join("bell")
    }

    /// The directory of the files that living processes hold locked.
    pub fn peers(&self) -> PathBuf {
        self.dir().join("peers")
    }

    /// Where files are made before they get their name.
    pub fn unfinished(&self) -> PathBuf {
        self.dir().join(".tmp")
    }

    /// What a `reach` that is killed leaves to the next one.
    pub fn reach(&self) -> PathBuf {
        self.dir().join("reach.json")
    }

    /// The file of a node: `obj/sensor_accel0`.
    pub fn node(&self, topic: &str, instance: Instance) -> PathBuf {
        self.nodes().join(node_name(topic, instance))
    }

    /// The FIFO of a node: `bell/sensor_accel0`.
    pub fn bell(&self, topic: &str, instance: Instance) -> PathBuf {
        self.bells().join(node_name(topic, instance))
    }

    /// The file that a process holds locked while it lives.
    pub fn peer(&self, peer: u16) -> PathBuf {
        self.peers().join(peer.to_string())
    }

    /// When a node has come or gone: one look at a directory, where a list is many.
    pub fn nodes_changed(&self) -> Option<SystemTime> {
        std::fs::metadata(self.nodes()).ok()?.modified().ok()
    }

    /// The nodes there are, by topic and instance. Empty where no broker ever
    /// ran.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] where the directory exists and cannot be read.
    pub fn list_nodes(&self) -> Result<Vec<(String, Instance)>, Error> {
        let dir = self.nodes();
        let entries = match std::fs::read_dir(&dir) {
            Ok(entries) => entries,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(error) => return Err(Error::io("read", &dir, error)),
        };
        let mut nodes: Vec<_> = entries
            .flatten()
            .filter_map(|entry| split_node_name(entry.file_name().to_str()?))
            .collect();
        nodes.sort();
        Ok(nodes)
    }
}

impl fmt::Display for System {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.dir().display())
    }
}

fn is_missing(path: &Path) -> bool {
    path.symlink_metadata().is_err_and(|error| error.kind() == std::io::ErrorKind::NotFound)
}

fn node_name(topic: &str, instance: Instance) -> String {
    format!("{topic}{instance}")
}

// The last digit is the instance; a topic's own name may end in digits, as
// `actuator_controls_0` does.
const _: () = assert!(INSTANCES_MAX <= 10);

fn split_node_name(name: &str) -> Option<(String, Instance)> {
    let (topic, digit) = name.split_at_checked(name.len().checked_sub(1)?)?;
    let instance = Instance::new(digit.parse().ok()?)?;
    crate::topic::is_topic_name(topic).then(|| (topic.to_string(), instance))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_s_name_splits_into_topic_and_instance() {
        let instance = |number| Instance::new(number).unwrap();
        assert_eq!(split_node_name("sensor_accel2"), Some(("sensor_accel".into(), instance(2))));
        assert_eq!(
            split_node_name("actuator_controls_00"),
            Some(("actuator_controls_0".into(), instance(0)))
        );
        assert_eq!(split_node_name("7"), None);
        assert_eq!(split_node_name(".tmp"), None);
        assert_eq!(split_node_name(""), None);
    }
}
