//! The time that messages carry.

use nix::time::{ClockId, clock_gettime};

/// Microseconds of CLOCK_MONOTONIC, as PX4's `hrt_absolute_time` counts them
/// on Linux. The same in every process of the machine.
///
/// No system call where the kernel's clock source can be read from user space
/// (`tsc`, `arch_sys_counter`), as nearly everywhere.
#[doc(alias = "hrt_absolute_time")]
#[inline]
pub fn now_us() -> u64 {
    let now = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("every Linux has this clock");
    now.tv_sec() as u64 * 1_000_000 + now.tv_nsec() as u64 / 1_000
}
