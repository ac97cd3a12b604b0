//! Corrections for the GPS receiver: the topic `gps_inject_data`.

use uorb_msg::GpsInjectData;

use crate::dialect::{GPS_INJECT_DATA_DATA, GPS_RTCM_DATA_DATA};

/// A part of a message of corrections, or a whole one.
pub fn gps_rtcm_data(message: &GPS_RTCM_DATA_DATA, now_us: u64) -> GpsInjectData {
    inject(message.flags, message.len, &message.data, now_us)
}

/// The same of old: it is always whole.
pub fn gps_inject_data(message: &GPS_INJECT_DATA_DATA, now_us: u64) -> GpsInjectData {
    inject(0, message.len, &message.data, now_us)
}

/// A length that is more than there is comes from nobody who means well.
fn inject(flags: u8, len: u8, data: &[u8], now_us: u64) -> GpsInjectData {
    let len = usize::from(len).min(data.len());
    let mut topic = GpsInjectData { timestamp: now_us, flags, ..Default::default() };
    topic.len = len as u8;
    topic.data[..len].copy_from_slice(&data[..len]);
    topic
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corrections_go_on_as_they_came() {
        let mut message = GPS_RTCM_DATA_DATA { flags: 5, len: 3, ..GPS_RTCM_DATA_DATA::DEFAULT };
        message.data[..4].copy_from_slice(&[1, 2, 3, 4]);
        let topic = gps_rtcm_data(&message, 7);
        assert_eq!((topic.timestamp, topic.flags, topic.len), (7, 5, 3));
        assert_eq!(topic.data[..4], [1, 2, 3, 0], "what is behind the length is not passed on");
    }

    #[test]
    fn a_length_that_is_too_much_is_cut() {
        let message = GPS_RTCM_DATA_DATA { len: 255, ..GPS_RTCM_DATA_DATA::DEFAULT };
        assert_eq!(gps_rtcm_data(&message, 0).len, 180);
        let message = GPS_INJECT_DATA_DATA { len: 255, ..GPS_INJECT_DATA_DATA::DEFAULT };
        assert_eq!(gps_inject_data(&message, 0).len, 110);
    }
}
