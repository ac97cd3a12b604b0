//! Names: how a message, a topic, a struct and a field are called in .msg
//! files, in Rust and in C.
//!
//! PX4 named its files in snake case (`sensor_accel.msg`) until 2022 and in
//! camel case (`SensorAccel.msg`) since; topics were always snake case, and a
//! message is known by that name here, whichever way its file spells it.

/// The most bytes of a topic's name: PX4's path of 64 bytes has `/obj/`, the
/// instance digit and the terminating NUL in it.
pub(crate) const TOPIC_NAME_MAX_BYTES: usize = 64 - 5 - 1 - 1;

/// The snake-case name, by PX4's own rule: `_` before every capital but the
/// first letter. `Ekf2Timestamps` becomes `ekf2_timestamps`, and `GPSData`
/// becomes `g_p_s_data`.
pub(crate) fn snake_case(name: &str) -> String {
    let mut snake = String::with_capacity(name.len() + 4);
    for (index, letter) in name.char_indices() {
        if letter.is_ascii_uppercase() && index > 0 {
            snake.push('_');
        }
        snake.push(letter.to_ascii_lowercase());
    }
    snake
}

/// A field's name without capitals, as PX4 changed its own: `altitudeSp` to
/// `altitude_sp`, `periph_5V_OC` to `periph_5v_oc`.
pub(crate) fn lower_case(name: &str) -> String {
    let mut lower = String::with_capacity(name.len() + 2);
    for letter in name.chars() {
        if letter.is_ascii_uppercase() && lower.ends_with(|last: char| last.is_ascii_lowercase()) {
            lower.push('_');
        }
        lower.push(letter);
    }
    lower.to_ascii_lowercase()
}

/// The name of a Rust type: `actuator_controls_1` becomes `ActuatorControls1`.
pub(crate) fn camel_case(snake: &str) -> String {
    let mut camel = String::with_capacity(snake.len());
    for word in snake.split('_') {
        let mut letters = word.chars();
        camel.extend(letters.next().map(|first| first.to_ascii_uppercase()));
        camel.push_str(letters.as_str());
    }
    camel
}

/// Whether a name is a letter followed by letters, digits and `_`.
pub(crate) fn is_word(name: &str) -> bool {
    name.starts_with(|first: char| first.is_ascii_alphabetic())
        && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
}

/// Why a name cannot be a field's or a constant's in Rust, C and C++, if so.
pub(crate) fn reserved(name: &str) -> Option<&'static str> {
    // Rust can escape its other keywords: `r#type`.
    if matches!(name, "self" | "Self" | "super" | "crate") {
        return Some("Rust");
    }
    C_KEYWORDS.split_whitespace().any(|keyword| keyword == name).then_some("C and C++")
}

/// What a name is in C and C++, if it is more than a name there: a keyword, a
/// type, or a macro of a header that every program includes.
pub(crate) fn reserved_in_c(name: &str) -> Option<&'static str> {
    let is_in = |list: &str| list.split_whitespace().any(|word| word == name);
    if is_in(C_KEYWORDS) || is_in(C_NEWER_KEYWORDS) {
        Some("a keyword of C and C++")
    } else if is_in(C_TYPES) {
        Some("a type of C and C++")
    } else {
        is_in(C_MACROS).then_some("a macro of C and C++")
    }
}

/// The name as Rust code writes it: `r#type` where it is a keyword.
pub(crate) fn rust_name(name: &str) -> String {
    let keyword = RUST_KEYWORDS.split_whitespace().any(|keyword| keyword == name);
    if keyword { format!("r#{name}") } else { name.to_string() }
}

/// The candidate that was probably meant, if one is near enough.
pub(crate) fn nearest<'a>(
    name: &str,
    candidates: impl Iterator<Item = &'a str>,
) -> Option<&'a str> {
    let lower = name.to_ascii_lowercase();
    candidates
        .map(|candidate| (distance(&lower, candidate), candidate))
        .min()
        .filter(|(distance, _)| *distance <= 1 + name.len() / 4)
        .map(|(_, candidate)| candidate)
}

