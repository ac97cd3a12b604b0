//! The Rust module: for each message a struct with its layout and its topics,
//! and for all of them `TOPICS` and `OrbId`.
//!
//! The structs are `repr(C)` with the padding as fields, and zerocopy's derives
//! prove that there is no other: their bytes are what PX4's C structs of the
//! same text are. What this compiler computed by itself (sizes and hashes) is
//! asserted once more by rustc in the output. Paths are absolute, so that a
//! message may be called `option` or `message`.

use std::fmt::Write;

use crate::layout::{Layout, Member};
use crate::message::{Field, Message, Messages, Type};
use crate::names::{camel_case, rust_name};
use crate::parse::Constant;
use crate::scalar::{Scalar, Value};

/// Writes the module.
pub(crate) fn module(messages: &Messages, layouts: &[Layout]) -> String {
    let mut out = String::from("// Written by uorb-codegen from .msg files; edit those instead.\n");
    for (message, layout) in messages.list.iter().zip(layouts) {
        write_struct(&mut out, messages, message, layout);
        write_constants(&mut out, message);
        write_message(&mut out, messages, message, layout);
        write_topics(&mut out, message);
    }
    write_field_helper(&mut out);
    write_orb_ids(&mut out, messages);
    out
}

fn write_struct(out: &mut String, messages: &Messages, message: &Message, layout: &Layout) {
    line!(out, "");
    let mut doc = message.comment.doc_lines();
    if doc.is_empty() {
        doc.push(format!("Message `{}`.", message.name));
    }
    doc.push(String::new());
    doc.push(topics_sentence(message, layout));
    write_doc(out, "", &doc);
    line!(out, "#[derive(");
    line!(out, "    Clone, Copy, Debug, PartialEq,");
    line!(out, "    ::uorb_core::zerocopy::FromBytes, ::uorb_core::zerocopy::IntoBytes,");
    line!(out, "    ::uorb_core::zerocopy::Immutable,");
    line!(out, ")]");
    line!(out, "#[zerocopy(crate = \"uorb_core::zerocopy\")]");
    line!(out, "#[repr(C)]");
    line!(out, "pub struct {} {{", camel_case(&message.name));
    for member in &layout.members {
        match *member {
            Member::Field { index, .. } => {
                let field = &message.fields[index];
                let mut doc = field.comment.doc_lines();
                if field.comment.lines.is_empty() {
                    let declared = format!("`{}`", declaration(messages, field));
                    let separator = (!doc.is_empty()).then(String::new);
                    doc.splice(0..0, [declared].into_iter().chain(separator));
                }
                write_doc(out, "    ", &doc);
                line!(out, "    pub {}: {},", rust_name(&field.name), rust_type(messages, field));
            }
            Member::Padding { number, length_bytes } => {
                line!(out, "    /// Padding, required for the logger.");
                line!(out, "    pub _padding{number}: [u8; {length_bytes}],");
            }
        }
    }
    line!(out, "}}");
}

/// What there is to know of the struct as a topic.
fn topics_sentence(message: &Message, layout: &Layout) -> String {
    let names: Vec<String> =
        message.topics.iter().map(|topic| format!("`{}`", topic.name)).collect();
    let queue = match message.queue_length {
        1 => String::new(),
        length => format!(", queue length {length}"),
    };
    match names.as_slice() {
        [] => format!("{} bytes, no topic of its own.", layout.size_bytes),
        [name] => format!("Topic {name}: {} bytes{queue}.", layout.size_bytes),
        names => format!("Topics {}: {} bytes{queue}.", names.join(", "), layout.size_bytes),
    }
}

fn write_constants(out: &mut String, message: &Message) {
    if message.constants.is_empty() {
        return;
    }
    line!(out, "");
    let upper = |name: &str| !name.bytes().any(|byte| byte.is_ascii_lowercase());
    if !message.constants.iter().all(|constant| upper(&constant.name)) {
        line!(out, "#[allow(non_upper_case_globals)]");
    }
    if message.constants.iter().any(|constant| matches!(constant.value, Value::Float(_))) {
        // A message may well say 3.14159 and mean it.
        line!(out, "#[allow(clippy::approx_constant, clippy::excessive_precision)]");
    }
    line!(out, "impl {} {{", camel_case(&message.name));
    for constant in &message.constants {
        let mut doc = constant.comment.doc_lines();
        if doc.is_empty() {
            doc.push(format!("`{} {}`", constant.scalar.msg_name(), constant.name));
        }
        write_doc(out, "    ", &doc);
        let (ty, value) = constant_in_rust(constant);
        line!(out, "    pub const {}: {ty} = {value};", rust_name(&constant.name));
    }
    line!(out, "}}");
}

