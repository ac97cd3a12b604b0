//! A topic that somebody else may publish with another layout.
//!
//! A flight log that is replayed has the messages of its year. The bridge reads
//! each field by its name: those that the publisher does not have are 0.

use std::fmt;
use std::time::Duration;

use uorb_core::zerocopy::{FromZeros, IntoBytes};
use uorb_core::{Error, Instance, Layout, RawSubscription, Session, Topic};
use uorb_modules::say;

/// A subscription by the names of fields.
pub struct Followed<T: Topic> {
    /// None: it could not be followed, and why has been said.
    raw: Option<RawSubscription>,
    session: Session,
    bytes: Vec<u8>,
    /// Known once somebody has described the topic.
    fields: Option<Vec<SharedField>>,
    skips_own: bool,
    topic: std::marker::PhantomData<fn() -> T>,
}

impl<T: Topic> fmt::Debug for Followed<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Followed").field("raw", &self.raw).finish_non_exhaustive()
    }
}

/// Where bytes that both layouts have are in each.
#[derive(Debug, PartialEq, Eq)]
struct SharedField {
    theirs: usize,
    ours: usize,
    size_bytes: usize,
}

impl<T: Topic> Followed<T> {
    /// Follows instance 0.
    pub fn new(session: &Session) -> Self {
        Self::instance(session, Instance::FIRST)
    }

    /// Looks at instance 0 now and then: what is not looked at is not lost.
    pub fn sampled(session: &Session) -> Self {
        Self::sampled_instance(session, Instance::FIRST)
    }

    /// Looks at an instance now and then.
    pub fn sampled_instance(session: &Session, instance: Instance) -> Self {
        let mut followed = Self::instance(session, instance);
        if let Some(raw) = &mut followed.raw {
            raw.set_interval(Duration::from_micros(1));
        }
        followed
    }

    /// Follows an instance.
    fn instance(session: &Session, instance: Instance) -> Self {
        let raw = RawSubscription::subscribe(session, &T::METADATA.name, instance);
        Self {
            raw: raw.map_err(|error: Error| say(&error)).ok(),
            session: session.clone(),
            bytes: Vec::new(),
            fields: None,
            skips_own: false,
            topic: std::marker::PhantomData,
        }
    }

    /// Does not show what this process has published itself.
    pub fn of_others(mut self) -> Self {
        self.skips_own = true;
        self
    }

    /// With a descriptor to wait on. Without one left it is not followed.
    pub fn with_descriptor(mut self) -> Self {
        let opened = self.raw.as_ref().map_or(Ok(()), RawSubscription::open_descriptor);
        if let Err(error) = opened {
            say(&error);
            self.raw = None;
        }
        self
    }

    /// What wakes whoever waits for it.
    pub fn raw(&mut self) -> Option<&mut RawSubscription> {
        self.raw.as_mut()
    }

    /// Takes all that was published until now as seen.
    pub fn skip(&mut self) {
        if let Some(raw) = &mut self.raw {
            raw.skip();
        }
    }

    /// The next message, if it is new.
    pub fn update(&mut self) -> Option<T::Message> {
        if self.raw.as_mut()?.updated() { self.copy() } else { None }
    }

    /// The next message, or the last one again. None if there never was one.
    pub fn copy(&mut self) -> Option<T::Message> {
        let raw = self.raw.as_mut()?;
        if !raw.copy(&mut self.bytes) {
            return None;
        }
        if self.skips_own && raw.last_copied()?.peer == self.session.peer() {
            return None;
        }
        if self.fields.is_none() {
            self.fields = Some(shared(&raw.metadata()?.layout, &T::METADATA.layout));
        }
        let mut message = T::Message::new_zeroed();
        for SharedField { theirs, ours, size_bytes } in self.fields.iter().flatten() {
            let value = self.bytes.get(*theirs..theirs + size_bytes)?;
            message.as_mut_bytes()[*ours..ours + size_bytes].copy_from_slice(value);
        }
        Some(message)
    }
}

/// Names that a field has had in other years.
const ALIASES: &[(&str, &str)] = &[("yaw", "heading")];

/// The fields that have the same name and type in both layouts.
fn shared(theirs: &Layout, ours: &Layout) -> Vec<SharedField> {
    let theirs = theirs.flatten();
    let fields = ours.flatten().into_iter().filter_map(|our| {
        let named =
            |path: &str| theirs.iter().find(|their| their.path == path && their.ty == our.ty);
        let alias = ALIASES.iter().find(|(name, _)| *name == our.path);
        let their = named(&our.path).or_else(|| named(alias?.1))?;
        let count = |length: Option<u32>| length.unwrap_or(1);
        let elements = count(their.array_length).min(count(our.array_length));
        Some(SharedField {
            theirs: their.offset_bytes as usize,
            ours: our.offset_bytes as usize,
            size_bytes: (our.ty.size_bytes() * elements) as usize,
        })
    });
    fields.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use uorb_core::topic;
    use uorb_msg::VehicleAttitude;

    topic! {
        /// As it was in a log, without angles.
        pub struct Logged = "vehicle_attitude" {
            pub timestamp: u64,
            pub rollspeed: f32,
            pub pitchspeed: f32,
            pub yawspeed: f32,
            pub q: [f32; 4],
            pub yaw: u32,
        }
    }

    #[test]
    fn fields_are_found_by_name_and_type() {
        let ours = &VehicleAttitude::METADATA.layout;
        let offset = |name: &str| {
            let field = ours.fields.iter().find(|field| field.name == name).unwrap();
            field.offset_bytes as usize
        };
        let fields = shared(&Logged::METADATA.layout, ours);
        let q = SharedField { theirs: 20, ours: offset("q"), size_bytes: 16 };
        assert!(fields.contains(&q), "{fields:?}");
        // `yaw` is another type there, and `roll` is not there at all.
        assert_eq!(fields.len(), 5);
    }

    #[test]
    fn equal_layouts_are_copied_whole() {
        let ours = &VehicleAttitude::METADATA.layout;
        let bytes: usize = shared(ours, ours).iter().map(|field| field.size_bytes).sum();
        assert_eq!(bytes, ours.size_no_padding_bytes() as usize);
    }
}
