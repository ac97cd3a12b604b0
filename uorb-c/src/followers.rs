//! Subscriptions without a descriptor: what uORBFollower.h says of them.

use std::ffi::{c_int, c_uint, c_void};
use std::time::Duration;

use nix::errno::Errno;
use uorb_core::{Instance, RawSubscription, poll};

use crate::failure::{errno_of, fail, fail_aloud};
use crate::metadata::OrbMetadata;
use crate::session::session;
use crate::subscriptions::{copy_to, follow};

/// What C sees as `struct uorb_follower`.
#[derive(Debug)]
pub(crate) struct Follower {
    raw: RawSubscription,
    meta: &'static OrbMetadata,
}

/// # Safety
///
/// As uORBFollower.h says: `meta` is NULL or a topic's.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn uorb_follow(
    meta: *const OrbMetadata,
    instance: c_uint,
    make: bool,
) -> *mut Follower {
    // SAFETY: the caller's word.
    match unsafe { try_follow(meta, instance, make) } {
        Some(follower) => Box::into_raw(Box::new(follower)),
        None => std::ptr::null_mut(),
    }
}

/// # Safety
///
/// As uORBFollower.h says.
unsafe fn try_follow(meta: *const OrbMetadata, instance: c_uint, make: bool) -> Option<Follower> {
    let refuse = |errno| {
        fail(errno);
        None
    };
    // SAFETY: the caller's word.
    let Some(meta) = (unsafe { OrbMetadata::from_c(meta) }) else { return refuse(Errno::ENOENT) };
    let Some(instance) = u8::try_from(instance).ok().and_then(Instance::new) else {
        return refuse(Errno::EIO);
    };
    let followed = session().and_then(|session| {
        if !make && !session.system().node(&meta.name(), instance).exists() {
            return Ok(None);
        }
        follow(meta, instance)
    });
    match followed {
        Ok(Some(raw)) => Some(Follower { raw, meta }),
        Ok(None) => refuse(Errno::ENOENT),
        Err(error) => {
            fail_aloud("subscribe", &meta.name(), errno_of(&error), &error);
            None
        }
    }
}

/// # Safety
///
/// As uORBFollower.h says: `follower` is NULL or one that was not ended.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn uorb_unfollow(follower: *mut Follower) {
    if !follower.is_null() {
        // SAFETY: it comes from `uorb_follow`, and this is its end.
        drop(unsafe { Box::from_raw(follower) });
    }
}

/// # Safety
///
/// As uORBFollower.h says: `follower` is one that was not ended.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn uorb_updates(follower: *mut Follower) -> c_uint {
    // SAFETY: the caller's word; one thread uses it at a time.
    let raw = unsafe { &mut (*follower).raw };
    if !raw.updated() {
        return 0;
    }
    c_uint::try_from(raw.pending()).unwrap_or(c_uint::MAX)
}

/// # Safety
///
/// As uORBFollower.h says: besides, `message` takes a message of the topic.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn uorb_copy(follower: *mut Follower, message: *mut c_void) -> bool {
    // SAFETY: the caller's word.
    let follower = unsafe { &mut *follower };
    // SAFETY: the caller's word.
    unsafe { copy_to(&mut follower.raw, follower.meta, message) }
}

/// # Safety
///
/// As uORBFollower.h says.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn uorb_advertised(follower: *mut Follower) -> bool {
    // SAFETY: the caller's word.
    unsafe { &mut (*follower).raw }.advertised()
}

/// # Safety
///
/// As uORBFollower.h says.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn uorb_generation(follower: *const Follower) -> c_uint {
    // SAFETY: the caller's word.
    unsafe { &(*follower).raw }.generation().get()
}

/// # Safety
///
/// As uORBFollower.h says.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn uorb_wait(follower: *mut Follower, timeout_us: i64) -> c_int {
    // SAFETY: the caller's word.
    let raw = unsafe { &mut (*follower).raw };
    let timeout = u64::try_from(timeout_us).ok().map(Duration::from_micros);
    match poll(&mut [raw], timeout) {
        Ok(updated) => c_int::from(updated > 0),
        Err(error) => fail(errno_of(&error)),
    }
}
