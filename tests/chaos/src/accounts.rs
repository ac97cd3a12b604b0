//! The model: every generation of a round is one message that somebody
//! published, once, and whoever copied it copied that.

use std::collections::{HashMap, HashSet};

/// A message: who sent it, and its number there.
type Message = (u64, u64);

/// What is known of a round's messages, by their distance from the generation
/// before the round.
#[derive(Debug, Default)]
pub(crate) struct Accounts {
    base: u32,
    messages: HashMap<u32, Message>,
    /// Publishes that were under way when their publishers were killed. Each may
    /// be there or not.
    in_flight: HashSet<Message>,
    pub(crate) faults: Vec<String>,
}

impl Accounts {
    pub(crate) fn since(base: u32) -> Self {
        Self { base, ..Self::default() }
    }

    /// What a publisher has noted. If it was killed, one message may be missing.
    pub(crate) fn published(&mut self, log: &[(u32, u64, u64)], in_flight: Option<Message>) {
        let mut last = 0;
        for (generation, sender, count) in log {
            let place = generation.wrapping_sub(self.base);
            if place <= last {
                self.fault(format!("message {count} of {sender} is before the one before it"));
            }
            last = place;
            if let Some(other) = self.messages.insert(place, (*sender, *count)) {
                self.fault(format!("generation +{place} is {other:?} and {sender}:{count}"));
            }
        }
        self.in_flight.extend(in_flight);
    }

    /// What a subscription has copied. After all publishers have been heard.
    pub(crate) fn copied(&mut self, who: &str, log: &[(u32, u64, u64)]) {
        let mut last = 0;
        for (generation, sender, count) in log {
            if *sender == 0 {
                // A new subscription begins with what is there.
                last = 0;
                continue;
            }
            let place = generation.wrapping_sub(self.base);
            let message = (*sender, *count);
            // It was published before this round, and is the first copy.
            if place == 0 || place > i32::MAX as u32 {
                continue;
            }
            if place <= last {
                self.fault(format!("{who} copied +{place} after +{last}"));
            }
            last = place;
            match self.messages.get(&place) {
                Some(known) if *known == message => {}
                Some(known) => {
                    let known = *known;
                    self.fault(format!("{who} copied {message:?} as +{place}, which is {known:?}"));
                }
                None if self.in_flight.remove(&message) => _ = self.messages.insert(place, message),
                None => self.fault(format!("{who} copied {message:?} as +{place}: nobody sent it")),
            }
        }
    }

    /// All generations up to the newest are accounted for.
    pub(crate) fn close(&mut self, newest: u32) -> u64 {
        let published = newest.wrapping_sub(self.base);
        if let Some(beyond) = self.messages.keys().find(|place| **place > published) {
            let beyond = *beyond;
            self.fault(format!("+{beyond} was published, and the newest is +{published}"));
        }
        let unknown = u64::from(published).saturating_sub(self.messages.len() as u64);
        if unknown > self.in_flight.len() as u64 {
            self.fault(format!(
                "{unknown} generations are nobody's, and {} publishes were under way",
                self.in_flight.len(),
            ));
        }
        published.into()
    }

    pub(crate) fn message(&self, generation: u32) -> Option<Message> {
        self.messages.get(&generation.wrapping_sub(self.base)).copied()
    }

    /// Whether a message may have been published by one who was killed.
    pub(crate) fn may_be(&self, message: Message) -> bool {
        self.in_flight.contains(&message)
    }

    pub(crate) fn fault(&mut self, what: String) {
        if self.faults.len() < 10 {
            self.faults.push(what);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_in_flight_counts_once_or_not_at_all() {
        let mut accounts = Accounts::since(u32::MAX - 1);
        accounts.published(&[(u32::MAX, 1, 0), (0, 1, 1)], Some((1, 2)));
        accounts.copied("one", &[(u32::MAX, 1, 0), (0, 1, 1), (1, 1, 2)]);
        accounts.copied("other", &[(1, 1, 2)]);
        assert_eq!(accounts.close(1), 3);
        assert_eq!(accounts.faults, Vec::<String>::new());
        accounts.copied("other", &[(2, 1, 2)]);
        assert_eq!(accounts.faults.len(), 1, "not twice");
    }

    #[test]
    fn a_generation_that_is_nobody_s_is_a_fault() {
        let mut accounts = Accounts::since(10);
        accounts.published(&[(11, 1, 0), (13, 1, 1)], None);
        accounts.close(13);
        assert_eq!(accounts.faults.len(), 1);
    }
}
