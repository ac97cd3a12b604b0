//! The values of constants, as C and C++ write them.

use crate::message::Message;
use crate::parse::Constant;
use crate::scalar::{Scalar, Value};

/// `SENSOR_ACCEL_X`, a macro in C: constants have no struct there to be in.
pub(super) fn macro_name(message: &Message, constant: &Constant) -> String {
    format!("{}_{}", message.name.to_ascii_uppercase(), constant.name)
}

/// The value in C, where a macro is put into any expression.
pub(super) fn in_c(constant: &Constant) -> String {
    let text = value(constant);
    match (constant.scalar, constant.value) {
        (Scalar::Float64, Value::Float(value)) if !value.is_finite() => {
            format!("((double){text})")
        }
        (Scalar::Char, Value::Int(128..)) => format!("((char){text})"),
        _ if text.starts_with('-') => format!("({text})"),
        _ => text,
    }
}

/// The value in C++, where it initializes a constant of its type.
pub(super) fn in_cpp(constant: &Constant) -> String {
    let text = value(constant);
    match (constant.scalar, constant.value) {
        (Scalar::Float64, Value::Float(value)) if !value.is_finite() => {
            format!("static_cast<double>({text})")
        }
        // A char may have a sign.
        (Scalar::Char, Value::Int(128..)) => format!("static_cast<char>({text})"),
        _ => text,
    }
}

fn value(constant: &Constant) -> String {
    match constant.value {
        Value::Int(value) => integer(constant.scalar, value),
        Value::Float(value) if value.is_nan() => "NAN".to_string(),
        Value::Float(value) if value.is_infinite() && value > 0.0 => "INFINITY".to_string(),
        Value::Float(value) if value.is_infinite() => "-INFINITY".to_string(),
        Value::Float(value) if constant.scalar == Scalar::Float32 => {
            format!("{:?}f", value as f32)
        }
        Value::Float(value) => format!("{value:?}"),
    }
}

/// The smallest integers have names, because C has a minus and a number that is
/// too large without it.
fn integer(scalar: Scalar, value: i128) -> String {
    match scalar {
        Scalar::Bool => (value != 0).to_string(),
        Scalar::Int32 if value == i32::MIN.into() => "INT32_MIN".to_string(),
        Scalar::Int64 if value == i64::MIN.into() => "INT64_MIN".to_string(),
        Scalar::Int64 if value < 0 => format!("-INT64_C({})", -value),
        Scalar::Int64 => format!("INT64_C({value})"),
        Scalar::Uint32 => format!("{value}U"),
        Scalar::Uint64 => format!("UINT64_C({value})"),
        _ => value.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comment::Comment;

    fn check(scalar: Scalar, text: &str, c: &str, cpp: &str) {
        let value = scalar.read(text).unwrap();
        let (name, comment) = ("X".to_string(), Comment::default());
        let constant = Constant { scalar, name, value, comment, line: 1 };
        assert_eq!((in_c(&constant), in_cpp(&constant)), (c.to_string(), cpp.to_string()));
    }

    #[test]
    fn integers_have_the_type_that_they_need() {
        check(Scalar::Uint8, "255", "255", "255");
        check(Scalar::Int16, "-0x10", "(-16)", "-16");
        check(Scalar::Int32, "-2147483647", "(-2147483647)", "-2147483647");
        check(Scalar::Int32, "-2147483648", "INT32_MIN", "INT32_MIN");
        check(Scalar::Uint32, "4294967295", "4294967295U", "4294967295U");
        check(Scalar::Int64, "5", "INT64_C(5)", "INT64_C(5)");
        check(Scalar::Int64, "-5", "(-INT64_C(5))", "-INT64_C(5)");
        check(Scalar::Int64, "-9223372036854775808", "INT64_MIN", "INT64_MIN");
        let max = "UINT64_C(18446744073709551615)";
        check(Scalar::Uint64, "18446744073709551615", max, max);
        check(Scalar::Bool, "True", "true", "true");
        check(Scalar::Char, "'A'", "65", "65");
        check(Scalar::Char, "255", "((char)255)", "static_cast<char>(255)");
    }

    #[test]
    fn floats_keep_every_digit() {
        check(Scalar::Float32, "25.2", "25.2f", "25.2f");
        check(Scalar::Float32, "-1", "(-1.0f)", "-1.0f");
        check(Scalar::Float32, "1e-30", "1e-30f", "1e-30f");
        check(Scalar::Float64, "3.14159265358979", "3.14159265358979", "3.14159265358979");
        check(Scalar::Float64, "1e300", "1e300", "1e300");
        check(Scalar::Float32, "nan", "NAN", "NAN");
        check(Scalar::Float32, "-inf", "(-INFINITY)", "-INFINITY");
        check(Scalar::Float64, "nan", "((double)NAN)", "static_cast<double>(NAN)");
        check(Scalar::Float64, "-inf", "((double)-INFINITY)", "static_cast<double>(-INFINITY)");
    }
}
