//! One node against a model of uORB: whatever is done to both, they agree.

use std::os::fd::AsFd;
use std::time::Duration;

use nix::poll::{PollFd, PollFlags, PollTimeout};
use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, RngSeed, TestRunner};
use uorb_core::{AdvertiseOptions, Publication, QueueLength, Subscription, poll};
use uorb_tests::{Bus, Plain};

/// What one may do to a node. Numbers choose among what there is.
#[derive(Clone, Debug)]
enum Step {
    Advertise { queue_length: u32 },
    Unadvertise(usize),
    Publish(usize),
    Subscribe { by_descriptor: bool },
    Unsubscribe(usize),
    Check(usize),
    Copy(usize),
    Update(usize),
    Poll,
    RestartBroker,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let any = any::<usize>;
    let step = prop_oneof![
        2 => prop::sample::select(vec![1, 2, 4, 16])
            .prop_map(|queue_length| Step::Advertise { queue_length }),
        1 => any().prop_map(Step::Unadvertise),
        20 => any().prop_map(Step::Publish),
        2 => proptest::bool::ANY.prop_map(|by_descriptor| Step::Subscribe { by_descriptor }),
        1 => any().prop_map(Step::Unsubscribe),
        5 => any().prop_map(Step::Check),
        10 => any().prop_map(Step::Copy),
        10 => any().prop_map(Step::Update),
        3 => Just(Step::Poll),
    ];
    // A restart takes as long as a hundred other steps.
    let step = prop_oneof![200 => step, 1 => Just(Step::RestartBroker)];
    prop::collection::vec(step, 1..200)
}

/// uORB in plain Rust: all messages there ever were, and who has seen which.
#[derive(Default)]
struct Model {
    published: Vec<u32>,
    /// Fixed by the first publisher.
    queue_length: Option<usize>,
    publishers: usize,
    subscriptions: Vec<Cursor>,
    lost: u64,
}

struct Cursor {
    /// Messages published up to the last copy.
    seen: usize,
    lost: u64,
    by_descriptor: bool,
}

impl Model {
    fn updated(&self, subscription: usize) -> bool {
        self.subscriptions[subscription].seen < self.published.len()
    }

    fn copy(&mut self, subscription: usize) -> Option<u32> {
        let newest = self.published.len();
        let cursor = &mut self.subscriptions[subscription];
        if cursor.seen < newest {
            let oldest = newest.saturating_sub(self.queue_length.unwrap_or(1));
            let next = cursor.seen.max(oldest);
            cursor.lost += (next - cursor.seen) as u64;
            self.lost += (next - cursor.seen) as u64;
            cursor.seen = next + 1;
        }
        cursor.seen.checked_sub(1).map(|index| self.published[index])
    }
}

struct Real {
    bus: Bus,
    publications: Vec<Publication<Plain>>,
    subscriptions: Vec<Subscription<Plain>>,
}

/// Does a step to both, and compares what can be seen.
fn take(step: &Step, model: &mut Model, real: &mut Real) {
    let (publishers, subscribers) = (real.publications.len(), real.subscriptions.len());
    match *step {
        Step::Advertise { queue_length } if publishers < 4 => {
            let options = AdvertiseOptions {
                queue_length: QueueLength::new(queue_length),
                ..AdvertiseOptions::default()
            };
            let session = real.bus.session();
            let publication = Publication::advertise_with(&session, options).unwrap();
            real.publications.push(publication);
            model.publishers += 1;
            let fixed = *model.queue_length.get_or_insert(queue_length as usize);
            let granted = real.publications[publishers].queue_length().get();
            assert_eq!(granted as usize, fixed);
        }
        Step::Unadvertise(which) if publishers > 0 => {
            real.publications.swap_remove(which % publishers);
            model.publishers -= 1;
        }
        Step::Publish(which) if publishers > 0 => {
            let value = model.published.len() as u32 * 3;
            model.published.push(value);
            let generation =
                real.publications[which % publishers].publish(&Plain { value }).unwrap();
            assert_eq!(generation.get() as usize, model.published.len());
        }
        Step::Subscribe { by_descriptor } if subscribers < 6 => {
            let subscription = real.bus.subscribe::<Plain>();
            if by_descriptor {
                subscription.open_descriptor().unwrap();
            }
            real.subscriptions.push(subscription);
            // The newest is pending for a newcomer, if there is one.
            let seen = model.published.len().saturating_sub(1);
            model.subscriptions.push(Cursor { seen, lost: 0, by_descriptor });
        }
        Step::Unsubscribe(which) if subscribers > 0 => {
            real.subscriptions.swap_remove(which % subscribers);
            model.subscriptions.swap_remove(which % subscribers);
        }
        Step::Check(which) if subscribers > 0 => {
            let which = which % subscribers;
            assert_eq!(real.subscriptions[which].updated(), model.updated(which));
        }
        Step::Copy(which) if subscribers > 0 => {
            let which = which % subscribers;
            let copied = real.subscriptions[which].copy().map(|plain| plain.value);
            assert_eq!(copied, model.copy(which));
        }
        Step::Update(which) if subscribers > 0 => {
            let which = which % subscribers;
            let expected = if model.updated(which) { model.copy(which) } else { None };
            assert_eq!(real.subscriptions[which].update().map(|plain| plain.value), expected);
        }
        Step::Poll if subscribers > 0 => {
            let updated = (0..subscribers).filter(|which| model.updated(*which)).count();
            let mut all: Vec<_> = real.subscriptions.iter_mut().map(|one| &mut **one).collect();
            assert_eq!(poll(&mut all, Some(Duration::ZERO)).unwrap(), updated);
        }
        // Somebody must hold something, or the system begins anew.
        Step::RestartBroker if publishers + subscribers > 0 => {
            real.bus.kill_broker();
            real.bus.start_broker();
        }
        _ => {}
    }
    for (cursor, subscription) in model.subscriptions.iter().zip(&real.subscriptions) {
        assert_eq!(subscription.lost(), cursor.lost);
        assert_eq!(subscription.pending() as usize, model.published.len() - cursor.seen);
        if cursor.by_descriptor {
            let mut ready = [PollFd::new(subscription.as_fd(), PollFlags::POLLIN)];
            let readable = nix::poll::poll(&mut ready, PollTimeout::ZERO).unwrap();
            // Readable is a hint: it may be so too often, never too rarely.
            assert!(readable == 1 || subscription.pending() == 0);
        }
    }
}

#[test]
fn a_node_agrees_with_its_model() {
    let seed = match std::env::var("UORB_SEED") {
        Ok(seed) => seed.parse().expect("UORB_SEED is a number"),
        Err(_) => uorb_core::now_us(),
    };
    eprintln!("repeat with UORB_SEED={seed}");
    let config = Config {
        cases: 150,
        failure_persistence: None,
        rng_algorithm: RngAlgorithm::ChaCha,
        rng_seed: RngSeed::Fixed(seed),
        ..Config::default()
    };
    TestRunner::new(config)
        .run(&steps(), |steps| {
            let mut model = Model::default();
            let bus = Bus::start();
            let mut real = Real { bus, publications: Vec::new(), subscriptions: Vec::new() };
            for step in &steps {
                take(step, &mut model, &mut real);
            }
            Ok(())
        })
        .unwrap_or_else(|failure| panic!("UORB_SEED={seed}: {failure}"));
}
