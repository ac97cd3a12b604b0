//! The broker, as a process sees it.
//!
//! Advertising and subscribing ask the broker and wait for its answer (see
//! `link.rs`); publishing and copying never come here.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::thread::JoinHandle;

use crate::error::Error;
use crate::link::{Link, Waiting, unexpected};
use crate::node::{Node, Role};
use crate::protocol::{Advertise, Claim, PeerInfo, Reply, Request, Subject, Subscribe};
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
    /// Nodes that are mapped, so that 10,000 subscriptions map one once.
    nodes: Mutex<HashMap<(String, Instance, Role), Weak<Node>>>,
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
        let (link, thread) = Link::connect(system)?;
        let inner = Inner { link, thread: Some(thread), nodes: Mutex::default() };
        Ok(Self { inner: Arc::new(inner) })
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
        let name = advertise.metadata.name.to_string();
        let mut advertise = Advertise { handle, ..advertise };
        let instance = match self.ask(Request::Advertise(advertise.clone()))? {
            Reply::Advertised(instance) => instance,
            reply => return Err(unexpected(reply)),
        };
        // From now on it is this instance, whatever was asked for first.
        advertise.claim = Claim::Shared(instance);
        self.inner.link.hold(handle, Request::Advertise(advertise));
        match self.node(&name, instance, Role::Publisher) {
            Ok(node) => Ok((handle, node)),
            Err(error) => {
                self.unadvertise(handle);
                Err(error)
            }
        }
    }

    /// Stops being a publisher.
    pub(crate) fn unadvertise(&self, handle: u32) {
        self.inner.link.forget(handle, Request::Unadvertise { handle });
    }

    /// Follows a node. Returns the handle and the node, or a place to wait.
    pub(crate) fn subscribe(
        &self,
        subject: Subject,
        instance: Instance,
    ) -> Result<(u32, Followed), Error> {
        let handle = self.inner.link.new_handle();
        let name = subject.name().to_string();
        let waiting = match &subject {
            Subject::Described(_) => None,
            Subject::Named(_) => Some(Waiting::new()?),
        };
        if let Some(waiting) = &waiting {
            self.inner.link.wait(handle, waiting.clone());
        }
        let request = Request::Subscribe(Subscribe { handle, subject, instance });
        let followed = self.ask(request.clone()).and_then(|reply| match (reply, waiting) {
            (Reply::Subscribed, _) => {
                self.inner.link.stop_waiting(handle);
                self.node(&name, instance, Role::Subscriber).map(Followed::Node)
            }
            (Reply::Waiting, Some(waiting)) => Ok(Followed::Waiting(waiting)),
            (reply, _) => Err(unexpected(reply)),
        });
        match followed {
            Ok(followed) => {
                self.inner.link.hold(handle, request);
                Ok((handle, followed))
            }
            Err(error) => {
                self.unsubscribe(handle);
                Err(error)
            }
        }
    }

    /// Stops following a node.
    pub(crate) fn unsubscribe(&self, handle: u32) {
        self.inner.link.forget(handle, Request::Unsubscribe { handle });
    }

    /// The node as this process has it mapped for `role`.
    pub(crate) fn node(
        &self,
        topic: &str,
        instance: Instance,
        role: Role,
    ) -> Result<Arc<Node>, Error> {
        let key = (topic.to_string(), instance, role);
        let mut nodes = self.inner.nodes.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(node) = nodes.get(&key).and_then(Weak::upgrade) {
            return Ok(node);
        }
        let node = Node::open(self.system(), topic, instance, role)?;
        if node.identity.system_id != self.inner.link.system_id {
            self.inner.link.end();
            return Err(self.ended());
        }
        let node = Arc::new(node);
        nodes.insert(key, Arc::downgrade(&node));
        Ok(node)
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.link.quit();
        // In the child of a fork the thread does not exist.
        if let Some(thread) = self.thread.take().filter(|_| !self.link.is_forked()) {
            let _ = thread.join();
        }
    }
}
