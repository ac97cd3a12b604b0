//! How the vehicle's parts are: SYS_STATUS, BATTERY_STATUS.

use uorb_core::{Instance, Session};
use uorb_msg::{BatteryStatus, Cpuload, VehicleStatus};

use super::source::{Source, on_clock};
use crate::dialect::{
    BATTERY_STATUS_DATA, MavBatteryChargeState, MavBatteryFunction, MavBatteryType, MavMessage,
    SYS_STATUS_DATA,
};
use crate::followed::Followed;

/// As many batteries as PX4 knows.
const BATTERIES_MAX: usize = 4;

fn follow_batteries(session: &Session) -> Vec<Followed<BatteryStatus>> {
    let instances = Instance::all().take(BATTERIES_MAX);
    instances.map(|instance| Followed::sampled_instance(session, instance)).collect()
}

pub(super) fn sys_status(session: &Session) -> Box<dyn Source> {
    let mut status = Followed::<VehicleStatus>::sampled(session);
    let mut load = Followed::<Cpuload>::sampled(session);
    let mut batteries = follow_batteries(session);
    on_clock(move |send| {
        let batteries = batteries.iter_mut().filter_map(Followed::copy);
        // Whoever looks at one battery only should see the one that is emptiest.
        let emptiest = batteries
            .filter(|battery| battery.connected.into())
            .min_by(|one, other| one.remaining.total_cmp(&other.remaining));
        let (status, load) = (status.copy(), load.copy());
        if status.is_some() || load.is_some() || emptiest.is_some() {
            send(MavMessage::SYS_STATUS(sys_status_message(status, load, emptiest)));
        }
    })
}

fn sys_status_message(
    status: Option<VehicleStatus>,
    load: Option<Cpuload>,
    battery: Option<BatteryStatus>,
) -> SYS_STATUS_DATA {
    let status = status.unwrap_or_default();
    SYS_STATUS_DATA {
        onboard_control_sensors_present: status.onboard_control_sensors_present,
        onboard_control_sensors_enabled: status.onboard_control_sensors_enabled,
        onboard_control_sensors_health: status.onboard_control_sensors_health,
        load: load.map_or(0, |load| (load.load * 1000.0).round() as u16),
        voltage_battery: battery.map_or(u16::MAX, |it| millivolts(filtered_voltage_v(&it))),
        current_battery: battery.map_or(-1, |it| centiamperes(&it)),
        battery_remaining: battery.map_or(-1, |it| percent((it.remaining * 100.0).ceil())),
        ..SYS_STATUS_DATA::DEFAULT
    }
}

pub(super) fn batteries(session: &Session) -> Box<dyn Source> {
    let mut batteries = follow_batteries(session);
    on_clock(move |send| {
        for (id, battery) in batteries.iter_mut().enumerate() {
            // The newest, also if it was sent before: whoever asks again wants an answer.
            if let Some(battery) = battery.copy() {
                send(MavMessage::BATTERY_STATUS(battery_message(id as u8, &battery)));
            }
        }
    })
}

fn battery_message(id: u8, battery: &BatteryStatus) -> BATTERY_STATUS_DATA {
    use MavBatteryChargeState as State;
    let is_there = bool::from(battery.connected);
    let known = |value| if is_there { value } else { -1 };
    let is_measured = is_there && battery.voltage_v.is_finite();
    let charge_state = match battery.warning {
        BatteryStatus::BATTERY_WARNING_NONE => State::MAV_BATTERY_CHARGE_STATE_OK,
        BatteryStatus::BATTERY_WARNING_LOW => State::MAV_BATTERY_CHARGE_STATE_LOW,
        BatteryStatus::BATTERY_WARNING_CRITICAL => State::MAV_BATTERY_CHARGE_STATE_CRITICAL,
        BatteryStatus::BATTERY_WARNING_EMERGENCY => State::MAV_BATTERY_CHARGE_STATE_EMERGENCY,
        BatteryStatus::BATTERY_WARNING_FAILED => State::MAV_BATTERY_CHARGE_STATE_FAILED,
        _ => State::MAV_BATTERY_CHARGE_STATE_UNDEFINED,
    };
    BATTERY_STATUS_DATA {
        id,
        battery_function: MavBatteryFunction::MAV_BATTERY_FUNCTION_ALL as u8,
        mavtype: MavBatteryType::MAV_BATTERY_TYPE_LIPO as u8,
        temperature: i16::MAX,
        voltages: if is_measured { whole_voltage(battery.voltage_v) } else { [u16::MAX; 10] },
        current_battery: known(i32::from(centiamperes(battery))) as i16,
        current_consumed: known(milliampere_hours(battery)),
        energy_consumed: -1,
        battery_remaining: known(percent((battery.remaining * 100.0).round()).into()) as i8,
        charge_state: charge_state as u8,
        ..BATTERY_STATUS_DATA::DEFAULT
    }
}

