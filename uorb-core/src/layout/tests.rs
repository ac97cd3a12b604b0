use super::*;
use crate::message_hash::message_hash;

fn field(name: &str, ty: FieldType, array_length: Option<u32>, offset_bytes: u32) -> Field {
    Field { name: name.to_string().into(), ty, array_length, offset_bytes, unit: Cow::Borrowed("") }
}

fn layout(name: &str, size_bytes: u32, fields: Vec<Field>) -> Layout {
    let message_hash = message_hash(&fields);
    Layout { name: name.to_string().into(), size_bytes, message_hash, fields: fields.into() }
}

fn vehicle_acceleration() -> Layout {
    layout(
        "vehicle_acceleration",
        32,
        vec![
            field("timestamp", FieldType::Uint64, None, 0),
            field("timestamp_sample", FieldType::Uint64, None, 8),
            field("xyz", FieldType::Float32, Some(3), 16),
        ],
    )
}

#[test]
fn o_fields_is_the_text_of_px4() {
    let layout = vehicle_acceleration();
    assert_eq!(
        layout.o_fields(),
        "uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;uint8_t[4] _padding0;"
    );
    assert_eq!(layout.size_no_padding_bytes(), 28);
}

#[test]
fn the_message_hash_is_the_one_of_px4() {
    assert_eq!(vehicle_acceleration().message_hash, 0x6708_8e65);
}

#[test]
fn nested_messages_flatten_to_paths() {
    let inner = layout("esc_report", 8, vec![field("rpm", FieldType::Int32, None, 0)]);
    let outer = layout(
        "esc_status",
        24,
        vec![
            field("esc", FieldType::Message(Cow::Owned(inner)), Some(2), 8),
            field("timestamp", FieldType::Uint64, None, 0),
        ],
    );
    outer.check().unwrap();
    let flat: Vec<_> =
        outer.flatten().into_iter().map(|flat| (flat.path, flat.offset_bytes)).collect();
    assert_eq!(
        flat,
        [
            ("timestamp".to_string(), 0),
            ("esc[0].rpm".to_string(), 8),
            ("esc[1].rpm".to_string(), 16)
        ]
    );
}

#[test]
fn a_mismatch_shows_what_differs_inside_a_nested_message() {
    let with = |name| {
        let inner = layout("inner", 4, vec![field(name, FieldType::Int32, None, 0)]);
        let nested = FieldType::Message(Cow::Owned(inner));
        layout("outer", 8, vec![field("inner", nested, Some(2), 0)])
    };
    let (ours, theirs) = (with("rpm"), with("rps"));
    assert!(!ours.matches(&theirs));
    let (topic, users) = ("outer".to_string(), vec!["logger (pid 7)".to_string()]);
    let text = crate::protocol::Mismatch { topic, ours, theirs, users }.to_string();
    assert!(text.contains("inner: int32_t rpm;") && text.contains("inner: int32_t rps;"));
}

#[test]
fn layouts_match_by_their_fields_and_not_by_the_order_of_the_text() {
    let ours = vehicle_acceleration();
    let mut theirs = ours.clone();
    theirs.message_hash = 0;
    theirs.fields.to_mut().reverse();
    assert!(ours.matches(&theirs));
    theirs.fields.to_mut()[0].name = "abc".into();
    assert!(!ours.matches(&theirs));
    assert!(ours.matches(&Layout::untyped("vehicle_acceleration", 32)));
    assert!(!ours.matches(&Layout::untyped("vehicle_acceleration", 28)));
}

#[test]
fn a_layout_that_lies_is_refused() {
    let mut outside = vehicle_acceleration();
    outside.fields.to_mut()[2].array_length = Some(5);
    assert!(matches!(outside.check(), Err(LayoutFault::Field { field, .. }) if field == "xyz"));

    let mut twice = vehicle_acceleration();
    twice.fields.to_mut()[1].name = "xyz".into();
    assert!(twice.check().is_err());

    let mut overlap = vehicle_acceleration();
    overlap.fields.to_mut()[1].offset_bytes = 4;
    assert!(overlap.check().is_err());

    let huge = Layout { size_bytes: MESSAGE_SIZE_MAX_BYTES + 1, ..vehicle_acceleration() };
    assert!(matches!(huge.check(), Err(LayoutFault::Size { size_bytes: 0x1000_0001, .. })));

    let mut deep = vehicle_acceleration();
    for _ in 0..NESTING_MAX {
        let nested = FieldType::Message(Cow::Owned(deep));
        deep = layout("deeper", 32, vec![field("inner", nested, None, 0)]);
    }
    assert!(deep.check().is_err());
}
