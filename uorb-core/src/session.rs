//! The broker, as a process sees it.
//!
//! Advertising and subscribing ask the broker and wait for its answer (see
//! `link.rs`); publishing and copying never come here.

use std::sync::{Arc, PoisonError, Weak};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::error::Error;
use crate::layout::Layout;
use crate::link::{Link, Waiting, unexpected};
use crate::node::{Node, Role};
use crate::poll::spin_time_from_env;
use crate::protocol::{Advertise, PeerInfo, Reply, Request, Subject, Subscribe};
use crate::stream::Member;
use crate::stream::port::{PortCell, Streamable};
use crate::system::System;
use crate::topic::{Instance, Metadata};

/// A process's connection to the broker of one system. Clones are the same
/// session; it ends with the last of them and of its handles.
#[derive(Clone, Debug)]
pub struct Session {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    link: Arc<Link>,
    thread: Option<JoinHandle<()>>,
}

/// What a new subscription gets: the node, or a place to wait for it.
pub(crate) enum Followed {
    Node(Arc<Node>),
    Waiting(Arc<Waiting>),
}

impl Session {
    /// Joins the system that the environment names (see [`System::from_env`]).
    ///
    /// # Errors
    ///
    /// [`Error::NoBroker`] where none runs; [`Error::Refused`] where it is of
    /// another version.
    pub fn connect() -> Result<Self, Error> {
        Self::connect_to(&System::from_env()?)
    }

    /// Joins a system.
    ///
    /// # Errors
    ///
    /// As [`Session::connect`].
    pub fn connect_to(system: &System) -> Result<Self, Error> {
        spin_time_from_env()?;
        let (link, thread) = Link::connect(system)?;
        Ok(Self { inner: Arc::new(Inner { link, thread: Some(thread) }) })
    }

    /// The system it belongs to.
    pub fn system(&self) -> &System {
        &self.inner.link.system
    }

    /// The number under which the broker knows this process.
    pub fn peer(&self) -> u16 {
        self.inner.link.peer
    }

    /// Whether the system has ended. Handles then fail with [`Error::Ended`];
    /// what was published can still be copied.
    pub fn has_ended(&self) -> bool {
        self.inner.link.has_ended()
    }

    /// Fails in the child of a fork, and when the system has ended.
    #[inline]
    pub(crate) fn check(&self) -> Result<(), Error> {
        self.inner.link.check()
    }

    /// Whether this process is a child of the one that made the session.
    pub(crate) fn is_forked(&self) -> bool {
        self.inner.link.is_forked()
    }

    /// The error of a handle whose system has ended.
    #[cold]
    pub(crate) fn ended(&self) -> Error {
        self.inner.link.unusable()
    }

