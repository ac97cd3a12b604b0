//! What the C functions cost, beside Rust's and one clock read of this run.
//!
//! One process, one topic of 64 bytes, a real broker; the C functions are those
//! of `libuorb.so`, as a C program calls them:
//! `cargo build --release && cargo bench -p uorb-c`. A C subscription is a
//! descriptor that poll(2) may be asked about at any time, so a copy that leaves
//! nothing makes it unreadable again: a system call. The C++ classes stand on
//! followers, which have none.
#![allow(unsafe_code)]

#[path = "../../uorb-core/benches/bus/mod.rs"]
mod bus;

use std::ffi::{c_char, c_int, c_uint, c_void};
use std::hint::black_box;
use std::path::PathBuf;

use criterion::{Criterion, criterion_group, criterion_main};
use libloading::{Library, Symbol};
use nix::libc::{POLLIN, pollfd};
use uorb_core::{DIR_VARIABLE, Publication, Session, Subscription, now_us, poll, topic};

use bus::Bus;

const BYTES: usize = 64;

topic! { pub struct Bytes64 = "bytes64" { words: [u64; BYTES / 8] } }

/// `struct orb_metadata` of uORB.h.
#[repr(C)]
struct Metadata {
    name: *const c_char,
    size: u16,
    size_no_padding: u16,
    fields: *const c_char,
    message_hash: u32,
    id: u16,
    queue: u8,
    layout: *const c_void,
}

/// The functions, where `libuorb.so` has them.
struct C<'l> {
    orb_advertise: Symbol<'l, extern "C" fn(*const Metadata, *const c_void) -> c_int>,
    orb_publish: Symbol<'l, extern "C" fn(*const Metadata, c_int, *const c_void) -> c_int>,
    orb_subscribe: Symbol<'l, extern "C" fn(*const Metadata) -> c_int>,
    orb_copy: Symbol<'l, extern "C" fn(*const Metadata, c_int, *mut c_void) -> c_int>,
    orb_check: Symbol<'l, extern "C" fn(c_int, *mut bool) -> c_int>,
    px4_poll: Symbol<'l, extern "C" fn(*mut pollfd, c_uint, c_int) -> c_int>,
    uorb_follow: Symbol<'l, extern "C" fn(*const Metadata, c_uint, bool) -> *mut c_void>,
    uorb_updates: Symbol<'l, extern "C" fn(*mut c_void) -> c_uint>,
    uorb_copy: Symbol<'l, extern "C" fn(*mut c_void, *mut c_void) -> bool>,
}

fn library() -> Library {
    let bench = std::env::current_exe().expect("every program has a file");
    let path: Option<PathBuf> =
        bench.ancestors().map(|dir| dir.join("libuorb.so")).find(|path| path.is_file());
    let path = path.expect("libuorb.so is not built: run `cargo build --release` first");
    // SAFETY: the library's start-up code is Rust's, which does nothing unusual.
    unsafe { Library::new(path) }.expect("libuorb.so loads")
}

impl<'l> C<'l> {
    fn of(library: &'l Library) -> Self {
        // SAFETY: the types are those of uORB.h and uORBFollower.h.
        unsafe {
            Self {
                orb_advertise: library.get(b"orb_advertise\0").expect("exported"),
                orb_publish: library.get(b"orb_publish\0").expect("exported"),
                orb_subscribe: library.get(b"orb_subscribe\0").expect("exported"),
                orb_copy: library.get(b"orb_copy\0").expect("exported"),
                orb_check: library.get(b"orb_check\0").expect("exported"),
                px4_poll: library.get(b"px4_poll\0").expect("exported"),
                uorb_follow: library.get(b"uorb_follow\0").expect("exported"),
                uorb_updates: library.get(b"uorb_updates\0").expect("exported"),
                uorb_copy: library.get(b"uorb_copy\0").expect("exported"),
            }
        }
    }
}

