//! The atomics that the ring and the bell are made of.
//!
//! They come from the standard library, or from loom when its model checker
//! explores the interleavings (`RUSTFLAGS="--cfg loom"`).

#[cfg(not(loom))]
pub(crate) use std::sync::atomic::{AtomicU64, Ordering, fence};

#[cfg(loom)]
pub(crate) use loom::sync::atomic::{AtomicU64, Ordering, fence};
