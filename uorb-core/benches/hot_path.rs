//! What a publish, a copy and a look cost, beside one clock read of this run.
//!
//! One process, one publisher, one subscription that never sleeps, a real
//! broker: `cargo build --release && cargo bench -p uorb-core`. A publish reads
//! the clock once, so its floor is that read and a memcpy. A copy by value is
//! moved once or twice more by Rust, which shows from a few kilobytes on.

mod bus;

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use uorb_core::zerocopy::FromZeros;
use uorb_core::{Publication, Session, Subscription, Topic, now_us, topic};

use bus::Bus;

macro_rules! sizes {
    ($($Message:ident = $name:literal, $bytes:literal;)*) => {
        $(topic! { pub struct $Message = $name { words: [u64; $bytes / 8] } })*

        fn all_sizes(criterion: &mut Criterion) {
            let bus = Bus::start("hot");
            $(one_size::<$Message>(criterion, &bus);)*
        }
    };
}

sizes! {
    Bytes16 = "bytes16", 16;
    Bytes64 = "bytes64", 64;
    Bytes256 = "bytes256", 256;
    Bytes1024 = "bytes1024", 1_024;
    Bytes4096 = "bytes4096", 4_096;
    Bytes16384 = "bytes16384", 16_384;
    Bytes65528 = "bytes65528", 65_528;
}

fn one_size<T: Topic>(criterion: &mut Criterion, bus: &Bus)
where
    T::Message: FromZeros,
{
    let session = Session::connect_to(&bus.system).expect("the broker takes us");
    let mut publication = Publication::<T>::advertise(&session).expect("advertised");
    let mut subscription = Subscription::<T>::subscribe(&session).expect("subscribed");
    let message = T::Message::new_zeroed();
    let mut copied = T::Message::new_zeroed();
    publication.publish(&message).expect("published");
    let bytes = size_of::<T::Message>() as u64;

    let mut group = criterion.benchmark_group("publish");
    group.throughput(Throughput::Bytes(bytes));
    group.bench_function(BenchmarkId::from_parameter(bytes), |bencher| {
        bencher.iter(|| publication.publish(black_box(&message)).expect("published"));
    });
    group.finish();

    let mut group = criterion.benchmark_group("copy");
    group.throughput(Throughput::Bytes(bytes));
    group.bench_function(BenchmarkId::new("by value", bytes), |bencher| {
        bencher.iter(|| black_box(subscription.copy()));
    });
    group.bench_function(BenchmarkId::new("in place", bytes), |bencher| {
        bencher.iter(|| subscription.copy_into(black_box(&mut copied)));
    });
    group.finish();

    let mut group = criterion.benchmark_group("updated");
    group.bench_function(BenchmarkId::from_parameter(bytes), |bencher| {
        bencher.iter(|| black_box(subscription.updated()));
    });
    group.finish();
}

fn clock(criterion: &mut Criterion) {
    let source = "/sys/devices/system/clocksource/clocksource0/current_clocksource";
    println!("clock source: {}", std::fs::read_to_string(source).unwrap_or_default().trim());
    criterion.bench_function("clock read", |bencher| bencher.iter(|| black_box(now_us())));
}

criterion_group!(benches, clock, all_sizes);
criterion_main!(benches);
