//! What a link publishes: a topic is advertised when its first message comes in.

use std::any::{Any, TypeId};
use std::collections::HashMap;

use uorb_core::{Error, Priority, Publication, Session, Topic};
use uorb_modules::say;

/// The publications of a link.
#[derive(Debug)]
pub struct Publications {
    session: Session,
    /// None: it could not be advertised.
    all: HashMap<TypeId, Option<Box<dyn Any + Send>>>,
}

impl Publications {
    pub(crate) fn new(session: &Session) -> Self {
        Self { session: session.clone(), all: HashMap::new() }
    }

    /// Publishes on instance 0, which several links may share.
    pub fn publish<T: Topic + 'static>(&mut self, message: &T::Message) {
        self.publish_by::<T>(message, Publication::advertise);
    }

    /// Publishes on an instance of the link's own, as a driver does.
    pub fn publish_multi<T: Topic + 'static>(&mut self, message: &T::Message) {
        self.publish_by::<T>(message, |session| {
            Publication::advertise_multi(session, Priority::DEFAULT)
        });
    }

    fn publish_by<T: Topic + 'static>(
        &mut self,
        message: &T::Message,
        advertise: impl FnOnce(&Session) -> Result<Publication<T>, Error>,
    ) {
        let session = &self.session;
        let publication = self.all.entry(TypeId::of::<T>()).or_insert_with(|| {
            let advertised = advertise(session);
            // Once: others of its messages will come.
            advertised.map(|it| Box::new(it) as Box<dyn Any + Send>).map_err(|e| say(&e)).ok()
        });
        let publication = publication.as_mut().and_then(|it| it.downcast_mut::<Publication<T>>());
        if let Some(publication) = publication {
            // A system that has ended ends the link by itself.
            let _ = publication.publish(message);
        }
    }
}