fn c_door(criterion: &mut Criterion) {
    let bus = Bus::start("c");
    // SAFETY: no other thread of this process runs yet.
    unsafe { std::env::set_var(DIR_VARIABLE, bus.system.base()) };
    criterion.bench_function("clock read", |bencher| bencher.iter(|| black_box(now_us())));
    rust(criterion, &bus);
    let library = library();
    c(criterion, &C::of(&library));
    // Its session's thread runs in it until the process ends.
    std::mem::forget(library);
}

fn rust(criterion: &mut Criterion, bus: &Bus) {
    let session = Session::connect_to(&bus.system).expect("the broker takes us");
    let mut publication = Publication::<Bytes64>::advertise(&session).expect("advertised");
    let mut subscription = Subscription::<Bytes64>::subscribe(&session).expect("subscribed");
    let mut message = Bytes64 { words: [0; BYTES / 8] };
    let mut group = criterion.benchmark_group("Rust");
    group.bench_function("publish", |bencher| {
        bencher.iter(|| publication.publish(black_box(&message)));
    });
    group.bench_function("poll, ready", |bencher| {
        bencher.iter(|| poll(&mut [&mut subscription], None));
    });
    group.bench_function("copy", |bencher| {
        bencher.iter(|| subscription.copy_into(black_box(&mut message)));
    });
    group.bench_function("updated", |bencher| bencher.iter(|| subscription.updated()));
    group.bench_function("publish and copy", |bencher| {
        bencher.iter(|| {
            let _ = publication.publish(black_box(&message));
            subscription.copy_into(black_box(&mut message))
        });
    });
    group.finish();
}

fn c(criterion: &mut Criterion, c: &C<'_>) {
    let meta = &Metadata {
        name: c"bytes64".as_ptr(),
        size: BYTES as u16,
        size_no_padding: BYTES as u16,
        fields: std::ptr::null(),
        message_hash: 0,
        id: u16::MAX,
        queue: 1,
        layout: std::ptr::null(),
    };
    let mut message = [0_u64; BYTES / 8];
    let data = message.as_mut_ptr().cast::<c_void>();
    let publication = (c.orb_advertise)(meta, data);
    let subscription = (c.orb_subscribe)(meta);
    let follower = (c.uorb_follow)(meta, 0, true);
    assert!(publication > 0 && subscription > 0 && !follower.is_null());
    let mut updated = false;
    let mut fds = [pollfd { fd: subscription, events: POLLIN, revents: 0 }];

    let mut group = criterion.benchmark_group("C");
    group.bench_function("orb_publish", |bencher| {
        bencher.iter(|| (c.orb_publish)(meta, publication, black_box(data)));
    });
    group.bench_function("px4_poll, ready", |bencher| {
        bencher.iter(|| (c.px4_poll)(fds.as_mut_ptr(), 1, 1_000));
    });
    group.bench_function("orb_check, updated", |bencher| {
        bencher.iter(|| (c.orb_check)(subscription, black_box(&mut updated)));
    });
    group.bench_function("orb_copy, nothing new", |bencher| {
        bencher.iter(|| (c.orb_copy)(meta, subscription, black_box(data)));
    });
    group.bench_function("orb_check, not updated", |bencher| {
        bencher.iter(|| (c.orb_check)(subscription, black_box(&mut updated)));
    });
    group.bench_function("orb_publish and orb_copy", |bencher| {
        bencher.iter(|| {
            (c.orb_publish)(meta, publication, black_box(data));
            (c.orb_copy)(meta, subscription, black_box(data))
        });
    });
    group.finish();

    let mut group = criterion.benchmark_group("C++");
    group.bench_function("copy", |bencher| {
        bencher.iter(|| (c.uorb_copy)(follower, black_box(data)));
    });
    group.bench_function("updated", |bencher| bencher.iter(|| (c.uorb_updates)(follower)));
    group.finish();
}

criterion_group!(benches, c_door);
criterion_main!(benches);
