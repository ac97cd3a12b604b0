//! iceoryx2 as its users write it: a publish-subscribe service, with an event
//! service beside it where somebody waits; and a blackboard.

use std::hint::spin_loop;

use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use uorb_core::{System, World};

use super::{Door, Side, WORDS};

pub type Ipc = ipc::Service;
type Out<T> = Publisher<Ipc, T, ()>;
type In<T> = Subscriber<Ipc, T, ()>;
type IpcNode = iceoryx2::node::Node<Ipc>;

/// More subscribers than the usual eight.
const SUBSCRIBERS_MAX: usize = 64;

/// iceoryx2 in a world of the bus, which goes with it.
pub fn node(system: &System) -> IpcNode {
    let World { prefix, root } = World::of(system);
    let mut config = Config::default();
    config.global.prefix = FileName::new(prefix.as_bytes()).expect("a name");
    let root = format!("{}/", root.display());
    config.global.set_root_path(&Path::new(root.as_bytes()).expect("a path"));
    NodeBuilder::new().config(&config).create::<Ipc>().expect("a node")
}

/// A publisher of fixed messages and some subscribers.
pub fn publisher_and_subscribers<T: ZeroCopySend + std::fmt::Debug + 'static>(
    system: &System,
    name: &str,
    subscribers: usize,
) -> (Out<T>, Vec<In<T>>) {
    let service = node(system)
        .service_builder(&name.try_into().expect("a name"))
        .publish_subscribe::<T>()
        .max_subscribers(SUBSCRIBERS_MAX)
        .open_or_create()
        .expect("a service");
    let publisher = service.publisher_builder().create().expect("a publisher");
    let subscribe = |_| service.subscriber_builder().create().expect("a subscriber");
    (publisher, (0..subscribers).map(subscribe).collect())
}

/// How one waits for a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wait {
    ForEvent,
    Spin,
}

/// One side's ends.
#[derive(Debug)]
pub struct Ends {
    wait: Wait,
    out: Out<[u64; WORDS]>,
    notifier: Notifier<Ipc>,
    from: In<[u64; WORDS]>,
    listener: Listener<Ipc>,
}

impl Ends {
    pub fn open(system: &System, side: Side, wait: Wait) -> Self {
        let node = node(system);
        let name = |way: &str| ServiceName::new(&format!("bench/{way}")).expect("a name");
        let [out, from] = side.ways().map(|way| {
            let messages = node.service_builder(&name(way)).publish_subscribe::<[u64; WORDS]>();
            let events = node.service_builder(&name(way)).event();
            let messages = messages.open_or_create().expect("a service");
            (messages, events.open_or_create().expect("a service"))
        });
        Self {
            wait,
            out: out.0.publisher_builder().create().expect("a publisher"),
            notifier: out.1.notifier_builder().create().expect("a notifier"),
            from: from.0.subscriber_builder().create().expect("a subscriber"),
            listener: from.1.listener_builder().create().expect("a listener"),
        }
    }
}

impl Door for Ends {
    fn send(&mut self, sent_ns: u64) {
        let mut words = [0; WORDS];
        words[0] = sent_ns;
        let sample = self.out.loan_uninit().expect("memory").write_payload(words);
        sample.send().expect("sent");
        if self.wait == Wait::ForEvent {
            self.notifier.notify().expect("notified");
        }
    }

    fn wait(&mut self) -> u64 {
        loop {
            // Before the event: one may stand for several messages.
            if let Some(sample) = self.from.receive().expect("received") {
                return sample.payload()[0];
            }
            match self.wait {
                Wait::ForEvent => {
                    self.listener.blocking_wait(|_| {}).expect("woken");
                }
                Wait::Spin => spin_loop(),
            }
        }
    }
}
