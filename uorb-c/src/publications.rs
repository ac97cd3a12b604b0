//! Advertise and publish.

use std::ffi::{c_int, c_uint, c_void};

use nix::errno::Errno;
use uorb_core::{
    AdvertiseOptions, Claim, Error, Instance, Priority, QueueLength, RawPublication,
    SharedPublication,
};

use crate::failure::{ERROR, OK, errno_of, fail, fail_aloud};
use crate::handles::{Advertised, end_publication, publication, put_publication};
use crate::metadata::OrbMetadata;
use crate::session::session;
use crate::signals::NoSignals;

/// # Safety
///
/// As uORB.h says: `meta` is NULL or a topic's, `data` NULL or a message.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn orb_advertise(
    meta: *const OrbMetadata,
    data: *const c_void,
) -> c_int {
    // SAFETY: the caller's word.
    unsafe { advertise("orb_advertise", meta, data, AdvertiseOptions::default(), None) }
}

/// # Safety
///
/// As uORB.h says.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn orb_advertise_queue(
    meta: *const OrbMetadata,
    data: *const c_void,
    queue_size: c_uint,
) -> c_int {
    let options = AdvertiseOptions {
        queue_length: Some(QueueLength::at_least(queue_size)),
        ..AdvertiseOptions::default()
    };
    // SAFETY: the caller's word.
    unsafe { advertise("orb_advertise_queue", meta, data, options, None) }
}

/// # Safety
///
/// As uORB.h says: besides, `instance` is NULL or can be written.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn orb_advertise_multi(
    meta: *const OrbMetadata,
    data: *const c_void,
    instance: *mut c_int,
    priority: c_int,
) -> c_int {
    let options = options(instance, priority, None);
    // SAFETY: the caller's word.
    unsafe { advertise("orb_advertise_multi", meta, data, options, instance.as_mut()) }
}

/// # Safety
///
/// As uORB.h says.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn orb_advertise_multi_queue(
    meta: *const OrbMetadata,
    data: *const c_void,
    instance: *mut c_int,
    priority: c_int,
    queue_size: c_uint,
) -> c_int {
    let options = options(instance, priority, Some(QueueLength::at_least(queue_size)));
    // SAFETY: the caller's word.
    unsafe { advertise("orb_advertise_multi_queue", meta, data, options, instance.as_mut()) }
}

fn options(
    instance: *mut c_int,
    priority: c_int,
    queue_length: Option<QueueLength>,
) -> AdvertiseOptions {
    let claim = if instance.is_null() { Claim::Shared(Instance::FIRST) } else { Claim::Lowest };
    let priority = Priority(priority.clamp(0, i32::from(u8::MAX)) as u8);
    AdvertiseOptions { claim, priority, queue_length }
}

/// # Safety
///
/// As uORB.h says.
unsafe fn advertise(
    function: &str,
    meta: *const OrbMetadata,
    data: *const c_void,
    options: AdvertiseOptions,
    instance: Option<&mut c_int>,
) -> c_int {
    // SAFETY: the caller's word.
    let Some(meta) = (unsafe { OrbMetadata::from_c(meta) }) else { return fail(Errno::ENOENT) };
    let made = session().and_then(|session| {
        let raw = RawPublication::advertise(&session, &meta.describe(), options)?;
        let shared = SharedPublication::new(raw);
        if !data.is_null() {
            // SAFETY: the caller's word: a message of the topic.
            unsafe { publish(&shared, meta, data) }?;
        }
        Ok(shared)
    });
    let shared = match made {
        Ok(shared) => shared,
        Err(error) => return fail_aloud(function, &meta.name(), errno_of(&error), &error),
    };
    if let Some(instance) = instance {
        *instance = c_int::from(shared.raw().instance().number());
    }
    put_publication(Box::new(Advertised { shared, meta })).unwrap_or_else(|_| {
        fail_aloud(function, &meta.name(), Errno::EMFILE, &"the process has too many publications")
    })
}

/// # Safety
///
/// `data` is a message of the topic.
#[inline]
unsafe fn publish(
    shared: &SharedPublication,
    meta: &OrbMetadata,
    data: *const c_void,
) -> Result<(), Error> {
    // SAFETY: the caller's word, and a message has this many bytes.
    let message = unsafe { std::slice::from_raw_parts(data.cast::<u8>(), meta.size_bytes()) };
    shared.publish(message, NoSignals::outside_of_handlers).map(|_| ())
}

#[unsafe(no_mangle)]
pub(crate) extern "C" fn orb_unadvertise(handle: c_int) -> c_int {
    if handle <= 0 {
        return fail(Errno::EINVAL);
    }
    if end_publication(handle) { OK } else { fail(Errno::EBADF) }
}

/// # Safety
///
/// As uORB.h says.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn orb_publish(
    meta: *const OrbMetadata,
    handle: c_int,
    data: *const c_void,
) -> c_int {
    // SAFETY: the caller's word.
    let meta = unsafe { OrbMetadata::from_c(meta) };
    let Some(meta) = meta.filter(|_| handle > 0 && !data.is_null()) else {
        return fail(Errno::EFAULT);
    };
    let Some(advertised) = publication(handle) else { return fail(Errno::EBADF) };
    if !advertised.meta.is_same_topic(meta) {
        return fail(Errno::EINVAL);
    }
    // A signal handler has to leave errno as it was.
    let errno = Errno::last();
    // SAFETY: the caller's word.
    match unsafe { publish(&advertised.shared, meta, data) } {
        Ok(()) => {
            errno.set();
            OK
        }
        Err(error) => fail(errno_of(&error)),
    }
}

/// # Safety
///
/// As uORB.h says: besides, `handle` is NULL or a publication, or a number that
/// is none yet.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn orb_publish_auto(
    meta: *const OrbMetadata,
    handle: *mut c_int,
    data: *const c_void,
    instance: *mut c_int,
    priority: c_int,
) -> c_int {
    // SAFETY: the caller's word.
    let Some(handle) = (unsafe { handle.as_mut() }) else { return fail(Errno::EFAULT) };
    if *handle > 0 {
        // SAFETY: the caller's word.
        return unsafe { orb_publish(meta, *handle, data) };
    }
    // SAFETY: the caller's word.
    *handle = unsafe { orb_advertise_multi(meta, data, instance, priority) };
    if *handle > 0 { OK } else { ERROR }
}

#[unsafe(no_mangle)]
pub(crate) extern "C" fn orb_get_instance(handle: c_int) -> c_int {
    match publication(handle) {
        Some(advertised) => c_int::from(advertised.shared.raw().instance().number()),
        None => fail(Errno::EBADF),
    }
}
