//! What a comment says about a field: words for a person, tags for programs.
//!
//! PX4's comments carry tags in brackets: a unit (`[m/s^2]`), and `[@enum X]`,
//! `[@range 0, 1]`, `[@frame NED]`, `[@invalid NaN]`. They are taken out of the
//! words, so that each is said once, and the words go into the documentation
//! of the generated code, where no character of theirs may turn into markup.
//! Letters that no source may have (a bare carriage return, an escape, what turns
//! the direction of writing) are left out before anything else is looked at.
//!
//! A command's constant (`VEHICLE_CMD_..`) lists its parameters behind its
//! words, each after a `|`. Tags there are the parameters', and stay with them.

/// A comment, sorted into words and tags. Empty texts: not given.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Comment {
    /// The lines of words, without `#` and tags.
    pub(crate) lines: Vec<String>,
    /// The unit, `m/s^2`.
    pub(crate) unit: String,
    /// The prefix of the constants that the field takes as values.
    pub(crate) values: String,
    pub(crate) range: String,
    pub(crate) frame: String,
    pub(crate) invalid: String,
}

impl Comment {
    /// Adds a line, given without its `#`. Rulers (`#----`) are dropped, and
    /// an empty line separates paragraphs.
    pub(crate) fn add(&mut self, line: &str) {
        let line = harmless(line);
        let words = self.take_tags(line.trim_start_matches('#').trim());
        let ruler = words.chars().all(|letter| "-=*~_#/".contains(letter));
        if !ruler {
            self.lines.push(words);
        } else if self.lines.last().is_some_and(|last| !last.is_empty()) && words.is_empty() {
            self.lines.push(String::new());
        }
    }

    /// Adds all of another comment behind this one.
    pub(crate) fn append(&mut self, other: Self) {
        self.lines.extend(other.lines);
        for (ours, theirs) in [
            (&mut self.unit, other.unit),
            (&mut self.values, other.values),
            (&mut self.range, other.range),
            (&mut self.frame, other.frame),
            (&mut self.invalid, other.invalid),
        ] {
            if ours.is_empty() {
                *ours = theirs;
            }
        }
    }

    /// Whether the comment begins as one entry of a list does: `0 - armed`.
    pub(crate) fn begins_as_list(&self) -> bool {
        self.lines.first().is_some_and(|line| is_list_entry(line))
    }

    fn take_tags(&mut self, line: &str) -> String {
        let mut words = String::new();
        let (mut rest, parameters) = line.split_at(line.find('|').unwrap_or(line.len()));
        while let Some(open) = rest.find('[') {
            let Some(length) = rest[open..].find(']') else { break };
            let close = open + length;
            let text = rest[open + 1..close].trim();
            words.push_str(&rest[..open]);
            if !self.take_tag(text) {
                words.push_str(&rest[open..=close]);
            }
            rest = &rest[close + 1..];
        }
        words.push_str(rest);
        words.push_str(parameters);
        words.split_whitespace().collect::<Vec<_>>().join(" ")
    }

    /// Whether the text between brackets is a tag; if so, it is kept.
    fn take_tag(&mut self, text: &str) -> bool {
        let (name, value) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
        let value = value.trim();
        let place = match name {
            "@enum" => &mut self.values,
            "@range" => &mut self.range,
            "@frame" => &mut self.frame,
            "@invalid" => &mut self.invalid,
            _ if is_unit(text) && self.unit.is_empty() => {
                self.unit = text.to_string();
                return true;
            }
            _ => return false,
        };
        *place = value.to_string();
        true
    }

