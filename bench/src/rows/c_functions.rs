//! The C functions, as a C program calls them in `libuorb.so`.
//!
//! A C subscription is a descriptor that poll(2) may be asked about at any time,
//! so a copy that leaves nothing makes it unreadable again: a system call. The
//! C++ classes stand on followers, which have none.

#![allow(unsafe_code)]

use std::ffi::{c_char, c_int, c_uint, c_void};
use std::hint::black_box;

use libloading::{Library, Symbol};
use nix::libc::{POLLIN, pollfd};
use uorb_core::DIR_VARIABLE;
use uorb_tests::{Bus, program};

use super::Run;
use super::kernel::{CLOCK, clock_read};
use crate::figures::Contestant;
use crate::times::per_call;

const BYTES: usize = 64;

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

pub fn measure(run: &mut Run, bus: &mut Bus) {
    // SAFETY: the library has not read it yet, and no other thread of this
    // process reads or writes the environment.
    unsafe { std::env::set_var(DIR_VARIABLE, bus.system.base()) };
    // SAFETY: the library's start-up code is Rust's, which does nothing unusual.
    let library = unsafe { Library::new(program("libuorb.so")) }.expect("libuorb.so loads");
    let c = C::of(&library);
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

    let batches = run.figures.effort.batches;
    run.alone(|figures| {
        let mut row = |row: &str, call: &mut dyn FnMut()| {
            let floor = &mut || clock_read(batches);
            let ours = Contestant::new("uorb, C", || per_call(batches, &mut *call));
            figures.measure((row, "64 B"), (CLOCK, floor), vec![ours]);
        };
        row("orb_publish", &mut || {
            (c.orb_publish)(meta, publication, black_box(data));
        });
        row("px4_poll, ready", &mut || {
            (c.px4_poll)(fds.as_mut_ptr(), 1, 1_000);
        });
        row("orb_check, updated", &mut || {
            (c.orb_check)(subscription, black_box(&mut updated));
        });
        row("orb_copy, nothing new", &mut || {
            (c.orb_copy)(meta, subscription, black_box(data));
        });
        row("orb_check, not updated", &mut || {
            (c.orb_check)(subscription, black_box(&mut updated));
        });
        row("orb_publish and orb_copy", &mut || {
            (c.orb_publish)(meta, publication, black_box(data));
            (c.orb_copy)(meta, subscription, black_box(data));
        });
        row("C++ copy", &mut || {
            (c.uorb_copy)(follower, black_box(data));
        });
        row("C++ updated", &mut || {
            black_box((c.uorb_updates)(follower));
        });
    });
    // Its session's thread runs in it until the process ends.
    std::mem::forget(library);
}
