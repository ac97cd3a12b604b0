//! What processes and the broker say to each other: bytes that are no message
//! are none, and a message is the same when it is packed again.

use uorb_core::broker_side::{
    FromBroker, Refusal, Reply, Request, Subject, ToBroker, decode, decode_beginning, encode,
};
use uorb_core::{Layout, is_topic_name};

/// One packet, as the broker reads it and as a process does.
pub(crate) fn both_directions(packet: &[u8]) {
    let _ = decode_beginning(packet);
    if let Some(message) = decode::<ToBroker>(packet) {
        assert_eq!(decode::<ToBroker>(&encode(&message)).as_ref(), Some(&message));
        match &message.request {
            Request::Advertise(advertise) => describe(&advertise.metadata.layout),
            Request::Subscribe(subscribe) => {
                let _ = is_topic_name(subscribe.subject.name());
                if let Subject::Described(metadata) = &subscribe.subject {
                    describe(&metadata.layout);
                }
            }
            _ => {}
        }
    }
    if let Some(message) = decode::<FromBroker>(packet) {
        assert_eq!(decode::<FromBroker>(&encode(&message)).as_ref(), Some(&message));
        if let FromBroker::Reply { reply: Reply::Refused(refusal), .. } = &message {
            // A process prints what the broker says, which it trusts.
            let bounded = match refusal {
                Refusal::LayoutMismatch(two) => two.ours.check().and(two.theirs.check()).is_ok(),
                _ => true,
            };
            if bounded {
                let _ = refusal.to_string();
            }
        }
    }
}

/// What the broker does with a layout that it takes.
fn describe(layout: &Layout) {
    if layout.check().is_ok() {
        let _ = (layout.o_fields(), layout.nested(), layout.size_no_padding_bytes());
        for field in layout.flatten() {
            let bytes = field.ty.size_bytes() * field.array_length.unwrap_or(1);
            assert!(field.offset_bytes + bytes <= layout.size_bytes, "{field:?} is outside");
        }
        assert!(layout.matches(layout));
    }
}
