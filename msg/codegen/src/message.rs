//! Messages as they are meant: types looked up, topics and queue length known.
//!
//! What one file cannot tell by itself is settled here, over all files at
//! once: which message a field's type is, whether two topics or two Rust types
//! would have one name, and whether a message contains itself. Afterwards a
//! message is plain data, and nothing behind this stage can meet a name that
//! does not exist. A field with a fault is left out, so that one mistake is
//! reported once.

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
    pub(crate) queue_length: u32,
}

#[derive(Debug)]
pub(crate) struct Field {
    pub(crate) name: String,
    pub(crate) ty: Type,
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

/// One .msg file, read.
#[derive(Debug)]
pub(crate) struct File {
    /// The file's name without `.msg`.
    pub(crate) stem: String,
    pub(crate) ast: Ast,
    pub(crate) notes: Notes,
    /// Found in a search folder: part of the output only if a message of ours
    /// contains it.
    pub(crate) searched: bool,
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

/// Settles the messages of all files.
pub(crate) fn resolve(files: Vec<File>) -> Messages {
    let mut messages = Messages::default();
    let (mut files, doubles) = by_name(files);
    messages.faults.extend(doubles);
    leave_out_what_nobody_contains(&mut files);
    let places: BTreeMap<String, usize> =
        files.keys().enumerate().map(|(place, name)| (name.clone(), place)).collect();
    let mut all_notes = Vec::new();
    for (name, file) in files {
        let mut notes = file.notes;
        messages.list.push(message(name, file.ast, file.searched, &places, &mut notes));
        all_notes.push(notes);
    }
    break_cycles(&mut messages.list, &mut all_notes);
    refuse_equal_names(&messages.list, &mut all_notes);
    for notes in all_notes {
        messages.faults.extend(notes.faults);
        messages.warnings.extend(notes.warnings);
    }
    messages
}

/// The files by their snake-case names, and those that share one.
fn by_name(files: Vec<File>) -> (BTreeMap<String, File>, Vec<Fault>) {
    let mut named = BTreeMap::new();
    let mut doubles = Vec::new();
    for mut file in files {
        match named.entry(names::snake_case(&file.stem)) {
            Entry::Vacant(place) => {
                place.insert(file);
            }
            // A folder's own messages go before those of search folders.
            Entry::Occupied(_) if file.searched => {}
            Entry::Occupied(first) => {
                let (first_path, name) = (first.get().notes.path(), first.key());
                file.notes.fault(None, format!("message `{name}` exists already: {first_path}"));
                doubles.append(&mut file.notes.faults);
            }
        }
    }
    (named, doubles)
}

fn leave_out_what_nobody_contains(files: &mut BTreeMap<String, File>) {
    let mut wanted: Vec<String> =
        files.iter().filter(|(_, file)| !file.searched).map(|(name, _)| name.clone()).collect();
    let mut kept = BTreeMap::new();
    while let Some(name) = wanted.pop() {
        if let Some(file) = files.remove(&name) {
            wanted.extend(file.ast.fields.iter().map(|field| names::snake_case(&field.type_name)));
            kept.insert(name, file);
        }
    }
    *files = kept;
}

fn message(
    name: String,
    ast: Ast,
    searched: bool,
    places: &BTreeMap<String, usize>,
    notes: &mut Notes,
) -> Message {
    if !names::is_word(&name) {
        notes.fault(None, format!("`{name}` cannot be a message's name: letters, digits and `_`"));
    } else if matches!(names::camel_case(&name).as_str(), "Self" | "OrbId") {
        notes
            .fault(None, format!("message `{name}` needs another name: this one is taken in Rust"));
    }
    refuse_doubles(&ast, notes);
    let queue_length = queue_length(&ast.constants, notes);
    let topics = if searched { Vec::new() } else { topics(&name, ast.topics, notes) };
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

fn queue_length(constants: &[Constant], notes: &mut Notes) -> u32 {
    let Some(constant) = constants.iter().find(|one| one.name == "ORB_QUEUE_LENGTH") else {
        return 1;
    };
    match constant.value {
        Value::Int(length)
            if constant.scalar.is_integer()
                && (1..=QUEUE_LENGTH_MAX).contains(&length)
                && length.count_ones() == 1 =>
        {
            length as u32
        }
        value => {
            let value = match value {
                Value::Int(value) => value.to_string(),
                Value::Float(value) => value.to_string(),
            };
            let text = format!(
                "`ORB_QUEUE_LENGTH = {value}`: a queue's length is a power of two up to \
                 {QUEUE_LENGTH_MAX}"
            );
            notes.fault(constant.line, text);
            1
        }
    }
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
        let text = format!(
            "the first topic is `{}`, not `{message}` as the file is named; there is no topic \
             `{message}` unless it is listed",
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
    let FieldLine { name, array_length, comment, line, .. } = field;
    Some(Field { name, ty, array_length, comment, line })
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
            fields.insert(0, Field { name, ty, array_length: None, comment, line: 1 });
        }
    }
}

/// Leaves out, with a fault, the fields by which messages contain themselves.
fn break_cycles(list: &mut [Message], notes: &mut [Notes]) {
    let mut done = vec![false; list.len()];
    for place in 0..list.len() {
        visit(place, &mut Vec::new(), &mut done, list, notes);
    }
}

fn visit(
    place: usize,
    above: &mut Vec<usize>,
    done: &mut [bool],
    list: &mut [Message],
    notes: &mut [Notes],
) {
    if done[place] {
        return;
    }
    above.push(place);
    let mut index = 0;
    while let Some(field) = list[place].fields.get(index) {
        index += 1;
        let Type::Message(inner) = field.ty else { continue };
        let Some(start) = above.iter().position(|&outer| outer == inner) else {
            visit(inner, above, done, list, notes);
            continue;
        };
        let path = above[start..].iter().chain([&inner]);
        let path: Vec<&str> = path.map(|&message| &*list[message].name).collect();
        let name = &list[inner].name;
        let text = format!("message `{name}` contains itself: {}", path.join(" > "));
        notes[place].fault(field.line, text);
        index -= 1;
        list[place].fields.remove(index);
    }
    above.pop();
    done[place] = true;
}

/// Two topics must not have one name, and neither must two Rust types.
fn refuse_equal_names(list: &[Message], notes: &mut [Notes]) {
    let mut topics: BTreeMap<&str, &str> = BTreeMap::new();
    let mut types: BTreeMap<String, String> = list
        .iter()
        .map(|message| (names::camel_case(&message.name), message.path.clone()))
        .collect();
    if types.len() < list.len() {
        refuse_equal_structs(list, notes);
    }
    for (message, notes) in list.iter().zip(notes) {
        for topic in &message.topics {
            let (name, line) = (&*topic.name, topic.line);
            if let Some(other) = topics.insert(name, &message.path) {
                notes.fault(line, format!("topic `{name}` is defined already, by {other}"));
            } else if *name != message.name {
                let type_name = names::camel_case(name);
                if let Some(other) = types.insert(type_name.clone(), message.path.clone()) {
                    let text = format!(
                        "topic `{name}` would be the Rust type `{type_name}`, which {other} has"
                    );
                    notes.fault(line, text);
                } else if type_name == "OrbId" {
                    notes.fault(line, format!("topic `{name}` needs another name"));
                }
            }
        }
    }
}

fn refuse_equal_structs(list: &[Message], notes: &mut [Notes]) {
    let mut first: BTreeMap<String, &str> = BTreeMap::new();
    for (message, notes) in list.iter().zip(notes) {
        let type_name = names::camel_case(&message.name);
        if let Some(other) = first.get(&type_name) {
            let text = format!("this would be the Rust type `{type_name}`, as {other}");
            notes.fault(None, text);
        } else {
            first.insert(type_name, &message.path);
        }
    }
}
