//! Our ways to wait: `poll`, the descriptor in an epoll of one's own, tokio.

use std::os::fd::AsFd;

use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags, EpollTimeout};
use tokio::io::unix::AsyncFd;
use tokio::runtime::{Builder, Runtime};
use uorb_core::{Error, Publication, Session, Subscription, System, Topic, poll, topic};

use super::{Door, Side, WORDS};

topic! { pub struct Ping = "ping" { pub words: [u64; WORDS] } }
topic! { pub struct Pong = "pong" { pub words: [u64; WORDS] } }

/// The messages of both ways.
trait Stamped: Topic<Message = Self> + Copy {
    fn of(sent_ns: u64) -> Self;
    fn sent_ns(&self) -> u64;
}

macro_rules! stamped {
    ($($Message:ident)*) => {$(
        impl Stamped for $Message {
            fn of(sent_ns: u64) -> Self {
                let mut words = [0; WORDS];
                words[0] = sent_ns;
                Self { words }
            }
            fn sent_ns(&self) -> u64 {
                self.words[0]
            }
        }
    )*};
}

stamped! { Ping Pong }

type Opened = Result<Box<dyn Door>, Error>;

pub fn by_poll(system: &System, side: Side) -> Opened {
    Ok(match side {
        Side::Ping => Box::new(ByPoll::<Ping, Pong>::open(system)?),
        Side::Pong => Box::new(ByPoll::<Pong, Ping>::open(system)?),
    })
}

pub fn by_epoll(system: &System, side: Side) -> Opened {
    Ok(match side {
        Side::Ping => Box::new(ByEpoll::<Ping, Pong>::open(system)?),
        Side::Pong => Box::new(ByEpoll::<Pong, Ping>::open(system)?),
    })
}

pub fn by_tokio(system: &System, side: Side) -> Opened {
    Ok(match side {
        Side::Ping => Box::new(ByTokio::<Ping, Pong>::open(system)?),
        Side::Pong => Box::new(ByTokio::<Pong, Ping>::open(system)?),
    })
}

struct ByPoll<Out: Topic, In: Topic> {
    out: Publication<Out>,
    from: Subscription<In>,
}

impl<Out: Stamped, In: Stamped> ByPoll<Out, In> {
    fn open(system: &System) -> Result<Self, Error> {
        let session = Session::connect_to(system)?;
        let mut from = Subscription::subscribe(&session)?;
        // The last message outlives those who exchanged it before us.
        from.skip();
        Ok(Self { out: Publication::advertise(&session)?, from })
    }
}

impl<Out: Stamped, In: Stamped> Door for ByPoll<Out, In> {
    fn send(&mut self, sent_ns: u64) {
        self.out.publish(&Out::of(sent_ns)).expect("published");
    }

    fn wait(&mut self) -> u64 {
        poll(&mut [&mut self.from], None).expect("it can be waited for");
        self.from.copy().expect("it has come").sent_ns()
    }
}

struct ByEpoll<Out: Topic, In: Topic> {
    epoll: Epoll,
    ends: ByPoll<Out, In>,
}

impl<Out: Stamped, In: Stamped> ByEpoll<Out, In> {
    fn open(system: &System) -> Result<Self, Error> {
        let ends = ByPoll::open(system)?;
        let epoll = Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC).expect("an epoll instance");
        let event = EpollEvent::new(EpollFlags::EPOLLIN, 0);
        epoll.add(ends.from.as_fd(), event).expect("it is a descriptor");
        Ok(Self { epoll, ends })
    }
}

impl<Out: Stamped, In: Stamped> Door for ByEpoll<Out, In> {
    fn send(&mut self, sent_ns: u64) {
        self.ends.send(sent_ns);
    }

    fn wait(&mut self) -> u64 {
        loop {
            let mut events = [EpollEvent::empty()];
            self.epoll.wait(&mut events, EpollTimeout::NONE).expect("it can be waited for");
            if let Some(message) = self.ends.from.update() {
                return message.sent_ns();
            }
        }
    }
}

struct ByTokio<Out: Topic, In: Topic> {
    runtime: Runtime,
    out: Publication<Out>,
    from: AsyncFd<Subscription<In>>,
}

impl<Out: Stamped, In: Stamped> ByTokio<Out, In> {
    fn open(system: &System) -> Result<Self, Error> {
        let ByPoll { out, from } = ByPoll::open(system)?;
        let runtime = Builder::new_current_thread().enable_io().build().expect("a runtime");
        let from = {
            let _inside = runtime.enter();
            // SAFETY: it has one descriptor from its first to its last day.
            #[allow(unsafe_code)]
            unsafe { AsyncFd::register(from) }.expect("it is a descriptor")
        };
        Ok(Self { runtime, out, from })
    }
}

impl<Out: Stamped, In: Stamped> Door for ByTokio<Out, In> {
    fn send(&mut self, sent_ns: u64) {
        self.out.publish(&Out::of(sent_ns)).expect("published");
    }

    fn wait(&mut self) -> u64 {
        let from = &mut self.from;
        self.runtime.block_on(async {
            loop {
                if let Some(message) = from.get_mut().update() {
                    return message.sent_ns();
                }
                from.readable().await.expect("it can be waited for").clear_ready();
            }
        })
    }
}
