//! What is known of topics: those that have nodes, and those compiled in.

use anyhow::anyhow;
use uorb_core::{Error, Layout, Metadata, Session};

use crate::context::Context;
use crate::nearest::did_you_mean;

/// A topic that was compiled in.
pub(crate) fn compiled_in(topic: &str) -> Option<&'static Metadata> {
    uorb_msg::TOPICS.iter().find(|metadata| metadata.name == topic).copied()
}

/// A topic as its nodes describe it, else as it was compiled in. None where
/// neither knows it.
pub(crate) fn describe(session: &Session, topic: &str) -> Result<Option<Metadata>, Error> {
    match session.describe(topic) {
        Ok(metadata) => Ok(Some(typed(metadata))),
        Err(Error::NoNode { .. }) => Ok(compiled_in(topic).cloned()),
        Err(error) => Err(error),
    }
}

/// A topic whose publisher gave no field list has that of the compiled-in topic
/// of its name, if the size fits.
pub(crate) fn typed(metadata: Metadata) -> Metadata {
    let fits = |ours: &&Metadata| ours.layout.size_bytes == metadata.layout.size_bytes;
    match compiled_in(&metadata.name).filter(fits) {
        Some(ours) if Layout::is_untyped(&metadata.layout) => {
            Metadata { layout: ours.layout.clone(), ..metadata }
        }
        _ => metadata,
    }
}

/// The names of all topics, for completions and suggestions.
pub(crate) fn names(context: &Context) -> Vec<String> {
    let nodes = context.system.list_nodes().unwrap_or_default().into_iter();
    let compiled_in = uorb_msg::TOPICS.iter().map(|metadata| metadata.name.to_string());
    let mut names: Vec<String> = nodes.map(|(topic, _)| topic).chain(compiled_in).collect();
    names.sort();
    names.dedup();
    names
}

/// Nobody knows this topic.
pub(crate) fn unknown(context: &Context, topic: &str) -> anyhow::Error {
    let names = names(context);
    let hint = match did_you_mean(topic, names.iter().map(String::as_str)) {
        hint if hint.is_empty() => {
            "; `uorb ls` lists the nodes, and `uorb listener --wait` waits for one".into()
        }
        hint => hint,
    };
    anyhow!("no topic {topic:?}: no node has it, and it is not compiled in{hint}")
}
