//! A part of a file in shared memory, as a table of 64-bit words.
//!
//! Shared memory is never a `&mut T` here: other processes write it while we
//! look. It is a slice of atomics, which is what any bytes can be.

#![allow(unsafe_code)]

use std::fs::File;
use std::num::NonZeroUsize;
use std::ops::Range;
use std::os::raw::c_void;
use std::ptr::NonNull;
use std::sync::atomic::AtomicU64;

use nix::sys::mman::{MapFlags, ProtFlags, mmap, munmap};

/// Who may write a mapping: this process, or only others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Access {
    ReadOnly,
    ReadWrite,
}

/// A mapped part of a file. Unmapped on drop.
#[derive(Debug)]
pub(crate) struct Mapping {
    start: NonNull<c_void>,
    length_bytes: NonZeroUsize,
}

// SAFETY: the mapping is plain memory, handed out as atomics only, and it is
// unmapped when its one owner is dropped, on whatever thread.
unsafe impl Send for Mapping {}
// SAFETY: as above; `words` needs no more than a shared reference.
unsafe impl Sync for Mapping {}

impl Mapping {
    /// Maps the bytes `range` of the file, which start on a page. The pages are
    /// read in at once, so that no later access waits for the kernel.
    pub(crate) fn new(file: &File, range: Range<usize>, access: Access) -> nix::Result<Self> {
        let length_bytes = NonZeroUsize::new(range.len()).ok_or(nix::errno::Errno::EINVAL)?;
        let protection = match access {
            Access::ReadOnly => ProtFlags::PROT_READ,
            Access::ReadWrite => ProtFlags::PROT_READ | ProtFlags::PROT_WRITE,
        };
        let flags = MapFlags::MAP_SHARED | MapFlags::MAP_POPULATE;
        // SAFETY: a new mapping at an address of the kernel's choice takes no
        // memory that Rust knows of.
        let start =
            unsafe { mmap(None, length_bytes, protection, flags, file, range.start as i64)? };
        Ok(Self { start, length_bytes })
    }

    /// The mapped words. Storing into those of a read-only mapping is SIGSEGV.
    #[inline]
    pub(crate) fn words(&self) -> &[AtomicU64] {
        let words = self.length_bytes.get() / size_of::<AtomicU64>();
        // SAFETY: the mapping is page aligned, this long, and lives as long as
        // `self`. Any bytes are valid atomics, and other processes write them
        // only as memory does.
        unsafe { std::slice::from_raw_parts(self.start.as_ptr().cast(), words) }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: `words` borrows from `self`, so nobody holds a reference into
        // the mapping any more.
        let unmapped = unsafe { munmap(self.start, self.length_bytes.get()) };
        debug_assert!(unmapped.is_ok(), "the range was mapped by us: {unmapped:?}");
    }
}

/// The bytes of a page on this machine: 4 KiB, on some aarch64 16 or 64 KiB.
pub(crate) fn page_bytes() -> usize {
    // SAFETY: sysconf only reads.
    let bytes = unsafe { libc::sysconf(libc::_SC_PAGESIZE) };
    usize::try_from(bytes).expect("every Linux knows its page size")
}
