//! A message as it is meant: types looked up, timestamp, topics and queue
//! length settled.
//!
//! It is plain data, and all that the writers need. Nothing behind this stage
//! can meet a type that does not exist: a field with a fault is left out, so
//! that one mistake is told once.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use crate::comment::Comment;
use crate::fault::{Fault, Notes};
use crate::names;
use crate::parse::{Ast, Constant, FieldLine, TopicName};
use crate::scalar::{Scalar, Value};

/// The longest queue a node keeps, PX4's limit.
const QUEUE_LENGTH_MAX: i128 = 128;

/// A message with everything the writers need.
#[derive(Debug)]
pub(crate) struct Message {
    /// The name in snake case: `sensor_accel`.
    pub(crate) name: String,
    pub(crate) path: String,
    pub(crate) comment: Comment,
    /// In the order of the text, an inserted timestamp first.
    pub(crate) fields: Vec<Field>,
    pub(crate) constants: Vec<Constant>,
    /// In the order of the text. Empty: only nested in others (it comes from a
    /// search folder).
    pub(crate) topics: Vec<TopicName>,
    /// The topics of a message from a search folder: somebody else defines
    /// them, but a header in C can declare them.
    pub(crate) topics_elsewhere: Vec<TopicName>,
    pub(crate) queue_length: u32,
}

#[derive(Debug)]
pub(crate) struct Field {
    pub(crate) name: String,
    pub(crate) ty: Type,
    /// The type as the text has it, without a package: `EscReport`. PX4 hashes
    /// that.
    pub(crate) written_type: String,
    pub(crate) array_length: Option<u32>,
    pub(crate) comment: Comment,
    pub(crate) line: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Type {
    Scalar(Scalar),
    /// The message's place in the list of all.
    Message(usize),
}

/// All messages, sorted by name, with what is wrong in their files.
#[derive(Debug, Default)]
pub(crate) struct Messages {
    pub(crate) list: Vec<Message>,
    pub(crate) faults: Vec<Fault>,
    pub(crate) warnings: Vec<Fault>,
}

impl Messages {
    /// The message that a field contains, if it contains one.
    pub(crate) fn nested(&self, field: &Field) -> Option<&Message> {
        match field.ty {
            Type::Scalar(_) => None,
            Type::Message(index) => Some(&self.list[index]),
        }
    }

