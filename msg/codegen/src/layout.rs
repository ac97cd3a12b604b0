//! Where the fields of a message lie, as PX4 lays them out.
//!
//! Fields are sorted by the size of their elements, the largest first and
//! nested messages last, otherwise as the text has them. Then every field is
//! aligned by itself, and padding is needed in two places only: before a
//! nested message and at the end, to multiples of 8. It is written out as
//! fields (`_padding0`), so that a logger can tell every byte.

use crate::fault::Fault;
use crate::message::{Field, Message, Messages, Type};

/// The bytes of the largest message, as `uorb_core::MESSAGE_SIZE_MAX_BYTES`:
/// above PX4's 65,535 a topic is a large one.
pub(crate) const MESSAGE_SIZE_MAX_BYTES: u64 = 256 << 20;

/// What a field's size is taken for at most, so that no sum overflows.
const FIELD_SIZE_MAX_BYTES: u64 = 1 << 40;

/// How deep messages may nest, and to how many fields they may flatten: what
/// `uorb_core::Layout::check` lets through.
const NESTING_MAX: usize = 8;
const FLAT_FIELDS_MAX: u64 = 8_192;

/// A message's members in memory order, and its sizes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Layout {
    pub(crate) members: Vec<Member>,
    pub(crate) size_bytes: u64,
    /// Without the padding at the end; padding before a nested message counts.
    pub(crate) size_no_padding_bytes: u64,
    pub(crate) message_hash: u32,
    /// How many levels of messages there are, this one included.
    depth: usize,
    /// How many scalars and arrays of scalars, those of nested ones included.
    flat_fields: u64,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Member {
    Field {
        /// The field's place in the text.
        index: usize,
        offset_bytes: u64,
    },
    Padding {
        /// Which padding of the message: the 0 of `_padding0`.
        number: u32,
        length_bytes: u64,
    },
}

/// Lays out all messages, in their order, and says which are too large.
pub(crate) fn lay_out(messages: &Messages) -> (Vec<Layout>, Vec<Fault>) {
    let layouts = vec![None; messages.list.len()];
    let mut table = Table { messages, layouts, faults: Vec::new() };
    for place in 0..messages.list.len() {
        table.lay_out(place);
    }
    (table.layouts.into_iter().flatten().collect(), table.faults)
}

/// The layouts so far; a nested message's comes before its outer one's.
struct Table<'a> {
    messages: &'a Messages,
    layouts: Vec<Option<Layout>>,
    faults: Vec<Fault>,
}

impl Table<'_> {
    fn lay_out(&mut self, place: usize) {
        if self.layouts[place].is_some() {
            return;
        }
        let message = &self.messages.list[place];
        let (mut depth, mut flat_fields) = (1, 0);
        let mut sizes = Vec::with_capacity(message.fields.len());
        for field in &message.fields {
            let count = u64::from(field.array_length.unwrap_or(1));
            let element_bytes = match field.ty {
                Type::Scalar(scalar) => {
                    flat_fields += 1;
                    u64::from(scalar.size_bytes())
                }
                Type::Message(inner) => {
                    self.lay_out(inner);
                    let inner = self.layouts[inner].as_ref();
                    depth = depth.max(1 + inner.map_or(0, |inner| inner.depth));
                    // One that is too large has its fault already, and is not
                    // multiplied until the numbers overflow.
                    let inner_fields = inner.map_or(0, |inner| inner.flat_fields);
                    flat_fields += count * inner_fields.min(FLAT_FIELDS_MAX + 1);
                    inner.map_or(0, |inner| inner.size_bytes).min(MESSAGE_SIZE_MAX_BYTES + 1)
                }
            };
            let size_bytes = element_bytes.saturating_mul(count).min(FIELD_SIZE_MAX_BYTES);
            sizes.push((field.ty, size_bytes));
        }
        let (members, size_no_padding_bytes, size_bytes) = place_members(&sizes);
        let message_hash = hash_fields(0x811c_9dc5, message, self.messages);
        let layout =
            Layout { members, size_bytes, size_no_padding_bytes, message_hash, depth, flat_fields };
        let largest = sizes.iter().enumerate().max_by_key(|(_, (_, bytes))| *bytes);
        if let Some((largest, _)) = largest {
            self.faults.extend(fault(message, &layout, &message.fields[largest]));
        }
        self.layouts[place] = Some(layout);
    }
}

