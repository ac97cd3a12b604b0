//! How far a node has come.
//!
//! Every publish moves a node to its next generation. A subscription remembers
//! the generation it last copied, so "is there anything new" is one compare and
//! "how much did I miss" is one subtraction. Programs see the low 32 bits,
//! which wrap after 49 days at 1 kHz; inside, a generation has 48 bits and
//! lasts for nine years at 1 MHz, so no comparison of ours meets a wrap.

use std::fmt;

/// The number of messages published to a node so far, modulo 2^32 (PX4's
/// `get_last_generation`).
#[doc(alias = "get_last_generation")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Generation(u32);

impl Generation {
    pub(crate) fn from_wide(generation: u64) -> Self {
        Self(generation as u32)
    }

    /// The number itself.
    pub fn get(self) -> u32 {
        self.0
    }

    /// How many messages were published since `earlier`, across a wrap too.
    pub fn since(self, earlier: Self) -> u32 {
        self.0.wrapping_sub(earlier.0)
    }
}

impl fmt::Display for Generation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn generations_count_on_across_the_wrap() {
        let before = Generation::from_wide((1 << 32) - 3);
        let after = Generation::from_wide((1 << 32) + 2);
        assert_eq!(after.get(), 2);
        assert_eq!(after.since(before), 5);
    }
}
