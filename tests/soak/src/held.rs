//! What a process holds, and what counts as growth.
//!
//! The rule: at the end each process has exactly the descriptors that it had
//! after the first minute, and not more memory than then by more than 512 KiB
//! and a fiftieth. The first minute is for what is taken once: stacks, queues,
//! pages of the rings.

use std::fs;

use anyhow::{Context as _, Result};

const GROWTH_KIB: u64 = 512;

/// One look at a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Held {
    pub(crate) memory_kib: u64,
    pub(crate) descriptors: u64,
}

impl Held {
    pub(crate) fn by(pid: u32) -> Result<Self> {
        let status = fs::read_to_string(format!("/proc/{pid}/status"))
            .with_context(|| format!("process {pid} is gone"))?;
        let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        let memory_kib = resident
            .and_then(|rest| rest.split_whitespace().next()?.parse().ok())
            .with_context(|| format!("process {pid} has ended"))?;
        let descriptors = fs::read_dir(format!("/proc/{pid}/fd"))
            .with_context(|| format!("the descriptors of process {pid} cannot be listed"))?;
        Ok(Self { memory_kib, descriptors: descriptors.count() as u64 })
    }

    /// What has grown since, in words.
    pub(crate) fn grown_since(self, before: Self) -> Option<String> {
        let allowed = before.memory_kib + GROWTH_KIB.max(before.memory_kib / 50);
        if self.descriptors != before.descriptors {
            Some(format!("descriptors {} -> {}", before.descriptors, self.descriptors))
        } else if self.memory_kib > allowed {
            Some(format!("memory {} -> {} KiB", before.memory_kib, self.memory_kib))
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_descriptor_more_is_growth_and_some_pages_are_not() {
        let before = Held { memory_kib: 4_000, descriptors: 10 };
        let now = |memory_kib, descriptors| Held { memory_kib, descriptors }.grown_since(before);
        assert_eq!(now(4_512, 10), None);
        assert_eq!(now(4_513, 10).as_deref(), Some("memory 4000 -> 4513 KiB"));
        assert_eq!(now(4_000, 11).as_deref(), Some("descriptors 10 -> 11"));
        assert!(now(4_000, 9).is_some(), "a descriptor that is gone is a wonder, too");
    }
}
