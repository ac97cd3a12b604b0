//! Three readers of flight logs, none of them ours: px4-ulog, yule_log, and
//! pyulog where PyPI is in reach. And the rules of the format, byte by byte.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs::{self, File};
use std::io::BufReader;
use std::path::{Path, PathBuf};

use px4_ulog::stream_parser::model::{Completeness, LogStage, ParameterMessage};
use px4_ulog::stream_parser::{Message, SimpleCallbackResult, read_file_with_simple_callback};
use serde_json::Value;
use uorb_tests::Python;
use yule_log::builder::ULogParserBuilder;
use yule_log::encode::Encode;
use yule_log::model::msg::UlogMessage;

/// The payloads of each topic instance, in order.
pub(crate) type Payloads = BTreeMap<(String, u8), Vec<Vec<u8>>>;

/// What a reader finds in a log.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Found {
    pub(crate) payloads: Payloads,
    pub(crate) dropouts_ms: Vec<u16>,
    /// Level and words.
    pub(crate) texts: Vec<(char, String)>,
    /// Names of parameters, at the start.
    pub(crate) parameters: BTreeSet<String>,
    /// Whether it ends with a whole record.
    pub(crate) is_whole: bool,
}

impl Found {
    pub(crate) fn count(&self) -> usize {
        self.payloads.values().map(Vec::len).sum()
    }

    /// The messages of instance 0 of a topic.
    pub(crate) fn of(&self, topic: &str) -> &[Vec<u8>] {
        self.payloads.get(&(topic.to_string(), 0)).map_or(&[], |messages| messages)
    }
}

pub(crate) fn by_px4_ulog(path: &Path) -> Found {
    let mut found = Found::default();
    let mut tell = |message: &Message<'_>| {
        match message {
            Message::Data(data) => {
                let series = (data.flattened_format.message_name().into(), data.multi_id.value());
                found.payloads.entry(series).or_default().push(data.data[2..].into());
            }
            Message::DropoutMessage(dropout) => found.dropouts_ms.push(dropout.duration_ms),
            Message::LoggedMessage(text) => {
                let words = (text.log_level.into(), text.logged_message.to_string());
                found.texts.push(words);
            }
            Message::ParameterMessage(
                ParameterMessage::Float(name, _, LogStage::Definitions)
                | ParameterMessage::Int32(name, _, LogStage::Definitions),
            ) => _ = found.parameters.insert(name.to_string()),
            _ => {}
        }
        SimpleCallbackResult::KeepReading
    };
    let path = path.to_str().expect("UTF-8");
    let ended = read_file_with_simple_callback(path, &mut tell);
    found.is_whole = match ended.unwrap_or_else(|why| panic!("{path}: {why}")) {
        Completeness::Complete => true,
        Completeness::Truncated => false,
        other => panic!("{path}: {other:?}"),
    };
    found
}

pub(crate) fn by_yule_log(path: &Path) -> Found {
    let reader = BufReader::new(File::open(path).expect("it is there"));
    let parser = ULogParserBuilder::new(reader).include_timestamp(true).include_padding(true);
    let mut found = Found { is_whole: true, ..Found::default() };
    let mut announced = HashMap::new();
    for message in parser.build().expect("it is a log") {
        match message {
            Ok(UlogMessage::AddSubscription(it)) => {
                announced.insert(it.msg_id, (it.message_name, it.multi_id));
            }
            Ok(UlogMessage::LoggedData(data)) => {
                let mut payload = Vec::new();
                data.data.encode(&mut payload).expect("memory takes it");
                let series = announced[&data.msg_id].clone();
                found.payloads.entry(series).or_default().push(payload);
            }
            Ok(UlogMessage::DropoutMark(dropout)) => {
                let mut bytes = Vec::new();
                dropout.encode(&mut bytes).expect("memory takes it");
                found.dropouts_ms.push(u16::from_le_bytes([bytes[0], bytes[1]]));
            }
            Ok(UlogMessage::LoggedString(it)) => {
                found.texts.push((char::from(it.level as u8), it.msg));
            }
            Ok(UlogMessage::Parameter(it)) => _ = found.parameters.insert(it.key),
            Ok(_) => {}
            Err(_) => {
                found.is_whole = false;
                break;
            }
        }
    }
    found
}

/// What pyulog finds in each of some logs. None: it cannot be had, and that is
/// said.
pub(crate) fn by_pyulog(logs: &[PathBuf]) -> Option<Vec<Value>> {
    let lines = Python::with_log_readers()?.read_logs(logs);
    Some(lines.iter().map(|line| serde_json::from_str(line).expect("it says JSON")).collect())
}

/// How many messages pyulog found.
pub(crate) fn count_by_pyulog(found: &Value) -> usize {
    let series = found["series"].as_object().expect("series");
    series.values().map(|one| one[0].as_u64().expect("a number") as usize).sum()
}

