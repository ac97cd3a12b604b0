//! The system's directory: whose it is, and what a broker finds in it.
//!
//! A broker that starts takes the lock first and then looks. What the system
//! left behind is adopted if it is of this boot and this build and one of its
//! processes still lives, which its locked file proves; else it is emptied. So
//! a broker that was killed comes back to its nodes, and a machine that was
//! switched off to an empty directory.

mod replace;

use std::fs::{self, DirBuilder, File};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::Path;

use anyhow::{Context, bail};
use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use uorb_core::broker_side::{Ending, NODE_FILE_VERSION, Node, Role, boot_id};
use uorb_core::{Error, System, World, fail_point};

pub(crate) use replace::end_the_running;

/// What a broker that starts has found.
pub(crate) enum Found {
    /// Another broker runs.
    Running,
    /// The directory is ours, locked, and of this system.
    Ours { lock: File, system_id: u64, living: Vec<Survivor> },
}

/// A process that outlived the broker before us.
pub(crate) struct Survivor {
    pub(crate) peer: u16,
    /// 0 where the kernel does not say.
    pub(crate) pid: u32,
    pub(crate) name: String,
}

/// What the lock file says of the system that it locks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Inscription {
    version: u32,
    boot_id: [u8; 16],
    system_id: u64,
}

/// What an inscription takes, about.
const INSCRIPTION_BYTES: usize = 100;

/// Makes the directory if need be, takes its lock, and adopts or empties it.
pub(crate) fn open(system: &System) -> anyhow::Result<Found> {
    make_ours(system.base())?;
    make_ours(&system.dir())?;
    refuse_strangers(system)?;
    let Some(lock) = take_lock(system)? else { return Ok(Found::Running) };
    fail_point!("start.locked");

    let now = |system_id| -> anyhow::Result<Inscription> {
        Ok(Inscription { version: NODE_FILE_VERSION, boot_id: boot_id()?, system_id })
    };
    let living = living(system);
    let before = Inscription::read(&lock);
    if let Some(before) = before
        && !living.is_empty()
        && before.boot_id == boot_id()?
        && !was_ending(system)?
    {
        if before.version != NODE_FILE_VERSION {
            let names: Vec<_> =
                living.iter().map(|peer| format!("{} (pid {})", peer.name, peer.pid)).collect();
            bail!(
                "{system} has nodes of version {}, this broker makes {NODE_FILE_VERSION}, and \
                 processes still use them: {}; stop those first",
                before.version,
                names.join(", "),
            );
        }
        return Ok(Found::Ours { lock, system_id: before.system_id, living });
    }

    empty(system)?;
    World::of(system).remove();
    fail_point!("start.emptied");
    for dir in [system.nodes(), system.bells(), system.peers(), system.unfinished()] {
        make_ours(&dir)?;
    }
    let inscription = now(random()?)?;
    if let Err(error) = inscription.write(&lock) {
        // Nothing of it is left for the next start to wonder about.
        remove(system);
        bail!(no_space(error, &system.lock(), INSCRIPTION_BYTES, "write"));
    }
    fail_point!("start.inscribed");
    Ok(Found::Ours { lock, system_id: inscription.system_id, living: Vec::new() })
}

/// Whether the broker before us was killed while it ended the system: some
/// handles have heard of it already.
fn was_ending(system: &System) -> anyhow::Result<bool> {
    let nodes = system.list_nodes()?.into_iter();
    let mut open =
        nodes.flat_map(|(topic, instance)| Node::open(system, &topic, instance, Role::Observer));
    Ok(open.any(|node| node.ending() == Some(Ending::System)))
}

/// Removes all that a system has, its lock last: whoever waits for the lock
/// finds out by it that the directory is gone.
pub(crate) fn remove(system: &System) {
    let _ = empty(system);
    fail_point!("end.emptied");
    for name in ["broker.log", "broker.log.1"] {
        let _ = fs::remove_file(system.dir().join(name));
    }
    for dir in [system.nodes(), system.bells(), system.peers(), system.unfinished()] {
        let _ = fs::remove_dir(dir);
    }
    let _ = fs::remove_file(system.lock());
    let _ = fs::remove_dir(system.dir());
    if system.base() == System::default_base() {
        // Empty only if no other system of this user runs. A directory that the
        // user named stays.
        let _ = fs::remove_dir(system.base());
    }
}

