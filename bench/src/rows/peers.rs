//! The hot path of the peers, with 64 bytes, each beside ours in turns.

use std::hint::black_box;
use std::os::unix::net::UnixDatagram;

use iceoryx2::prelude::ServiceName;
use uorb_tests::Bus;

use super::Run;
use super::hot::{Bytes64, IDLE, setting};
use super::kernel::{CLOCK, clock_read};
use crate::doors::mutex_ring::Ring;
use crate::doors::{WORDS, iceoryx};
use crate::figures::Contestant;
use crate::times::{per_call, per_call_in};

/// As many datagrams as a socket certainly keeps.
const DATAGRAMS: u32 = 8;

const MESSAGE: [u64; WORDS] = [1; WORDS];

pub fn measure(run: &mut Run, bus: &mut Bus) {
    publish(run, bus);
    copy(run, bus);
    datagram(run);
    #[cfg(feature = "zenoh")]
    zenoh(run, bus);
}

/// What is published to is idle: it keeps the newest and lets the rest go.
fn publish(run: &mut Run, bus: &mut Bus) {
    let batches = run.figures.effort.batches;
    let mut ours = bus.advertise::<Bytes64>();
    let mut idle = Vec::new();
    let ring = Ring::default();
    run.alone(|figures| {
        for subscribers in IDLE {
            idle.resize_with(subscribers, || bus.subscribe::<Bytes64>());
            let name = format!("publish/{subscribers}");
            let (publisher, _subscribers) =
                iceoryx::publisher_and_subscribers::<[u64; WORDS]>(&bus.system, &name, subscribers);
            let contestants = vec![
                Contestant::new("uorb", || {
                    per_call(batches, || {
                        ours.publish(black_box(&Bytes64 { words: MESSAGE })).expect("published");
                    })
                }),
                Contestant::new("iceoryx2", || {
                    per_call(batches, || {
                        let sample = publisher.loan_uninit().expect("memory");
                        sample.write_payload(black_box(MESSAGE)).send().expect("sent");
                    })
                }),
                Contestant::new("mutex ring in one process", || {
                    per_call(batches, || ring.publish(black_box(&MESSAGE)))
                }),
            ];
            let floor = &mut || clock_read(batches);
            let row = ("publish, beside peers", &*setting(subscribers));
            figures.measure(row, (CLOCK, floor), contestants);
        }
    });
}

fn copy(run: &mut Run, bus: &mut Bus) {
    let batches = run.figures.effort.batches;
    let mut publication = bus.advertise::<Bytes64>();
    let mut subscription = bus.subscribe::<Bytes64>();
    publication.publish(&Bytes64 { words: MESSAGE }).expect("published");
    let node = iceoryx::node(&bus.system);
    let board = node
        .service_builder(&ServiceName::new("bench/blackboard").expect("a name"))
        .blackboard_creator::<u32>()
        .add::<[u64; WORDS]>(0, MESSAGE)
        .create()
        .expect("a blackboard");
    let writer = board.writer_builder().create().expect("a writer");
    let reader = board.reader_builder().create().expect("a reader");
    let writer = writer.entry::<[u64; WORDS]>(&0).expect("its entry");
    let reader = reader.entry::<[u64; WORDS]>(&0).expect("its entry");
    let ring = Ring::default();
    let mut seen = 0;
    let got = reader.get();
    run.alone(|figures| {
        let floor = &mut || clock_read(batches);
        let contestants = vec![
            Contestant::new("uorb", || per_call(batches, || subscription.copy())),
            Contestant::new("iceoryx2 blackboard", || per_call(batches, || *reader.get())),
            Contestant::new("mutex ring in one process", || {
                per_call(batches, || ring.copy(&mut seen))
            }),
        ];
        figures.measure(("copy, beside peers", "64 B"), (CLOCK, floor), contestants);

        let floor = &mut || clock_read(batches);
        let contestants = vec![
            Contestant::new("uorb", || per_call(batches, || subscription.updated())),
            Contestant::new("iceoryx2 blackboard", || {
                per_call(batches, || !reader.is_up_to_date(&got))
            }),
            Contestant::new("mutex ring in one process", || {
                per_call(batches, || ring.updated(black_box(0)))
            }),
        ];
        figures.measure(("updated, beside peers", "64 B"), (CLOCK, floor), contestants);

        let floor = &mut || clock_read(batches);
        let contestants = vec![Contestant::new("iceoryx2 blackboard", || {
            per_call(batches, || writer.update_with_copy(black_box(MESSAGE)))
        })];
        figures.measure(("publish, beside peers", "64 B, blackboard"), (CLOCK, floor), contestants);
    });
}

fn datagram(run: &mut Run) {
    let batches = run.figures.effort.batches;
    let (sender, receiver) = UnixDatagram::pair().expect("a pair of sockets");
    let message = [1_u8; WORDS * 8];
    let drain = || {
        receiver.set_nonblocking(true).expect("a switch");
        while receiver.recv(&mut [0; WORDS * 8]).is_ok() {}
    };
    run.alone(|figures| {
        let floor = &mut || clock_read(batches);
        let socket = Contestant::new("Unix datagram", || {
            let send = || sender.send(black_box(&message)).expect("sent");
            per_call_in(batches, DATAGRAMS, send, drain)
        });
        figures.measure(("publish, beside peers", &setting(1)), (CLOCK, floor), vec![socket]);
    });
}

/// Subscribers in processes of their own, which take what comes.
#[cfg(feature = "zenoh")]
fn zenoh(run: &mut Run, bus: &mut Bus) {
    use crate::doors::zenoh::{Out, session};
    use crate::role::{on, play};

    let batches = run.figures.effort.batches;
    for subscribers in [0, 1, 4] {
        let session = session(&bus.system, true);
        let mut out = Out::declare(&session, "publish");
        let core = on(run.cores.other());
        let start = |_| {
            let mut actor = play(Some(bus), &["zenoh-subscriber", &core, "publish"]);
            actor.expect("ready");
            actor
        };
        let _actors: Vec<_> = (0..subscribers).map(start).collect();
        if subscribers > 0 {
            out.meet();
        }
        run.alone(|figures| {
            let floor = &mut || clock_read(batches);
            let zenoh = Contestant::new("zenoh", || {
                per_call_in(batches, 64, || out.put(black_box(&[1; WORDS * 8])), || {})
            });
            figures.measure(
                ("publish, beside peers", &setting(subscribers)),
                (CLOCK, floor),
                vec![zenoh],
            );
        });
    }
}