/// Reads a log that was ended in order with all three, checks that they agree and
/// that it keeps the rules, and returns what is in it.
#[track_caller]
pub(crate) fn read_by_all(path: &Path) -> Found {
    let found = by_px4_ulog(path);
    assert!(found.is_whole, "{}", path.display());
    // Not `assert_eq`: nobody wants to read a megabyte of payload.
    assert!(found == by_yule_log(path), "{}", path.display());
    if let Some(theirs) = by_pyulog(&[path.into()]) {
        let theirs = &theirs[0];
        assert_eq!((&theirs["is_corrupt"], &theirs["words"]), (&false.into(), &"".into()));
        let series = theirs["series"].as_object().expect("series");
        assert_eq!(series.len(), found.payloads.len());
        for ((topic, instance), payloads) in &found.payloads {
            assert_eq!(series[&format!("{topic}/{instance}")][0], payloads.len(), "{topic}");
        }
        let numbers = |them: &Value| -> Vec<u64> {
            them.as_array().expect("dropouts").iter().filter_map(Value::as_u64).collect()
        };
        let dropouts: Vec<u64> = found.dropouts_ms.iter().map(|ms| (*ms).into()).collect();
        assert_eq!(numbers(&theirs["dropouts_ms"]), dropouts);
        let texts = theirs["texts"].as_array().expect("texts");
        let texts = texts.iter().map(|it| (it[0].as_str(), it[2].as_str()));
        let ours: Vec<_> =
            found.texts.iter().map(|(level, words)| (level.to_string(), words)).collect();
        assert!(texts.eq(ours.iter().map(|(level, words)| (Some(&**level), Some(&***words)))));
        let parameters = theirs["parameters"].as_object().expect("parameters");
        assert!(parameters.keys().eq(&found.parameters));
    }
    check_rules(path);
    found
}

/// The records of a log: type and payload, up to one that is cut off.
pub(crate) fn records(bytes: &[u8]) -> Vec<(char, &[u8])> {
    let mut records = Vec::new();
    let mut rest = bytes.get(16..).unwrap_or(&[]);
    while let Some((&[low, high, kind], after)) = rest.split_first_chunk() {
        let length = usize::from(u16::from_le_bytes([low, high]));
        let Some((payload, after)) = after.split_at_checked(length) else { break };
        records.push((char::from(kind), payload));
        rest = after;
    }
    records
}

/// What the format demands of who writes it.
#[track_caller]
fn check_rules(path: &Path) {
    let bytes = fs::read(path).expect("it is there");
    assert_eq!(&bytes[..8], b"ULog\x01\x12\x35\x01");
    let records = records(&bytes);
    assert_eq!((records[0].0, records[0].1.len()), ('B', 40));
    assert_eq!(records.iter().filter(|(kind, _)| *kind == 'B').count(), 1);
    // Definitions, in PX4's order, and all of them before the first topic.
    let first_topic = records.iter().position(|(kind, _)| *kind == 'A').unwrap_or(records.len());
    let head: String = records[..first_topic].iter().map(|(kind, _)| *kind).collect();
    let order = "BIFPQML";
    let ranks: Vec<_> = head.chars().map(|kind| order.find(kind).expect("a definition")).collect();
    assert!(ranks.is_sorted(), "{head}");
    assert!(records[first_topic..].iter().all(|(kind, _)| "ADPLSO".contains(*kind)));

    let mut formats = HashMap::new();
    for (_, text) in records.iter().filter(|(kind, _)| *kind == 'F') {
        let text = std::str::from_utf8(text).expect("UTF-8");
        let (name, fields) = text.split_once(':').expect("a name");
        assert!(fields.ends_with(';'), "{text}");
        assert!(formats.insert(name, fields).is_none(), "{name} twice");
    }
    let scalars = "int8_t uint8_t int16_t uint16_t int32_t uint32_t int64_t uint64_t float double \
                   bool char";
    for fields in formats.values() {
        for field in fields.split_terminator(';') {
            let ty = field.split([' ', '[']).next().expect("a type");
            let is_known = scalars.split(' ').any(|it| it == ty) || formats.contains_key(ty);
            assert!(is_known, "{field}");
        }
    }
    let mut topics = HashMap::new();
    for (kind, payload) in &records {
        match kind {
            'A' => {
                let name = std::str::from_utf8(&payload[3..]).expect("UTF-8");
                assert!(formats[name].contains("uint64_t timestamp;"), "{name}");
                let id = [payload[1], payload[2]];
                assert!(topics.insert(id, (name, payload[0])).is_none(), "{name}");
            }
            'D' => assert!(topics.contains_key(&payload[..2]), "a message before its topic"),
            _ => {}
        }
    }
    assert_eq!(topics.values().collect::<BTreeSet<_>>().len(), topics.len(), "announced twice");
}
