//! What only all files together can tell, or get wrong.
//!
//! Which file a field's type means, which messages of a search folder are
//! needed, whether two topics or two Rust types would have one name, and
//! whether a message contains itself.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

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
    let mut topics: BTreeMap<&str, usize> = BTreeMap::new();
    for message in list {
        for topic in &message.topics {
            *topics.entry(&topic.name).or_default() += 1;
        }
    }
    let mut topic_owners: BTreeMap<&str, &str> = BTreeMap::new();
    let mut type_owners: BTreeMap<String, &str> = BTreeMap::new();
    for (message, notes) in list.iter().zip(&mut *notes) {
        let type_name = names::camel_case(&message.name);
        if let Some(other) = type_owners.get(&type_name) {
            notes.fault(None, format!("this would be the Rust type `{type_name}`, as {other}"));
        } else {
            type_owners.insert(type_name, &message.path);
        }
    }
    for (message, notes) in list.iter().zip(notes) {
        for topic in &message.topics {
            let (name, line) = (&*topic.name, topic.line);
            if topics[name] > 1 {
                if let Some(other) = topic_owners.insert(name, &message.path) {
                    notes.fault(line, format!("topic `{name}` is defined already, by {other}"));
                }
            } else if *name != message.name {
                let type_name = names::camel_case(name);
                let owner = match &*type_name {
                    "OrbId" => Some("every folder"),
                    _ => type_owners.insert(type_name.clone(), &message.path),
                };
                if let Some(other) = owner {
                    let text = format!(
                        "topic `{name}` would be the Rust type `{type_name}`, which {other} has"
                    );
                    notes.fault(line, text);
                }
            }
        }
    }
}
