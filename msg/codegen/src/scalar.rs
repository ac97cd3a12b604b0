//! The twelve scalar types of the .msg language, and the values of constants.

/// A scalar type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    Int8,
    Int16,
    Int32,
    Int64,
    Uint8,
    Uint16,
    Uint32,
    Uint64,
    Float32,
    Float64,
    Bool,
    Char,
}

/// What a constant is. Bool and char constants are `Int`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Value {
    Int(i128),
    Float(f64),
}

impl Scalar {
    pub(crate) const ALL: [Self; 12] = [
        Self::Int8,
        Self::Int16,
        Self::Int32,
        Self::Int64,
        Self::Uint8,
        Self::Uint16,
        Self::Uint32,
        Self::Uint64,
        Self::Float32,
        Self::Float64,
        Self::Bool,
        Self::Char,
    ];

    /// How the type is called in .msg files, in Rust, as a variant of
    /// `uorb_core::FieldType`, and in C.
    const fn names(self) -> [&'static str; 4] {
        match self {
            Self::Int8 => ["int8", "i8", "Int8", "int8_t"],
            Self::Int16 => ["int16", "i16", "Int16", "int16_t"],
            Self::Int32 => ["int32", "i32", "Int32", "int32_t"],
            Self::Int64 => ["int64", "i64", "Int64", "int64_t"],
            Self::Uint8 => ["uint8", "u8", "Uint8", "uint8_t"],
            Self::Uint16 => ["uint16", "u16", "Uint16", "uint16_t"],
            Self::Uint32 => ["uint32", "u32", "Uint32", "uint32_t"],
            Self::Uint64 => ["uint64", "u64", "Uint64", "uint64_t"],
            Self::Float32 => ["float32", "f32", "Float32", "float"],
            Self::Float64 => ["float64", "f64", "Float64", "double"],
            Self::Bool => ["bool", "::uorb_core::Bool", "Bool", "bool"],
            Self::Char => ["char", "u8", "Char", "char"],
        }
    }

