//! `uorb ls`: the nodes, as `ls /obj` lists them on NuttX.

use std::io::Write;

use anyhow::bail;

use crate::context::Context;
use crate::unreadable::{Looked, look_at};

/// List the nodes, one a line, as `ls /obj` does.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The directory of the nodes; the only one there is
    #[arg(default_value = "/obj", value_name = "DIR")]
    path: String,

    /// Say more: message size, queue length, publishers, subscribers, messages
    #[arg(short)]
    long: bool,
}

const EXAMPLES: &str = "\
Examples:
  uorb ls /obj
  uorb ls -l | grep sensor_

With -l: SIZE of a message in bytes, messages the node keeps (#Q, 0 before its
first publisher), publishers (#PUB), subscriptions (#SUB), messages published
so far (#MSG), and the node's name; question marks, and the reason, where a node
cannot be read.";

pub(crate) fn run(args: &Args, context: &Context, out: &mut dyn Write) -> anyhow::Result<()> {
    if !matches!(args.path.trim_matches('/'), "obj") {
        bail!("no such directory: {}; the nodes are in /obj", args.path);
    }
    let system = &context.system;
    if !system.nodes().exists() {
        bail!(system.no_broker());
    }
    let mut rows = Vec::new();
    for (topic, instance) in system.list_nodes()? {
        if !args.long {
            writeln!(out, "{topic}{instance}")?;
            continue;
        }
        let node = match look_at(system, &topic, instance)? {
            Looked::Open(node) => node,
            Looked::Gone => continue,
            Looked::Unreadable(node) => {
                writeln!(out, "    ?   ?    ?    ?          ? {node}")?;
                continue;
            }
        };
        rows.push((node.name(), node.identity.metadata.layout.size_bytes, node.status()));
    }
    if !args.long {
        return Ok(());
    }
    // As wide as the largest message needs it.
    let width = rows.iter().map(|(_, size, _)| size.to_string().len()).max().unwrap_or(0).max(5);
    writeln!(out, "{:>width$}  #Q #PUB #SUB       #MSG NODE", "SIZE")?;
    for (name, size_bytes, status) in rows {
        writeln!(
            out,
            "{size_bytes:width$} {:3} {:4} {:4} {:10} {name}",
            status.queue_length.map_or(0, |length| length.get()),
            status.publishers.len(),
            status.subscribers,
            status.published,
        )?;
    }
    Ok(())
}
