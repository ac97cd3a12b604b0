//! A message on the stream, beside plain iceoryx2: loaned, published, borrowed.
//!
//! Twice: untouched, which shows what handing over takes; and written and read,
//! which is what a stream is for. The floor of that is a bare ring of as many
//! buffers in one process.

use std::hint::black_box;

use iceoryx2::prelude::ServiceName;
use uorb_core::zerocopy::{FromBytes, IntoBytes};
use uorb_core::{Publication, StreamSubscription, Topic, UorbHeader, now_us, topic};
use uorb_tests::Bus;

use super::Run;
use super::kernel::{CLOCK, clock_read};
use crate::doors::iceoryx;
use crate::figures::Contestant;
use crate::times::per_call;

/// Buffers of the bare ring: as a port of two queued messages has in use.
const BUFFERS: usize = 4;

pub const WRITTEN: &str = "stream, written and read";

macro_rules! sizes {
    ($($Message:ident = $name:literal, $bytes:literal;)*) => {
        $(topic! { pub struct $Message = $name { words: [u64; $bytes / 8] } })*

        pub fn measure(run: &mut Run, bus: &mut Bus) {
            $(one_size::<$Message>(run, bus);)*
        }
    };
}

sizes! {
    Stream64 = "stream64", 64;
    Stream4Ki = "stream4ki", 4_096;
    Stream64Ki = "stream64ki", 65_528;
    Stream1Mi = "stream1mi", 1_048_576;
    Stream4Mi = "stream4mi", 4_194_304;
    Stream8Mi = "stream8mi", 8_388_608;
}

fn one_size<T: Topic>(run: &mut Run, bus: &mut Bus) {
    let bytes = size_of::<T::Message>();
    let batches = run.figures.effort.batches;
    // Whole seconds of copying are not needed for a median.
    let few = batches.min((256 << 20) / bytes as u32).max(5);
    let setting = format!("{bytes} B");
    let message = vec![1_u64; bytes / 8];
    let mut publication: Publication<T> = bus.advertise();
    let mut stream: StreamSubscription<T> = bus.stream();
    let plain = Plain::open(bus, bytes);
    run.alone(|figures| {
        let (mut ours, mut stream) = (&mut publication, &mut stream);
        let floor = &mut || clock_read(batches);
        let contestants = vec![
            Contestant::new("uorb", || {
                per_call(batches, || {
                    ours.loan().expect("memory").publish().expect("published");
                    black_box(stream.update().expect("it was published"));
                })
            }),
            Contestant::new("iceoryx2", || per_call(batches, || plain.exchange(|_| {}, |_| {}))),
        ];
        figures.measure(("stream, untouched", &setting), (CLOCK, floor), contestants);

        let (ours, stream) = (&mut ours, &mut stream);
        let mut ring = vec![vec![0_u64; bytes / 8]; BUFFERS];
        let mut turn = 0;
        let mut bare = || {
            per_call(few, || {
                turn = (turn + 1) % BUFFERS;
                ring[turn].copy_from_slice(black_box(&message));
                read(black_box(&ring[turn]));
            })
        };
        let contestants = vec![
            Contestant::new("uorb", || {
                per_call(few, || {
                    let mut loan = ours.loan().expect("memory");
                    loan.as_mut_bytes().copy_from_slice(black_box(&message).as_bytes());
                    loan.publish().expect("published");
                    let message = stream.update().expect("it was published");
                    read(<[u64]>::ref_from_bytes(message.as_bytes()).expect("it is aligned"));
                })
            }),
            Contestant::new("iceoryx2", || {
                let write = |into: &mut [u8]| into.copy_from_slice(black_box(&message).as_bytes());
                let take = |from: &[u8]| read(<[u64]>::ref_from_bytes(from).expect("aligned"));
                per_call(few, || plain.exchange(write, take))
            }),
        ];
        figures.measure((WRITTEN, &setting), ("a bare ring", &mut bare), contestants);
    });
}

fn read(words: &[u64]) {
    black_box(words.iter().fold(0_u64, |sum, word| sum.wrapping_add(*word)));
}

/// A publisher and a subscriber of plain iceoryx2, with a header as ours.
struct Plain {
    publisher: iceoryx2::port::publisher::Publisher<iceoryx::Ipc, [u8], UorbHeader>,
    subscriber: iceoryx2::port::subscriber::Subscriber<iceoryx::Ipc, [u8], UorbHeader>,
    bytes: usize,
}

impl Plain {
    fn open(bus: &Bus, bytes: usize) -> Self {
        let service = iceoryx::node(&bus.system)
            .service_builder(&ServiceName::new(&format!("stream/{bytes}")).expect("a name"))
            .publish_subscribe::<[u8]>()
            .user_header::<UorbHeader>()
            .open_or_create()
            .expect("a service");
        let builder = service.publisher_builder().initial_max_slice_len(bytes);
        let publisher = builder.create().expect("a publisher");
        let subscriber = service.subscriber_builder().create().expect("a subscriber");
        Self { publisher, subscriber, bytes }
    }

    fn exchange(&self, write: impl FnOnce(&mut [u8]), read: impl FnOnce(&[u8])) {
        let mut sample = self.publisher.loan_slice_uninit(self.bytes).expect("memory");
        // What our header costs, it costs here.
        sample.user_header_mut().publish_time_us = now_us();
        // SAFETY: shared memory is zeros before anybody writes there, and bytes
        // have no invalid values.
        #[allow(unsafe_code)]
        let mut sample = unsafe { sample.assume_init() };
        write(sample.payload_mut());
        sample.send().expect("sent");
        let sample = self.subscriber.receive().expect("received").expect("it was sent");
        read(black_box(sample.payload()));
    }
}
