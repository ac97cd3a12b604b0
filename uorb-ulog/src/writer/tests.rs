use std::borrow::Cow;
use std::io::Cursor;

use proptest::prelude::*;
use uorb_core::{Field, FieldType};

use super::*;
use crate::{Ending, Fault, Told, read};

fn layout(name: &'static str, fields: &[(&'static str, FieldType)], end: u32) -> Layout {
    let mut size_bytes = 0;
    let mut described = Vec::new();
    for (name, ty) in fields {
        let (ty, offset_bytes) = (ty.clone(), size_bytes);
        let (name, unit) = (Cow::Borrowed(*name), "".into());
        let field = Field { name, ty, array_length: None, offset_bytes, unit };
        size_bytes = field.end_bytes() as u32;
        described.push(field);
    }
    Layout {
        name: name.into(),
        size_bytes: size_bytes + end,
        message_hash: 0,
        fields: described.into(),
    }
}

/// A timestamp, a byte and 7 bytes of padding.
fn stamped(name: &'static str) -> Layout {
    layout(name, &[("timestamp", FieldType::Uint64), ("x", FieldType::Uint8)], 7)
}

fn begin(topics: &[(&str, &Layout)]) -> Writer<Vec<u8>> {
    let topics = topics.iter().map(|&(topic, layout)| (topic.to_string(), layout.clone()));
    let head = Head { timestamp_us: 7, topics: topics.collect(), ..Head::default() };
    Writer::begin(Vec::new(), &head).unwrap()
}

impl<W: Write> Writer<W> {
    fn id(&mut self, topic: &str, instance: u8, layout: &Layout) -> SeriesId {
        match self.announce(topic, instance, layout).unwrap() {
            Ok(Announced::As(id)) => id,
            other => panic!("{topic}{instance}: {other:?}"),
        }
    }
}

fn record(kind: u8, payload: &[u8]) -> Vec<u8> {
    [&(payload.len() as u16).to_le_bytes()[..], &[kind], payload].concat()
}

/// The kinds of all records.
fn kinds(bytes: &[u8]) -> String {
    let mut kinds = String::new();
    let mut rest = &bytes[16..];
    while let [low, high, kind, more @ ..] = rest {
        kinds.push(char::from(*kind));
        rest = &more[usize::from(u16::from_le_bytes([*low, *high]))..];
    }
    kinds
}

#[test]
fn every_byte_of_a_small_log_is_as_the_format_says() {
    let a = stamped("a");
    let head = Head {
        timestamp_us: 0x0102,
        infos: vec![
            ("sys_name".into(), Value::Text("uORB".into())),
            ("time_ref_utc".into(), Value::Int32(-60)),
        ],
        topics: vec![("a".into(), a.clone())],
        parameters: vec![Parameter {
            name: "P".into(),
            value: ParameterValue::Float(1.5),
            default: Some(ParameterValue::Float(2.0)),
        }],
        texts: vec![("t".into(), vec!["one".into(), "two".into()])],
    };
    let mut writer = Writer::begin(Vec::new(), &head).unwrap();
    let id = writer.id("a", 3, &a);
    writer.message(id, 0, &[[9; 9].to_vec(), vec![0; 7]].concat()).unwrap();
    writer.text(Level::Warning, 5, "hm").unwrap();
    writer.dropout(Duration::from_millis(65_535 + 3)).unwrap();
    writer.dropout(Duration::ZERO).unwrap();
    writer.parameter("P", ParameterValue::Int32(-1)).unwrap();
    writer.sync().unwrap();

    let mut flags = [0; 40];
    flags[0] = 1;
    let expected = [
        b"ULog\x01\x12\x35\x01\x02\x01\0\0\0\0\0\0".to_vec(),
        record(b'B', &flags),
        record(b'I', b"\x10char[4] sys_nameuORB"),
        record(b'I', b"\x14int32_t time_ref_utc\xc4\xff\xff\xff"),
        record(b'F', b"a:uint64_t timestamp;uint8_t x;uint8_t[7] _padding0;"),
        record(b'P', b"\x07float P\0\0\xc0\x3f"),
        record(b'Q', b"\x03\x07float P\0\0\0\x40"),
        record(b'M', b"\0\x09char[3] tone"),
        record(b'M', b"\x01\x09char[3] ttwo"),
        record(b'A', b"\x03\0\0a"),
        record(b'D', &[&[0, 0], &[9; 9][..]].concat()),
        record(b'L', b"4\x05\0\0\0\0\0\0\0hm"),
        record(b'O', &[0xff, 0xff]),
        record(b'O', &[3, 0]),
        record(b'O', &[1, 0]),
        record(b'P', b"\x09int32_t P\xff\xff\xff\xff"),
        record(b'S', &[0x2f, 0x73, 0x13, 0x20, 0x25, 0x0c, 0xbb, 0x12]),
    ]
    .concat();
    assert_eq!(writer.written_bytes(), expected.len() as u64);
    assert_eq!(*writer.get_mut(), expected);
}