/// How many letters have to be put in, left out, changed, or swapped with
/// their neighbour to make one name of the other.
fn distance(from: &str, to: &str) -> usize {
    let (from, to) = (from.as_bytes(), to.as_bytes());
    let mut table = vec![vec![0; to.len() + 1]; from.len() + 1];
    table.iter_mut().enumerate().for_each(|(i, row)| row[0] = i);
    table[0].iter_mut().enumerate().for_each(|(j, cell)| *cell = j);
    for i in 1..=from.len() {
        for j in 1..=to.len() {
            let changed = table[i - 1][j - 1] + usize::from(from[i - 1] != to[j - 1]);
            let mut least = changed.min(table[i - 1][j] + 1).min(table[i][j - 1] + 1);
            let swapped = i > 1 && j > 1 && from[i - 2..i] == [to[j - 1], to[j - 2]];
            if swapped {
                least = least.min(table[i - 2][j - 2] + 1);
            }
            table[i][j] = least;
        }
    }
    table[from.len()][to.len()]
}

const C_KEYWORDS: &str = "
    alignas alignof and and_eq asm auto bitand bitor bool break case catch char class compl
    concept const const_cast consteval constexpr constinit continue co_await co_return co_yield
    decltype default delete do double dynamic_cast else enum explicit export extern false float
    for friend goto if inline int long mutable namespace new noexcept not not_eq nullptr operator
    or or_eq private protected public register reinterpret_cast requires restrict return short
    signed sizeof static static_assert static_cast struct switch template this thread_local throw
    true try typedef typeid typename union unsigned using virtual void volatile wchar_t while xor
    xor_eq";

/// Keywords that no PX4 of its time knew, and that Rust output goes on taking.
const C_NEWER_KEYWORDS: &str = "char8_t char16_t char32_t typeof typeof_unqual";

/// Types that the members of a struct have.
const C_TYPES: &str = "int8_t int16_t int32_t int64_t uint8_t uint16_t uint32_t uint64_t";

/// Macros of the compiler, and of the headers that `uORB.h` includes.
const C_MACROS: &str = "
    linux unix i386 errno offsetof NULL NAN INFINITY INT8_MIN INT16_MIN INT32_MIN INT64_MIN INT8_MAX
    INT16_MAX INT32_MAX INT64_MAX UINT8_MAX UINT16_MAX UINT32_MAX UINT64_MAX SIZE_MAX";

const RUST_KEYWORDS: &str = "
    abstract as async await become box break const continue do dyn else enum extern false final fn
    for gen if impl in let loop macro match mod move mut override priv pub ref return static struct
    trait true try type typeof unsafe unsized use virtual where while yield";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_become_topics_by_the_rule_of_px4() {
        for (file, topic) in [
            ("SensorAccel", "sensor_accel"),
            ("sensor_accel", "sensor_accel"),
            ("Ekf2Timestamps", "ekf2_timestamps"),
            ("GPSData", "g_p_s_data"),
        ] {
            assert_eq!(snake_case(file), topic);
        }
        assert_eq!(camel_case("ekf2_timestamps"), "Ekf2Timestamps");
        assert_eq!(camel_case("actuator_controls_1"), "ActuatorControls1");
    }

    #[test]
    fn what_was_probably_meant_is_found() {
        let types = || ["float32", "float64", "uint8", "esc_report"].into_iter();
        assert_eq!(nearest("flaot32", types()), Some("float32"));
        assert_eq!(nearest("Uint8", types()), Some("uint8"));
        assert_eq!(nearest("esc_reports", types()), Some("esc_report"));
        assert_eq!(nearest("vehicle_roi", types()), None);
    }

    #[test]
    fn keywords_are_escaped_where_that_is_possible_in_all_languages() {
        assert_eq!(rust_name("type"), "r#type");
        assert_eq!(rust_name("x"), "x");
        assert_eq!(reserved("type"), None);
        assert_eq!(reserved("default"), Some("C and C++"));
        assert_eq!(reserved("self"), Some("Rust"));
    }
}
