//! A message of our own: CA_TRAJECTORY_MSG.

use uorb_core::Session;
use uorb_msg::CaTrajectoryMsg;

use super::source::{Source, on_update};
use crate::dialect::{CA_TRAJECTORY_MSG_DATA, MavMessage};
use crate::followed::Followed;

pub(super) fn ca_trajectory(session: &Session) -> Box<dyn Source> {
    // What came in from a partner is not sent back.
    let lead = Followed::<CaTrajectoryMsg>::new(session).of_others();
    on_update(lead, |trajectory, send| {
        send(MavMessage::CA_TRAJECTORY_MSG(message(&trajectory)));
    })
}

fn message(trajectory: &CaTrajectoryMsg) -> CA_TRAJECTORY_MSG_DATA {
    CA_TRAJECTORY_MSG_DATA {
        time_start_usec: trajectory.time_start_usec,
        time_stop_usec: trajectory.time_stop_usec,
        coefficients: trajectory.coefficients,
        seq_id: trajectory.seq_id,
    }
}
