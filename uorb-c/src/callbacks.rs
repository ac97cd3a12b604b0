//! Callbacks: a thread that waits for all registered topics and calls.
//!
//! In PX4 a callback runs in the thread that publishes. A publisher here is
//! another process, so one thread of the subscriber's runs them all, one after
//! the other.

use std::collections::HashMap;
use std::ffi::{c_int, c_uint, c_void};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::{self, ThreadId};

use nix::errno::Errno;
use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags, EpollTimeout};
use nix::sys::signal::{SigSet, SigmaskHow, pthread_sigmask};
use uorb_core::{Error, Instance, RawSubscription};

use crate::failure::{errno_of, fail, fail_aloud};
use crate::metadata::OrbMetadata;
use crate::per_process::PerProcess;
use crate::subscriptions::follow;

type Call = unsafe extern "C" fn(*mut c_void);

/// One callback.
struct Registered {
    raw: Mutex<RawSubscription>,
    call: Call,
    argument: *mut c_void,
    /// Held while it is called.
    calling: Mutex<()>,
    is_over: AtomicBool,
}

// SAFETY: the argument is handed back to C as it came, in the library's thread,
// which is what the caller has asked for.
unsafe impl Send for Registered {}
// SAFETY: as above; nothing here looks behind the pointer.
unsafe impl Sync for Registered {}

impl Registered {
    /// Calls, if there is anything new.
    fn look(&self) {
        let _calling = self.calling.lock().unwrap_or_else(PoisonError::into_inner);
        if self.is_over.load(Ordering::Acquire) {
            return;
        }
        let mut raw = self.raw.lock().unwrap_or_else(PoisonError::into_inner);
        if !raw.updated() {
            return;
        }
        raw.skip();
        // It may unregister, which closes the subscription.
        drop(raw);
        // SAFETY: whoever registered it said that it may be called with this.
        unsafe { (self.call)(self.argument) };
    }
}

#[derive(Default)]
struct Callbacks {
    registered: Mutex<(HashMap<c_int, Arc<Registered>>, c_int)>,
    thread: OnceLock<Result<(Epoll, OnceLock<ThreadId>), Errno>>,
}

static CALLBACKS: PerProcess<Callbacks> = PerProcess::new();

impl Callbacks {
    /// The epoll instance of the thread, which runs from now on.
    fn epoll(&'static self) -> Result<&'static Epoll, Error> {
        let failed = |errno: &Errno| Error::io("start", "callbacks".as_ref(), (*errno).into());
        let mut is_new = false;
        let made = self.thread.get_or_init(|| {
            is_new = true;
            Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC).map(|epoll| (epoll, OnceLock::new()))
        });
        let (epoll, id) = made.as_ref().map_err(failed)?;
        if is_new {
            let thread = thread::Builder::new().name("uorb callbacks".into());
            let started = thread.spawn(|| self.run(epoll));
            let started =
                started.map_err(|error| Error::io("start", "callbacks".as_ref(), error))?;
            let _ = id.set(started.thread().id());
        }
        Ok(epoll)
    }

    fn run(&self, epoll: &Epoll) {
        // The program's signals are for its own threads.
        let _ = pthread_sigmask(SigmaskHow::SIG_BLOCK, Some(&SigSet::all()), None);
        let mut events = [EpollEvent::empty(); 16];
        loop {
            let count = epoll.wait(&mut events, EpollTimeout::NONE).unwrap_or(0);
            for event in &events[..count] {
                let registered = self.registered.lock().unwrap_or_else(PoisonError::into_inner);
                let found = registered.0.get(&(event.data() as c_int)).cloned();
                drop(registered);
                if let Some(found) = found {
                    found.look();
                }
            }
        }
    }

    fn is_own_thread(&self) -> bool {
        let Some(Ok((_, id))) = self.thread.get() else { return false };
        id.get() == Some(&thread::current().id())
    }

    fn register(&'static self, registered: Registered) -> Result<c_int, Error> {
        let epoll = self.epoll()?;
        let registered = Arc::new(registered);
        let mut all = self.registered.lock().unwrap_or_else(PoisonError::into_inner);
        all.1 += 1;
        let number = all.1;
        all.0.insert(number, registered.clone());
        drop(all);
        let raw = registered.raw.lock().unwrap_or_else(PoisonError::into_inner);
        let event = EpollEvent::new(EpollFlags::EPOLLIN, number as u64);
        let added = raw.open_descriptor().and_then(|()| {
            let failed = |errno: Errno| Error::io("watch", raw.topic().as_ref(), errno.into());
            epoll.add(&*raw, event).map_err(failed)
        });
        drop(raw);
        added.map(|()| number).inspect_err(|_| self.unregister(number))
    }

    fn unregister(&self, number: c_int) {
        let mut all = self.registered.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(found) = all.0.remove(&number) else { return };
        drop(all);
        found.is_over.store(true, Ordering::Release);
        // In a callback nothing else runs, and the one that does holds this.
        if !self.is_own_thread() {
            drop(found.calling.lock().unwrap_or_else(PoisonError::into_inner));
        }
    }
}

/// # Safety
///
/// As uORBFollower.h says: `meta` is NULL or a topic's, and `call` may be called
/// with `argument` until it is unregistered.
#[unsafe(no_mangle)]
pub(crate) unsafe extern "C" fn uorb_register_callback(
    meta: *const OrbMetadata,
    instance: c_uint,
    call: Option<Call>,
    argument: *mut c_void,
) -> c_int {
    // SAFETY: the caller's word.
    let Some(meta) = (unsafe { OrbMetadata::from_c(meta) }) else { return fail(Errno::ENOENT) };
    let Some(call) = call else { return fail(Errno::EFAULT) };
    let Some(instance) = u8::try_from(instance).ok().and_then(Instance::new) else {
        return fail(Errno::EIO);
    };
    let made = follow(meta, instance).and_then(|raw| match raw {
        None => Ok(None),
        Some(mut raw) => {
            // What was published before is no news.
            raw.skip();
            let (raw, calling, is_over) = (Mutex::new(raw), Mutex::new(()), AtomicBool::new(false));
            let registered = Registered { raw, call, argument, calling, is_over };
            CALLBACKS.get().register(registered).map(Some)
        }
    });
    match made {
        Ok(Some(number)) => number,
        Ok(None) => fail(Errno::ENOENT),
        Err(error) => fail_aloud("register_callback", &meta.name(), errno_of(&error), &error),
    }
}

#[unsafe(no_mangle)]
pub(crate) extern "C" fn uorb_unregister_callback(registration: c_int) {
    CALLBACKS.get().unregister(registration);
}
