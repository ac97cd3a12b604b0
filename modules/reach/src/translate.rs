//! `--translate-time`: what another machine stamps, by our clock.

use uorb_core::{FieldType, Layout};

/// Where in a message there are times of its sender's clock: in every `uint64`
/// of the name `timestamp`, or one that begins with it, as `timestamp_sample` does.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Timestamps {
    offsets_bytes: Vec<usize>,
}

impl Timestamps {
    pub(crate) fn of(layout: &Layout) -> Self {
        let is_time = |path: &str| {
            let name = path.rsplit('.').next().unwrap_or(path);
            name == "timestamp" || name.starts_with("timestamp_")
        };
        let flat = layout.flatten().into_iter();
        let times = flat.filter(|field| {
            field.ty == FieldType::Uint64 && field.array_length.is_none() && is_time(&field.path)
        });
        Self { offsets_bytes: times.map(|field| field.offset_bytes as usize).collect() }
    }

    /// Whether two messages are one, but for these times.
    pub(crate) fn is_same(&self, one: &[u8], other: &[u8]) -> bool {
        let without = |message: &[u8]| {
            let mut message = message.to_vec();
            for at in &self.offsets_bytes {
                message.iter_mut().skip(*at).take(size_of::<u64>()).for_each(|byte| *byte = 0);
            }
            message
        };
        without(one) == without(other)
    }

    /// Translates them, where the other clock is ahead by `offset_us`. Zero is no time
    /// and stays; what was before our clock began is 1.
    pub(crate) fn translate(&self, message: &mut [u8], offset_us: i64) {
        for at in &self.offsets_bytes {
            let Some(word) = message.get_mut(*at..).and_then(|rest| rest.first_chunk_mut()) else {
                continue;
            };
            let theirs_us = u64::from_le_bytes(*word);
            if theirs_us > 0 {
                let ours_us = theirs_us.saturating_add_signed(offset_us.saturating_neg()).max(1);
                *word = ours_us.to_le_bytes();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use uorb_core::Message;
    use uorb_core::zerocopy::{FromBytes, IntoBytes};
    use uorb_msg::VehicleAcceleration;

    use super::*;

    #[test]
    fn timestamps_are_translated_and_what_is_none_is_left_alone() {
        let times = Timestamps::of(VehicleAcceleration::LAYOUT);
        let mut message =
            VehicleAcceleration { timestamp: 5_000, xyz: [1.0; 3], ..Default::default() };
        times.translate(message.as_mut_bytes(), 1_000);
        assert_eq!((message.timestamp, message.timestamp_sample), (4_000, 0));
        assert_eq!(message.xyz, [1.0; 3]);
        times.translate(message.as_mut_bytes(), 10_000);
        assert_eq!(message.timestamp, 1, "before our clock began");
        times.translate(message.as_mut_bytes(), -6);
        assert_eq!(VehicleAcceleration::read_from_bytes(message.as_bytes()).unwrap().timestamp, 7);
    }
}
