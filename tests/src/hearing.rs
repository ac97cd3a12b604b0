//! What the process of a story is told: its arguments, and lines of its input.

use std::io::{BufRead, stdin};

/// A number among the arguments.
pub fn number(text: &str) -> u64 {
    text.parse().unwrap_or_else(|_| panic!("{text:?} is not a number"))
}

/// The next line of the story; None when it has said all.
pub fn heard() -> Option<String> {
    let mut line = String::new();
    (stdin().lock().read_line(&mut line).expect("the pipe can be read") > 0).then_some(line)
}
