//! `field=value`, as `uorb pub` takes it: refused with words, or written inside
//! the field and nowhere else; and what was written can be printed.

use uorb_core::{Layout, Topic};
use uorb_msg::{EscStatus, Mission, OrbTestMedium, SensorCombined, VehicleCommand};

use crate::fields::assign::Assignment;
use crate::fields::{fields, path};

/// The first byte chooses the message, the rest is what the user writes.
pub(crate) fn assign(bytes: &[u8]) {
    let Some((choice, text)) = bytes.split_first() else { return };
    let Ok(text) = std::str::from_utf8(text) else { return };
    let layouts: [&Layout; 5] = [
        &OrbTestMedium::METADATA.layout,
        &EscStatus::METADATA.layout,
        &VehicleCommand::METADATA.layout,
        &SensorCombined::METADATA.layout,
        &Mission::METADATA.layout,
    ];
    let layout = layouts[usize::from(*choice) % layouts.len()];
    let assignment = match Assignment::parse(layout, text) {
        Ok(assignment) => assignment,
        Err(error) => return assert!(!format!("{error:#}").is_empty()),
    };
    let place = path::find(layout, &assignment.path).expect("it was found before");
    let inside = place.offset_bytes..place.offset_bytes + place.size_bytes();
    for background in [0, 0xff] {
        let mut message = vec![background; layout.size_bytes as usize];
        assignment.write(&mut message);
        let mut rest = message.iter().enumerate().filter(|(at, _)| !inside.contains(at));
        assert!(rest.all(|(_, byte)| *byte == background), "{text} writes outside of its field");
        assert!(place.part(&message).and_then(|part| part.content()).is_some());
        assert_eq!(fields(layout, &message).count(), layout.fields.len());
    }
}