/// A directory that belongs to us, made if it is missing.
fn make_ours(dir: &Path) -> anyhow::Result<()> {
    let made = DirBuilder::new().recursive(true).mode(0o700).create(dir);
    made.with_context(|| format!("cannot make the directory {}", dir.display()))?;
    let owner =
        fs::metadata(dir).with_context(|| format!("cannot look at {}", dir.display()))?.uid();
    let us = nix::unistd::geteuid().as_raw();
    if owner != us {
        bail!(Error::OtherUser { path: dir.into(), owner, us });
    }
    Ok(())
}

/// A directory with other things in it is not a system's: it would be emptied.
fn refuse_strangers(system: &System) -> anyhow::Result<()> {
    const OURS: [&str; 10] = [
        "broker.sock",
        "broker.lock",
        "broker.log",
        "broker.log.1",
        "obj",
        "bell",
        "peers",
        ".tmp",
        "iox2",
        "reach.json",
    ];
    let dir = system.dir();
    for entry in fs::read_dir(&dir).with_context(|| format!("cannot read {}", dir.display()))? {
        let name = entry?.file_name();
        if !OURS.iter().any(|ours| name == *ours) {
            bail!(
                "{} is not a directory of uORB: it has {:?} in it; \
                 choose another with UORB_DIR or --dir",
                dir.display(),
                name,
            );
        }
    }
    Ok(())
}

/// Locks `broker.lock`; None if another broker has it. The file that was locked
/// must still be the one of that name: a broker that stops removes it.
fn take_lock(system: &System) -> anyhow::Result<Option<File>> {
    let path = system.lock();
    loop {
        let lock = File::options()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            .custom_flags(libc::O_CLOEXEC | libc::O_NOFOLLOW)
            .open(&path);
        let lock = match lock {
            Ok(lock) => lock,
            // It was removed with its directory, by a broker that stopped.
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                make_ours(&system.dir())?;
                continue;
            }
            Err(error) => {
                return Err(error).with_context(|| format!("cannot open {}", path.display()));
            }
        };
        match fcntl(&lock, FcntlArg::F_SETLK(&write_lock())) {
            Ok(_) => {}
            Err(Errno::EACCES | Errno::EAGAIN) => return Ok(None),
            Err(errno) => {
                return Err(errno).with_context(|| format!("cannot lock {}", path.display()));
            }
        }
        let same = |named: fs::Metadata, held: fs::Metadata| {
            (named.dev(), named.ino()) == (held.dev(), held.ino())
        };
        if fs::metadata(&path)
            .is_ok_and(|named| lock.metadata().is_ok_and(|held| same(named, held)))
        {
            return Ok(Some(lock));
        }
    }
}

/// Removes nodes, bells, peers and the socket. What is left of a file that was
/// being made goes with them.
fn empty(system: &System) -> anyhow::Result<()> {
    for dir in [system.nodes(), system.bells(), system.peers(), system.unfinished()] {
        let entries = match fs::read_dir(&dir) {
            Ok(entries) => entries,
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            Err(error) => {
                return Err(error).with_context(|| format!("cannot read {}", dir.display()));
            }
        };
        for entry in entries {
            let path = entry?.path();
            fs::remove_file(&path).with_context(|| format!("cannot remove {}", path.display()))?;
        }
    }
    for file in [system.socket(), system.reach()] {
        let _ = fs::remove_file(file);
    }
    Ok(())
}

/// The processes whose files are locked: they live. The files of the others are
/// left to whoever adopts the nodes.
fn living(system: &System) -> Vec<Survivor> {
    listed(system).into_iter().filter_map(|peer| survivor(system, peer)).collect()
}

/// A process that lives, by its number.
pub(crate) fn survivor(system: &System, peer: u16) -> Option<Survivor> {
    let pid = match life_of(system, peer) {
        Life::Goes(pid) => pid,
        Life::Unknown => 0,
        Life::Over => return None,
    };
    let name = match fs::read_to_string(system.peer(peer)) {
        Ok(name) if !name.is_empty() => name,
        // Until it has re-joined.
        _ => "a process".into(),
    };
    Some(Survivor { peer, pid, name })
}

/// All processes that have a file.
pub(crate) fn listed(system: &System) -> Vec<u16> {
    let Ok(entries) = fs::read_dir(system.peers()) else { return Vec::new() };
    entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect()
}

