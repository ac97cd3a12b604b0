use uorb_tests::{Actor, Bus, Stamped};

/// The numbers in a follower's last line.
struct Followed {
    copied: u64,
    lost: u64,
    pending: u64,
    torn: u64,
    disorder: u64,
}

fn followed(actor: &mut Actor) -> Followed {
    actor.say("all is published");
    let line = actor.finish().pop().expect("it says what it saw");
    let numbers: Vec<u64> = line.split(' ').filter_map(|word| word.parse().ok()).collect();
    let [copied, lost, pending, torn, disorder] = numbers[..] else { panic!("{line}") };
    Followed { copied, lost, pending, torn, disorder }
}

fn publishers_and_followers(publishers: usize, queue: &str, followers: &[&str]) {
    const MESSAGES: u64 = 50_000;
    let bus = Bus::start();
    let mut followers: Vec<_> = followers.iter().map(|how| bus.spawn(&[how])).collect();
    followers.iter_mut().for_each(|follower| follower.expect("subscribed"));
    let count = MESSAGES.to_string();
    let mut publishers: Vec<_> =
        (0..publishers).map(|_| bus.spawn(&["publish", &count, queue])).collect();
    publishers.iter_mut().for_each(|publisher| publisher.expect("advertised"));
    publishers.iter_mut().for_each(|publisher| publisher.say("go"));
    publishers.iter_mut().for_each(|publisher| publisher.expect("published"));

    let published = MESSAGES * publishers.len() as u64;
    for follower in &mut followers {
        let Followed { copied, lost, pending, torn, disorder } = followed(follower);
        assert_eq!((torn, disorder), (0, 0));
        assert_eq!(copied + lost + pending, published, "copied {copied} lost {lost}");
        assert!(copied > 0 && pending == 0);
    }
}

#[test]
fn four_publishers_on_one_instance_have_one_total_order() {
    publishers_and_followers(4, "1", &["follow", "follow"]);
}

#[test]
fn four_publishers_on_a_queue_have_one_total_order() {
    publishers_and_followers(4, "16", &["follow", "follow-by-descriptor"]);
}

#[test]
fn publishers_that_are_killed_in_mid_publish_tear_nothing_and_block_nobody() {
    let mut bus = Bus::start();
    let mut followers = [bus.spawn(&["follow"]), bus.spawn(&["follow-by-descriptor"])];
    followers.iter_mut().for_each(|follower| follower.expect("subscribed"));
    let mut survivor = bus.spawn(&["publish-for-ever", "4"]);
    survivor.expect("advertised");
    for _ in 0..40 {
        let mut victim = bus.spawn(&["publish-for-ever", "4"]);
        victim.expect("advertised");
        victim.kill();
    }
    survivor.say("enough");
    survivor.finish();

    let mut last = bus.subscribe::<Stamped>();
    assert!(last.copy().is_some_and(|message| message.is_whole()));
    let published = u64::from(last.last_copied().unwrap().generation.get());
    for follower in &mut followers {
        let Followed { copied, lost, pending, torn, disorder } = followed(follower);
        assert_eq!((torn, disorder), (0, 0));
        assert_eq!(copied + lost + pending, published);
    }
}
