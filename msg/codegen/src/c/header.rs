//! The header of a message: its constants and its struct, and the topics on
//! which it is published.

use std::collections::BTreeSet;
use std::fmt::Write;

use super::{constant, mark, too_large, write_comment, write_commented};
use crate::layout::{Layout, Member};
use crate::message::{Field, Message, Messages, Type};
use crate::names::camel_case;
use crate::scalar::Value;

/// `uORB/topics/<message>.h`
pub(super) fn of_message(messages: &Messages, message: &Message, layout: &Layout) -> String {
    let mut out = mark(message);
    open_guard(&mut out, &message.name);
    write_includes(&mut out, messages, message);
    write_macros(&mut out, message);
    write_struct(&mut out, messages, message, layout);
    line!(out, "");
    line!(out, "#ifdef __cplusplus");
    line!(out, "namespace px4 {{");
    line!(out, "namespace msg {{");
    line!(out, "using {} = {}_s;", camel_case(&message.name), message.name);
    line!(out, "}} // namespace msg");
    line!(out, "}} // namespace px4");
    line!(out, "#endif");
    line!(out, "");
    for topic in message.topics.iter().chain(&message.topics_elsewhere) {
        line!(out, "ORB_DECLARE({});", topic.name);
    }
    close_guard(&mut out);
    out
}

/// The header of a topic that is not named as its message.
pub(super) fn of_topic(message: &Message, topic: &str) -> String {
    let mut out = mark(message);
    open_guard(&mut out, topic);
    line!(out, "/* Messages on this topic are struct {}_s. */", message.name);
    line!(out, "#include <uORB/topics/{}.h>", message.name);
    close_guard(&mut out);
    out
}

/// The header of a message that C cannot have.
pub(super) fn of_large(message: &Message, layout: &Layout) -> String {
    let mut out = mark(message);
    line!(out, "");
    line!(out, "#error \"{}\"", too_large(message, layout));
    out
}

fn open_guard(out: &mut String, name: &str) {
    let guard = format!("UORB_TOPICS_{}_H", name.to_ascii_uppercase());
    line!(out, "");
    line!(out, "#ifndef {guard}");
    line!(out, "#define {guard}");
    line!(out, "");
}

fn close_guard(out: &mut String) {
    line!(out, "");
    line!(out, "#endif");
}

fn write_includes(out: &mut String, messages: &Messages, message: &Message) {
    let not_finite = |value| matches!(value, Value::Float(value) if !value.is_finite());
    if message.constants.iter().any(|constant| not_finite(constant.value)) {
        line!(out, "#include <math.h>");
        line!(out, "");
    }
    line!(out, "#include <uORB/uORB.h>");
    let nested: BTreeSet<&str> = message
        .fields
        .iter()
        .filter_map(|field| messages.nested(field))
        .map(|nested| &*nested.name)
        .collect();
    for name in nested {
        line!(out, "#include <uORB/topics/{name}.h>");
    }
}

fn write_macros(out: &mut String, message: &Message) {
    if message.constants.is_empty() {
        return;
    }
    line!(out, "");
    line!(out, "#ifndef __cplusplus");
    for one in &message.constants {
        let declaration =
            format!("#define {} {}", constant::macro_name(message, one), constant::in_c(one));
        write_commented(out, "", &declaration, &one.comment.plain_lines());
    }
    line!(out, "#endif");
}

fn write_struct(out: &mut String, messages: &Messages, message: &Message, layout: &Layout) {
    let mut doc = message.comment.plain_lines();
    if doc.is_empty() {
        doc.push(format!("Message {}.", message.name));
    }
    doc.push(String::new());
    doc.push(topics_sentence(message, layout));
    line!(out, "");
    write_comment(out, "", &doc);
    line!(out, "struct {}_s {{", message.name);
    for member in &layout.members {
        match *member {
            Member::Field { index, .. } => {
                let field = &message.fields[index];
                let declaration = declaration(messages, field);
                write_commented(out, "\t", &declaration, &field.comment.plain_lines());
            }
            Member::Padding { number, length_bytes } => {
                line!(out, "\tuint8_t _padding{number}[{length_bytes}]; // required for logger");
            }
        }
    }
    if !message.constants.is_empty() {
        line!(out, "");
        line!(out, "#ifdef __cplusplus");
        for one in &message.constants {
            let (ty, value) = (one.scalar.c_name(), constant::in_cpp(one));
            let declaration = format!("static constexpr {ty} {} = {value};", one.name);
            write_commented(out, "\t", &declaration, &one.comment.plain_lines());
        }
        line!(out, "#endif");
    }
    line!(out, "}};");
}

/// The member as C declares it: `float xyz[3];`.
fn declaration(messages: &Messages, field: &Field) -> String {
    let ty = match field.ty {
        Type::Scalar(scalar) => scalar.c_name().to_string(),
        Type::Message(inner) => format!("struct {}_s", messages.list[inner].name),
    };
    match field.array_length {
        Some(length) => format!("{ty} {}[{length}];", field.name),
        None => format!("{ty} {};", field.name),
    }
}

/// What there is to know of the struct as a topic.
fn topics_sentence(message: &Message, layout: &Layout) -> String {
    let names: Vec<&str> = message.topics.iter().map(|topic| &*topic.name).collect();
    let bytes = layout.size_bytes;
    let queue = match message.queue_length {
        1 => String::new(),
        length => format!(", queue length {length}"),
    };
    match names.as_slice() {
        [] => format!("{bytes} bytes, no topic of its own."),
        [name] => format!("Topic {name}: {bytes} bytes{queue}."),
        names => format!("Topics {}: {bytes} bytes{queue}.", names.join(", ")),
    }
}
