//! Parameters from a file, in one of two forms.
//!
//! QGroundControl's `.params`: five columns, vehicle, component, name, value and
//! MAVLink type (9: float, all others: integer). And a simple one: `NAME VALUE`,
//! or `NAME VALUE DEFAULT` where the default is known. A value with a point or an
//! exponent is a float. Lines that begin with `#` are comments.

use crate::writer::{Parameter, ParameterValue};

const MAV_PARAM_TYPE_REAL32: &str = "9";

/// What is wrong with a file of parameters.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "line {line}: {text:?} is neither `NAME VALUE [DEFAULT]` nor a line of QGroundControl's .params"
)]
pub struct ParameterFault {
    /// Counted from 1.
    pub line: usize,
    /// What stands there.
    pub text: String,
}

/// Reads a file of parameters.
///
/// # Errors
///
/// [`ParameterFault`], which names the line.
pub fn parse_parameters(text: &str) -> Result<Vec<Parameter>, ParameterFault> {
    let mut parameters = Vec::new();
    for (line, text) in (1..).zip(text.lines()) {
        let text = text.trim();
        if text.is_empty() || text.starts_with('#') {
            continue;
        }
        let parameter =
            parse_line(text).ok_or_else(|| ParameterFault { line, text: text.to_string() })?;
        parameters.push(parameter);
    }
    Ok(parameters)
}

fn parse_line(text: &str) -> Option<Parameter> {
    let columns: Vec<&str> = text.split_whitespace().collect();
    let (name, value, default) = match columns[..] {
        [name, value] => (name, guess(value)?, None),
        [name, value, default] => (name, guess(value)?, Some(guess(default)?)),
        [_, _, name, value, MAV_PARAM_TYPE_REAL32] => {
            (name, ParameterValue::Float(value.parse().ok()?), None)
        }
        [_, _, name, value, _] => (name, ParameterValue::Int32(value.parse().ok()?), None),
        _ => return None,
    };
    let is_name = name.len() <= 200
        && name.starts_with(|first: char| first.is_ascii_alphabetic())
        && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
    is_name.then(|| Parameter { name: name.to_string(), value, default })
}

fn guess(text: &str) -> Option<ParameterValue> {
    match text.parse() {
        Ok(value) => Some(ParameterValue::Int32(value)),
        Err(_) => Some(ParameterValue::Float(text.parse().ok()?)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_are_read() {
        use ParameterValue::{Float, Int32};
        let text = "# Onboard parameters\n1\t1\tMC_ROLL_P\t6.500000\t9\n1 1 SYS_AUTOSTART 4001 6\n\n\
                    EKF2_AID_MASK 3 1\nMC_YAW_P 2.8\n";
        let found: Vec<_> = (parse_parameters(text).unwrap().into_iter())
            .map(|one| (one.name, one.value, one.default))
            .collect();
        let expected = [
            ("MC_ROLL_P", Float(6.5), None),
            ("SYS_AUTOSTART", Int32(4001), None),
            ("EKF2_AID_MASK", Int32(3), Some(Int32(1))),
            ("MC_YAW_P", Float(2.8), None),
        ];
        assert_eq!(found, expected.map(|(name, value, default)| (name.into(), value, default)));
    }

    #[test]
    fn a_line_that_makes_no_sense_is_named() {
        for bad in ["A", "A x", "A 1 x", "1 1 A x 6", "1 1 A 1.5 6", "1 1 A 1 6 7", "1A 1", "A;B 1"]
        {
            let fault = parse_parameters(&format!("OK 1\n{bad}")).unwrap_err();
            assert_eq!(fault, ParameterFault { line: 2, text: bad.to_string() });
        }
    }
}
