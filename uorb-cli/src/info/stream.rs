//! An instance's stream: where it is, who follows it, and who else is there.

use std::io::{self, Write};

use serde::Serialize;
use uorb_core::broker_side::{Foreigners, Node, PeerInfo, StreamStatus, service_name};
use uorb_core::{System, depth_max};

use super::Process;

#[derive(Debug, Serialize)]
pub(super) struct StreamInfo {
    /// What the iceoryx2 service is called.
    name: String,
    /// How many messages the deepest queue holds.
    depth_max: u32,
    followers: Vec<Follower>,
    foreign: Foreign,
}

/// A subscription that has a queue on the stream.
#[derive(Debug, Serialize)]
struct Follower {
    #[serde(flatten)]
    process: Process,
    /// How many messages its queue holds.
    depth: u32,
    /// Whether publishers that ask are to wait for it.
    back_pressure: bool,
    /// Messages that it has still to receive: of more than its queue holds, the
    /// oldest will be lost.
    pending: u64,
    lost: u64,
}

/// Programs that are on the stream and not on the bus.
#[derive(Debug, Default, Serialize)]
struct Foreign {
    followers: u64,
    publishers: u64,
    /// Messages of theirs that followers have dropped.
    dropped: u64,
}

impl StreamInfo {
    pub(super) fn new(system: &System, node: &Node, peers: &[PeerInfo]) -> Self {
        let metadata = &node.identity.metadata;
        let Foreigners { subscribers, publishers, dropped } = node.foreigners();
        let follower = |StreamStatus { entry, pending, lost, .. }| Follower {
            process: Process::of(entry.peer, peers),
            depth: entry.depth,
            back_pressure: entry.back_pressure,
            pending,
            lost,
        };
        Self {
            name: service_name(system, &metadata.name, node.identity.instance),
            depth_max: depth_max(metadata.layout.size_bytes),
            followers: node.streams().into_iter().map(follower).collect(),
            foreign: Foreign { followers: subscribers, publishers, dropped },
        }
    }

    pub(super) fn print(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { name, depth_max, followers, foreign } = self;
        writeln!(out, "  stream     {name}, queues of up to {depth_max} messages")?;
        for Follower { process, depth, back_pressure, pending, lost } in followers {
            let back_pressure = if *back_pressure { ", back-pressure" } else { "" };
            writeln!(
                out,
                "  follower   {process}, queue of {depth}{back_pressure}, pending {pending}, lost \
                 {lost}"
            )?;
        }
        let Foreign { followers, publishers, dropped } = foreign;
        if *followers > 0 {
            writeln!(out, "  foreign    followers: {followers}")?;
        }
        if *publishers > 0 || *dropped > 0 {
            writeln!(out, "  foreign    publishers: {publishers}, messages dropped: {dropped}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in super::super) fn quiet() -> StreamInfo {
        StreamInfo {
            name: "uorb/0/one_of_each/0".into(),
            depth_max: 1_024,
            followers: Vec::new(),
            foreign: Foreign::default(),
        }
    }

    fn printed(stream: &StreamInfo) -> String {
        let mut out = Vec::new();
        stream.print(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn a_stream_that_nobody_follows_is_one_line() {
        assert_eq!(
            printed(&quiet()),
            "  stream     uorb/0/one_of_each/0, queues of up to 1024 messages\n"
        );
    }

    #[test]
    fn followers_and_foreign_programs_are_shown() {
        let process =
            |name: &str, pid| Process { peer: 1, name: Some(name.into()), pid: Some(pid) };
        let mut stream = quiet();
        let logger = process("logger", 4711);
        let (pending, lost) = (12, 0);
        stream.followers = vec![
            Follower { process: logger, depth: 1_024, back_pressure: true, pending, lost },
            Follower {
                process: process("uorb", 4712),
                depth: 16,
                back_pressure: false,
                pending: 0,
                lost: 345,
            },
        ];
        stream.foreign = Foreign { followers: 2, publishers: 1, dropped: 77 };
        assert_eq!(
            printed(&stream),
            "  stream     uorb/0/one_of_each/0, queues of up to 1024 messages
  follower   logger (pid 4711), queue of 1024, back-pressure, pending 12, lost 0
  follower   uorb (pid 4712), queue of 16, pending 0, lost 345
  foreign    followers: 2
  foreign    publishers: 1, messages dropped: 77
"
        );
    }
}
