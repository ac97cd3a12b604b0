//! From the numbers that C holds to what they stand for.
//!
//! Both tables grow by chunks that never move and never go, so that looking a
//! number up takes no lock: a publish in a signal handler may have interrupted
//! anything. A number that stands for nothing, or for nothing any more, is
//! found out here.

use std::ffi::c_int;
use std::ops::Deref;
use std::sync::atomic::{AtomicI32, AtomicPtr, AtomicU32, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};
use std::thread;
use std::time::Duration;

use uorb_core::{RawSubscription, SharedPublication};

use crate::metadata::OrbMetadata;
use crate::per_process::{PerProcess, is_child};

const CHUNK: usize = 1_024;

/// How often, and how long between, the child of a fork looks whether something
/// is still in use: a thread of the parent that was using it does not exist.
const PATIENCE: u32 = 1_000;
const LOOK_INTERVAL: Duration = Duration::from_micros(50);

/// An array that grows: `CHUNKS` chunks, each made when it is first needed.
struct Growing<T: 'static, const CHUNKS: usize> {
    chunks: [AtomicPtr<[T; CHUNK]>; CHUNKS],
}

impl<T: Default + Sync, const CHUNKS: usize> Growing<T, CHUNKS> {
    const fn new() -> Self {
        Self { chunks: [const { AtomicPtr::new(std::ptr::null_mut()) }; CHUNKS] }
    }