/// The voltage in mV in the first cell's place, as nobody knows the cells; what
/// a place cannot hold goes into the next. Places without a cell are 65,535.
fn whole_voltage(voltage_v: f32) -> [u16; 10] {
    const PLACE_MAX: u32 = u16::MAX as u32 - 1;
    let mut rest = (voltage_v * 1e3).round() as u32;
    let mut voltages = [u16::MAX; 10];
    for place in &mut voltages {
        *place = rest.min(PLACE_MAX) as u16;
        rest -= u32::from(*place);
        if rest == 0 {
            break;
        }
    }
    voltages
}

/// Without a filter, the voltage as it is.
fn filtered_voltage_v(battery: &BatteryStatus) -> f32 {
    match battery.voltage_filtered_v {
        0.0 => battery.voltage_v,
        filtered => filtered,
    }
}

/// 65,535 says that nobody has measured it.
fn millivolts(voltage_v: f32) -> u16 {
    if voltage_v.is_finite() { (voltage_v * 1e3).round() as u16 } else { u16::MAX }
}

/// -1 says that nobody has measured it, also in those that follow.
fn milliampere_hours(battery: &BatteryStatus) -> i32 {
    if battery.discharged_mah >= 0.0 { battery.discharged_mah as i32 } else { -1 }
}

fn centiamperes(battery: &BatteryStatus) -> i16 {
    let current_a = match battery.current_filtered_a {
        0.0 => battery.current_a,
        filtered => filtered,
    };
    if current_a >= 0.0 { (current_a * 100.0) as i16 } else { -1 }
}

fn percent(percent: f32) -> i8 {
    if percent >= 0.0 { percent.min(100.0) as i8 } else { -1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn battery() -> BatteryStatus {
        BatteryStatus {
            connected: true.into(),
            voltage_v: 16.234,
            voltage_filtered_v: 16.2,
            current_filtered_a: 12.5,
            discharged_mah: 321.0,
            remaining: 0.754,
            warning: BatteryStatus::BATTERY_WARNING_LOW,
            ..BatteryStatus::default()
        }
    }

    #[test]
    fn a_battery_in_the_units_of_mavlink() {
        let message = battery_message(1, &battery());
        assert_eq!(message.voltages[..2], [16_234, u16::MAX]);
        assert_eq!((message.current_battery, message.current_consumed), (1_250, 321));
        assert_eq!((message.battery_remaining, message.charge_state, message.id), (75, 2, 1));
    }

    #[test]
    fn no_battery_is_unknown_and_not_empty() {
        let message = battery_message(0, &BatteryStatus::default());
        assert_eq!((message.current_battery, message.battery_remaining), (-1, -1));
        assert_eq!(message.voltages, [u16::MAX; 10]);
        let status = sys_status_message(Some(VehicleStatus::default()), None, None);
        assert_eq!((status.voltage_battery, status.current_battery), (u16::MAX, -1));
        assert_eq!(status.battery_remaining, -1);
    }

    #[test]
    fn what_nobody_has_measured_is_unknown_and_not_a_number() {
        let battery = BatteryStatus {
            connected: true.into(),
            voltage_v: f32::NAN,
            voltage_filtered_v: f32::NAN,
            current_filtered_a: f32::NAN,
            discharged_mah: f32::NAN,
            remaining: f32::NAN,
            ..BatteryStatus::default()
        };
        let message = battery_message(0, &battery);
        assert_eq!((message.current_battery, message.current_consumed), (-1, -1));
        assert_eq!((message.voltages[0], message.battery_remaining), (u16::MAX, -1));
        let status = sys_status_message(None, None, Some(battery));
        assert_eq!((status.voltage_battery, status.current_battery), (u16::MAX, -1));
        assert_eq!(status.battery_remaining, -1);
    }

    #[test]
    fn a_system_s_status() {
        let load = Cpuload { load: 0.4567, ..Cpuload::default() };
        let status =
            VehicleStatus { onboard_control_sensors_health: 0x2f, ..VehicleStatus::default() };
        let message = sys_status_message(Some(status), Some(load), Some(battery()));
        assert_eq!((message.load, message.voltage_battery), (457, 16_200));
        assert_eq!((message.current_battery, message.battery_remaining), (1_250, 76));
        assert_eq!(message.onboard_control_sensors_health, 0x2f);
    }

    #[test]
    fn a_high_voltage_takes_two_places() {
        assert_eq!(whole_voltage(100.0)[..3], [65_534, 34_466, u16::MAX]);
    }
}
