//! The list of all topics, and their numbers: `ORB_ID`.

use std::collections::BTreeSet;
use std::fmt::Write;

use super::{MARK, TopicId};

/// The three headers and the source: path and text.
pub(super) fn files(topics: &[TopicId<'_>]) -> [(String, String); 4] {
    [
        ("include/uORB/topics/uORBTopics.h".into(), header(topics)),
        ("include/uORB/topics/uORBTopics.hpp".into(), including("UORB_TOPICS_UORBTOPICS_HPP")),
        ("include/uORB/uORBTopics.h".into(), including("UORB_UORBTOPICS_H")),
        ("src/uORBTopics.c".into(), source(topics)),
    ]
}

fn mark() -> String {
    format!("{MARK}.msg files; edit those instead. */\n\n")
}

/// The header by another name of PX4's.
fn including(guard: &str) -> String {
    let mut out = mark();
    line!(out, "#ifndef {guard}");
    line!(out, "#define {guard}");
    line!(out, "");
    line!(out, "#include <uORB/topics/uORBTopics.h>");
    line!(out, "");
    line!(out, "#endif");
    out
}

fn header(topics: &[TopicId<'_>]) -> String {
    let count = topics.len();
    let mut out = mark();
    line!(out, "#ifndef UORB_TOPICS_UORBTOPICS_H");
    line!(out, "#define UORB_TOPICS_UORBTOPICS_H");
    line!(out, "");
    line!(out, "#include <uORB/uORB.h>");
    line!(out, "");
    line!(out, "/**");
    line!(out, " * A topic by number: its place among all topics of this set of messages, sorted");
    line!(out, " * by name. Another set has other numbers; what lasts is the name. It is");
    line!(out, " * ORB_ID::sensor_accel in C++ and ORB_ID_sensor_accel in C.");
    line!(out, " */");
    line!(out, "#ifdef __cplusplus");
    line!(out, "enum class ORB_ID : orb_id_size_t {{");
    for topic in topics {
        line!(out, "\t{} = {},", topic.name, topic.id);
    }
    line!(out, "\tINVALID");
    line!(out, "}};");
    line!(out, "");
    line!(out, "typedef ORB_ID uorb_topic_number_t;");
    line!(out, "");
    line!(out, "static constexpr size_t ORB_TOPICS_COUNT{{{count}}};");
    line!(out, "static constexpr size_t orb_topics_count() {{ return ORB_TOPICS_COUNT; }}");
    line!(out, "#else");
    line!(out, "enum {{");
    for topic in topics {
        line!(out, "\tORB_ID_{} = {},", topic.name, topic.id);
    }
    line!(out, "\tORB_ID_INVALID = {count}");
    line!(out, "}};");
    line!(out, "");
    line!(out, "typedef orb_id_size_t uorb_topic_number_t;");
    line!(out, "");
    line!(out, "#define ORB_TOPICS_COUNT ((size_t){count})");
    line!(out, "static inline size_t orb_topics_count(void) {{ return ORB_TOPICS_COUNT; }}");
    line!(out, "#endif");
    out.push_str(
        "
#ifdef __cplusplus
extern \"C\" {
#endif

/** All topics, ORB_TOPICS_COUNT of them and a NULL, sorted by name. */
__EXPORT extern const struct orb_metadata *const *orb_get_topics(void);

/** The topic of this number; NULL for INVALID and all above. */
__EXPORT extern const struct orb_metadata *get_orb_meta(uorb_topic_number_t id);

#ifdef __cplusplus
} /* extern \"C\" */
#endif

#endif
",
    );
    out
}

fn source(topics: &[TopicId<'_>]) -> String {
    let mut out = mark();
    line!(out, "#include <uORB/topics/uORBTopics.h>");
    let messages: BTreeSet<&str> = topics.iter().map(|topic| &*topic.message.name).collect();
    for name in messages {
        line!(out, "#include <uORB/topics/{name}.h>");
    }
    line!(out, "");
    line!(out, "static const struct orb_metadata *const uorb_topics[ORB_TOPICS_COUNT + 1] = {{");
    for topic in topics {
        line!(out, "\tORB_ID({}),", topic.name);
    }
    line!(out, "\tNULL");
    line!(out, "}};");
    out.push_str(
        "
const struct orb_metadata *const *orb_get_topics(void)
{
	return uorb_topics;
}

const struct orb_metadata *get_orb_meta(uorb_topic_number_t id)
{
	const size_t place = (size_t)id;

	/* The last one is INVALID's. */
	return place <= ORB_TOPICS_COUNT ? uorb_topics[place] : NULL;
}
",
    );
    out
}
