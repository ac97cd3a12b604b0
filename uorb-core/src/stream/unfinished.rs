//! What in the memory of streams was begun and never finished.
//!
//! iceoryx2 makes a file first, and finishes it then: one in shared memory gets a
//! size, the description of a service loses the right to be written. Where somebody
//! was killed between the two, 0.10 waits for the size for ever, whoever opens the
//! file, and so does its own cleaning up; and a service whose description is not
//! finished can neither be opened nor made. When the file is gone they all go on.

use std::fs::{self, Metadata};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use super::world::{SHM, World};

/// What iceoryx2 puts between the prefix and the rest of a name.
const HASH_DIGITS: usize = 40;

/// The rights that the description of a service has until it is finished.
const UNFINISHED_MODE: u32 = 0o600;

/// How long a file may take to be finished. What takes longer belongs to somebody
/// who was killed.
const FINISHED_WITHIN: Duration = Duration::from_secs(1);

/// File systems write times down by a clock that ticks: what is made within a tick
/// of the last change cannot be told from it. No kernel's tick is longer.
const TICK: Duration = Duration::from_millis(20);

/// Removes the unfinished files of a world.
#[derive(Debug)]
pub struct Unfinished {
    world: World,
    memory: Folder,
    services: Folder,
}

impl Unfinished {
    /// Those of `world`.
    pub fn of(world: World) -> Self {
        let services = world.root.join("services");
        Self { world, memory: Folder::new(SHM.into()), services: Folder::new(services) }
    }

    /// Removes what was begun a second ago and is not finished. Where nobody has
    /// made a file since the last look, this is two system calls. What was removed.
    pub fn remove(&mut self) -> Vec<PathBuf> {
        let world = &self.world;
        let mut removed = self.memory.remove(|path, file| file.len() == 0 && is_of(world, path));
        let is_service =
            |path: &Path, file: &Metadata| is_unfinished_service(file) && is_of(world, path);
        removed.extend(self.services.remove(is_service));
        removed
    }

    /// Removes the descriptions of services that are not finished, however new they
    /// are. For a broker that starts: nobody else makes services in a private world.
    /// What was removed.
    pub fn remove_services(&self) -> Vec<PathBuf> {
        if !self.world.is_private() {
            return Vec::new();
        }
        removed(self.services.find(&|_, file| is_unfinished_service(file)).into_iter())
    }
}

/// Whether a file is of this world and no other: the default one's prefix begins
/// those of others, too, but what follows it is a hash.
fn is_of(world: &World, path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().as_encoded_bytes();
    let rest = name.strip_prefix(world.prefix.as_bytes()).unwrap_or_default();
    let digits = rest.iter().take_while(|byte| byte.is_ascii_hexdigit()).count();
    digits == HASH_DIGITS && matches!(rest.get(digits), Some(b'_' | b'.'))
}

fn is_unfinished_service(file: &Metadata) -> bool {
    file.is_file() && file.permissions().mode() & 0o777 == UNFINISHED_MODE
}

fn removed(found: impl Iterator<Item = (PathBuf, Duration)>) -> Vec<PathBuf> {
    found.filter_map(|(path, _)| fs::remove_file(&path).is_ok().then_some(path)).collect()
}

/// A folder in which files are made.
#[derive(Debug)]
struct Folder {
    path: PathBuf,
    /// When a name was last made or removed there, where nothing was unfinished
    /// after that.
    nothing_since: Option<SystemTime>,
}

impl Folder {
    fn new(path: PathBuf) -> Self {
        Self { path, nothing_since: None }
    }

    fn remove(&mut self, is_unfinished: impl Fn(&Path, &Metadata) -> bool) -> Vec<PathBuf> {
        let changed = fs::metadata(&self.path).and_then(|folder| folder.modified()).ok();
        if changed.is_some() && changed == self.nothing_since {
            return Vec::new();
        }
        let is_certain = |at: &SystemTime| at.elapsed().is_ok_and(|since| since > TICK);
        let certain = changed.filter(is_certain);
        let found = self.find(&is_unfinished);
        self.nothing_since = certain.filter(|_| found.is_empty());
        removed(found.into_iter().filter(|(_, age)| *age >= FINISHED_WITHIN))
    }

    /// The unfinished files, and how old they are.
    fn find(&self, is_unfinished: &dyn Fn(&Path, &Metadata) -> bool) -> Vec<(PathBuf, Duration)> {
        let entries = fs::read_dir(&self.path).into_iter().flatten().flatten();
        let unfinished = |path: PathBuf| {
            let file = fs::metadata(&path).ok()?;
            let age = file.modified().ok()?.elapsed().unwrap_or_default();
            is_unfinished(&path, &file).then_some((path, age))
        };
        entries.filter_map(|entry| unfinished(entry.path())).collect()
    }
}
