//! Several instances of one topic.

use std::io::Write;
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, ensure};
use uorb_core::{
    INSTANCES_MAX, Instance, Priority, Publication, Session, Subscription, Topic, now_us, poll,
};
use uorb_msg::{OrbMultitest, OrbTest, OrbTestMedium, OrbTestMediumMulti};

use super::single::message;
use super::{PATIENCE, copy_new, drain, nothing_new};

/// Claims an instance and checks that it is the one of this number.
fn claim<T: Topic>(
    session: &Session,
    number: u8,
    priority: Priority,
) -> anyhow::Result<Publication<T>> {
    let publication = Publication::<T>::advertise_multi(session, priority)?;
    let instance = publication.instance();
    ensure!(instance.number() == number, "instance {instance} instead of {number}");
    Ok(publication)
}

fn follow<T: Topic>(session: &Session, number: u8) -> anyhow::Result<Subscription<T>> {
    let instance = Instance::new(number).context("no such instance")?;
    Ok(Subscription::subscribe_instance(session, instance)?)
}

/// As many instances as there can be, followed from before they are advertised.
pub(super) fn test_subscription_multi(
    session: &Session,
    _out: &mut dyn Write,
) -> anyhow::Result<()> {
    let follow_all = || -> anyhow::Result<Vec<Subscription<OrbTest>>> {
        (0..INSTANCES_MAX).map(|number| follow(session, number)).collect()
    };
    let mut subscriptions = follow_all()?;
    let mut publications = Vec::new();
    for number in 0..INSTANCES_MAX {
        let advertised = subscriptions.iter_mut().filter_map(|s| s.advertised().then_some(()));
        ensure!(advertised.count() == number as usize, "not {number} are advertised");
        publications.push(claim::<OrbTest>(session, number, Priority::DEFAULT)?);
        let is_advertised = subscriptions[number as usize].advertised();
        ensure!(is_advertised, "instance {number} is not advertised");
    }
    for _ in 0..2 {
        subscriptions.iter_mut().for_each(drain);
        for round in 0..10 {
            for (number, publication) in (0..).zip(&mut publications) {
                publication.publish(&message(number * 100 + round))?;
            }
            for (number, subscription) in (0..).zip(&mut subscriptions) {
                let before = subscription.last_copied().map(|copied| copied.generation);
                let val = copy_new(subscription)?.val;
                ensure!(val == number * 100 + round, "instance {number} gave {val}");
                let after = subscription.last_copied().map(|copied| copied.generation);
                if let (Some(before), Some(after)) = (before, after) {
                    ensure!(after.since(before) == 1, "generation {before} went to {after}");
                }
                nothing_new(subscription)?;
            }
        }
        // Whoever comes anew sees updates again.
        subscriptions = follow_all()?;
    }
    Ok(())
}

/// Two instances have numbers, messages and priorities of their own.
pub(super) fn test_multi(session: &Session, _out: &mut dyn Write) -> anyhow::Result<()> {
    let mut first = claim::<OrbMultitest>(session, 0, Priority::MAX)?;
    let mut second = claim::<OrbMultitest>(session, 1, Priority::MIN)?;
    first.publish(&message(103))?;
    second.publish(&message(203))?;

    let mut of_first = follow::<OrbMultitest>(session, 0)?;
    let mut of_second = follow::<OrbMultitest>(session, 1)?;
    ensure!(copy_new(&mut of_first)?.val == 103, "instance 0 has not 103");
    ensure!(copy_new(&mut of_second)?.val == 203, "instance 1 has not 203");

    ensure!(of_first.priority() == Priority::MAX, "instance 0: {:?}", of_first.priority());
    ensure!(of_second.priority() == Priority::MIN, "instance 1: {:?}", of_second.priority());
    Ok(())
}