    /// Whether a topic's instance has a publisher.
    ///
    /// # Errors
    ///
    /// [`Error::CorruptNode`] and the like where the node cannot be read; that
    /// there is none is `false`.
    #[doc(alias = "orb_exists")]
    pub fn exists(&self, topic: &str, instance: Instance) -> Result<bool, Error> {
        match Node::open(self.system(), topic, instance, Role::Observer) {
            Ok(node) => Ok(node.publishers() > 0),
            Err(Error::NoNode { .. }) => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// How many instances a topic has, counted from 0 up to the first that does
    /// not exist. One that is only subscribed exists.
    #[doc(alias = "orb_group_count")]
    pub fn group_count(&self, topic: &str) -> usize {
        let exists = |instance: &Instance| self.system().node(topic, *instance).exists();
        Instance::all().take_while(exists).count()
    }

    /// The description of a topic that exists, from any of its nodes.
    ///
    /// # Errors
    ///
    /// [`Error::NoNode`] where the topic has no node.
    pub fn describe(&self, topic: &str) -> Result<Metadata, Error> {
        let node = Instance::all()
            .map(|instance| Node::open(self.system(), topic, instance, Role::Observer))
            .find(|node| !matches!(node, Err(Error::NoNode { .. })));
        match node {
            Some(node) => Ok(node?.identity.metadata),
            None => Err(Error::NoNode { topic: topic.into(), instance: Instance::FIRST }),
        }
    }

    /// The process that the broker knows by this number: the sender of a
    /// message, for one (see [`crate::Copied::peer`]). None where it has ended.
    ///
    /// # Errors
    ///
    /// [`Error::NoBroker`] and [`Error::NoAnswer`] where nobody can say.
    pub fn process(&self, peer: u16) -> Result<Option<PeerInfo>, Error> {
        match self.ask(Request::Peers)? {
            Reply::Peers(peers) => Ok(peers.into_iter().find(|process| process.peer == peer)),
            reply => Err(unexpected(reply)),
        }
    }

    /// Asks the broker something and waits for the answer.
    ///
    /// # Errors
    ///
    /// [`Error::NoBroker`] and [`Error::NoAnswer`] where none comes in time.
    #[doc(hidden)]
    pub fn ask(&self, request: Request) -> Result<Reply, Error> {
        self.inner.link.ask(request)
    }

    /// Becomes a publisher. Returns the handle and the node, ready to publish.
    pub(crate) fn advertise(&self, advertise: Advertise) -> Result<(u32, Arc<Node>), Error> {
        let handle = self.inner.link.new_handle();
        let metadata = advertise.metadata.clone();
        let advertise = Advertise { handle, ..advertise };
        fail_point!("advertise.begun");
        let advertised = self.ask(Request::Advertise(advertise)).and_then(|reply| match reply {
            Reply::Advertised(instance) => {
                fail_point!("advertise.granted");
                self.node(&metadata.name, instance, Role::Publisher, Some(&metadata.layout))
            }
            reply => Err(unexpected(reply)),
        });
        // It may have been granted all the same, or may yet be.
        advertised.map(|node| (handle, node)).inspect_err(|_| {
            self.inner.link.take_back(handle, Request::Unadvertise { handle });
        })
    }

    /// Where a publication finds its port to the stream, when there is one. It
    /// is opened now if somebody follows the stream already, or always will.
    pub(crate) fn port(&self, handle: u32, node: &Arc<Node>) -> Result<Arc<PortCell>, Error> {
        fail_point!("advertise.mapped");
        let link = &self.inner.link;
        let cell = Arc::new(PortCell::default());
        let publisher = (self.peer(), handle);
        let streamable = Streamable { cell: cell.clone(), node: node.clone(), publisher };
        link.add_streamable(handle, streamable);
        // After it is noted: who begins to follow from now on has the broker
        // tell the session's thread.
        let is_large = node.identity.metadata.layout.is_large();
        if is_large || node.is_streamed() {
            let opened = link.open_port(handle);
            if is_large {
                opened?;
            }
        }
        Ok(cell)
    }

    /// Keeps the port of a publication that is about to go, as long as it is needed.
    pub(crate) fn linger(&self, port: Streamable, last: u64) {
        self.inner.link.linger(port, last);
    }

    /// Asks for a place among the streams of a node that is subscribed already.
    pub(crate) fn stream(&self, subscribe: Subscribe) -> Result<u8, Error> {
        match self.ask(Request::Subscribe(subscribe))? {
            Reply::Streaming { place } => {
                fail_point!("follow.granted");
                Ok(place)
            }
            reply => Err(unexpected(reply)),
        }
    }

    /// Tells publishers, by way of the broker, that a subscription has its queue.
    pub(crate) fn follows(&self, handle: u32) {
        self.inner.link.tell(Request::Following { handle });
        fail_point!("follow.told");
    }

    /// This process as a member of the world of the system's streams.
    pub(crate) fn member(&self) -> Result<Arc<Member>, Error> {
        self.inner.link.member()
    }

    /// A process of this system by name and process id, for people.
    pub(crate) fn describe_process(&self, peer: u16) -> String {
        self.inner.link.describe_process(peer)
    }

    /// Stops being a publisher.
    pub(crate) fn unadvertise(&self, handle: u32) {
        fail_point!("unadvertise.begun");
        self.inner.link.remove_streamable(handle);
        self.inner.link.forget(handle, Request::Unadvertise { handle });
        fail_point!("unadvertise.answered");
    }

    /// Follows a node. Returns the handle and the node, or a place to wait.
    pub(crate) fn subscribe(
        &self,
        subject: Subject,
        instance: Instance,
    ) -> Result<(u32, Followed), Error> {
        let handle = self.inner.link.new_handle();
        let waiting = match &subject {
            Subject::Described(_) => None,
            Subject::Named(_) => Some(Waiting::new()?),
        };
        if let Some(waiting) = &waiting {
            self.inner.link.wait(handle, waiting.clone());
        }
        let subscribe = Subscribe { handle, subject: subject.clone(), instance, stream: None };
        fail_point!("subscribe.begun");
        let followed =
            self.ask(Request::Subscribe(subscribe)).and_then(|reply| match (reply, waiting) {
                (Reply::Subscribed, _) => {
                    fail_point!("subscribe.granted");
                    self.node(subject.name(), instance, Role::Subscriber, subject.layout())
                        .map(Followed::Node)
                }
                (Reply::Waiting, Some(waiting)) => Ok(Followed::Waiting(waiting)),
                (reply, _) => Err(unexpected(reply)),
            });
        followed.map(|followed| (handle, followed)).inspect_err(|_| {
            self.inner.link.take_back(handle, Request::Unsubscribe { handle });
        })
    }

    /// Stops following a node.
    pub(crate) fn unsubscribe(&self, handle: u32) {
        fail_point!("unsubscribe.begun");
        self.inner.link.forget(handle, Request::Unsubscribe { handle });
        fail_point!("unsubscribe.answered");
    }

    /// The node as this process has it mapped for `role`. What the broker has
    /// granted is looked at again: its messages are `layout`, if that is known.
    pub(crate) fn node(
        &self,
        topic: &str,
        instance: Instance,
        role: Role,
        layout: Option<&Layout>,
    ) -> Result<Arc<Node>, Error> {
        // Nothing is held while the thread is waited for, which may end it all.
        self.map(topic, instance, role, layout).map_err(|error| self.inner.link.explain(error))
    }

    fn map(
        &self,
        topic: &str,
        instance: Instance,
        role: Role,
        layout: Option<&Layout>,
    ) -> Result<Arc<Node>, Error> {
        let key = (topic.to_string(), instance, role);
        let mut nodes = self.inner.link.nodes.lock().unwrap_or_else(PoisonError::into_inner);
        let mapped = nodes.get(&key).and_then(Weak::upgrade);
        // One that gave way may still be in somebody's hands.
        let node = match mapped.filter(|node| !node.has_ended()) {
            Some(node) => node,
            None => {
                let node = Arc::new(Node::open(self.system(), topic, instance, role)?);
                if node.identity.system_id != self.inner.link.system_id {
                    drop(nodes);
                    self.inner.link.end();
                    return Err(self.ended());
                }
                nodes.insert(key, Arc::downgrade(&node));
                node
            }
        };
        if layout.is_some_and(|layout| !layout.matches(&node.identity.metadata.layout)) {
            let (path, what) = (node.name().into(), "its layout is not the granted one".into());
            return Err(Error::CorruptNode { path, what });
        }
        Ok(node)
    }
}

/// How long the end of a session waits until what was sent last is received.
const LINGER: Duration = Duration::from_millis(100);

/// How often it looks: nobody tells a publisher that something was received.
const LINGER_LOOK: Duration = Duration::from_millis(1);

impl Drop for Inner {
    fn drop(&mut self) {
        // In the child of a fork the thread does not exist, and the event that
        // would end it is the parent's.
        if self.link.is_forked() {
            self.link.forget_member();
            return;
        }
        // What this process has sent last is to be received, by all who look.
        let deadline = Instant::now() + LINGER;
        while self.link.has_lingering_ports() && Instant::now() < deadline {
            std::thread::sleep(LINGER_LOOK);
        }
        self.link.quit();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
