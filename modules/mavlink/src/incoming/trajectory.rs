//! A message of our own: CA_TRAJECTORY_MSG, to the topic ca_trajectory_msg.

use uorb_core::now_us;
use uorb_msg::CaTrajectoryMsg;

use crate::dialect::CA_TRAJECTORY_MSG_DATA;
use crate::link::Link;

pub(super) fn receive(link: &mut Link, message: &CA_TRAJECTORY_MSG_DATA) {
    link.publications.publish::<CaTrajectoryMsg>(&CaTrajectoryMsg {
        timestamp: now_us(),
        time_start_usec: message.time_start_usec,
        time_stop_usec: message.time_stop_usec,
        coefficients: message.coefficients,
        seq_id: message.seq_id,
        ..CaTrajectoryMsg::default()
    });
}