    /// The comment as the lines of a doc comment: words, then tags.
    pub(crate) fn doc_lines(&self) -> Vec<String> {
        let mut doc: Vec<String> = Vec::new();
        for line in &self.lines {
            let entry = is_list_entry(line);
            let after_entry = doc.last().is_some_and(|last| last.starts_with("- "));
            let after_words = doc.last().is_some_and(|last| !last.is_empty());
            if after_words && entry != after_entry {
                doc.push(String::new());
            }
            let words = line.trim_start_matches(['-', '*']).trim();
            doc.push(if entry { format!("- {}", escape(words)) } else { escape(line) });
        }
        while doc.last().is_some_and(String::is_empty) {
            doc.pop();
        }
        let tags = [
            ("Unit", &self.unit),
            ("Range", &self.range),
            ("Frame", &self.frame),
            ("Invalid", &self.invalid),
            ("Values", &self.values),
        ];
        let tags: Vec<String> = tags
            .into_iter()
            .filter(|(_, text)| !text.is_empty())
            .map(|(name, text)| format!("{name}: `{}`.", text.replace('`', "'")))
            .collect();
        if !tags.is_empty() {
            if !doc.is_empty() {
                doc.push(String::new());
            }
            doc.push(tags.join(" "));
        }
        doc
    }

    /// The comment as lines of plain text: the unit in brackets, as PX4 writes
    /// it, the words, and the other tags behind them.
    pub(crate) fn plain_lines(&self) -> Vec<String> {
        let mut plain = self.lines.clone();
        while plain.last().is_some_and(String::is_empty) {
            plain.pop();
        }
        if !self.unit.is_empty() {
            match plain.first_mut() {
                Some(first) => *first = format!("[{}] {first}", self.unit).trim().to_string(),
                None => plain.push(format!("[{}]", self.unit)),
            }
        }
        let tags = [
            ("Range", &self.range),
            ("Frame", &self.frame),
            ("Invalid", &self.invalid),
            ("Values", &self.values),
        ];
        let tags: Vec<String> = tags
            .into_iter()
            .filter(|(_, text)| !text.is_empty())
            .map(|(name, text)| format!("{name}: {text}."))
            .collect();
        if !tags.is_empty() {
            plain.push(tags.join(" "));
        }
        plain
    }
}

/// The text without letters that rustc refuses in a doc comment, or that make a
/// source look like what it is not.
pub(crate) fn harmless(text: &str) -> String {
    let separated = text.chars().map(|letter| if letter.is_whitespace() { ' ' } else { letter });
    let harmful = |letter: &char| {
        letter.is_control()
            || matches!(letter, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}')
    };
    separated.filter(|letter| !harmful(letter)).collect()
}

/// `m/s^2`, `1e-7 deg`, `%`, `-`; but not `0..360`, `-1,1`, a type or a remark.
fn is_unit(text: &str) -> bool {
    let unit_letter = |letter: char| letter.is_alphanumeric() || " /^*%°.-()".contains(letter);
    let number = text.chars().all(|letter| letter.is_ascii_digit() || ".- ".contains(letter));
    let short = text.len() <= 20 && text.split_whitespace().count() <= 2;
    let a_type = matches!(text, "bool" | "boolean" | "enum");
    text == "-" || !text.is_empty() && short && !number && !a_type && text.chars().all(unit_letter)
}

fn is_list_entry(line: &str) -> bool {
    let digits = line.bytes().take_while(u8::is_ascii_digit).count();
    let after = line[digits..].trim_start();
    let numbered = digits > 0 && after.starts_with(['-', ':', '=', ')']);
    numbered || line.starts_with("- ") || line.starts_with("* ")
}

