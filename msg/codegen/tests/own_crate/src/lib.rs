//! A crate with messages of its own, in `msg/`: what a user writes.
//!
//! `uorb_codegen::compile("msg")` in the build script and the `include!` below
//! are all that is needed; the tests prove that the result is whole.
#![deny(missing_docs)]

include!(concat!(env!("OUT_DIR"), "/uorb_msg.rs"));

#[cfg(test)]
mod tests {
    use uorb_core::{FieldType, Message, Topic, message_hash};

    use super::*;

    #[test]
    fn the_messages_of_the_folder_are_topics() {
        let names: Vec<&str> = TOPICS.iter().map(|topic| &*topic.name).collect();
        assert_eq!(
            names,
            ["dock_arm", "dock_image", "dock_status", "dock_status_simulated", "dock_status_spare"]
        );
        assert_eq!(OrbId::from_name("dock_status"), Some(OrbId::DockStatus));
        assert_eq!(DockStatusSpare::METADATA.queue_length.get(), 4);
        assert_eq!(DockArm::METADATA.queue_length.get(), 1);
    }

    #[test]
    fn a_message_of_a_search_folder_is_a_struct_and_no_topic() {
        assert_eq!(size_of::<EscReport>(), 48);
        assert_eq!(OrbId::from_name("esc_report"), None);
    }

    #[test]
    fn a_message_may_be_too_large_for_a_node() {
        assert_eq!(size_of::<DockImage>(), 6_220_808);
        assert!(DockImage::LAYOUT.is_large() && !DockStatus::LAYOUT.is_large());
    }

    #[test]
    fn the_layout_is_the_struct() {
        for topic in TOPICS {
            topic.layout.check().unwrap();
            // A nested type is hashed as the text has it, `DockArm`, which a
            // layout does not say.
            if topic.layout.nested().is_empty() {
                assert_eq!(message_hash(&topic.layout.fields), topic.layout.message_hash);
            }
        }
        assert_eq!(
            DockStatus::LAYOUT.o_fields(),
            "uint64_t timestamp;double charged;float[2] arm_angle;int16_t offset;bool \
             locked;uint8_t type;char[9] sign;uint8_t state;uint8_t lamps;uint8_t[1] \
             _padding0;dock_arm[2] arms;esc_report winch;"
        );
        assert_eq!(DockStatus::LAYOUT.size_bytes as usize, size_of::<DockStatus>());
        assert_eq!(DockArm::LAYOUT.fields[0].name, "timestamp");
        let winch = DockStatus::LAYOUT.fields.last().unwrap();
        assert!(matches!(&winch.ty, FieldType::Message(layout) if layout.name == "esc_report"));
    }

    #[test]
    fn fields_and_constants_have_the_types_of_rust() {
        let dock = DockStatus {
            locked: DockStatus::HAS_LAMPS.into(),
            r#type: DockStatus::LAMPS_ALL,
            sign: *b"north\0\0\0\0",
            offset: DockStatus::OFFSET_MIN,
            ..DockStatus::default()
        };
        assert!(dock.locked.get());
        assert_eq!((dock.r#type, dock.offset), (7, -16));
        assert_eq!(DockStatus::LAYOUT.fields[2].name, "type");
        assert_eq!((DockStatus::VOLTAGE_MAX, DockStatus::SIGN), (25.2_f32, b'D'));
    }
}
