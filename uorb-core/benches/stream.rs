//! What a message on a stream costs, of 64 bytes and of 6 MiB, beside plain
//! iceoryx2 in the same run: loaned, published and borrowed, without filling it.
//!
//! One process, one publisher, one stream subscription, a real broker:
//! `cargo build --release && cargo bench -p uorb-core --bench stream`. Last it
//! prints what the publishes of a running publisher cost while somebody joins.

mod bus;

use std::hint::black_box;
use std::time::Instant;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use iceoryx2::prelude::*;
use uorb_core::{
    Publication, Session, StreamSubscription, System, Topic, UorbHeader, World, now_us, topic,
};

use bus::Bus;

topic! { pub struct Small = "small" { words: [u64; 8] } }
topic! { pub struct Large = "large" { words: [u64; 786_432] } }

fn ours<T: Topic>(criterion: &mut Criterion, bus: &Bus) {
    let session = Session::connect_to(&bus.system).expect("the broker takes us");
    let mut publication = Publication::<T>::advertise(&session).expect("advertised");
    let mut stream = StreamSubscription::<T>::subscribe(&session).expect("subscribed");
    let bytes = size_of::<T::Message>();
    let mut group = criterion.benchmark_group("publish and borrow");
    group.bench_function(BenchmarkId::new("uorb", bytes), |bencher| {
        bencher.iter(|| {
            publication.loan().expect("memory").publish().expect("published");
            black_box(stream.update().expect("it was published"));
        });
    });
    group.finish();
    assert_eq!(stream.lost(), 0);
}

fn plain<S: iceoryx2::service::Service>(
    criterion: &mut Criterion,
    bus: &Bus,
    kind: &str,
    bytes: usize,
) {
    let World { prefix, root } = World::of(&bus.system);
    let mut config = Config::default();
    config.global.prefix = FileName::new(prefix.as_bytes()).expect("a name");
    let root = format!("{}/", root.display());
    config.global.set_root_path(&Path::new(root.as_bytes()).expect("a path"));
    let node = NodeBuilder::new().config(&config).create::<S>().expect("a node");
    let name = format!("plain/{kind}/{bytes}");
    let service = node
        .service_builder(&name.as_str().try_into().expect("a name"))
        .publish_subscribe::<[u8]>()
        .user_header::<UorbHeader>()
        .max_subscribers(17)
        .max_publishers(20)
        .subscriber_max_buffer_size(2)
        .open_or_create()
        .expect("a service");
    let publisher =
        service.publisher_builder().initial_max_slice_len(bytes).create().expect("a publisher");
    let subscriber = service.subscriber_builder().create().expect("a subscriber");
    let mut group = criterion.benchmark_group("publish and borrow");
    group.bench_function(BenchmarkId::new(format!("iceoryx2 {kind}"), bytes), |bencher| {
        bencher.iter(|| {
            let mut sample = publisher.loan_slice_uninit(bytes).expect("memory");
            // What our header costs, it costs here.
            sample.user_header_mut().publish_time_us = now_us();
            // SAFETY: shared memory is zeros before anybody writes there, and
            // bytes have no invalid values.
            unsafe { sample.assume_init() }.send().expect("sent");
            black_box(subscriber.receive().expect("received"));
        });
    });
    group.finish();
}

fn all(criterion: &mut Criterion) {
    let bus = Bus::start("stream");
    criterion.bench_function("clock read", |bencher| bencher.iter(|| black_box(now_us())));
    plain::<ipc::Service>(criterion, &bus, "ipc", 64);
    plain::<ipc_threadsafe::Service>(criterion, &bus, "ipc_threadsafe", 64);
    ours::<Small>(criterion, &bus);
    plain::<ipc::Service>(criterion, &bus, "ipc", 6 << 20);
    plain::<ipc_threadsafe::Service>(criterion, &bus, "ipc_threadsafe", 6 << 20);
    ours::<Large>(criterion, &bus);
    joining(&bus.system);
}

/// The publishes of a running publisher while somebody begins to follow.
fn joining(system: &System) {
    let session = Session::connect_to(system).expect("the broker takes us");
    let mut publication = Publication::<Small>::advertise(&session).expect("advertised");
    let message = Small { words: [0; 8] };
    let follower = std::thread::spawn({
        let session = Session::connect_to(system).expect("the broker takes us");
        move || StreamSubscription::<Small>::subscribe(&session).expect("subscribed")
    });
    let (mut slowest, mut count) = (std::time::Duration::ZERO, 0_u64);
    while !follower.is_finished() {
        let began = Instant::now();
        publication.publish(&message).expect("published");
        slowest = slowest.max(began.elapsed());
        count += 1;
    }
    println!("{count} publishes while somebody joined: the slowest took {slowest:?}");
    let mut follower = follower.join().expect("it subscribed");
    let began = Instant::now();
    publication.publish(&message).expect("published");
    println!("the next one took {:?}", began.elapsed());
    assert!(follower.update().is_some());
}

criterion_group!(benches, all);
criterion_main!(benches);
