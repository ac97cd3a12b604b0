//! The source of a message: what a node says about itself, as constants.

use std::collections::BTreeSet;
use std::fmt::Write;

use super::{TopicId, mark};
use crate::layout::{Layout, Member};
use crate::message::{Field, Message, Messages, Type};

/// The longest string that ISO C promises; a compiler may warn of longer ones.
const STRING_MAX_BYTES: usize = 4095;

/// `src/<message>.c`
pub(super) fn of_message(
    messages: &Messages,
    message: &Message,
    layout: &Layout,
    topics: &[TopicId<'_>],
) -> String {
    let name = &message.name;
    let mut out = mark(message);
    line!(out, "");
    line!(out, "#include <uORB/topics/{name}.h>");
    write_layouts_used(&mut out, messages, message);
    write_asserts(&mut out, message, layout);
    write_layout(&mut out, messages, message, layout);
    if topics.is_empty() {
        return out;
    }
    write_o_fields(&mut out, messages, message, layout);
    for topic in topics {
        line!(out, "");
        line!(
            out,
            "UORB_DEFINE({}, struct {name}_s, {}, o_fields_{name}, {:#010x}, {}, {}, \
             &__uorb_layout_{name});",
            topic.name,
            layout.size_no_padding_bytes,
            layout.message_hash,
            topic.id,
            message.queue_length,
        );
    }
    out
}

/// A layout is defined once, in its message's own source. Declared first, so
/// that it can be seen from others in C++ too. One that was found in a search
/// folder may have been compiled elsewhere as well, and gives way.
fn write_layouts_used(out: &mut String, messages: &Messages, message: &Message) {
    let nested: BTreeSet<&str> = message
        .fields
        .iter()
        .filter_map(|field| messages.nested(field))
        .map(|nested| &*nested.name)
        .collect();
    let weak = if message.topics.is_empty() { " __attribute__((weak))" } else { "" };
    line!(out, "");
    line!(out, "#ifdef __cplusplus");
    line!(out, "extern \"C\" {{");
    line!(out, "#endif");
    line!(out, "extern const struct orb_layout __uorb_layout_{}{weak};", message.name);
    for name in nested {
        line!(out, "extern const struct orb_layout __uorb_layout_{name};");
    }
    line!(out, "#ifdef __cplusplus");
    line!(out, "}}");
    line!(out, "#endif");
}

fn write_asserts(out: &mut String, message: &Message, layout: &Layout) {
    let name = &message.name;
    line!(out, "");
    line!(
        out,
        "UORB_STATIC_ASSERT(sizeof(struct {name}_s) == {}, \"the size of {name}\");",
        layout.size_bytes
    );
    for member in &layout.members {
        let Member::Field { index, offset_bytes } = *member else { continue };
        let field = &message.fields[index].name;
        line!(
            out,
            "UORB_STATIC_ASSERT(offsetof(struct {name}_s, {field}) == {offset_bytes}, \"the place \
             of {name}.{field}\");"
        );
    }
}

fn write_layout(out: &mut String, messages: &Messages, message: &Message, layout: &Layout) {
    let name = &message.name;
    line!(out, "");
    line!(out, "static const struct orb_field fields_{name}[] = {{");
    for field in &message.fields {
        let nested = match messages.nested(field) {
            Some(nested) => format!("&__uorb_layout_{}", nested.name),
            None => "NULL".to_string(),
        };
        line!(
            out,
            "\t{{\"{field}\", \"{}\", {}, offsetof(struct {name}_s, {field}), \"{}\", {nested}}},",
            type_name(messages, field),
            field.array_length.unwrap_or(0),
            in_string(&field.comment.unit),
            field = field.name,
        );
    }
    line!(out, "}};");
    line!(out, "");
    line!(out, "const struct orb_layout __uorb_layout_{name} = {{");
    line!(
        out,
        "\t\"{name}\", {:#010x}, sizeof(struct {name}_s), {}, fields_{name}",
        layout.message_hash,
        message.fields.len()
    );
    line!(out, "}};");
}

/// The members in the order of memory, as PX4's loggers read them:
/// `uint64_t timestamp;float[3] xyz;uint8_t[4] _padding0;`.
fn write_o_fields(out: &mut String, messages: &Messages, message: &Message, layout: &Layout) {
    let fields: Vec<String> = layout
        .members
        .iter()
        .map(|member| match *member {
            Member::Field { index, .. } => {
                let field = &message.fields[index];
                let ty = type_name(messages, field);
                match field.array_length {
                    Some(length) => format!("{ty}[{length}] {};", field.name),
                    None => format!("{ty} {};", field.name),
                }
            }
            Member::Padding { number, length_bytes } => {
                format!("uint8_t[{length_bytes}] _padding{number};")
            }
        })
        .collect();
    let is_long = fields.iter().map(String::len).sum::<usize>() >= STRING_MAX_BYTES;
    line!(out, "");
    if is_long {
        line!(out, "#pragma GCC diagnostic ignored \"-Woverlength-strings\"");
    }
    line!(out, "static const char o_fields_{}[] =", message.name);
    for (number, field) in fields.iter().enumerate() {
        let end = if number + 1 == fields.len() { ";" } else { "" };
        line!(out, "\t\"{field}\"{end}");
    }
}

/// `float`, or `esc_report` for a message.
fn type_name<'a>(messages: &'a Messages, field: &Field) -> &'a str {
    match field.ty {
        Type::Scalar(scalar) => scalar.c_name(),
        Type::Message(inner) => &messages.list[inner].name,
    }
}

/// The text as it stands between quotes in C, in ASCII.
fn in_string(text: &str) -> String {
    let mut string = String::with_capacity(text.len());
    for byte in text.bytes() {
        match byte {
            b'"' | b'\\' | b'?' => string.extend(['\\', byte.into()]),
            b' '..=b'~' => string.push(byte.into()),
            _ => string.push_str(&format!("\\{byte:03o}")),
        }
    }
    string
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_ascii_with_every_byte() {
        assert_eq!(in_string("m/s^2"), "m/s^2");
        assert_eq!(in_string("°C 1"), r"\302\260C 1");
        assert_eq!(in_string(r#"a"b\"#), r#"a\"b\\"#);
    }
}
