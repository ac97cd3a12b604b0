//! PX4's topic `log_message`: what modules say in words. Its messages stand in a
//! log as lines of text, as those of PX4's logger do.

use uorb_core::{FieldType, Layout};

use crate::writer::Level;

/// Where in a message of words what is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Words {
    timestamp_at: Option<usize>,
    severity_at: usize,
    text_at: usize,
    text_bytes: usize,
}

impl Words {
    /// None: the topic is another one, or its fields are not those of PX4.
    pub(super) fn of(topic: &str, layout: &Layout) -> Option<Self> {
        let find = |name: &str, ty: FieldType, is_array: bool| {
            layout.fields.iter().find(|field| {
                field.name == name && field.ty == ty && field.array_length.is_some() == is_array
            })
        };
        let at = |field: &uorb_core::Field| field.offset_bytes as usize;
        let text = find("text", FieldType::Char, true).filter(|_| topic == "log_message")?;
        Some(Self {
            timestamp_at: find("timestamp", FieldType::Uint64, false).map(at),
            severity_at: at(find("severity", FieldType::Uint8, false)?),
            text_at: at(text),
            text_bytes: text.array_length? as usize,
        })
    }

    /// What a message says, how grave it is, and when it was said, if it tells.
    pub(super) fn read(self, message: &[u8]) -> Option<(Level, Option<u64>, String)> {
        let timestamp = self.timestamp_at.and_then(|at| message.get(at..)?.first_chunk());
        let severity = *message.get(self.severity_at)?;
        let text = message.get(self.text_at..)?.get(..self.text_bytes)?;
        let end = text.iter().position(|byte| *byte == 0).unwrap_or(text.len());
        let text = String::from_utf8_lossy(&text[..end]).into_owned();
        Some((Level::of(severity), timestamp.copied().map(u64::from_le_bytes), text))
    }
}
