//! Room for streams in shared memory.
//!
//! iceoryx2 makes its files sparse, and a page that a full /dev/shm cannot give
//! is SIGBUS at the first touch. So the pages of a port are taken here before
//! they are touched, with an error where there are none: all of them when a
//! port for ordinary messages is opened, those of one message at a time for
//! large ones.

use nix::errno::Errno;
use nix::sys::statvfs::statvfs;

use super::world::SHM;
use crate::error::Error;
use crate::mapping::page_bytes;

/// What the files of a port and its connections take besides the messages.
const OVERHEAD_BYTES: u64 = 1 << 20;

/// Fails where shared memory has not this much left for `name`.
pub(crate) fn check_room(name: &str, needed_bytes: u64) -> Result<(), Error> {
    let needed_bytes = needed_bytes + OVERHEAD_BYTES;
    let free_bytes = statvfs(SHM)
        .map_err(|errno| Error::io("look at", SHM.as_ref(), errno.into()))
        .map(|room| room.blocks_available() * room.fragment_size())?;
    if free_bytes < needed_bytes {
        return Err(no_room(name, needed_bytes));
    }
    Ok(())
}

pub(crate) fn no_room(name: &str, needed_bytes: u64) -> Error {
    Error::NoSpace { path: format!("the stream of {name}").into(), needed_bytes }
}

/// The start and end of the mapping that an address is in.
pub(crate) fn mapping_of(address: usize) -> Option<(usize, usize)> {
    let maps = std::fs::read_to_string("/proc/self/maps").ok()?;
    maps.lines().find_map(|line| {
        // 7f2a9ebd8000-7f2ae0bd9000 rw-s 00000000 00:1b 14449 /dev/shm/...
        let (start, end) = line.split(' ').next()?.split_once('-')?;
        let start = usize::from_str_radix(start, 16).ok()?;
        let end = usize::from_str_radix(end, 16).ok()?;
        (start..end).contains(&address).then_some((start, end))
    })
}

/// Takes the pages from `start` to `end` of a shared mapping. `false`: there is
/// no room for them.
pub(crate) fn populate(start: usize, end: usize) -> Result<bool, Errno> {
    /// Linux 5.14 and later; libc has it for some targets only.
    const MADV_POPULATE_WRITE: libc::c_int = 23;
    let first = start - start % page_bytes();
    let end = end.next_multiple_of(page_bytes());
    // SAFETY: this advice changes no content: it faults pages in as a write
    // would. The range is that of a mapping of ours (EFAULT or ENOMEM if not).
    let advised =
        unsafe { libc::madvise(first as *mut libc::c_void, end - first, MADV_POPULATE_WRITE) };
    match Errno::result(advised) {
        Ok(_) => Ok(true),
        // What would have been SIGBUS.
        Err(Errno::EFAULT) => Ok(false),
        Err(errno) => Err(errno),
    }
}
