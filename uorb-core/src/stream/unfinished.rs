//! What in the memory of streams was begun and never finished.
//!
//! iceoryx2 makes a file first, and gives it a size then. Where somebody was killed
//! between the two, 0.10 waits for the size for ever, whoever opens the file, and
//! so does its own cleaning up; when the file is gone they all go on.

use std::fs;
use std::path::PathBuf;
use std::time::{Duration, SystemTime};

use super::world::{SHM, World};

/// What iceoryx2 puts between the prefix and the rest of a name.
const HASH_DIGITS: usize = 40;

/// How long a file may take to get its size. What
/// takes longer belongs to somebody who was killed.
const FINISHED_WITHIN: Duration = Duration::from_secs(1);

/// File systems write times down by a clock that ticks: what is made within a tick
/// of the last change cannot be told from it. No kernel's tick is longer.
const TICK: Duration = Duration::from_millis(20);

/// Removes the unfinished files of a world.
#[derive(Debug)]
pub struct Unfinished {
    world: World,
    /// When a name was last made in shared memory, where nothing was unfinished
    /// after that.
    nothing_since: Option<SystemTime>,
}

impl Unfinished {
    /// Those of `world`.
    pub fn of(world: World) -> Self {
        Self { world, nothing_since: None }
    }

    /// Removes what was begun a second ago and has no size. Where nobody has made
    /// a file since the last look, this is one system call.
    pub fn remove(&mut self) {
        let changed = changed_at();
        if changed.is_some() && changed == self.nothing_since {
            return;
        }
        let is_certain = |at: &SystemTime| at.elapsed().is_ok_and(|since| since > TICK);
        let certain = changed.filter(is_certain);
        let found = self.find();
        self.nothing_since = certain.filter(|_| found.is_empty());
        let old = found.into_iter().filter(|(_, age)| *age >= FINISHED_WITHIN);
        old.for_each(|(path, _)| _ = fs::remove_file(path));
    }

    /// The files without a size, and how old they are. Only of this world: the
    /// default one's prefix begins those of others, too, but what follows it is
    /// a hash.
    fn find(&self) -> Vec<(PathBuf, Duration)> {
        let is_of_this_world = |path: &PathBuf| {
            let name = path.file_name().unwrap_or_default().as_encoded_bytes();
            let rest = name.get(self.world.prefix.len()..);
            let hash = rest.and_then(|rest| rest.get(..HASH_DIGITS + 1));
            hash.is_some_and(|hash| {
                hash.ends_with(b"_") && hash[..HASH_DIGITS].iter().all(u8::is_ascii_hexdigit)
            })
        };
        let unfinished = |path: PathBuf| {
            let file = fs::metadata(&path).ok()?;
            let age = file.modified().ok()?.elapsed().unwrap_or_default();
            (file.len() == 0).then_some((path, age))
        };
        self.world.names().filter(is_of_this_world).filter_map(unfinished).collect()
    }
}

/// When a name was last made or removed in shared memory.
fn changed_at() -> Option<SystemTime> {
    fs::metadata(SHM).and_then(|folder| folder.modified()).ok()
}
