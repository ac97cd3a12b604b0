//! .msg files of lines that are nearly right, put together as bytes choose.

use arbitrary::{Result, Unstructured};

const LINES_MAX: usize = 24;

/// Names of files, topics, fields and types, some of them words of a language.
const NAMES: &[&str] = &[
    "a",
    "b",
    "a_b",
    "ab",
    "AB",
    "a1",
    "a_1",
    "a__b",
    "timestamp",
    "type",
    "self",
    "Self",
    "match",
    "orb_id",
    "topics",
    "_padding0",
    "x_",
    "option",
    "vec",
    "int",
    "linux",
    "uorb_field",
    "OrbId",
    "string",
    "ORB_QUEUE_LENGTH",
    "MESSAGE_VERSION",
    "ALL",
    "LAYOUT",
    "METADATA",
    "r#x",
    "default",
    "gen",
    "a_s",
    "crate",
    "super",
    "é",
];

const TYPES: &[&str] = &[
    "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float32", "float64",
    "bool", "char", "a", "b", "AB", "px4/b", "ab",
];

const LENGTHS: &[&str] =
    &["", "[1]", "[2]", "[65535]", "[268435456]", "[4294967296]", "[]", "[0]", "[3"];

const VALUES: &[&str] = &[
    "0",
    "1",
    "-1",
    "255",
    "256",
    "0x1f",
    "0b101",
    "1.5",
    "-1e-3",
    "nan",
    "inf",
    "-inf",
    "True",
    "'A'",
    "'''",
    "'\\'",
    "9223372036854775808",
    "-9223372036854775808",
    "1e40",
    "3.4e38",
    "-0",
    "+7",
    "0x",
    "1e400",
    "2",
    "16",
];

/// What comments are made of: tags, markup of Rust's and C's documentation, and
/// letters that no source may have.
const WORDS: &[&str] = &[
    "word",
    " ",
    "[m/s^2]",
    "[@enum A]",
    "[@range 0, 1]",
    "[@frame NED]",
    "[@invalid NaN]",
    "[",
    "]",
    "`",
    "``",
    "*/",
    "/*",
    "//",
    "\\",
    "\"",
    "'",
    "??/",
    "#",
    "|",
    "<b>",
    "http://a.b",
    "https://",
    "\r",
    "\u{b}",
    "\u{c}",
    "\u{85}",
    "\u{2028}",
    "\u{2029}",
    "\u{202e}",
    "\u{2066}",
    "\u{feff}",
    "\u{200b}",
    "\0",
    "\u{1b}[2J",
    "\u{7f}",
    "é",
    "0 - ",
    "- ",
    "* ",
    "----",
    "{}",
    "@enum",
    "]]",
    "[°C]",
    "\u{9b}",
    "\u{61c}",
    "[@range \r]",
    "[\u{1680}m]",
];

/// A file's name and text.
pub(super) fn file(choices: &mut Unstructured<'_>) -> Result<(String, String)> {
    let name = format!("{}.msg", choices.choose(NAMES)?);
    let mut text = String::new();
    for _ in 0..choices.int_in_range(0..=LINES_MAX)? {
        line(choices, &mut text)?;
        text.push_str(choices.choose(&["\n", "\n", "\n", "\r\n", "\n\n", ""])?);
    }
    Ok((name, text))
}

fn line(choices: &mut Unstructured<'_>, text: &mut String) -> Result<()> {
    match choices.int_in_range(0..=7)? {
        0 => text.push_str(&format!("# TOPICS {} {}", pick(choices)?, pick(choices)?)),
        1 | 2 => {
            let (ty, value) = (choices.choose(TYPES)?, choices.choose(VALUES)?);
            text.push_str(&format!("{ty} {} = {value}", pick(choices)?));
            comment(choices, text)?;
        }
        3 => comment(choices, text)?,
        4 => text.push_str("  "),
        _ => {
            let (ty, length) = (choices.choose(TYPES)?, choices.choose(LENGTHS)?);
            text.push_str(&format!("{ty}{length} {}", pick(choices)?));
            comment(choices, text)?;
        }
    }
    Ok(())
}

fn pick(choices: &mut Unstructured<'_>) -> Result<&'static str> {
    choices.choose(NAMES).copied()
}

fn comment(choices: &mut Unstructured<'_>, text: &mut String) -> Result<()> {
    let words = choices.int_in_range(0..=6)?;
    if words > 0 {
        text.push('#');
    }
    for _ in 0..words {
        text.push_str(choices.choose(WORDS)?);
    }
    Ok(())
}
