use uorb_core::{
    Error, Instance, Publication, Session, StreamOptions, StreamSubscription, poll, topic,
};
use uorb_tests::{Bus, Plain, Stamped};

topic! {
    /// Too large for a node.
    pub struct Image = "image" {
        /// Counts up.
        pub count: u64,
        /// What it shows.
        pub pixels: [u8; 1 << 20],
    }
}

#[test]
fn a_stream_begins_with_the_newest_message_and_has_every_one_from_there() {
    let mut bus = Bus::start();
    let mut plain = bus.advertise::<Plain>();
    for value in 1..=3 {
        plain.publish(&Plain { value }).unwrap();
    }
    let mut stream = bus.stream::<Plain>();
    for value in 4..=1_000 {
        plain.publish(&Plain { value }).unwrap();
    }
    for value in 3..=1_000 {
        assert_eq!(stream.update(), Some(&Plain { value }));
    }
    assert_eq!(stream.update(), None);
    assert_eq!(stream.lost(), 0);
}

#[test]
fn a_large_message_is_borrowed_and_copied() {
    let mut bus = Bus::start();
    let mut image = bus.advertise::<Image>();
    let mut stream = bus.stream::<Image>();
    let mut newest = bus.subscribe::<Image>();
    for count in 1..=5 {
        let mut loan = image.loan().unwrap();
        loan.count = count;
        loan.pixels[0xf_ffff] = count as u8;
        loan.publish().unwrap();
        let seen = stream.update().unwrap();
        assert_eq!((seen.count, seen.pixels[0xf_ffff]), (count, count as u8));
        assert!(newest.updated());
        let copied = newest.copy().unwrap();
        assert_eq!((copied.count, copied.pixels[0xf_ffff]), (count, count as u8));
    }
    let mut late = bus.subscribe::<Image>();
    assert!(late.updated());
    assert_eq!(late.copy().unwrap().count, 5);
    drop(image);
    let mut later = bus.subscribe::<Image>();
    assert!(later.updated());
    assert_eq!(later.copy().unwrap().count, 5);
}
