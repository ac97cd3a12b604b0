//! What only all files together can tell, or get wrong.
//!
//! Which file a field's type means, which messages of a search folder are
//! needed, whether two topics or two Rust types would have one name, and
//! whether a message contains itself.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

use crate::fault::{Fault, Notes};
use crate::message::{self, Message, Messages, Type};
use crate::names;
use crate::parse::Ast;

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
        messages.list.push(message::resolve(name, file.ast, file.searched, &places, &mut notes));
        all_notes.push(notes);
    }
    break_cycles(&mut messages.list, &mut all_notes);
    refuse_equal_topics(&messages.list, &mut all_notes);
    refuse_equal_types(&messages.list, &mut all_notes);
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

fn refuse_equal_topics(list: &[Message], notes: &mut [Notes]) {
    let mut owners: BTreeMap<&str, &str> = BTreeMap::new();
    for (message, notes) in list.iter().zip(notes) {
        for topic in &message.topics {
            if let Some(other) = owners.insert(&topic.name, &message.path) {
                let text = format!("topic `{}` is defined already, by {other}", topic.name);
                notes.fault(topic.line, text);
            }
        }
    }
}

/// A message is a Rust type, and so is every topic that is not named as its
/// message; `group_1` and `group1` would both be `Group1`.
fn refuse_equal_types(list: &[Message], notes: &mut [Notes]) {
    let mut owners: BTreeMap<String, &str> = BTreeMap::new();
    owners.insert("OrbId".to_string(), "every module");
    // Two topics of one name have their fault already.
    let mut seen: BTreeSet<&str> = BTreeSet::new();
    for (message, notes) in list.iter().zip(&mut *notes) {
        seen.extend(message.topics.iter().map(|topic| &*topic.name).filter(|n| *n == message.name));
        let type_name = names::camel_case(&message.name);
        match owners.get(&type_name) {
            Some(other) => {
                let text = format!("this would be the Rust type `{type_name}`, which {other} has");
                notes.fault(None, text);
            }
            None => {
                owners.insert(type_name, &message.path);
            }
        }
    }
    // A message of this name has its fault already.
    owners.insert("Self".to_string(), "the language");
    for (message, notes) in list.iter().zip(notes) {
        for topic in message.topics.iter().filter(|topic| seen.insert(&topic.name)) {
            let type_name = names::camel_case(&topic.name);
            if let Some(other) = owners.insert(type_name.clone(), &message.path) {
                let name = &topic.name;
                let text = format!(
                    "topic `{name}` would be the Rust type `{type_name}`, which {other} has"
                );
                notes.fault(topic.line, text);
            }
        }
    }
}