/// The text with everything escaped that rustdoc would take for markup.
fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    // An odd backtick would open a span that nothing closes.
    let spans = text.matches('`').count().is_multiple_of(2);
    let mut in_code = false;
    let mut rest = text;
    while let Some(letter) = rest.chars().next() {
        let url = (rest.starts_with("http://") || rest.starts_with("https://")) && !in_code;
        if url {
            let end = rest.find(|end: char| end.is_whitespace() || "),;<>`".contains(end));
            let (address, after) = rest.split_at(end.unwrap_or(rest.len()));
            escaped.push_str(&format!("<{address}>"));
            rest = after;
            continue;
        }
        let markup = match letter {
            '`' if spans => {
                in_code = !in_code;
                false
            }
            '[' | ']' | '<' | '*' | '\\' | '`' | '&' | '~' => !in_code,
            '#' | '>' | '+' | '-' | '=' | '|' => escaped.is_empty(),
            _ => false,
        };
        if markup {
            escaped.push('\\');
        }
        escaped.push(letter);
        rest = &rest[letter.len_utf8()..];
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    fn comment(lines: &[&str]) -> Comment {
        let mut comment = Comment::default();
        lines.iter().for_each(|line| comment.add(line));
        comment
    }

    #[test]
    fn tags_are_taken_out_of_the_words() {
        let comment = comment(&[" [m/s^2] Acceleration [@range 0, 1] in the [@frame NED] frame"]);
        assert_eq!(comment.lines, ["Acceleration in the frame"]);
        assert_eq!(comment.unit, "m/s^2");
        assert_eq!(comment.range, "0, 1");
        assert_eq!(comment.frame, "NED");
        assert_eq!(
            comment.doc_lines(),
            ["Acceleration in the frame", "", "Unit: `m/s^2`. Range: `0, 1`. Frame: `NED`."]
        );
    }

    #[test]
    fn letters_that_no_source_may_have_are_left_out_of_words_and_tags() {
        let comment =
            comment(&["\u{feff}a\u{202e}b\u{2028}c\0 [m\u{b}/s] [@range 0\r1] \u{1b}d\u{85}"]);
        assert_eq!(comment.doc_lines(), ["ab c d", "", "Unit: `m /s`. Range: `0 1`."]);
        assert_eq!(comment.plain_lines(), ["[m /s] ab c d", "Range: 0 1."]);
    }

    #[test]
    fn brackets_that_are_no_unit_stay_in_the_words() {
        for words in [
            "angle [0..360]",
            "either [-1,1]",
            "set [bool] if true",
            "(see [the MAV_ROI enum])",
            "open [ end",
        ] {
            let comment = comment(&[words]);
            assert_eq!((comment.unit.as_str(), &*comment.lines[0]), ("", words));
        }
        for unit in ["rad/s", "1e-7 deg", "%", "-", "degC", "deg*1e7", "1/s"] {
            assert_eq!(comment(&[&format!("[{unit}] x")]).unit, unit);
        }
    }

    #[test]
    fn the_tags_of_a_commands_parameters_stay_with_them() {
        let line = "[@enum TURN] Circle. |[m] Radius|[m/s] [@range 0,9] Speed|Unused|";
        let comment = comment(&[line]);
        assert_eq!(comment.lines, ["Circle. |[m] Radius|[m/s] [@range 0,9] Speed|Unused|"]);
        assert_eq!((&*comment.values, &*comment.unit, &*comment.range), ("TURN", "", ""));
    }

    #[test]
    fn words_never_turn_into_markup() {
        for (text, escaped) in [
            ("a[0] < b * c", r"a\[0\] \< b \* c"),
            ("as `a[0]` says", "as `a[0]` says"),
            ("an odd ` tick", r"an odd \` tick"),
            ("see https://px4.io (now)", "see <https://px4.io> (now)"),
            ("# 1", r"\# 1"),
        ] {
            assert_eq!(escape(text), escaped);
        }
    }

    #[test]
    fn numbered_lines_become_a_list() {
        let comment = comment(&["Bits:", "0 - tilt aligned", "1 - yaw aligned"]);
        assert_eq!(comment.doc_lines(), ["Bits:", "", "- 0 - tilt aligned", "- 1 - yaw aligned"]);
    }

    #[test]
    fn rulers_are_dropped_and_empty_lines_separate_paragraphs() {
        assert_eq!(
            comment(&["", "One.", "-----", "", "Two.", ""]).doc_lines(),
            ["One.", "", "Two."]
        );
    }
}