/// The type and the value of a constant. A bool constant is Rust's `bool`: a
/// field's `Bool` compares with it and is made `from` it.
fn constant_in_rust(constant: &Constant) -> (&'static str, String) {
    let ty = match constant.scalar {
        Scalar::Bool => "bool",
        scalar => scalar.rust_name(),
    };
    let value = match constant.value {
        Value::Int(value) if constant.scalar == Scalar::Bool => (value != 0).to_string(),
        Value::Int(value) => value.to_string(),
        Value::Float(value) if value.is_nan() => format!("{ty}::NAN"),
        Value::Float(value) if value.is_infinite() && value > 0.0 => format!("{ty}::INFINITY"),
        Value::Float(value) if value.is_infinite() => format!("{ty}::NEG_INFINITY"),
        Value::Float(value) if constant.scalar == Scalar::Float32 => format!("{:?}", value as f32),
        Value::Float(value) => format!("{value:?}"),
    };
    (ty, value)
}

fn write_message(out: &mut String, messages: &Messages, message: &Message, layout: &Layout) {
    let type_name = camel_case(&message.name);
    line!(out, "");
    line!(out, "impl ::core::default::Default for {type_name} {{");
    line!(out, "    fn default() -> Self {{");
    line!(out, "        ::uorb_core::zerocopy::FromZeros::new_zeroed()");
    line!(out, "    }}");
    line!(out, "}}");
    line!(out, "");
    line!(out, "impl ::uorb_core::Message for {type_name} {{");
    line!(out, "    const LAYOUT: &'static ::uorb_core::Layout = {{");
    line!(out, "        const FIELDS: &[::uorb_core::Field] = &[");
    for field in &message.fields {
        let kind = match field.ty {
            Type::Scalar(scalar) => format!("::uorb_core::FieldType::{}", scalar.kind_name()),
            Type::Message(inner) => format!(
                "::uorb_core::FieldType::Message(::std::borrow::Cow::Borrowed(<{} as \
                 ::uorb_core::Message>::LAYOUT))",
                camel_case(&messages.list[inner].name)
            ),
        };
        let length = match field.array_length {
            Some(length) => format!("::core::option::Option::Some({length})"),
            None => "::core::option::Option::None".to_string(),
        };
        line!(out, "            uorb_field(");
        line!(out, "                \"{}\",", field.name);
        line!(out, "                {kind},");
        line!(out, "                {length},");
        let member = rust_name(&field.name);
        line!(out, "                ::core::mem::offset_of!({type_name}, {member}),");
        line!(out, "                \"{}\",", field.comment.unit.escape_default());
        line!(out, "            ),");
    }
    line!(out, "        ];");
    line!(out, "        assert!(::core::mem::size_of::<{type_name}>() == {});", layout.size_bytes);
    // The layout has a nested message's name in snake case, the hash has it as
    // the text does.
    if message.fields.iter().all(|field| messages.nested(field).is_none()) {
        let hash = layout.message_hash;
        line!(out, "        assert!(::uorb_core::message_hash(FIELDS) == {hash:#010x});");
    }
    line!(out, "        &::uorb_core::Layout {{");
    line!(out, "            name: ::std::borrow::Cow::Borrowed(\"{}\"),", message.name);
    line!(out, "            size_bytes: {},", layout.size_bytes);
    line!(out, "            message_hash: {:#010x},", layout.message_hash);
    line!(out, "            fields: ::std::borrow::Cow::Borrowed(FIELDS),");
    line!(out, "        }}");
    line!(out, "    }};");
    line!(out, "}}");
}