    pub(crate) fn from_msg_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|scalar| scalar.msg_name() == name)
    }

    /// `float32`
    pub(crate) const fn msg_name(self) -> &'static str {
        self.names()[0]
    }

    /// The Rust type of a field.
    pub(crate) const fn rust_name(self) -> &'static str {
        self.names()[1]
    }

    /// The variant of `uorb_core::FieldType`.
    pub(crate) const fn kind_name(self) -> &'static str {
        self.names()[2]
    }

    /// The type in C, in C++, and in `o_fields`.
    pub(crate) const fn c_name(self) -> &'static str {
        self.names()[3]
    }

    pub(crate) const fn size_bytes(self) -> u32 {
        match self {
            Self::Int8 | Self::Uint8 | Self::Bool | Self::Char => 1,
            Self::Int16 | Self::Uint16 => 2,
            Self::Int32 | Self::Uint32 | Self::Float32 => 4,
            Self::Int64 | Self::Uint64 | Self::Float64 => 8,
        }
    }

    pub(crate) const fn is_integer(self) -> bool {
        !matches!(self, Self::Float32 | Self::Float64 | Self::Bool | Self::Char)
    }

    /// The smallest and the largest integer that fits.
    const fn limits(self) -> (i128, i128) {
        match self {
            Self::Int8 => (i8::MIN as i128, i8::MAX as i128),
            Self::Int16 => (i16::MIN as i128, i16::MAX as i128),
            Self::Int32 => (i32::MIN as i128, i32::MAX as i128),
            Self::Int64 => (i64::MIN as i128, i64::MAX as i128),
            Self::Uint8 | Self::Char => (0, u8::MAX as i128),
            Self::Uint16 => (0, u16::MAX as i128),
            Self::Uint32 => (0, u32::MAX as i128),
            Self::Uint64 => (0, u64::MAX as i128),
            Self::Bool => (0, 1),
            Self::Float32 | Self::Float64 => (0, 0),
        }
    }

    /// Reads the value of a constant of this type, or says what is wrong.
    pub(crate) fn read(self, text: &str) -> Result<Value, String> {
        match self {
            Self::Float32 | Self::Float64 => self.read_float(text),
            Self::Bool if matches!(text, "True" | "true") => Ok(Value::Int(1)),
            Self::Bool if matches!(text, "False" | "false") => Ok(Value::Int(0)),
            Self::Char => match text.as_bytes() {
                [b'\'', letter, b'\''] => Ok(Value::Int((*letter).into())),
                _ => self.read_integer(text),
            },
            _ => self.read_integer(text),
        }
    }

    fn read_float(self, text: &str) -> Result<Value, String> {
        let not_a_number = |_| format!("`{text}` is not a number");
        let value: f64 = text.parse().map_err(not_a_number)?;
        let spelled_out = !text.bytes().any(|byte| byte.is_ascii_digit());
        let fits = match self {
            Self::Float32 => (value as f32).is_finite(),
            _ => value.is_finite(),
        };
        // `inf` and `nan` are said on purpose; 1e40 as a float32 is not.
        if fits || spelled_out {
            Ok(Value::Float(value))
        } else {
            Err(format!("`{text}` does not fit {}", self.msg_name()))
        }
    }

    fn read_integer(self, text: &str) -> Result<Value, String> {
        let (sign, digits) = match text.strip_prefix(['-', '+']) {
            Some(digits) => (if text.starts_with('-') { -1 } else { 1 }, digits),
            None => (1, text),
        };
        let lower = digits.to_ascii_lowercase();
        let (radix, digits) = match lower.get(..2) {
            Some("0x") => (16, &lower[2..]),
            Some("0b") => (2, &lower[2..]),
            _ => (10, &*lower),
        };
        let all_digits = !digits.is_empty() && digits.chars().all(|digit| digit.is_digit(radix));
        if !all_digits {
            return Err(match self {
                Self::Bool => format!("`{text}` is not True, False, 0 or 1"),
                _ => format!("`{text}` is not an integer, as {} asks for", self.msg_name()),
            });
        }
        let (min, max) = self.limits();
        // All digits and too long for i128: out of range for every type.
        let value = i128::from_str_radix(digits, radix).map(|value| sign * value);
        match value {
            Ok(value) if (min..=max).contains(&value) => Ok(Value::Int(value)),
            _ => Err(format!("`{text}` does not fit {}: {min} to {max}", self.msg_name())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constants_are_read_however_px4_writes_them() {
        let int = |value| Ok(Value::Int(value));
        assert_eq!(Scalar::Int32.read("2147483647"), int(2_147_483_647));
        assert_eq!(Scalar::Int8.read("-128"), int(-128));
        assert_eq!(Scalar::Uint8.read("0x10"), int(16));
        assert_eq!(Scalar::Uint8.read("0b101"), int(5));
        assert_eq!(Scalar::Uint64.read("18446744073709551615"), int(u64::MAX.into()));
        assert_eq!(Scalar::Bool.read("True"), int(1));
        assert_eq!(Scalar::Bool.read("0"), int(0));
        assert_eq!(Scalar::Char.read("'A'"), int(65));
        assert_eq!(Scalar::Char.read("255"), int(255));
        assert_eq!(Scalar::Float32.read("-1.5e3"), Ok(Value::Float(-1500.0)));
        assert_eq!(Scalar::Float64.read("inf"), Ok(Value::Float(f64::INFINITY)));
    }

    #[test]
    fn constants_that_do_not_fit_their_type_are_refused() {
        for (scalar, text) in [
            (Scalar::Uint8, "256"),
            (Scalar::Uint8, "-1"),
            (Scalar::Int16, "32768"),
            (Scalar::Uint64, "99999999999999999999999999999999999999999"),
            (Scalar::Bool, "2"),
            (Scalar::Bool, "yes"),
            (Scalar::Char, "256"),
            (Scalar::Uint8, "1.5"),
            (Scalar::Uint8, "0x"),
            (Scalar::Uint8, "- 1"),
            (Scalar::Float32, "1e40"),
            (Scalar::Float32, "fast"),
        ] {
            let error = scalar.read(text).unwrap_err();
            assert!(error.contains(text), "{error}");
        }
    }
}
