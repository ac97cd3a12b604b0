//! How long messages took, in buckets that are at most an eighth wide.

use std::fmt;

const SUB_BITS: u32 = 3;
const BUCKETS: usize = 64 << SUB_BITS;

/// Counts of latencies in microseconds.
#[derive(Clone, Debug)]
pub(crate) struct Latencies(Vec<u64>);

impl Latencies {
    pub(crate) fn new() -> Self {
        Self(vec![0; BUCKETS])
    }

    pub(crate) fn add(&mut self, took_us: u64) {
        self.0[bucket(took_us)] += 1;
    }

    /// Adds what another process has printed.
    pub(crate) fn add_printed(&mut self, text: &str) {
        for pair in text.split_whitespace() {
            let Some((at, count)) = pair.split_once(':') else { continue };
            let (Ok(at), Ok(count)) = (at.parse::<usize>(), count.parse::<u64>()) else { continue };
            if let Some(bucket) = self.0.get_mut(at) {
                *bucket += count;
            }
        }
    }

    /// The time within which so many of a thousand arrived; the upper end of its
    /// bucket. None: nothing arrived.
    pub(crate) fn within_us(&self, per_thousand: u64) -> Option<u64> {
        let all: u64 = self.0.iter().sum();
        let mut wanted = (all * per_thousand).div_ceil(1000);
        let at = self.0.iter().position(|count| {
            let found = *count >= wanted;
            wanted = wanted.saturating_sub(*count);
            found
        });
        at.filter(|_| all > 0).map(end)
    }
}

impl fmt::Display for Latencies {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counted = self.0.iter().enumerate().filter(|(_, count)| **count > 0);
        let pairs: Vec<String> = counted.map(|(at, count)| format!("{at}:{count}")).collect();
        f.write_str(&pairs.join(" "))
    }
}

/// Below 8 a bucket each; above, eight buckets from each power of two to the next.
fn bucket(took_us: u64) -> usize {
    let shift = (u64::BITS - took_us.leading_zeros()).saturating_sub(SUB_BITS + 1);
    ((u64::from(shift) << SUB_BITS) + (took_us >> shift)) as usize
}

/// The largest latency of a bucket.
fn end(bucket: usize) -> u64 {
    let shift = (bucket >> SUB_BITS).saturating_sub(1);
    let top = (bucket - (shift << SUB_BITS)) as u64;
    ((top + 1) << shift) - 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_latency_is_within_an_eighth_of_its_bucket_s_end() {
        for took_us in (0..5_000).chain([1 << 20, 123_456_789, 1 << 60]) {
            let end = end(bucket(took_us));
            assert!(took_us <= end && end - took_us <= took_us / 8, "{took_us}: {end}");
        }
    }

    #[test]
    fn one_slow_message_in_a_thousand_is_beyond_the_rest() {
        let mut latencies = Latencies::new();
        assert_eq!(latencies.within_us(999), None);
        (0..1998).for_each(|_| latencies.add(5));
        latencies.add(1_000);
        latencies.add(1_000);
        let mut copy = Latencies::new();
        copy.add_printed(&latencies.to_string());
        assert_eq!((copy.within_us(999), copy.within_us(1000)), (Some(5), Some(1023)));
    }
}
