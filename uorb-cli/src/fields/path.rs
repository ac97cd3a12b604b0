//! The way to a field: `xyz`, `xyz[1]`, `esc[2].esc_rpm`, `previous.lat`.

use anyhow::{Context as _, Result, bail};
use uorb_core::{Field, FieldType, Layout};

use super::Part;
use crate::nearest::did_you_mean;

/// Where a path leads in a message of one layout.
#[derive(Clone, Debug)]
pub(crate) struct Place<'l> {
    /// The path as it was given.
    pub(crate) path: String,
    pub(crate) ty: &'l FieldType,
    pub(crate) array_length: Option<u32>,
    /// Where it starts, in bytes from the start of the outermost message.
    pub(crate) offset_bytes: usize,
}

impl<'l> Place<'l> {
    /// The bytes of all of it.
    pub(crate) fn size_bytes(&self) -> usize {
        self.ty.size_bytes() as usize * self.array_length.unwrap_or(1) as usize
    }

    /// The part of a message that is there; None where the message is shorter
    /// than its layout says.
    pub(crate) fn part<'m>(&self, message: &'m [u8]) -> Option<Part<'m>>
    where
        'l: 'm,
    {
        let bytes = message.get(self.offset_bytes..)?.get(..self.size_bytes())?;
        Some(Part { ty: self.ty, array_length: self.array_length, bytes })
    }

    /// The type, as the .msg text has it: `float32[3]`.
    pub(crate) fn type_name(&self) -> String {
        match self.array_length {
            Some(length) => format!("{}[{length}]", self.ty.msg_name()),
            None => self.ty.msg_name().to_string(),
        }
    }
}

/// The places of all fields of a message, in the order of the .msg text.
pub(crate) fn all<'l>(layout: &'l Layout) -> Vec<Place<'l>> {
    let place = |field: &'l Field| Place {
        path: field.name.to_string(),
        ty: &field.ty,
        array_length: field.array_length,
        offset_bytes: field.offset_bytes as usize,
    };
    layout.fields.iter().map(place).collect()
}

/// Where a path leads.
///
/// # Errors
///
/// There is no such field, with the nearest names; an index is out of range;
/// something that is no message is asked for its fields.
pub(crate) fn find<'l>(layout: &'l Layout, path: &str) -> Result<Place<'l>> {
    let mut layout = layout;
    let mut offset_bytes = 0;
    let mut steps = path.split('.').peekable();
    // What was understood so far.
    let mut walked = String::new();
    while let Some(step) = steps.next() {
        let (name, index) = split_index(step).with_context(|| format!("field {path:?}"))?;
        let Some(field) = layout.fields.iter().find(|field| field.name == name) else {
            bail!(no_such_field(layout, name));
        };
        if !walked.is_empty() {
            walked.push('.');
        }
        walked.push_str(step);
        offset_bytes += field.offset_bytes as usize;
        let mut array_length = field.array_length;
        if let Some(index) = index {
            match field.array_length {
                Some(length) if index < length => {
                    offset_bytes += index as usize * field.ty.size_bytes() as usize;
                    array_length = None;
                }
                Some(length) => bail!(
                    "{walked} is out of range: {name} is {}, its elements are {name}[0] to \
                     {name}[{}]",
                    field.msg_type(),
                    length - 1
                ),
                None => bail!("{name} is {}, not an array", field.msg_type()),
            }
        }
        if steps.peek().is_none() {
            return Ok(Place { path: path.to_string(), ty: &field.ty, array_length, offset_bytes });
        }
        match (&field.ty, array_length) {
            (FieldType::Message(nested), None) => layout = nested,
            (FieldType::Message(_), Some(_)) => {
                bail!("{name} is {}: say which, as {name}[0]", field.msg_type());
            }
            (_, _) => bail!("{walked} is {}: it has no fields", field.msg_type()),
        }
    }
    // `split` gives one step at least, and the last one returns.
    bail!("a field's name is missing")
}

/// `xyz[1]` as `xyz` and 1.
fn split_index(step: &str) -> Result<(&str, Option<u32>)> {
    let Some((name, rest)) = step.split_once('[') else { return Ok((step, None)) };
    let index = rest.strip_suffix(']').with_context(|| format!("{step:?} lacks a ]"))?;
    match index.parse() {
        Ok(index) => Ok((name, Some(index))),
        Err(_) => bail!("{index:?} is not the number of an element"),
    }
}

fn no_such_field(layout: &Layout, name: &str) -> String {
    let names = layout.fields.iter().map(|field| &*field.name);
    let mut hint = did_you_mean(name, names);
    if hint.is_empty() {
        // Perhaps it is deeper down.
        let flat = layout.flatten();
        let deeper = flat.iter().map(|flat| &*flat.path);
        let deeper = deeper.filter(|path| path.rsplit('.').next() == Some(name));
        hint = did_you_mean(name, deeper);
    }
    if hint.is_empty() {
        let names: Vec<_> = layout.fields.iter().map(|field| &*field.name).collect();
        hint = format!("; it has {}", names.join(", "));
    }
    format!("message {} has no field {name:?}{hint}", layout.name)
}
