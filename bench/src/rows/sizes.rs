//! Publish and copy from 16 bytes to 64 KiB, with one idle subscription.
//!
//! The floor is what the machine takes to move as many bytes, and for a publish
//! a clock read besides.

use std::hint::black_box;

use uorb_core::zerocopy::FromZeros;
use uorb_core::{Topic, now_us, topic};
use uorb_tests::Bus;

use super::Run;
use super::kernel::memcpy;
use crate::doors::iceoryx;
use crate::figures::Contestant;
use crate::times::{Times, per_call};

macro_rules! sizes {
    ($($Message:ident = $name:literal, $bytes:literal;)*) => {
        $(topic! { pub struct $Message = $name { words: [u64; $bytes / 8] } })*

        pub fn measure(run: &mut Run, bus: &mut Bus) {
            $(one_size::<$Message, { $bytes / 8 }>(run, bus);)*
        }
    };
}

sizes! {
    Size16 = "size16", 16;
    Size64 = "size64", 64;
    Size256 = "size256", 256;
    Size1024 = "size1024", 1_024;
    Size4096 = "size4096", 4_096;
    Size16384 = "size16384", 16_384;
    Size65528 = "size65528", 65_528;
}

fn clock_and_memcpy(batches: u32, bytes: usize) -> Times {
    let from = vec![1_u8; bytes];
    let mut to = vec![0_u8; bytes];
    per_call(batches, || {
        black_box(now_us());
        black_box(&mut to).copy_from_slice(black_box(&from));
    })
}

fn one_size<T: Topic, const WORDS: usize>(run: &mut Run, bus: &mut Bus)
where
    T::Message: FromZeros,
{
    let batches = run.figures.effort.batches;
    let bytes = size_of::<T::Message>();
    let setting = format!("{bytes} B");
    let mut publication = bus.advertise::<T>();
    let mut subscription = bus.subscribe::<T>();
    let mut by_value = bus.subscribe::<T>();
    let message = T::Message::new_zeroed();
    let mut copied = T::Message::new_zeroed();
    publication.publish(&message).expect("published");
    let (publisher, _subscribers) =
        iceoryx::publisher_and_subscribers::<[u64; WORDS]>(&bus.system, &setting, 1);
    let plain = [0_u64; WORDS];
    run.alone(|figures| {
        let floor = &mut || clock_and_memcpy(batches, bytes);
        let contestants = vec![
            Contestant::new("uorb", || {
                per_call(batches, || publication.publish(black_box(&message)))
            }),
            Contestant::new("iceoryx2", || {
                per_call(batches, || {
                    let mut sample = publisher.loan_uninit().expect("memory");
                    sample.payload_mut().write(*black_box(&plain));
                    // SAFETY: all of it was just written.
                    #[allow(unsafe_code)]
                    unsafe { sample.assume_init() }.send().expect("sent");
                })
            }),
        ];
        figures.measure(("publish, by size", &setting), ("clock and memcpy", floor), contestants);
        let floor = &mut || memcpy(batches, bytes);
        let contestants = vec![
            Contestant::new("uorb", || {
                per_call(batches, || subscription.copy_into(black_box(&mut copied)))
            }),
            Contestant::new("uorb, by value", || per_call(batches, || by_value.copy())),
        ];
        figures.measure(("copy, by size", &setting), ("memcpy", floor), contestants);
    });
}
