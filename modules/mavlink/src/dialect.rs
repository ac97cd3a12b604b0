//! The messages: what `build.rs` makes of `dialect/uorb.xml`.

// The generator's code has its own ways.
#![allow(missing_debug_implementations, unreachable_pub)]
#![allow(non_camel_case_types, non_upper_case_globals)]
#![allow(clippy::all)]

include!(concat!(env!("OUT_DIR"), "/mod.rs"));

pub use uorb::*;
