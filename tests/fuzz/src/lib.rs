//! What reads bytes of others, and must not fall over them.
//!
//! A [`Target`] takes any bytes and panics where something is wrong. The
//! fuzzer (`scripts/fuzz`) looks for such bytes; what it has found so far to
//! be worth trying is kept in `corpus/<target>`, and `cargo test` tries it
//! again. To see one crash alone, put its file there.

mod logs;
mod mavlink;
mod messages;
mod nodes;
mod packets;
mod values;

// Parts of the `uorb` command, which is no library.
#[allow(dead_code)]
#[path = "../../../uorb-cli/src"]
mod cli {
    pub(crate) mod fields;
    pub(crate) mod nearest;
}
use cli::{fields, nearest};

/// Tries these bytes; panics where something is wrong.
pub type Target = fn(&[u8]);

/// All targets by their names, which are those of their corpora.
pub const TARGETS: &[(&str, Target)] = &[
    ("msg-text", messages::any_text),
    ("msg-lines", messages::near_valid_lines),
    ("packets", packets::both_directions),
    ("node-file", nodes::open),
    ("pub-values", values::assign),
    ("flight-log", logs::read_all),
    ("mavlink-bytes", mavlink::bytes),
    ("mavlink-messages", mavlink::messages),
];

/// The target of this name.
pub fn target(name: &str) -> Option<Target> {
    TARGETS.iter().find(|(known, _)| *known == name).map(|(_, target)| *target)
}