/// A subscription may be there before its instance.
pub(super) fn test_multi_reversed(session: &Session, _out: &mut dyn Write) -> anyhow::Result<()> {
    let _first = claim::<OrbMultitest>(session, 0, Priority::MAX)?;
    let _second = claim::<OrbMultitest>(session, 1, Priority::MIN)?;
    let mut early = follow::<OrbMultitest>(session, 2)?;
    drain(&mut early);

    let mut third = claim::<OrbMultitest>(session, 2, Priority::MAX)?;
    let mut fourth = claim::<OrbMultitest>(session, 3, Priority::MIN)?;
    third.publish(&message(204))?;
    fourth.publish(&message(304))?;
    ensure!(copy_new(&mut early)?.val == 204, "instance 2 has not 204");
    let mut late = follow::<OrbMultitest>(session, 3)?;
    ensure!(copy_new(&mut late)?.val == 304, "instance 3 has not 304");
    Ok(())
}

/// Who unadvertises and advertises again gets the instances again, in order.
pub(super) fn test_unadvertise(session: &Session, _out: &mut dyn Write) -> anyhow::Result<()> {
    for _ in 0..2 {
        let publications: Vec<Publication<OrbMultitest>> = (0..4)
            .map(|number| claim(session, number, Priority::DEFAULT))
            .collect::<anyhow::Result<_>>()?;
        drop(publications);
        for instance in Instance::all().take(4) {
            let exists = session.exists("orb_multitest", instance)?;
            ensure!(!exists, "instance {instance} is still advertised");
        }
    }
    Ok(())
}

/// Three instances that another thread publishes in turn, followed in turn.
pub(super) fn test_multi2(session: &Session, _out: &mut dyn Write) -> anyhow::Result<()> {
    const INSTANCES: u8 = 3;
    const MESSAGES: u64 = 50 * INSTANCES as u64;
    let mut subscriptions: Vec<Subscription<OrbTestMediumMulti>> =
        (0..INSTANCES).map(|number| follow(session, number)).collect::<anyhow::Result<_>>()?;
    subscriptions.iter_mut().for_each(drain);

    thread::scope(|scope| {
        let publisher = scope.spawn(|| -> anyhow::Result<()> {
            let mut publications: Vec<Publication<OrbTestMediumMulti>> = (0..INSTANCES)
                .map(|number| claim(session, number, Priority::DEFAULT))
                .collect::<anyhow::Result<_>>()?;
            for number in 0..MESSAGES as usize {
                let message = OrbTestMedium { timestamp: now_us(), ..OrbTestMedium::default() };
                publications[number % usize::from(INSTANCES)].publish(&message)?;
                // So that no two of them have the same time.
                thread::sleep(Duration::from_millis(1));
            }
            Ok(())
        });
        let followed = follow_in_turn(&mut subscriptions, MESSAGES);
        let published = publisher.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        published.and(followed)
    })
}

/// Copies until so many messages came or were lost; each instance's times rise.
fn follow_in_turn(
    subscriptions: &mut [Subscription<OrbTestMediumMulti>],
    messages: u64,
) -> anyhow::Result<()> {
    let mut newest_us = vec![0; subscriptions.len()];
    let mut copied = 0;
    let lost_before: u64 = subscriptions.iter().map(|subscription| subscription.lost()).sum();
    loop {
        let lost: u64 = subscriptions.iter().map(|subscription| subscription.lost()).sum();
        if copied + lost - lost_before >= messages {
            return Ok(());
        }
        let mut waiting: Vec<_> = subscriptions.iter_mut().map(|s| &mut **s).collect();
        ensure!(poll(&mut waiting, Some(PATIENCE))? > 0, "{copied} of {messages} messages came");
        for (subscription, newest_us) in subscriptions.iter_mut().zip(&mut newest_us) {
            if let Some(message) = subscription.update() {
                let (before, after) = (*newest_us, message.timestamp);
                ensure!(after > before, "a message of {after} us came after one of {before} us");
                *newest_us = after;
                copied += 1;
            }
        }
    }
}
