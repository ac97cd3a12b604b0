//! `--back-pressure`: who is to have every message.
//!
//! A recorder does not want all topics, and nobody but itself knows which. So
//! the replay asks: it publishes a message of the topic `replay_ready` when it
//! has advertised everything, and a recorder takes it when it follows what it
//! wants. Where no recorder answers, every topic is to be followed by somebody.

use std::time::{Duration, Instant};

use anyhow::bail;
use uorb_core::broker_side::{Node, Role, StreamStatus};
use uorb_core::{Error, Priority, Publication, RawPublication, Session, System, now_us};
use uorb_ulog::ReplayReady;

use crate::exit::{Early, say};
use crate::interrupt::Interrupt;

/// How long to wait before one looks again.
const LOOK_AGAIN: Duration = Duration::from_millis(2);

/// Waits until all is followed that is to be followed.
pub(super) fn wait_for_followers<'a>(
    session: &Session,
    publications: impl Iterator<Item = &'a RawPublication>,
) -> anyhow::Result<()> {
    let mut question = Publication::<ReplayReady>::advertise_multi(session, Priority::DEFAULT)?;
    question.publish(&ReplayReady { timestamp: now_us() })?;
    let asked = observe(session.system(), &question)?;
    let nodes = publications.map(|one| observe(session.system(), one));
    let nodes = nodes.collect::<Result<Vec<_>, _>>()?;
    let is_followed = || {
        let mut answers = pressing(&asked).peekable();
        match answers.peek() {
            Some(_) => answers.all(has_received),
            None => nodes.iter().all(|node| pressing(node).any(|stream| stream.has_begun)),
        }
    };
    let words = "nobody follows with back-pressure yet (`uorb record --back-pressure`)";
    wait(words, is_followed)
}

/// Waits until those who follow have all that was published: a queue does not
/// outlive its publisher for long.
pub(super) fn wait_until_received<'a>(
    session: &Session,
    publications: impl Iterator<Item = &'a RawPublication>,
) -> anyhow::Result<()> {
    let nodes = publications.map(|one| observe(session.system(), one));
    let nodes = nodes.collect::<Result<Vec<_>, _>>()?;
    wait("a follower is slow to take the last messages", || {
        nodes.iter().all(|node| pressing(node).all(has_received))
    })
}

fn has_received(stream: StreamStatus) -> bool {
    stream.has_begun && stream.pending == 0
}

fn observe(system: &System, publication: &RawPublication) -> Result<Node, Error> {
    let topic = &publication.metadata().name;
    Node::open(system, topic, publication.instance(), Role::Observer)
}

/// The streams that publishers wait for.
fn pressing(node: &Node) -> impl Iterator<Item = StreamStatus> {
    node.streams().into_iter().filter(|stream| stream.entry.back_pressure)
}

/// Says what it waits for, should that take a while.
fn wait(what: &str, is_so: impl Fn() -> bool) -> anyhow::Result<()> {
    let interrupt = Interrupt::catch()?;
    let since = Instant::now();
    let mut has_said = false;
    while !is_so() {
        if !has_said && since.elapsed() >= Duration::from_secs(1) {
            say(format_args!("{what}; waiting, Ctrl-C ends it"));
            has_said = true;
        }
        if interrupt.wait_until(Some(Instant::now() + LOOK_AGAIN))? {
            bail!(Early::Interrupted);
        }
    }
    Ok(())
}
