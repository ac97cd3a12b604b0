//! A flight log: whatever the file holds, it is read up to a fault that says
//! what is wrong, and each message belongs to a series that was told before.

use std::io::Cursor;

use uorb_ulog::{Fault, Said, Told};

/// The bytes are the file.
pub(crate) fn read_all(bytes: &[u8]) {
    let mut sizes = Vec::new();
    let ended = uorb_ulog::read_all::<Fault>(&mut Cursor::new(bytes), u64::MAX, |said| {
        match said {
            Said::Told(Told::Began { .. }) => {}
            Said::Noted(note) => _ = note.read(),
            Said::Told(Told::Series(series)) => sizes.push(series.layout.size_bytes as usize),
            Said::Told(Told::Message(message)) => {
                let size_bytes = sizes.get(message.series).expect("its series was told before");
                assert!(message.bytes.len() <= *size_bytes, "more bytes than the layout has");
            }
        }
        Ok(())
    });
    if let Err(fault) = ended {
        assert!(!fault.to_string().is_empty());
    }
}