fn write_topics(out: &mut String, message: &Message) {
    let type_name = camel_case(&message.name);
    for topic in &message.topics {
        let topic_type = camel_case(&topic.name);
        line!(out, "");
        if topic.name != message.name {
            line!(out, "/// Topic `{}`, on which [`{type_name}`] is published.", topic.name);
            line!(out, "#[derive(Clone, Copy, Debug)]");
            line!(out, "pub enum {topic_type} {{}}");
            line!(out, "");
        }
        line!(out, "impl ::uorb_core::Topic for {topic_type} {{");
        line!(out, "    type Message = {type_name};");
        line!(
            out,
            "    const METADATA: &'static ::uorb_core::Metadata = &::uorb_core::Metadata {{"
        );
        line!(out, "        name: ::std::borrow::Cow::Borrowed(\"{}\"),", topic.name);
        line!(
            out,
            "        layout: ::std::borrow::Cow::Borrowed(<{type_name} as \
             ::uorb_core::Message>::LAYOUT),"
        );
        let length = message.queue_length;
        line!(out, "        queue_length: ::uorb_core::QueueLength::at_least({length}),");
        line!(out, "    }};");
        line!(out, "}}");
    }
}

fn write_field_helper(out: &mut String) {
    out.push_str(
        "
const fn uorb_field(
    name: &'static str,
    ty: ::uorb_core::FieldType,
    array_length: ::core::option::Option<u32>,
    offset_bytes: usize,
    unit: &'static str,
) -> ::uorb_core::Field {
    ::uorb_core::Field {
        name: ::std::borrow::Cow::Borrowed(name),
        ty,
        array_length,
        offset_bytes: offset_bytes as u32,
        unit: ::std::borrow::Cow::Borrowed(unit),
    }
}
",
    );
}

fn write_orb_ids(out: &mut String, messages: &Messages) {
    let topics = messages.list.iter().flat_map(|message| &message.topics);
    let mut names: Vec<&str> = topics.map(|topic| &*topic.name).collect();
    names.sort_unstable();
    line!(out, "");
    line!(out, "/// All topics that are defined here, sorted by name.");
    line!(out, "pub static TOPICS: &[&::uorb_core::Metadata] = &[");
    for name in &names {
        line!(out, "    <{} as ::uorb_core::Topic>::METADATA,", camel_case(name));
    }
    line!(out, "];");
    line!(out, "");
    line!(out, "/// A topic by number: its place in [`TOPICS`]. Another set of messages has");
    line!(out, "/// other numbers; what lasts is the name.");
    line!(out, "#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]");
    line!(out, "#[repr(u16)]");
    line!(out, "pub enum OrbId {{");
    for name in &names {
        line!(out, "    /// `{name}`");
        line!(out, "    {},", camel_case(name));
    }
    line!(out, "}}");
    line!(out, "");
    line!(out, "impl OrbId {{");
    line!(out, "    /// All of them, in order.");
    line!(out, "    pub const ALL: &'static [Self] = &[");
    for name in &names {
        line!(out, "        Self::{},", camel_case(name));
    }
    line!(out, "    ];");
    out.push_str(
        "
    /// The topic's name, layout and queue length.
    pub fn metadata(self) -> &'static ::uorb_core::Metadata {
        TOPICS[self as usize]
    }

    /// The topic of this name, if it is defined here.
    pub fn from_name(name: &str) -> ::core::option::Option<Self> {
        let place = TOPICS.binary_search_by(|topic| (*topic.name).cmp(name)).ok()?;
        ::core::option::Option::Some(Self::ALL[place])
    }
}
",
    );
}

fn write_doc(out: &mut String, indent: &str, lines: &[String]) {
    for text in lines {
        let blank = if text.is_empty() { "" } else { " " };
        line!(out, "{indent}///{blank}{text}");
    }
}

fn rust_type(messages: &Messages, field: &Field) -> String {
    let element = match field.ty {
        Type::Scalar(scalar) => scalar.rust_name().to_string(),
        Type::Message(inner) => camel_case(&messages.list[inner].name),
    };
    match field.array_length {
        Some(length) => format!("[{element}; {length}]"),
        None => element,
    }
}

/// The field as the .msg text has it: `float32[3] xyz`.
fn declaration(messages: &Messages, field: &Field) -> String {
    let ty = messages.type_name(field);
    match field.array_length {
        Some(length) => format!("{ty}[{length}] {}", field.name),
        None => format!("{ty} {}", field.name),
    }
}