/// Whether a process that holds its file locked lives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Life {
    /// It does. Its process id; 0 where the kernel does not say.
    Goes(u32),
    /// Nobody holds the lock: it is dead.
    Over,
    /// It cannot be told now, so nothing of it may be given away.
    Unknown,
}

/// Whether a process lives, by the lock on its file.
pub(crate) fn life_of(system: &System, peer: u16) -> Life {
    let file = File::options()
        .read(true)
        .write(true)
        .custom_flags(libc::O_CLOEXEC | libc::O_NOFOLLOW)
        .open(system.peer(peer));
    let file = match file {
        Ok(file) => file,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Life::Over,
        Err(_) => return Life::Unknown,
    };
    let mut lock = write_lock();
    match fcntl(&file, FcntlArg::F_GETLK(&mut lock)) {
        Err(_) => Life::Unknown,
        Ok(_) if lock.l_type == libc::F_UNLCK as libc::c_short => Life::Over,
        Ok(_) => Life::Goes(lock.l_pid.unsigned_abs()),
    }
}

/// Removes the file of a process that is dead. False: it lives, after all.
///
/// Under its lock: who has been given its number by a broker that died, and was
/// about to lock the file, finds out by it, and joins anew.
pub(crate) fn forget(system: &System, peer: u16) -> bool {
    let path = system.peer(peer);
    let Ok(file) = File::options().read(true).write(true).open(&path) else { return true };
    if fcntl(&file, FcntlArg::F_SETLK(&write_lock())).is_err() {
        return false;
    }
    let _ = fs::remove_file(&path);
    true
}

/// Makes the file that a new process is to lock. Its name is in it, for the next
/// broker; where shared memory is full it goes without, since an empty file
/// takes none: whoever wants to look or to copy must get in then, too.
pub(crate) fn make_peer_file(system: &System, peer: u16, name: &str) -> Result<(), Error> {
    let path = system.peer(peer);
    let made = File::options().write(true).create(true).truncate(true).mode(0o600).open(&path);
    let written = made.and_then(|mut file| match file.write_all(name.as_bytes()) {
        Err(error) if error.kind() == io::ErrorKind::StorageFull => Ok(()),
        written => written,
    });
    written.map_err(|error| no_space(error, &path, name.len(), "make"))
}

/// An error of making a file; where there is no room for it, with the sum.
fn no_space(error: io::Error, path: &Path, size_bytes: usize, action: &'static str) -> Error {
    match error.kind() {
        io::ErrorKind::StorageFull => {
            Error::NoSpace { path: path.into(), needed_bytes: size_bytes as u64 }
        }
        _ => Error::io(action, path, error),
    }
}

fn write_lock() -> libc::flock {
    libc::flock {
        l_type: libc::F_WRLCK as libc::c_short,
        l_whence: libc::SEEK_SET as libc::c_short,
        l_start: 0,
        l_len: 0,
        l_pid: 0,
    }
}

fn random() -> anyhow::Result<u64> {
    let mut bytes = [0; 8];
    let path = "/dev/urandom";
    File::open(path)
        .and_then(|mut file| file.read_exact(&mut bytes))
        .with_context(|| format!("cannot read {path}"))?;
    Ok(u64::from_ne_bytes(bytes))
}

impl Inscription {
    /// Three numbers in words, for people too.
    fn write(&self, mut lock: &File) -> io::Result<()> {
        lock.set_len(0)?;
        lock.rewind()?;
        let boot = u128::from_be_bytes(self.boot_id);
        write!(lock, "version {}\nboot {boot:032x}\nsystem {:016x}\n", self.version, self.system_id)
    }

    /// From the descriptor that holds the lock: opening the file again and
    /// closing it would let go of it.
    fn read(mut lock: &File) -> Option<Self> {
        let mut text = String::new();
        lock.read_to_string(&mut text).ok()?;
        let value = |name: &str| text.lines().find_map(|line| line.strip_prefix(name));
        Some(Self {
            version: value("version ")?.parse().ok()?,
            boot_id: u128::from_str_radix(value("boot ")?, 16).ok()?.to_be_bytes(),
            system_id: u64::from_str_radix(value("system ")?, 16).ok()?,
        })
    }
}
