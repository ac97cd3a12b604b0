//! The keys of zenoh under which things are.
//!
//! Messages are at `uorb/<machine>/<system>/<topic>/<instance>`, for everybody who
//! reads there, a bridge to ROS 2 included; a `delete` there follows the last one when
//! nobody publishes any more. What machines say to each other about topics has a word
//! with `@` in its key, which no `*` of zenoh matches:
//!
//! | key | |
//! |---|---|
//! | `<key>/@topic/<revision>` | a token: the topic is advertised |
//! | `<key>/@about` | a question: what are its messages? |
//! | `<key>/@wanted/<machine>/<system>/<mHz>` | a token: somebody subscribes, at this rate; 0: to all |
//! | `uorb/<machine>/<system>/@clock` | a question: what time is it? |

use std::fmt;

use uorb_core::{Instance, is_topic_name};

/// The longest name of a machine: it has to fit into `reach_status`.
pub(crate) const MACHINE_NAME_MAX_BYTES: usize = 31;

/// A system of a machine.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Place {
    pub(crate) machine: String,
    pub(crate) system: u32,
}

/// An instance of a topic.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Source {
    pub(crate) topic: String,
    pub(crate) instance: Instance,
}

/// An instance of a topic of another machine.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Remote {
    pub(crate) place: Place,
    pub(crate) source: Source,
}

/// That a place subscribes to a topic of ours.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Wish {
    pub(crate) source: Source,
    pub(crate) place: Place,
    /// None: every message.
    pub(crate) rate_mhz: Option<u32>,
}

/// Whether a machine can have this name.
pub(crate) fn is_machine_name(name: &str) -> bool {
    let is_letter = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-';
    (1..=MACHINE_NAME_MAX_BYTES).contains(&name.len()) && name.bytes().all(is_letter)
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.machine, self.system)
    }
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.topic, self.instance)
    }
}

impl fmt::Display for Remote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.place, self.source)
    }
}

impl Place {
    pub(crate) fn clock(&self) -> String {
        format!("uorb/{self}/@clock")
    }

    /// Where we hear who subscribes to topics of this place.
    pub(crate) fn all_wanted(&self) -> String {
        format!("uorb/{self}/*/*/@wanted/**")
    }

    /// Where others ask about topics of this place.
    pub(crate) fn all_about(&self) -> String {
        format!("uorb/{self}/*/*/@about")
    }

    fn parse(machine: &str, system: &str) -> Option<Self> {
        let system = system.parse().ok()?;
        is_machine_name(machine).then(|| Self { machine: machine.into(), system })
    }
}

impl Remote {
    /// Where its messages are.
    pub(crate) fn key(&self) -> String {
        format!("uorb/{self}")
    }

    pub(crate) fn about(&self) -> String {
        format!("uorb/{self}/@about")
    }

    pub(crate) fn token(&self, revision: u32) -> String {
        format!("uorb/{self}/@topic/{revision:08x}")
    }

    pub(crate) fn wanted(&self, by: &Place, rate_mhz: Option<u32>) -> String {
        format!("uorb/{self}/@wanted/{by}/{}", rate_mhz.unwrap_or(0))
    }

    /// Where we hear which topics anybody has.
    pub(crate) const ALL_TOKENS: &str = "uorb/*/*/*/*/@topic/*";

    /// Reads the beginning of a key; what follows is the rest.
    fn parse<'k>(words: &mut impl Iterator<Item = &'k str>) -> Option<Self> {
        if words.next()? != "uorb" {
            return None;
        }
        let place = Place::parse(words.next()?, words.next()?)?;
        let topic = words.next().filter(|topic| is_topic_name(topic))?.to_string();
        let instance = Instance::new(words.next()?.parse().ok()?)?;
        Some(Self { place, source: Source { topic, instance } })
    }

    /// Reads a token of an advertised topic.
    pub(crate) fn parse_token(key: &str) -> Option<(Self, u32)> {
        let mut words = key.split('/');
        let remote = Self::parse(&mut words)?;
        let revision = match (words.next()?, words.next()?, words.next()) {
            ("@topic", revision, None) => u32::from_str_radix(revision, 16).ok()?,
            _ => return None,
        };
        Some((remote, revision))
    }

    /// Reads a question about a topic.
    pub(crate) fn parse_about(key: &str) -> Option<Self> {
        let mut words = key.split('/');
        let remote = Self::parse(&mut words)?;
        (words.next() == Some("@about") && words.next().is_none()).then_some(remote)
    }
}

impl Wish {
    /// Reads a token of somebody who subscribes.
    pub(crate) fn parse(key: &str) -> Option<Self> {
        let mut words = key.split('/');
        let Remote { source, .. } = Remote::parse(&mut words)?;
        if words.next()? != "@wanted" {
            return None;
        }
        let place = Place::parse(words.next()?, words.next()?)?;
        let rate_mhz = words.next()?.parse().ok()?;
        words.next().is_none().then_some(Self {
            source,
            place,
            rate_mhz: Some(rate_mhz).filter(|rate_mhz| *rate_mhz > 0),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn remote() -> Remote {
        let place = Place { machine: "drone7".into(), system: 0 };
        let source = Source { topic: "vehicle_attitude".into(), instance: Instance::FIRST };
        Remote { place, source }
    }

    #[test]
    fn keys_are_read_as_they_are_written() {
        let gcs = Place { machine: "gcs".into(), system: 1 };
        assert_eq!(remote().key(), "uorb/drone7/0/vehicle_attitude/0");
        assert_eq!(Remote::parse_token(&remote().token(0xab)), Some((remote(), 0xab)));
        assert_eq!(Remote::parse_about(&remote().about()), Some(remote()));
        for rate_mhz in [None, Some(10_500)] {
            let wish = Wish { source: remote().source, place: gcs.clone(), rate_mhz };
            assert_eq!(Wish::parse(&remote().wanted(&gcs, rate_mhz)), Some(wish));
        }
    }

    #[test]
    fn what_others_write_is_no_key_until_all_of_it_is_right() {
        for key in [
            "",
            "uorb",
            "uorb/drone7/0/vehicle_attitude/0/@topic/",
            "uorb/drone7/0/vehicle_attitude/0/@topic/1/2",
            "uorb/drone7/0/vehicle attitude/0/@topic/1",
            "uorb/drone7/0/../0/@topic/1",
            "uorb/drone7/0/vehicle_attitude/10/@topic/1",
            "uorb/drone7/x/vehicle_attitude/1/@topic/1",
            "uorb/a_name_that_is_longer_than_one_may/0/vehicle_attitude/1/@topic/1",
            "ros/drone7/0/vehicle_attitude/1/@topic/1",
        ] {
            assert_eq!(Remote::parse_token(key), None, "{key}");
        }
    }
}