    /// The element, if its chunk is there.
    fn get(&'static self, index: usize) -> Option<&'static T> {
        let chunk = self.chunks.get(index / CHUNK)?.load(Ordering::Acquire);
        // SAFETY: what is stored here comes from a box that nobody frees; NULL
        // is none.
        unsafe { chunk.as_ref() }.map(|chunk| &chunk[index % CHUNK])
    }

    /// The element, whose chunk is made if need be; None beyond the last chunk.
    fn make(&'static self, index: usize) -> Option<&'static T> {
        let place = self.chunks.get(index / CHUNK)?;
        if place.load(Ordering::Acquire).is_null() {
            let chunk: Box<[T; CHUNK]> = Box::new(std::array::from_fn(|_| T::default()));
            let chunk = Box::into_raw(chunk);
            let was = std::ptr::null_mut();
            if place.compare_exchange(was, chunk, Ordering::AcqRel, Ordering::Acquire).is_err() {
                // SAFETY: it comes from `Box::into_raw`, and nobody has seen it.
                drop(unsafe { Box::from_raw(chunk) });
            }
        }
        self.get(index)
    }
}

// Subscriptions: by descriptor.

/// A subscription of the C API.
pub(crate) struct Subscribed {
    pub(crate) raw: RawSubscription,
    pub(crate) meta: &'static OrbMetadata,
}

/// Its place in the table. Locked while it is used, not while it sleeps.
pub(crate) type Place = Mutex<Option<Box<Subscribed>>>;

/// As many descriptors as Linux lets a process have, unless it is told otherwise
/// (fs.nr_open).
static SUBSCRIPTIONS: Growing<Place, 1_024> = Growing::new();

/// The subscription of a descriptor, locked. None: it is none.
pub(crate) fn subscription(descriptor: c_int) -> Option<SubscribedGuard> {
    let place = SUBSCRIPTIONS.get(usize::try_from(descriptor).ok()?)?;
    let guard = lock(place)?;
    guard.is_some().then_some(SubscribedGuard(guard))
}

/// A locked place that is known to hold a subscription.
pub(crate) struct SubscribedGuard(MutexGuard<'static, Option<Box<Subscribed>>>);

impl SubscribedGuard {
    pub(crate) fn get(&mut self) -> &mut Subscribed {
        self.0.as_mut().unwrap_or_else(|| unreachable!("looked at when it was locked"))
    }
}

/// Stores a subscription by its descriptor. Returns what was there: somebody
/// has closed its descriptor with close(2), and the number was given again.
/// Err: the number is higher than the table.
pub(crate) fn put_subscription(
    descriptor: c_int,
    subscribed: Box<Subscribed>,
) -> Result<Option<Box<Subscribed>>, Box<Subscribed>> {
    let place = usize::try_from(descriptor).ok().and_then(|index| SUBSCRIPTIONS.make(index));
    match place.and_then(lock) {
        Some(mut place) => Ok(place.replace(subscribed)),
        None => Err(subscribed),
    }
}

/// Takes a subscription out of the table.
pub(crate) fn take_subscription(descriptor: c_int) -> Option<Box<Subscribed>> {
    let place = SUBSCRIPTIONS.get(usize::try_from(descriptor).ok()?)?;
    lock(place)?.take()
}

/// None: a thread that a fork has left behind holds it, and will for ever.
fn lock(place: &'static Place) -> Option<MutexGuard<'static, Option<Box<Subscribed>>>> {
    if !is_child() {
        return Some(place.lock().unwrap_or_else(PoisonError::into_inner));
    }
    for _ in 0..PATIENCE {
        match place.try_lock() {
            Ok(guard) => return Some(guard),
            Err(TryLockError::Poisoned(poisoned)) => return Some(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => thread::sleep(LOOK_INTERVAL),
        }
    }
    None
}

// Publications: by number, 1 and up.

/// A publication of the C API.
pub(crate) struct Advertised {
    pub(crate) shared: SharedPublication,
    pub(crate) meta: &'static OrbMetadata,
}

/// One publication's place in the table.
#[derive(Default)]
struct Entry {
    /// The handle that stands for it now; 0: none. A place's next handle is
    /// another, so that old ones are found out.
    handle: AtomicI32,
    advertised: AtomicPtr<Advertised>,
    /// Publishes under way.
    users: AtomicU32,
}

/// So many publications a process may have: the broker's limit for both kinds
/// of handles.
const PUBLICATIONS_MAX: usize = 64 * CHUNK;

static PUBLICATIONS: Growing<Entry, 64> = Growing::new();

/// How many places were ever used.
static USED: AtomicUsize = AtomicUsize::new(0);

/// Places that were given up, to be used again.
static FREE: PerProcess<Mutex<Vec<usize>>> = PerProcess::new();

/// The bits of a handle that are its place in the table, counted from 1.
const PLACE_BITS: u32 = 17;
const _: () = assert!(PUBLICATIONS_MAX < 1 << PLACE_BITS);

fn entry(handle: c_int) -> Option<&'static Entry> {
    let place = handle & ((1 << PLACE_BITS) - 1);
    PUBLICATIONS.get(usize::try_from(place).ok()?.checked_sub(1)?)
}

/// A publication that is not unadvertised while this is held.
pub(crate) struct InUse {
    entry: &'static Entry,
    advertised: &'static Advertised,
}

impl Deref for InUse {
    type Target = Advertised;
    fn deref(&self) -> &Advertised {
        self.advertised
    }
}

impl Drop for InUse {
    fn drop(&mut self) {
        // Pairs with the load in `end_publication`: whoever sees that nobody
        // uses it comes after all that its users did.
        self.entry.users.fetch_sub(1, Ordering::Release);
    }
}

/// The publication of a handle. None: it is none.
#[inline]
pub(crate) fn publication(handle: c_int) -> Option<InUse> {
    let entry = entry(handle)?;
    // Sequentially consistent, with the swap and the load in `end_publication`:
    // either that sees us, or we see that it is gone.
    entry.users.fetch_add(1, Ordering::SeqCst);
    let advertised = entry.advertised.load(Ordering::SeqCst);
    // SAFETY: it comes from `Box::into_raw`, and is freed by nobody who sees
    // that it has a user. NULL is none.
    match unsafe { advertised.as_ref() } {
        Some(advertised) if entry.handle.load(Ordering::Relaxed) == handle => {
            Some(InUse { entry, advertised })
        }
        _ => {
            entry.users.fetch_sub(1, Ordering::Release);
            None
        }
    }
}

/// Stores a publication and returns its handle. Err: there are too many.
pub(crate) fn put_publication(advertised: Box<Advertised>) -> Result<c_int, Box<Advertised>> {
    let free = FREE.get().lock().unwrap_or_else(PoisonError::into_inner).pop();
    let index = free.or_else(|| {
        let index = USED.fetch_add(1, Ordering::Relaxed);
        (index < PUBLICATIONS_MAX).then_some(index)
    });
    let Some((index, entry)) = index.and_then(|index| Some((index, PUBLICATIONS.make(index)?)))
    else {
        return Err(advertised);
    };
    let place = index as c_int + 1;
    let last = entry.handle.load(Ordering::Relaxed);
    let handle = match last {
        0 => place,
        // Goes round after 16,384 times, and is never negative.
        last => (last.wrapping_add(1 << PLACE_BITS)) & c_int::MAX,
    };
    entry.handle.store(handle, Ordering::Relaxed);
    entry.advertised.store(Box::into_raw(advertised), Ordering::SeqCst);
    Ok(handle)
}

/// Ends a publication, once nobody publishes on it any more: a publish waits for
/// nobody, so that is soon. False: there is none.
pub(crate) fn end_publication(handle: c_int) -> bool {
    let Some(entry) = entry(handle) else { return false };
    if entry.handle.load(Ordering::Relaxed) != handle {
        return false;
    }
    let advertised = entry.advertised.swap(std::ptr::null_mut(), Ordering::SeqCst);
    if advertised.is_null() {
        return false;
    }
    let mut looks = 0;
    while entry.users.load(Ordering::SeqCst) > 0 {
        looks += 1;
        if is_child() && looks > PATIENCE {
            // A thread that the fork has left behind was publishing: what it
            // used stays where it is, and its place is not given again.
            return true;
        }
        thread::sleep(LOOK_INTERVAL);
    }
    // SAFETY: it comes from `Box::into_raw`; the swap gave it to us alone, and
    // nobody uses it any more.
    drop(unsafe { Box::from_raw(advertised) });
    let place = handle & ((1 << PLACE_BITS) - 1);
    FREE.get().lock().unwrap_or_else(PoisonError::into_inner).push(place as usize - 1);
    true
}
