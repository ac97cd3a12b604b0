//! PING and TIMESYNC: how far away the partner is, and what its clock shows.

use mavlink_core::MavHeader;

use crate::dialect::{PING_DATA, TIMESYNC_DATA};

/// The answer to a ping. One that names its target is an answer itself.
pub fn ping(message: &PING_DATA, from: &MavHeader) -> Option<PING_DATA> {
    if message.target_system != 0 || message.target_component != 0 {
        return None;
    }
    let target_system = u8::try_from(from.system_id).ok()?;
    Some(PING_DATA { target_system, target_component: from.component_id, ..message.clone() })
}

/// Our clock beside the partner's. What has both times already is an answer.
pub fn timesync(message: &TIMESYNC_DATA, from: &MavHeader, now_us: u64) -> Option<TIMESYNC_DATA> {
    if message.tc1 != 0 {
        return None;
    }
    Some(TIMESYNC_DATA {
        tc1: i64::try_from(now_us).ok()?.checked_mul(1_000)?,
        ts1: message.ts1,
        target_system: u8::try_from(from.system_id).ok()?,
        target_component: from.component_id,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const FROM: MavHeader = MavHeader { system_id: 255, component_id: 190, sequence: 0 };

    #[test]
    fn a_ping_comes_back_to_its_sender_and_an_answer_does_not() {
        let ping_of =
            |target_system| PING_DATA { time_usec: 5, seq: 6, target_system, target_component: 0 };
        let answer = ping(&ping_of(0), &FROM).unwrap();
        let expected =
            PING_DATA { time_usec: 5, seq: 6, target_system: 255, target_component: 190 };
        assert_eq!(answer, expected);
        assert_eq!(ping(&ping_of(1), &FROM), None);
    }

    #[test]
    fn a_question_for_the_time_is_answered_in_nanoseconds() {
        let question = TIMESYNC_DATA { ts1: 77, ..TIMESYNC_DATA::DEFAULT };
        let answer = timesync(&question, &FROM, 1_000).unwrap();
        assert_eq!((answer.tc1, answer.ts1, answer.target_system), (1_000_000, 77, 255));
        assert_eq!(timesync(&answer, &FROM, 2_000), None);
        assert_eq!(timesync(&question, &FROM, u64::MAX), None);
    }
}
