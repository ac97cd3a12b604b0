//! Subscribe, check and copy, by descriptor.

use std::ffi::{c_int, c_uint, c_void};
use std::mem::MaybeUninit;
use std::time::Duration;

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;
use uorb_core::{Error, Instance, RawSubscription};

use crate::failure::{ERROR, OK, errno_of, fail, fail_aloud};
use crate::handles::{Subscribed, put_subscription, subscription, take_subscription};
use crate::metadata::OrbMetadata;
use crate::session::session;

/// # Safety
///
/// As uORB.h says: `meta` is NULL or a topic's.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn orb_subscribe(meta: *const OrbMetadata) -> c_int {
    // SAFETY: the caller's word.
    unsafe { subscribe("orb_subscribe", meta, 0) }
}

/// # Safety
///
/// As uORB.h says.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn orb_subscribe_multi(
    meta: *const OrbMetadata,
    instance: c_uint,
) -> c_int {
    // SAFETY: the caller's word.
    unsafe { subscribe("orb_subscribe_multi", meta, instance) }
}

/// # Safety
///
/// As uORB.h says.
unsafe fn subscribe(function: &str, meta: *const OrbMetadata, instance: c_uint) -> c_int {
    // SAFETY: the caller's word.
    let Some(meta) = (unsafe { OrbMetadata::from_c(meta) }) else { return fail(Errno::ENOENT) };
    let Some(instance) = u8::try_from(instance).ok().and_then(Instance::new) else {
        let why = format!("there is no instance {instance}");
        return fail_aloud(function, &meta.name(), Errno::EIO, &why);
    };
    let made = follow(meta, instance).and_then(|raw| match raw {
        Some(raw) => open_descriptor(raw).map(Some),
        None => Ok(None),
    });
    let (raw, descriptor) = match made {
        Ok(Some(made)) => made,
        Ok(None) => return fail(Errno::ENOENT),
        Err(error) => return fail_aloud(function, &meta.name(), errno_of(&error), &error),
    };
    match put_subscription(descriptor, Box::new(Subscribed { raw, meta })) {
        // What was closed behind our back goes now. Its descriptor is not its
        // any more, and not ours to close: it is the new one's.
        Ok(closed) => {
            drop(closed);
            descriptor
        }
        Err(refused) => {
            drop(refused);
            close(descriptor);
            let why = "its descriptor's number is too high";
            fail_aloud(function, &meta.name(), Errno::EMFILE, &why)
        }
    }
}

/// A subscription; None: to an optional topic that nobody has described.
pub(crate) fn follow(
    meta: &OrbMetadata,
    instance: Instance,
) -> Result<Option<RawSubscription>, Error> {
    let (session, metadata) = (session()?, meta.describe());
    if meta.is_optional() {
        match session.describe(&metadata.name) {
            Err(Error::NoNode { .. }) => return Ok(None),
            described => drop(described?),
        }
    }
    RawSubscription::subscribe_described(&session, &metadata, instance).map(Some)
}

/// A duplicate of the subscription's descriptor is what C gets: close(2) on it,
/// which is a mistake, then hurts nobody but the caller.
fn open_descriptor(raw: RawSubscription) -> Result<(RawSubscription, c_int), Error> {
    raw.open_descriptor()?;
    let descriptor = fcntl(&raw, FcntlArg::F_DUPFD_CLOEXEC(0))
        .map_err(|errno| Error::io("open", raw.topic().as_ref(), errno.into()))?;
    Ok((raw, descriptor))
}

fn close(descriptor: c_int) {
    // SAFETY: the number is a duplicate that we made. If somebody has closed it
    // before us, the call fails, or does what that mistake always does.
    unsafe { libc::close(descriptor) };
}

#[unsafe(no_mangle)]
pub(crate) extern "C" fn orb_unsubscribe(handle: c_int) -> c_int {
    match take_subscription(handle) {
        Some(subscribed) => {
            // Out of the table before the number is free for others.
            drop(subscribed);
            close(handle);
            OK
        }
        None => fail(Errno::EBADF),
    }
}

/// # Safety
///
/// As uORB.h says: `buffer` is NULL or takes a message.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn orb_copy(
    meta: *const OrbMetadata,
    handle: c_int,
    buffer: *mut c_void,
) -> c_int {
    // SAFETY: the caller's word.
    let Some(meta) = (unsafe { OrbMetadata::from_c(meta) }) else { return fail(Errno::EFAULT) };
    let Some(mut found) = subscription(handle) else { return fail(Errno::EBADF) };
    let subscribed = found.get();
    if !subscribed.meta.is_same_topic(meta) {
        return fail(Errno::EIO);
    }
    // SAFETY: the caller's word.
    if unsafe { copy_to(&mut subscribed.raw, meta, buffer) } { OK } else { fail(Errno::EIO) }
}

