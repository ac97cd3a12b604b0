//! What processes leave: files in shared memory, descriptors, mappings.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

pub(crate) struct Traces;

impl Traces {
    /// All names in /dev/shm.
    pub(crate) fn shared_memory() -> BTreeSet<PathBuf> {
        let names = fs::read_dir("/dev/shm").into_iter().flatten().flatten();
        names.map(|entry| entry.path()).collect()
    }

    /// Files of other buses, whose tests run meanwhile.
    pub(crate) fn is_another_s(path: &Path) -> bool {
        let ours = format!("uorb-test-{}-", std::process::id());
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        !name.starts_with(&ours) && (name.starts_with("uorb-") || !name.starts_with("uorb_"))
    }

    /// What a process has open or mapped that is a removed file, or belongs to a
    /// process that has died.
    pub(crate) fn of_the_dead(pid: u32) -> Vec<String> {
        let open = fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
        let open = open.filter_map(|entry| fs::read_link(entry.path()).ok());
        let open = open.map(|target| target.to_string_lossy().into_owned());
        let maps = fs::read_to_string(format!("/proc/{pid}/maps")).unwrap_or_default();
        let mapped: Vec<String> = maps
            .lines()
            .filter_map(|line| line.split_once('/').map(|(_, path)| format!("/{path}")))
            .collect();
        let all = open.chain(mapped);
        all.filter(|name| name.ends_with(" (deleted)") && name.contains("/dev/shm")).collect()
    }
}
