//! The C door: `libuorb`, the functions of PX4's uORB.h.
//!
//! Each exported function does what its declaration in `include/uORB/uORB.h`
//! (or `uORBFollower.h`, on which the C++ classes stand) says, in the order of
//! those headers; a test compares the two. What C passes in is checked here
//! once: a NULL or a handle that is none is an errno, never a crash.
//!
//! Publish is `publications.rs`, `handles.rs`, and then uorb-core's
//! `publication/shared.rs`; copy is `subscriptions.rs` and `subscription.rs`
//! there. Neither takes a lock that another publish or a sleeper holds.
#![allow(unsafe_code)]

mod callbacks;
mod failure;
mod followers;
mod handles;
mod metadata;
mod per_process;
mod poll;
mod publications;
mod session;
mod signals;
mod subscriptions;
