//! C and C++: for each message a header and a source with its metadata, and for
//! all of them the list of topics.
//!
//! One text serves both languages: the headers are C11 and C++17, and so are
//! the sources, whatever compiler a program's build gives them to. Structs are
//! PX4's, with its padding as members, so that no compiler adds any; what this
//! one computed (sizes and offsets) is asserted once more by theirs.
//!
//! PX4's struct of metadata counts a message's bytes in 16 bits. Messages that
//! have more are left out of the sources and of the list, and their headers say
//! so to whoever includes them.

mod constant;
mod header;
mod source;
mod topic_list;

use std::collections::BTreeMap;

use crate::comment::harmless;
use crate::fault::Fault;
use crate::layout::Layout;
use crate::message::{Message, Messages};
use crate::names;

/// How every file starts: by this it is known as ours.
pub(crate) const MARK: &str = "/* Written by `uorb msg` from ";

/// The most bytes of a message in C: what `o_size` can say.
const SIZE_MAX_BYTES: u64 = u16::MAX as u64;

/// A topic that C programs have: its name, and its place among all of them.
#[derive(Clone, Copy)]
struct TopicId<'a> {
    name: &'a str,
    message: &'a Message,
    id: usize,
}

/// Writes all files: path and text.
pub(crate) fn files(messages: &Messages, layouts: &[Layout]) -> Vec<(String, String)> {
    let topics = topics(messages, layouts);
    let mut files = Vec::new();
    for (message, layout) in messages.list.iter().zip(layouts) {
        let name = &message.name;
        let is_large = layout.size_bytes > SIZE_MAX_BYTES;
        let header = match is_large {
            true => header::of_large(message, layout),
            false => header::of_message(messages, message, layout),
        };
        files.push((header_path(name), header));
        for topic in message.topics.iter().chain(&message.topics_elsewhere) {
            if topic.name != *name {
                files.push((header_path(&topic.name), header::of_topic(message, &topic.name)));
            }
        }
        if !is_large {
            let ids: Vec<TopicId<'_>> =
                topics.iter().filter(|topic| topic.message.name == *name).copied().collect();
            files.push((
                format!("src/{name}.c"),
                source::of_message(messages, message, layout, &ids),
            ));
        }
    }
    files.extend(topic_list::files(&topics));
    files.sort();
    // Two messages of a search folder can name one topic.
    files.dedup_by(|later, first| later.0 == first.0);
    files
}

fn header_path(name: &str) -> String {
    format!("include/uORB/topics/{name}.h")
}

/// The topics that C programs have, sorted by name.
fn topics<'a>(messages: &'a Messages, layouts: &[Layout]) -> Vec<TopicId<'a>> {
    let small = messages.list.iter().zip(layouts);
    let small = small.filter(|(_, layout)| layout.size_bytes <= SIZE_MAX_BYTES);
    let mut topics: Vec<TopicId<'_>> = small
        .flat_map(|(message, _)| message.topics.iter().map(move |topic| (message, topic)))
        .map(|(message, topic)| TopicId { name: &topic.name, message, id: 0 })
        .collect();
    topics.sort_unstable_by_key(|topic| topic.name);
    topics.iter_mut().enumerate().for_each(|(id, topic)| topic.id = id);
    topics
}

/// Finds names that are words of the language in C and C++ alone.
pub(crate) fn refuse_names(messages: &mut Messages) {
    let mut faults = Vec::new();
    for message in &messages.list {
        let mut check = |kind: &str, name: &str, line| {
            let what = match names::reserved_in_c(name) {
                Some(what) => what,
                None if kind == "constant" && name == format!("{}_s", message.name) => {
                    "the struct around it"
                }
                None => return,
            };
            let text = format!("{kind} `{name}` cannot have this name: it is {what}");
            faults.push(Fault { path: message.path.clone(), line, text });
        };
        for topic in message.topics.iter().chain(&message.topics_elsewhere) {
            // A topic that no line names is the file's.
            let line = (topic.line != 1 || topic.name != message.name).then_some(topic.line);
            check("topic", &topic.name, line);
        }
        for field in &message.fields {
            check("field", &field.name, Some(field.line));
        }
        for constant in &message.constants {
            check("constant", &constant.name, Some(constant.line));
        }
    }
    messages.faults.extend(faults);
}