#[test]
fn all_formats_stand_before_the_first_topic_nested_ones_too() {
    let inner = stamped("inner");
    let nested = FieldType::Message(Cow::Owned(inner));
    let outer = layout("outer", &[("timestamp", FieldType::Uint64), ("i", nested)], 0);
    let mut writer = begin(&[("outer", &outer), ("a", &stamped("a"))]);
    writer.id("outer", 0, &outer);
    writer.id("a", 0, &stamped("a"));
    assert_eq!(writer.id("outer", 0, &outer), SeriesId(0));
    assert_eq!(kinds(writer.get_mut()), "BFFFAA");
}

#[test]
fn a_topic_that_the_head_does_not_know_needs_a_new_file() {
    let mut writer = begin(&[("a", &stamped("a"))]);
    let other = layout("a", &[("timestamp", FieldType::Uint64), ("y", FieldType::Uint8)], 7);
    for (topic, layout) in [("b", &stamped("b")), ("a", &other)] {
        assert_eq!(writer.announce(topic, 0, layout).unwrap(), Ok(Announced::NeedsNewFile));
    }
    assert_eq!(kinds(writer.get_mut()), "BF");
}

#[test]
fn a_topic_without_a_timestamp_gets_that_of_its_publication() {
    let plain = layout("plain", &[("value", FieldType::Uint32)], 0);
    let untyped = Layout::untyped("untyped", 2);
    let mut writer = begin(&[("plain", &plain), ("untyped", &untyped)]);
    let (first, second) = (writer.id("plain", 0, &plain), writer.id("untyped", 0, &untyped));
    writer.message(first, 1_000, &[1, 2, 3, 4]).unwrap();
    writer.message(second, 2_000, &[5, 6]).unwrap();
    let (_, messages) = told(writer.get_mut()).unwrap();
    let stamp = |us: u64, rest: &[u8]| [&us.to_le_bytes()[..], rest].concat();
    let expected = [
        ("plain".to_string(), 0, Some(1_000), stamp(1_000, &[1, 2, 3, 4])),
        ("untyped".to_string(), 0, Some(2_000), stamp(2_000, &[5, 6])),
    ];
    assert_eq!(messages, expected);
}

#[test]
fn a_nested_message_does_not_take_the_name_of_a_topic_that_is_another() {
    // A topic has the nested one's name, the same fields, or others.
    let inner = layout("inner", &[("value", FieldType::Uint64)], 0);
    let nested = FieldType::Message(Cow::Owned(inner.clone()));
    let outer = layout("outer", &[("timestamp", FieldType::Uint64), ("i", nested)], 0);
    let mut writer = begin(&[("outer", &outer), ("inner", &inner)]);
    writer.id("inner", 0, &inner);
    writer.id("outer", 0, &outer);
    let text = String::from_utf8_lossy(writer.get_mut()).to_string();
    for expected in [
        "inner:uint64_t timestamp;uint64_t value;",
        "inner_1:uint64_t value;",
        "outer:uint64_t timestamp;inner_1 i;",
    ] {
        assert!(text.contains(expected), "{expected}: {text}");
    }

    let same = stamped("same");
    let nested = FieldType::Message(Cow::Owned(same.clone()));
    let outer = layout("outer", &[("timestamp", FieldType::Uint64), ("i", nested)], 0);
    let mut writer = begin(&[("outer", &outer), ("same", &same)]);
    assert_eq!(kinds(writer.get_mut()), "BFF");
}

