//! Which messages go out, and how often in each mode: PX4's table.
//!
//! A stream that no mode has goes out when it is asked for
//! (MAV_CMD_SET_MESSAGE_INTERVAL, MAV_CMD_REQUEST_MESSAGE).

use uorb_core::Session;

use super::source::Source;
use super::{attitude, battery, position, sensors, state, text};

/// What a link is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Mode {
    /// A ground station
    Normal,
    /// A program on the vehicle's other computer
    Onboard,
    /// A slow radio
    Minimal,
    /// Nothing but heartbeats, and what is asked for
    Custom,
}

/// How often a message goes out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rate {
    /// Not at all.
    Off,
    /// So often a second at most.
    Hz(f32),
    /// As often as its topic is published.
    Every,
}

use Rate::{Every, Hz, Off};

/// A kind of stream.
pub struct StreamDefinition {
    /// The message's name.
    pub name: &'static str,
    /// The message's number.
    pub message_id: u32,
    normal: Rate,
    onboard: Rate,
    minimal: Rate,
    custom: Rate,
    /// Whether its rate gives way on a slow link.
    pub(super) is_scaled: bool,
    pub(crate) make: fn(&Session) -> Box<dyn Source>,
}

impl std::fmt::Debug for StreamDefinition {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

impl StreamDefinition {
    /// How often it goes out in a mode.
    pub fn rate(&self, mode: Mode) -> Rate {
        match mode {
            Mode::Normal => self.normal,
            Mode::Onboard => self.onboard,
            Mode::Minimal => self.minimal,
            Mode::Custom => self.custom,
        }
    }
}

/// In the order of a mode's rates: normal, onboard, minimal.
pub(crate) const fn stream(
    name: &'static str,
    message_id: u32,
    [normal, onboard, minimal]: [Rate; 3],
    make: fn(&Session) -> Box<dyn Source>,
) -> StreamDefinition {
    let (custom, is_scaled) = (Off, true);
    StreamDefinition { name, message_id, normal, onboard, minimal, custom, is_scaled, make }
}

/// At one rate in all modes, on a slow link too.
const fn always(
    name: &'static str,
    message_id: u32,
    rate: Rate,
    make: fn(&Session) -> Box<dyn Source>,
) -> StreamDefinition {
    StreamDefinition {
        custom: rate,
        is_scaled: false,
        ..stream(name, message_id, [rate, rate, rate], make)
    }
}

/// The streams of MAVLink's own messages; `ours.rs` has those of ours. Where two
/// are due at once, the one that stands first goes first.
#[rustfmt::skip]
pub static STREAMS: &[StreamDefinition] = &[
    //                                 normal     onboard    minimal
    always("HEARTBEAT", 0,             Hz(1.0),                         state::heartbeat),
    always("STATUSTEXT", 253,          Every,                           text::statustext),
    stream("HIGHRES_IMU", 105,         [Off,      Hz(50.0),  Off],      sensors::highres_imu),
    stream("LOCAL_POSITION_NED", 32,   [Hz(1.0),  Hz(30.0),  Off],      position::local),
    stream("ATTITUDE", 30,             [Hz(15.0), Hz(100.0), Hz(10.0)], attitude::angles),
    stream("ATTITUDE_QUATERNION", 31,  [Hz(10.0), Hz(50.0),  Off],      attitude::quaternion),
    stream("ALTITUDE", 141,            [Hz(1.0),  Hz(10.0),  Hz(0.5)],  position::altitude),
    stream("GLOBAL_POSITION_INT", 33,  [Hz(5.0),  Hz(50.0),  Hz(5.0)],  position::global),
    stream("GPS_RAW_INT", 24,          [Hz(5.0),  Every,     Hz(0.5)],  sensors::gps_raw),
    stream("VFR_HUD", 74,              [Hz(4.0),  Hz(10.0),  Hz(1.0)],  position::hud),
    stream("SYS_STATUS", 1,            [Hz(1.0),  Hz(5.0),   Hz(0.1)],  battery::sys_status),
    stream("BATTERY_STATUS", 147,      [Hz(0.5),  Hz(0.5),   Off],      battery::batteries),
    stream("EXTENDED_SYS_STATE", 245,  [Hz(1.0),  Hz(5.0),   Hz(0.1)],  state::extended),
    stream("HOME_POSITION", 242,       [Hz(0.5),  Hz(0.5),   Hz(0.1)],  position::home),
    stream("SYSTEM_TIME", 2,           [Off,      Hz(1.0),   Off],      state::system_time),
    stream("AUTOPILOT_VERSION", 148,   [Off,      Off,       Off],      state::autopilot_version),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::MavMessage;
    use mavlink_core::Message;

    #[test]
    fn every_stream_has_its_message_s_name_and_number() {
        for stream in STREAMS.iter().chain(crate::ours::STREAMS) {
            let id = MavMessage::message_id_from_name(stream.name);
            assert_eq!(id, Some(stream.message_id), "{}", stream.name);
        }
    }
}