/// What is odd about the messages in C alone.
pub(crate) fn warnings(messages: &Messages, layouts: &[Layout]) -> Vec<Fault> {
    let mut warnings = equal_macros(messages);
    for (message, layout) in messages.list.iter().zip(layouts) {
        if layout.size_bytes > SIZE_MAX_BYTES {
            let text = format!("{}; it is left out here", too_large(message, layout));
            warnings.push(Fault { path: message.path.clone(), line: None, text });
        }
    }
    warnings
}

/// Two constants that are one macro in C: whoever includes both headers is
/// warned by the compiler, and has the one that comes last.
fn equal_macros(messages: &Messages) -> Vec<Fault> {
    let mut owners: BTreeMap<String, (&Message, String)> = BTreeMap::new();
    let mut warnings = Vec::new();
    for message in &messages.list {
        for constant in &message.constants {
            let name = constant::macro_name(message, constant);
            let value = constant::in_c(constant);
            let (owner, other_value) =
                owners.entry(name.clone()).or_insert_with(|| (message, value.clone()));
            if *other_value != value {
                let text = format!("constant `{name}` of C has another value in {}", owner.path);
                let line = Some(constant.line);
                warnings.push(Fault { path: message.path.clone(), line, text });
            }
        }
    }
    warnings
}

/// Why a message is not for C, and what to do.
fn too_large(message: &Message, layout: &Layout) -> String {
    let topics: Vec<&str> = message.topics.iter().map(|topic| &*topic.name).collect();
    let what = match topics.as_slice() {
        [] => format!("message {}", message.name),
        [topic] => format!("topic {topic}"),
        topics => format!("topics {}", topics.join(", ")),
    };
    let bytes = layout.size_bytes;
    format!(
        "{what}: {bytes} bytes are more than the {SIZE_MAX_BYTES} of a message in C and C++; it \
         travels as a stream, which programs in Rust read and write"
    )
}

/// The first line of a file, which says from where it comes.
fn mark(message: &Message) -> String {
    let path = &message.path;
    let file = path.rsplit_once('/').map_or(&**path, |(_, file)| file);
    format!("{MARK}{}; edit that instead. */\n", in_comment(file))
}

/// The text so that it can stand in a comment and that no compiler warns of it.
fn in_comment(text: &str) -> String {
    let text = harmless(text);
    text.replace("*/", "* /").replace("/*", "/ *").replace("??/", "?? /")
}

/// Writes lines as a comment in front of a declaration.
fn write_comment(out: &mut String, indent: &str, lines: &[String]) {
    use std::fmt::Write;
    line!(out, "{indent}/**");
    for text in lines {
        let text = in_comment(text);
        line!(out, "{indent} *{}{text}", if text.is_empty() { "" } else { " " });
    }
    line!(out, "{indent} */");
}

/// Writes a declaration with its comment: behind it if that is short.
fn write_commented(out: &mut String, indent: &str, declaration: &str, comment: &[String]) {
    use std::fmt::Write;
    match comment {
        [] => line!(out, "{indent}{declaration}"),
        [text] if declaration.len() + text.len() <= 100 => {
            line!(out, "{indent}{declaration} /**< {} */", in_comment(text));
        }
        lines => {
            write_comment(out, indent, lines);
            line!(out, "{indent}{declaration}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_never_end_the_comment_they_stand_in() {
        assert_eq!(in_comment("a */ b /* c ??/ d\u{202e}"), "a * / b / * c ?? / d");
        assert_eq!(in_comment("/*/"), "/ * /");
    }
}