    /// The name of a field's type in .msg files: `float32`, `esc_report`.
    pub(crate) fn type_name(&self, field: &Field) -> &str {
        match field.ty {
            Type::Scalar(scalar) => scalar.msg_name(),
            Type::Message(index) => &self.list[index].name,
        }
    }
}

/// Settles one message; `places` has the names of all.
pub(crate) fn resolve(
    name: String,
    ast: Ast,
    searched: bool,
    places: &BTreeMap<String, usize>,
    notes: &mut Notes,
) -> Message {
    if !names::is_word(&name) {
        notes.fault(None, format!("`{name}` cannot be a message's name: letters, digits and `_`"));
    } else if names::camel_case(&name) == "Self" {
        notes.fault(
            None,
            format!("message `{name}` needs another name: in Rust this one is a keyword"),
        );
    }
    refuse_doubles(&ast, notes);
    let queue_length = queue_length(&ast.constants, notes);
    let (topics, topics_elsewhere) = match (searched, ast.topics) {
        (false, listed) => (topics(&name, listed, notes), Vec::new()),
        (true, none) if none.is_empty() => (none, vec![TopicName { name: name.clone(), line: 1 }]),
        (true, listed) => (Vec::new(), listed),
    };
    let fields = ast.fields.into_iter().filter_map(|field| resolve_field(field, places, notes));
    let mut fields: Vec<Field> = fields.collect();
    insert_timestamp(&mut fields, notes);
    Message {
        name,
        path: notes.path().to_string(),
        comment: ast.comment,
        fields,
        constants: ast.constants,
        topics,
        topics_elsewhere,
        queue_length,
    }
}

fn refuse_doubles(ast: &Ast, notes: &mut Notes) {
    let fields = ast.fields.iter().map(|field| ("field", &field.name, field.line));
    let constants = ast.constants.iter().map(|one| ("constant", &one.name, one.line));
    let mut first_lines: BTreeMap<&str, u32> = BTreeMap::new();
    let mut declared: Vec<_> = fields.chain(constants).collect();
    declared.sort_by_key(|&(_, _, line)| line);
    for (kind, name, line) in declared {
        match first_lines.entry(name) {
            Entry::Vacant(place) => {
                place.insert(line);
            }
            Entry::Occupied(first) => {
                let first = first.get();
                notes.fault(line, format!("{kind} `{name}` is declared already, in line {first}"));
            }
        }
    }
}

/// The queue length that the text asks for, rounded up to a power of two: PX4
/// had queues of 3, 5 and 10 until 2020, and rounded them so from then on.
fn queue_length(constants: &[Constant], notes: &mut Notes) -> u32 {
    let Some(constant) = constants.iter().find(|one| one.name == "ORB_QUEUE_LENGTH") else {
        return 1;
    };
    let written = match constant.value {
        Value::Int(length) => {
            if constant.scalar.is_integer() && (1..=QUEUE_LENGTH_MAX).contains(&length) {
                let rounded = (length as u32).next_power_of_two();
                if i128::from(rounded) != length {
                    let text = format!(
                        "`ORB_QUEUE_LENGTH = {length}`: a queue's length is a power of two; this \
                         one becomes {rounded}"
                    );
                    notes.warn(constant.line, text);
                }
                return rounded;
            }
            length.to_string()
        }
        Value::Float(length) => length.to_string(),
    };
    let text = format!(
        "`ORB_QUEUE_LENGTH = {written}`: a queue's length is a whole number from 1 to \
         {QUEUE_LENGTH_MAX}"
    );
    notes.fault(constant.line, text);
    1
}

/// The topics of the `# TOPICS` lines, or the one that is named as the message.
fn topics(message: &str, listed: Vec<TopicName>, notes: &mut Notes) -> Vec<TopicName> {
    let Some(first) = listed.first() else {
        if message.len() > names::TOPIC_NAME_MAX_BYTES {
            let max = names::TOPIC_NAME_MAX_BYTES;
            let text = format!("`{message}` is longer than a topic's name may be, {max} bytes");
            notes.fault(None, text);
        }
        return vec![TopicName { name: message.to_string(), line: 1 }];
    };
    if first.name != message {
        let is_listed = listed.iter().any(|topic| topic.name == message);
        let none =
            if is_listed { String::new() } else { format!("; there is no topic `{message}`") };
        let text = format!(
            "the first topic is `{}`, not `{message}` as the file is named{none}",
            first.name
        );
        notes.warn(first.line, text);
    }
    let mut topics: Vec<TopicName> = Vec::new();
    for topic in listed {
        if topics.iter().any(|other| other.name == topic.name) {
            notes.fault(topic.line, format!("topic `{}` is listed already", topic.name));
        } else {
            topics.push(topic);
        }
    }
    topics
}

fn resolve_field(
    field: FieldLine,
    places: &BTreeMap<String, usize>,
    notes: &mut Notes,
) -> Option<Field> {
    let type_name = &field.type_name;
    let ty = Scalar::from_msg_name(type_name)
        .map(Type::Scalar)
        .or_else(|| places.get(&names::snake_case(type_name)).map(|&place| Type::Message(place)));
    let Some(ty) = ty else {
        notes.fault(field.line, format!("unknown type `{type_name}`{}", hint(type_name, places)));
        return None;
    };
    let FieldLine { name, type_name: written_type, array_length, comment, line, .. } = field;
    Some(Field { name, ty, written_type, array_length, comment, line })
}

/// What to write instead of a type that does not exist.
fn hint(type_name: &str, places: &BTreeMap<String, usize>) -> String {
    let known = match type_name {
        "string" | "wstring" => return ": text has a fixed size here, as `char[32]`".to_string(),
        "time" | "duration" => return ": write microseconds as `uint64`".to_string(),
        "byte" => Some("int8"),
        "float" => Some("float32"),
        "double" => Some("float64"),
        "int" => Some("int32"),
        c_type => c_type.strip_suffix("_t"),
    };
    let snake = names::snake_case(type_name);
    let scalars = || Scalar::ALL.iter().map(|scalar| scalar.msg_name());
    let near = known
        .filter(|name| scalars().any(|scalar| scalar == *name))
        .or_else(|| names::nearest(&snake, scalars().chain(places.keys().map(String::as_str))));
    match near {
        Some(near) => format!("; did you mean `{near}`?"),
        None => format!("; there is no file {type_name}.msg beside this one"),
    }
}

fn insert_timestamp(fields: &mut Vec<Field>, notes: &mut Notes) {
    let ty = Type::Scalar(Scalar::Uint64);
    match fields.iter_mut().find(|field| field.name == "timestamp") {
        Some(field) if field.ty == ty && field.array_length.is_none() => {
            if field.comment.unit.is_empty() {
                field.comment.unit = "us".to_string();
            }
        }
        Some(field) => {
            let text =
                "`timestamp` is a `uint64` in every message; leave it out to have it inserted";
            notes.fault(field.line, text);
        }
        None => {
            let lines = vec!["Time since the system started.".to_string()];
            let comment = Comment { lines, unit: "us".to_string(), ..Comment::default() };
            let name = "timestamp".to_string();
            let written_type = "uint64".to_string();
            fields
                .insert(0, Field { name, ty, written_type, array_length: None, comment, line: 1 });
        }
    }
}