/// Places fields of these types and whole sizes: the members in memory order,
/// the end of the last one, and that end padded.
fn place_members(fields: &[(Type, u64)]) -> (Vec<Member>, u64, u64) {
    let mut order: Vec<usize> = (0..fields.len()).collect();
    // A stable sort: equal ones stay as the text has them.
    order.sort_by_key(|&index| match fields[index].0 {
        Type::Scalar(scalar) => 8 - scalar.size_bytes(),
        Type::Message(_) => 8,
    });
    let mut members = Vec::new();
    let mut end = 0;
    let mut paddings = 0;
    let mut pad = |members: &mut Vec<Member>, end: u64| {
        let padded = end.next_multiple_of(8);
        if padded > end {
            members.push(Member::Padding { number: paddings, length_bytes: padded - end });
            paddings += 1;
        }
        padded
    };
    for index in order {
        let (ty, size_bytes) = fields[index];
        if matches!(ty, Type::Message(_)) {
            end = pad(&mut members, end);
        }
        members.push(Member::Field { index, offset_bytes: end });
        end += size_bytes;
    }
    let padded = pad(&mut members, end);
    (members, end, padded)
}

/// What no node would take: a message too large, too deep, or too manifold.
fn fault(message: &Message, layout: &Layout, largest: &Field) -> Option<Fault> {
    let (name, field) = (&message.name, &largest.name);
    let text = if layout.size_bytes > MESSAGE_SIZE_MAX_BYTES {
        let bytes = layout.size_bytes;
        format!(
            "message `{name}` has {bytes} bytes, most of them in `{field}`; a topic takes at most \
             {MESSAGE_SIZE_MAX_BYTES}"
        )
    } else if layout.depth > NESTING_MAX {
        format!("messages nest more than {NESTING_MAX} levels deep in `{name}`")
    } else if layout.flat_fields > FLAT_FIELDS_MAX {
        let count = layout.flat_fields;
        format!(
            "message `{name}` has {count} fields, nested ones counted, most of them in `{field}`; \
             a topic takes at most {FLAT_FIELDS_MAX}"
        )
    } else {
        return None;
    };
    Some(Fault { path: message.path.clone(), line: Some(largest.line), text })
}

