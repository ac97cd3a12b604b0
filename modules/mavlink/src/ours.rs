//! Messages of our own, whose fields are those of a topic: a line each.
//!
//! A line names the message, its struct in the dialect, and the topic with the
//! fields that both have. It makes both ways: a message that comes in is published,
//! with the time of its arrival as the timestamp that MAVLink does not carry; and a
//! message that is published goes out. A field of the message that is left out does
//! not compile. `docs/adding-a-mavlink-message.md` adds one.

use mavlink_core::MessageData;
use uorb_msg::CaTrajectoryMsg;

use crate::dialect::{CA_TRAJECTORY_MSG_DATA, MavMessage};
use crate::followed::Followed;
use crate::link::Link;
use crate::outgoing::source::on_update;
use crate::outgoing::table::{Rate, StreamDefinition, stream};

macro_rules! same_fields {
    ($($MESSAGE:ident: $Data:ident = $Topic:ident { $($field:ident),* $(,)? })*) => {
        /// Publishes a message of ours; all others are somebody else's.
        #[allow(clippy::needless_update, reason = "most structs have padding")]
        pub(crate) fn receive(link: &mut Link, message: &MavMessage, now_us: u64) {
            match message {
                $(MavMessage::$MESSAGE(message) => {
                    link.publications.publish::<$Topic>(&$Topic {
                        timestamp: now_us,
                        $($field: message.$field,)*
                        ..Default::default()
                    });
                })*
                _ => {}
            }
        }

        /// What goes out, each time that its topic is published.
        pub(crate) static STREAMS: &[StreamDefinition] = &[$(
            stream(
                stringify!($MESSAGE),
                $Data::ID,
                [Rate::Every, Rate::Every, Rate::Off],
                |session| {
                    // What came in from a partner is not sent back.
                    let lead = Followed::<$Topic>::new(session).of_others();
                    on_update(lead, |topic, send| {
                        send(MavMessage::$MESSAGE($Data { $($field: topic.$field),* }));
                    })
                },
            ),
        )*];
    };
}

same_fields! {
    CA_TRAJECTORY_MSG: CA_TRAJECTORY_MSG_DATA =
        CaTrajectoryMsg { time_start_usec, time_stop_usec, coefficients, seq_id }
}
