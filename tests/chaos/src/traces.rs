//! What processes leave: files in shared memory, descriptors, mappings.

use std::fs;

pub(crate) struct Traces;

impl Traces {
    /// What a world of iceoryx2 has in /dev/shm.
    pub(crate) fn of_world(prefix: &str) -> Vec<String> {
        let names = fs::read_dir("/dev/shm").into_iter().flatten().flatten();
        let names = names.filter_map(|entry| entry.file_name().into_string().ok());
        names.filter(|name| name.starts_with(prefix)).collect()
    }

    /// How many descriptors a process has, and mappings of shared memory.
    pub(crate) fn held_by(pid: u32) -> (usize, usize) {
        let open = fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().count();
        let maps = fs::read_to_string(format!("/proc/{pid}/maps")).unwrap_or_default();
        (open, maps.lines().filter(|line| line.contains("/dev/shm/")).count())
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
