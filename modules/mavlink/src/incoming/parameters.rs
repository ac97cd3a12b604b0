//! PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET, over a file.
//!
//! The file is the truth: it is read for each question, so several links and
//! processes agree. An integer goes as the bits of the float that MAVLink has for
//! values, as in PX4.

use std::collections::VecDeque;

use uorb_core::now_us;
use uorb_modules::say;
use uorb_ulog::{Parameter, ParameterValue};

use crate::dialect::{
    MavMessage, PARAM_REQUEST_READ_DATA, PARAM_SET_DATA, PARAM_VALUE_DATA, STATUSTEXT_DATA,
};
use crate::link::Link;
use crate::parameter_file::ParameterFile;
use crate::transport::Sent;

/// Values of MAV_PARAM_TYPE.
const INT32: u8 = 6;
const REAL32: u8 = 9;

/// Between two values of a list at least: nobody needs more than 300 a second.
const PACE_MIN_US: u64 = 3_300;

/// How much later the same value is tried again that there was no room for.
const RETRY_US: u64 = 33_000;

/// Value of MAV_SEVERITY.
const ERROR: u8 = 3;

/// The parameters of a link.
#[derive(Debug)]
pub struct Parameters {
    file: ParameterFile,
    /// What is left of a list that was asked for.
    list: VecDeque<PARAM_VALUE_DATA>,
    due_us: u64,
}

impl Parameters {
    pub(super) fn new(file: ParameterFile) -> Self {
        Self { file, list: VecDeque::new(), due_us: 0 }
    }

    /// Begins to send all. Another request begins anew.
    pub(super) fn list(&mut self) {
        let all = self.read();
        self.list = (0..all.len()).filter_map(|index| value(&all, index)).collect();
        self.due_us = now_us();
    }

    /// Sends the one that is asked for: by number, or by name if that is -1.
    pub(super) fn read_one(&mut self, link: &mut Link, message: &PARAM_REQUEST_READ_DATA) {
        let all = self.read();
        let index = match usize::try_from(message.param_index) {
            Ok(index) => Some(index),
            Err(_) => message.param_id.to_str().ok().and_then(|name| position(&all, name)),
        };
        if let Some(value) = index.and_then(|index| value(&all, index)) {
            link.send(&MavMessage::PARAM_VALUE(value));
        }
    }

    /// Changes one, and sends what it is then: the sender sees whether it took.
    pub(super) fn set(&mut self, link: &mut Link, message: &PARAM_SET_DATA) {
        let Ok(name) = message.param_id.to_str() else { return };
        let all = self.read();
        let Some(index) = position(&all, name) else {
            return complain(link, &format!("unknown parameter: {name}"));
        };
        match decode(all[index].value, message.param_type, message.param_value) {
            Some(value) => {
                if let Err(error) = self.file.set(name, value) {
                    say(&error);
                    complain(link, &format!("cannot save {name}"));
                }
            }
            None => complain(link, &format!("wrong type or value for {name}")),
        }
        let all = self.read();
        if let Some(value) = position(&all, name).and_then(|index| value(&all, index)) {
            link.send(&MavMessage::PARAM_VALUE(value));
        }
    }

    /// Sends what is due of a list.
    pub(super) fn step(&mut self, link: &mut Link, now_us: u64) {
        while now_us >= self.due_us {
            let Some(value) = self.list.front() else { break };
            let before = link.port.transmitted().bytes;
            match link.port.send(&MavMessage::PARAM_VALUE(value.clone())) {
                Sent::Whole => {
                    let sent_bytes = link.port.transmitted().bytes - before;
                    self.list.pop_front();
                    self.due_us += pace_us(sent_bytes, link.data_rate());
                }
                Sent::Dropped => {
                    self.due_us = now_us + RETRY_US;
                    break;
                }
                Sent::Nobody => self.forget_list(),
            }
        }
    }

    /// Whoever comes now has not asked for it.
    pub(super) fn forget_list(&mut self) {
        self.list.clear();
    }

    pub(super) fn due_us(&self) -> u64 {
        if self.list.is_empty() { u64::MAX } else { self.due_us }
    }