/// PX4's message hash: FNV-1a over one line a field, `float32[3] xyz`, in the
/// order of the text, a nested message's line followed by its own. Types stand
/// as they are written there, so `EscReport` and `esc_report` hash differently.
fn hash_fields(mut hash: u32, message: &Message, messages: &Messages) -> u32 {
    for field in &message.fields {
        let name = &field.written_type;
        let line = match field.array_length {
            Some(length) => format!("{name}[{length}] {}\n", field.name),
            None => format!("{name} {}\n", field.name),
        };
        for byte in line.bytes() {
            hash = (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
        }
        if let Some(nested) = messages.nested(field) {
            hash = hash_fields(hash, nested, messages);
        }
    }
    hash
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::fault::Notes;
    use crate::folder::{self, File};
    use crate::parse;
    use crate::scalar::Scalar;

    /// The messages of these texts, which have no faults, and their layouts.
    fn laid_out(texts: &[(&str, &str)]) -> (Messages, Vec<Layout>) {
        let files = texts.iter().map(|(stem, text)| {
            let mut notes = Notes::new(stem);
            let ast = parse::parse(text, &mut notes);
            File { stem: stem.to_string(), ast, notes, searched: false }
        });
        let messages = folder::resolve(files.collect());
        let (layouts, faults) = lay_out(&messages);
        assert_eq!((&*messages.faults, &*faults), (&[][..], &[][..]));
        (messages, layouts)
    }

    /// `timestamp@0 x@8 pad4@12`: the members of the first message in memory
    /// order, and where they start.
    fn members(texts: &[(&str, &str)]) -> String {
        let (messages, layouts) = laid_out(texts);
        let mut end = layouts[0].size_bytes;
        let mut shown: Vec<String> = Vec::new();
        for member in layouts[0].members.iter().rev() {
            end = match *member {
                Member::Field { index, offset_bytes } => {
                    let name = &messages.list[0].fields[index].name;
                    shown.insert(0, format!("{name}@{offset_bytes}"));
                    offset_bytes
                }
                Member::Padding { length_bytes, .. } => {
                    let start = end - length_bytes;
                    shown.insert(0, format!("pad{length_bytes}@{start}"));
                    start
                }
            };
        }
        shown.join(" ")
    }

    #[test]
    fn fields_are_sorted_by_the_size_of_their_elements() {
        assert_eq!(members(&[("orb_test", "int32 val")]), "timestamp@0 val@8 pad4@12");
        assert_eq!(
            members(&[(
                "m",
                "bool a\nuint8[3] b\nint16 c\nfloat32 d\nfloat64 e\nuint64 timestamp"
            )]),
            "e@0 timestamp@8 d@16 c@20 a@22 b@23 pad6@26"
        );
    }

    #[test]
    fn nested_messages_come_last_and_at_multiples_of_8() {
        let inner = ("z_inner", "uint8 x");
        assert_eq!(
            members(&[("m", "z_inner first\nuint8 a\nz_inner[2] last"), inner]),
            "timestamp@0 a@8 pad7@9 first@16 last@32"
        );
    }

    #[test]
    fn hashes_and_sizes_are_those_of_px4() {
        let medium = "uint64 timestamp\nint32 val\nuint8[64] junk\nuint8 ORB_QUEUE_LENGTH = 16";
        let acceleration = "uint64 timestamp\nuint64 timestamp_sample\nfloat32[3] xyz";
        for (text, message_hash, size_bytes, size_no_padding_bytes) in [
            ("uint64 timestamp\nint32 val", 0x766b_aa60, 16, 12),
            // An inserted timestamp counts as the first field.
            ("int32 val", 0x766b_aa60, 16, 12),
            (medium, 0x1cbb_8bca, 80, 76),
            (acceleration, 0x6708_8e65, 32, 28),
        ] {
            let layout = &laid_out(&[("m", text)]).1[0];
            assert_eq!(layout.message_hash, message_hash, "{text}");
            assert_eq!(layout.size_bytes, size_bytes, "{text}");
            assert_eq!(layout.size_no_padding_bytes, size_no_padding_bytes, "{text}");
        }
    }

    #[test]
    fn a_nested_type_is_hashed_as_it_is_written() {
        let report = ("EscReport", "uint64 timestamp\nint32 rpm");
        let hash = |text| {
            let (messages, layouts) = laid_out(&[("m", text), report]);
            layouts[messages.list.iter().position(|one| one.name == "m").unwrap()].message_hash
        };
        assert_eq!(hash("EscReport[2] esc"), 0x3ef4_dcb0);
        assert_eq!(hash("px4/EscReport[2] esc"), 0x3ef4_dcb0);
        assert_ne!(hash("esc_report[2] esc"), 0x3ef4_dcb0);
    }

    /// The text of a message with any fields; `nested` can be one's type.
    fn any_text(nested: Option<&'static str>) -> impl Strategy<Value = String> {
        let names = Scalar::ALL.map(Scalar::msg_name).into_iter().chain(nested);
        let types = prop::sample::select(names.collect::<Vec<_>>());
        let fields = prop::collection::vec((types, prop::option::of(1..40_u32)), 0..12);
        fields.prop_map(|fields| {
            let lines = fields.into_iter().enumerate().map(|(index, (ty, length))| match length {
                Some(length) => format!("{ty}[{length}] f{index}\n"),
                None => format!("{ty} f{index}\n"),
            });
            lines.collect()
        })
    }

    proptest! {
        #[test]
        fn members_follow_each_other_without_gap_or_overlap(
            inner in any_text(None),
            outer in any_text(Some("m_inner")),
        ) {
            let (messages, layouts) = laid_out(&[("m_inner", &inner), ("m_outer", &outer)]);
            for (message, layout) in messages.list.iter().zip(&layouts) {
                let mut end = 0;
                let mut seen = vec![0; message.fields.len()];
                for member in &layout.members {
                    match *member {
                        Member::Padding { length_bytes, .. } => {
                            prop_assert!((1..8).contains(&length_bytes));
                            end += length_bytes;
                        }
                        Member::Field { index, offset_bytes } => {
                            seen[index] += 1;
                            prop_assert_eq!(offset_bytes, end);
                            let field = &message.fields[index];
                            let (element_bytes, aligned_to) = match field.ty {
                                Type::Scalar(scalar) => {
                                    let bytes = u64::from(scalar.size_bytes());
                                    (bytes, bytes)
                                }
                                Type::Message(inner) => (layouts[inner].size_bytes, 8),
                            };
                            prop_assert!(offset_bytes.is_multiple_of(aligned_to));
                            end += element_bytes * u64::from(field.array_length.unwrap_or(1));
                            prop_assert!(end <= layout.size_no_padding_bytes);
                        }
                    }
                }
                prop_assert_eq!(end, layout.size_bytes);
                prop_assert!(layout.size_bytes.is_multiple_of(8));
                prop_assert!(seen.iter().all(|&times| times == 1));
            }
        }
    }
}
