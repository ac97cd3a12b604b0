use uorb_core::poll;
use uorb_tests::{Bus, PATIENCE, Plain};

#[test]
fn a_late_subscriber_copies_the_last_message() {
    let mut bus = Bus::start();
    let mut plain = bus.advertise::<Plain>();
    plain.publish(&Plain { value: 1 }).unwrap();

    let mut late = bus.subscribe::<Plain>();

    assert!(late.updated());
    assert_eq!(late.copy(), Some(Plain { value: 1 }));
    assert!(!late.updated());
    assert_eq!(late.copy(), Some(Plain { value: 1 }), "the last message again");
}

#[test]
fn a_sleeper_wakes_for_each_message() {
    let mut bus = Bus::start();
    let mut plain = bus.advertise::<Plain>();
    let mut sub = bus.subscribe::<Plain>();
    let thread = std::thread::spawn(move || {
        for value in 0..1000 {
            plain.publish(&Plain { value }).unwrap();
            std::thread::yield_now();
        }
        plain
    });
    let mut seen = 0;
    loop {
        assert!(poll(&mut [&mut sub], Some(PATIENCE)).unwrap() == 1);
        let m = sub.copy().unwrap();
        seen += 1;
        if m.value == 999 {
            break;
        }
    }
    eprintln!("seen {seen} lost {}", sub.lost());
    assert_eq!(seen + sub.lost(), 1000);
    drop(thread.join().unwrap());
    assert!(!bus.is_advertised("plain"));
}