    fn read(&self) -> Vec<Parameter> {
        let all = self.file.read().inspect_err(|error| say(error));
        let mut all = all.unwrap_or_default();
        // MAVLink has no room for longer ones, nor for more of them.
        all.retain(|parameter| parameter.name.len() <= 16);
        all.truncate(u16::MAX.into());
        all
    }
}

/// How long after a value of so many bytes the next one follows: half of the link is
/// left for all else.
fn pace_us(sent_bytes: u64, data_rate: u32) -> u64 {
    (sent_bytes * 2_000_000 / u64::from(data_rate)).max(PACE_MIN_US)
}

fn position(all: &[Parameter], name: &str) -> Option<usize> {
    all.iter().position(|parameter| parameter.name == name)
}

fn value(all: &[Parameter], index: usize) -> Option<PARAM_VALUE_DATA> {
    let parameter = all.get(index)?;
    let (param_type, param_value) = encode(parameter.value);
    Some(PARAM_VALUE_DATA {
        param_id: parameter.name.as_str().into(),
        param_value,
        param_type,
        param_count: u16::try_from(all.len()).ok()?,
        param_index: u16::try_from(index).ok()?,
    })
}

/// A value as MAVLink has it: its type, and its bits.
fn encode(value: ParameterValue) -> (u8, f32) {
    match value {
        ParameterValue::Int32(value) => (INT32, f32::from_bits(value.cast_unsigned())),
        ParameterValue::Float(value) => (REAL32, value),
    }
}

/// A new value; it has the old one's type, and is a number.
pub fn decode(old: ParameterValue, param_type: u8, bits: f32) -> Option<ParameterValue> {
    match (old, param_type) {
        (ParameterValue::Int32(_), INT32) => {
            Some(ParameterValue::Int32(bits.to_bits().cast_signed()))
        }
        (ParameterValue::Float(_), REAL32) => {
            bits.is_finite().then_some(ParameterValue::Float(bits))
        }
        _ => None,
    }
}

fn complain(link: &mut Link, words: &str) {
    // At most 50 letters, and whole ones: names are ASCII, but for strangers'.
    let text: String = words.chars().filter(char::is_ascii).take(50).collect();
    link.send(&MavMessage::STATUSTEXT(STATUSTEXT_DATA {
        severity: ERROR,
        text: text.as_str().into(),
        ..STATUSTEXT_DATA::DEFAULT
    }));
}

#[cfg(test)]
mod tests {
    use super::*;
    use ParameterValue::{Float, Int32};

    #[test]
    fn an_integer_goes_as_bits_and_comes_back() {
        for number in [0, 1, -1, 4_001, i32::MIN, i32::MAX] {
            let (param_type, bits) = encode(Int32(number));
            assert_eq!(decode(Int32(7), param_type, bits), Some(Int32(number)));
        }
        let (param_type, bits) = encode(Float(2.5));
        assert_eq!((param_type, bits), (REAL32, 2.5));
        assert_eq!(decode(Float(0.0), param_type, bits), Some(Float(2.5)));
    }

    #[test]
    fn a_value_keeps_its_type_and_is_a_number() {
        assert_eq!(decode(Int32(1), REAL32, 2.0), None);
        assert_eq!(decode(Float(1.0), INT32, 2.0), None);
        assert_eq!(decode(Float(1.0), REAL32, f32::NAN), None);
        assert_eq!(decode(Int32(1), 1, 2.0), None);
    }

    #[test]
    fn a_list_takes_half_of_a_slow_link() {
        assert_eq!(pace_us(37, 4_000_000), PACE_MIN_US);
        // 50 a second are 1,000 bytes a second.
        assert_eq!(pace_us(20, 2_000), 20_000);
    }

    #[test]
    fn a_value_says_which_of_how_many_it_is() {
        let parameter = |name: &str, value| Parameter { name: name.into(), value, default: None };
        let all = [parameter("SYS_AUTOSTART", Int32(4_001)), parameter("A_FLOAT", Float(0.5))];
        let second = value(&all, 1).unwrap();
        assert_eq!((second.param_count, second.param_index, second.param_value), (2, 1, 0.5));
        assert_eq!(second.param_id.to_str(), Ok("A_FLOAT"));
        assert_eq!(value(&all, 2), None);
    }
}