#[test]
fn what_no_log_can_hold_is_named() {
    let large = Layout::untyped("large", 65_524);
    let strange =
        layout("strange", &[("timestamp", FieldType::Uint64), ("a;b", FieldType::Bool)], 0);
    let float = layout("float_time", &[("timestamp", FieldType::Float32)], 0);
    let mut writer = begin(&[]);
    for (layout, expected) in [
        (large, Unloggable::TooLarge(65_524)),
        (strange, Unloggable::Name("a;b".into())),
        (float, Unloggable::Timestamp),
    ] {
        assert_eq!(writer.announce("t", 0, &layout).unwrap(), Err(expected));
    }
    let most = Layout::untyped("most", 65_523);
    let mut writer = begin(&[("most", &most)]);
    let id = writer.id("most", 0, &most);
    writer.message(id, 1, &vec![1; 65_523]).unwrap();
    assert_eq!(told(writer.get_mut()).unwrap().1.len(), 1);
}

/// Topic, instance, timestamp and bytes.
type Read = (String, u8, Option<u64>, Vec<u8>);

fn told(bytes: &[u8]) -> Result<(Ending, Vec<Read>), Fault> {
    let (mut series, mut messages) = (Vec::new(), Vec::new());
    let ending = read::<Fault>(&mut Cursor::new(bytes), u64::MAX, |told| {
        match told {
            Told::Began { timestamp_us } => assert_eq!(timestamp_us, 7),
            Told::Series(one) => series.push((one.topic, one.instance)),
            Told::Message(message) => {
                let (topic, instance) = series[message.series].clone();
                messages.push((topic, instance, message.timestamp_us, message.bytes.to_vec()));
            }
        }
        Ok(())
    })?;
    Ok((ending, messages))
}

/// One thing that is written behind the head.
#[derive(Clone, Debug)]
enum Step {
    Message { topic: usize, instance: u8, bytes: Vec<u8> },
    Text(String),
    Dropout(u64),
    Sync,
}

fn step() -> impl Strategy<Value = Step> {
    let message = (0..2_usize, 0..10_u8, prop::collection::vec(any::<u8>(), 16))
        .prop_map(|(topic, instance, bytes)| Step::Message { topic, instance, bytes });
    prop_oneof![
        6 => message,
        1 => ".{0,40}".prop_map(Step::Text),
        1 => (0..200_000_u64).prop_map(Step::Dropout),
        1 => Just(Step::Sync),
    ]
}

proptest! {
    #[test]
    fn what_is_written_is_read_back_wherever_the_file_is_cut(
        steps in prop::collection::vec(step(), 0..40),
        cut in any::<prop::sample::Index>(),
    ) {
        let topics = [("first", stamped("first")), ("second", stamped("second"))];
        let mut writer = begin(&topics.each_ref().map(|(topic, layout)| (*topic, layout)));
        let head_bytes = writer.written_bytes() as usize;
        let mut expected: Vec<(u64, Read)> = Vec::new();
        for step in steps {
            match step {
                Step::Message { topic, instance, bytes } => {
                    let (topic, layout) = &topics[topic];
                    let id = writer.id(topic, instance, layout);
                    writer.message(id, 0, &bytes).unwrap();
                    let stamp = u64::from_le_bytes(bytes[..8].try_into().unwrap());
                    let read = (topic.to_string(), instance, Some(stamp).filter(|&us| us != 0),
                        bytes[..9].to_vec());
                    expected.push((writer.written_bytes(), read));
                }
                Step::Text(text) => writer.text(Level::Info, 1, &text).unwrap(),
                Step::Dropout(ms) => writer.dropout(Duration::from_millis(ms)).unwrap(),
                Step::Sync => writer.sync().unwrap(),
            }
        }
        let bytes = writer.get_mut().clone();
        let all: Vec<Read> = expected.iter().map(|(_, read)| read.clone()).collect();
        prop_assert_eq!(told(&bytes).unwrap(), (Ending::Whole, all));

        let cut = head_bytes + cut.index(bytes.len() - head_bytes + 1);
        let whole: Vec<Read> = expected.iter()
            .filter(|(end, _)| *end <= cut as u64).map(|(_, read)| read.clone()).collect();
        prop_assert_eq!(told(&bytes[..cut]).unwrap().1, whole);
    }
}