/// Copies the next message, or, where there is no buffer, takes all as seen.
///
/// # Safety
///
/// `buffer` is NULL or takes a message of the topic.
pub(crate) unsafe fn copy_to(
    raw: &mut RawSubscription,
    meta: &OrbMetadata,
    buffer: *mut c_void,
) -> bool {
    if buffer.is_null() {
        return raw.skip();
    }
    let buffer = buffer.cast::<MaybeUninit<u8>>();
    // SAFETY: the caller's word: there is room for this many bytes, which need
    // not be initialised.
    raw.copy_to(unsafe { std::slice::from_raw_parts_mut(buffer, meta.size_bytes()) })
}

/// # Safety
///
/// As uORB.h says: `updated` is NULL or can be written.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn orb_check(handle: c_int, updated: *mut bool) -> c_int {
    // SAFETY: the caller's word.
    let Some(updated) = (unsafe { updated.as_mut() }) else { return fail(Errno::EFAULT) };
    *updated = false;
    let Some(mut found) = subscription(handle) else { return fail(Errno::EBADF) };
    *updated = found.get().raw.updated();
    OK
}

/// # Safety
///
/// As uORB.h says: `time` is NULL or can be written.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn orb_stat(handle: c_int, time: *mut u64) -> c_int {
    // SAFETY: the caller's word.
    let Some(time) = (unsafe { time.as_mut() }) else { return fail(Errno::EFAULT) };
    let Some(mut found) = subscription(handle) else { return fail(Errno::EBADF) };
    *time = found.get().raw.last_publish_time_us().unwrap_or(0);
    OK
}

/// # Safety
///
/// As uORB.h says: `priority` is NULL or can be written.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn orb_priority(handle: c_int, priority: *mut i32) -> c_int {
    // SAFETY: the caller's word.
    let Some(priority) = (unsafe { priority.as_mut() }) else { return fail(Errno::EFAULT) };
    let Some(mut found) = subscription(handle) else { return fail(Errno::EBADF) };
    *priority = i32::from(found.get().raw.priority().0);
    OK
}

#[unsafe(no_mangle)]
pub(crate) extern "C" fn orb_set_interval(handle: c_int, interval: c_uint) -> c_int {
    let Some(mut found) = subscription(handle) else { return fail(Errno::EBADF) };
    found.get().raw.set_interval(Duration::from_millis(u64::from(interval)));
    OK
}

/// # Safety
///
/// As uORB.h says: `interval` is NULL or can be written.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn orb_get_interval(handle: c_int, interval: *mut c_uint) -> c_int {
    // SAFETY: the caller's word.
    let Some(interval) = (unsafe { interval.as_mut() }) else { return fail(Errno::EFAULT) };
    let Some(mut found) = subscription(handle) else { return fail(Errno::EBADF) };
    let milliseconds = found.get().raw.interval().as_millis();
    *interval = c_uint::try_from(milliseconds).unwrap_or(c_uint::MAX);
    OK
}

/// # Safety
///
/// As uORB.h says.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn orb_exists(meta: *const OrbMetadata, instance: c_int) -> c_int {
    // SAFETY: the caller's word.
    let Some(meta) = (unsafe { OrbMetadata::from_c(meta) }) else { return fail(Errno::ENOENT) };
    let Some(instance) = u8::try_from(instance).ok().and_then(Instance::new) else {
        return fail(Errno::EINVAL);
    };
    match session().and_then(|session| session.exists(&meta.name(), instance)) {
        Ok(true) => OK,
        Ok(false) => ERROR,
        Err(error) => fail_aloud("orb_exists", &meta.name(), errno_of(&error), &error),
    }
}

/// # Safety
///
/// As uORB.h says.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn orb_group_count(meta: *const OrbMetadata) -> c_int {
    // SAFETY: the caller's word.
    let Some(meta) = (unsafe { OrbMetadata::from_c(meta) }) else { return fail(Errno::ENOENT) };
    match session() {
        Ok(session) => session.group_count(&meta.name()) as c_int,
        Err(error) => fail_aloud("orb_group_count", &meta.name(), errno_of(&error), &error),
    }
}
