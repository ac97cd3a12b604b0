//! A char array as a quoted string, and back.
//!
//! What stands between the quotes is what the array holds up to its first NUL.
//! Control characters and bytes that are no UTF-8 are escaped, so that a
//! message cannot command the terminal it is printed on.

use std::fmt::Write as _;

/// The text in quotes.
pub(crate) fn quote(text: &[u8]) -> String {
    let mut quoted = String::from("\"");
    for chunk in text.utf8_chunks() {
        for character in chunk.valid().chars() {
            match character {
                '"' | '\\' => quoted.extend(['\\', character]),
                '\n' => quoted.push_str("\\n"),
                '\r' => quoted.push_str("\\r"),
                '\t' => quoted.push_str("\\t"),
                // Those outside ASCII, too, as the bytes that they are.
                control if control.is_control() => {
                    escape(&mut quoted, control.encode_utf8(&mut [0; 4]).as_bytes());
                }
                other => quoted.push(other),
            }
        }
        escape(&mut quoted, chunk.invalid());
    }
    quoted.push('"');
    quoted
}

fn escape(quoted: &mut String, bytes: &[u8]) {
    for byte in bytes {
        let _ = write!(quoted, "\\x{byte:02x}");
    }
}

/// The bytes of a text that may be in quotes; without them it is taken as it
/// stands. None where an escape is not understood.
pub(crate) fn unquote(text: &str) -> Option<Vec<u8>> {
    let inner = text.strip_prefix('"').and_then(|rest| rest.strip_suffix('"'));
    let Some(inner) = inner else { return Some(text.as_bytes().to_vec()) };
    let mut bytes = Vec::new();
    let mut rest = inner;
    while let Some((plain, escaped)) = rest.split_once('\\') {
        bytes.extend_from_slice(plain.as_bytes());
        let mut characters = escaped.chars();
        match characters.next()? {
            'n' => bytes.push(b'\n'),
            'r' => bytes.push(b'\r'),
            't' => bytes.push(b'\t'),
            same @ ('"' | '\\') => bytes.push(same as u8),
            'x' => {
                bytes.push(u8::from_str_radix(escaped.get(1..3)?, 16).ok()?);
                characters = escaped.get(3..)?.chars();
            }
            _ => return None,
        }
        rest = characters.as_str();
    }
    bytes.extend_from_slice(rest.as_bytes());
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_message_cannot_command_the_terminal() {
        assert_eq!(quote(b"\x1b[2J \"a\\b\"\n"), r#""\x1b[2J \"a\\b\"\n""#);
        assert_eq!(quote("\u{9b}2J".as_bytes()), r#""\xc2\x9b2J""#);
    }

    #[test]
    fn a_text_without_quotes_is_taken_as_it_stands() {
        assert_eq!(unquote(r"C:\temp").as_deref(), Some(&br"C:\temp"[..]));
        assert_eq!(unquote(r#""\q""#), None);
        assert_eq!(unquote(r#""\x4""#), None);
    }

    proptest! {
        #[test]
        fn whatever_is_quoted_comes_back(bytes: Vec<u8>) {
            prop_assert_eq!(unquote(&quote(&bytes)), Some(bytes));
        }
    }
}
