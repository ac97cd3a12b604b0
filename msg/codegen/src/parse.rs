//! The text of one .msg file, line by line.
//!
//! A line is a field (`float32[3] xyz`), a constant (`uint8 ARMED = 1`: it has
//! a `=`), a `# TOPICS` line, or a comment. Nothing here needs to know another
//! file; whether a type exists is asked in `message`. A line with a mistake is
//! noted and left out, and the next one is read.
//!
//! To whom a comment belongs: behind a declaration, to it. The first block in
//! the file, to the message. A block between two declarations, to the one
//! below if it touches it; but to the one above if it is indented or is a list
//! (`# 0 - armed`) and touches that. Any other block belongs to nobody.

use crate::comment::Comment;
use crate::fault::Notes;
use crate::layout::MESSAGE_SIZE_MAX_BYTES;
use crate::names;
use crate::scalar::{Scalar, Value};

/// A .msg file as its text has it.
#[derive(Debug, Default)]
pub(crate) struct Ast {
    pub(crate) comment: Comment,
    pub(crate) fields: Vec<FieldLine>,
    pub(crate) constants: Vec<Constant>,
    /// The names of all `# TOPICS` lines, in snake case.
    pub(crate) topics: Vec<TopicName>,
}

/// `float32[3] xyz`, its type not yet looked up.
#[derive(Debug)]
pub(crate) struct FieldLine {
    pub(crate) type_name: String,
    pub(crate) array_length: Option<u32>,
    pub(crate) name: String,
    pub(crate) comment: Comment,
    pub(crate) line: u32,
}

/// `uint8 ARMED = 1`
#[derive(Clone, Debug)]
pub(crate) struct Constant {
    pub(crate) scalar: Scalar,
    pub(crate) name: String,
    pub(crate) value: Value,
    pub(crate) comment: Comment,
    pub(crate) line: u32,
}

/// One name of a `# TOPICS` line.
#[derive(Clone, Debug)]
pub(crate) struct TopicName {
    pub(crate) name: String,
    pub(crate) line: u32,
}

/// Reads a file.
pub(crate) fn parse(text: &str, notes: &mut Notes) -> Ast {
    let mut parser = Parser { ast: Ast::default(), block: None, last: Last::Nothing, notes };
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    for (index, line) in text.lines().enumerate() {
        parser.line(index as u32 + 1, line);
    }
    parser.end_block();
    parser.ast
}

struct Parser<'a> {
    ast: Ast,
    /// The comment lines just above, with no empty line since.
    block: Option<Block>,
    last: Last,
    notes: &'a mut Notes,
}

/// Comment lines that stand together.
struct Block {
    comment: Comment,
    indented: bool,
    touches_above: bool,
}

/// The last line that was no comment.
#[derive(Clone, Copy, PartialEq)]
enum Last {
    /// There was none yet: a comment here is the message's.
    Nothing,
    Empty,
    Field,
    Constant,
    /// A line that was left out, or `# TOPICS`.
    Other,
}

impl Parser<'_> {
    fn line(&mut self, number: u32, line: &str) {
        if let Some(names) = topics(line) {
            self.end_block();
            self.last = Last::Other;
            return self.topics(number, names);
        }
        let (code, comment) = match line.split_once('#') {
            Some((code, comment)) => (code.trim(), Some(comment)),
            None => (line.trim(), None),
        };
        match comment {
            _ if !code.is_empty() => self.declaration(number, code, comment.unwrap_or("")),
            Some(comment) => self.comment_line(number, comment, line.starts_with('#')),
            None => {
                self.end_block();
                if self.last != Last::Nothing {
                    self.last = Last::Empty;
                }
            }
        }
    }

    fn comment_line(&mut self, number: u32, comment: &str, at_column_0: bool) {
        if comment.trim_start().starts_with("TOPICS") {
            let text = "this line defines no topics; it would as `# TOPICS name`, from column 0";
            self.notes.warn(number, text);
        }
        let touches_above = matches!(self.last, Last::Field | Last::Constant);
        let block = self.block.get_or_insert_with(|| Block {
            comment: Comment::default(),
            indented: !at_column_0,
            touches_above,
        });
        block.comment.add(comment);
    }

    fn declaration(&mut self, line: u32, code: &str, comment: &str) {
        let mut words = Comment::default();
        match self.block.take() {
            Some(block) if self.is_of_message() => self.ast.comment = block.comment,
            Some(block) if block.is_of_above() => self.append_to_last(block.comment),
            Some(block) => words = block.comment,
            None => {}
        }
        words.add(comment);
        self.last = Last::Other;
        match code.split_once('=') {
            Some((declared, value)) => {
                if let Some(constant) = self.constant(line, declared, value.trim(), words) {
                    self.ast.constants.push(constant);
                    self.last = Last::Constant;
                }
            }
            None => {
                if let Some(field) = self.field(line, code, words) {
                    self.ast.fields.push(field);
                    self.last = Last::Field;
                }
            }
        }
    }

    /// An empty line, or the end: the block touches nothing below.
    fn end_block(&mut self) {
        match self.block.take() {
            Some(block) if self.is_of_message() => {
                self.ast.comment = block.comment;
                self.last = Last::Empty;
            }
            Some(block) if block.is_of_above() => self.append_to_last(block.comment),
            _ => {}
        }
    }

    fn is_of_message(&self) -> bool {
        self.last == Last::Nothing
    }

    fn append_to_last(&mut self, comment: Comment) {
        let last = match self.last {
            Last::Field => self.ast.fields.last_mut().map(|field| &mut field.comment),
            Last::Constant => self.ast.constants.last_mut().map(|constant| &mut constant.comment),
            _ => None,
        };
        if let Some(last) = last {
            last.append(comment);
        }
    }

    fn topics(&mut self, line: u32, names: &str) {
        let mut any = false;
        for word in names.split_whitespace() {
            any = true;
            let name = names::snake_case(word);
            if !names::is_word(&name) {
                self.notes.fault(line, format!("`{word}` cannot be a topic's name"));
            } else if name.len() > names::TOPIC_NAME_MAX_BYTES {
                let max = names::TOPIC_NAME_MAX_BYTES;
                let text = format!("`{word}` is longer than a topic's name may be, {max} bytes");
                self.notes.fault(line, text);
            } else {
                self.ast.topics.push(TopicName { name, line });
            }
        }
        if !any {
            self.notes.fault(line, "`# TOPICS` names no topic");
        }
    }

    fn field(&mut self, line: u32, code: &str, comment: Comment) -> Option<FieldLine> {
        let words: Vec<&str> = code.split_whitespace().collect();
        let &[type_text, name] = words.as_slice() else {
            let text = format!("`{code}` is not a field: type and name, as `float32[3] xyz`");
            self.notes.fault(line, text);
            return None;
        };
        let name = self.field_name(line, type_text, name);
        let ty = self.array_type(line, type_text);
        let (type_name, array_length) = ty?;
        Some(FieldLine { type_name, array_length, name: name?, comment, line })
    }

    fn field_name(&mut self, line: u32, type_text: &str, name: &str) -> Option<String> {
        let fault = if let Some((name, length)) = name.split_once('[') {
            format!("`{name}[{length}`: the length goes to the type, `{type_text}[{length} {name}`")
        } else if !names::is_word(name) {
            format!("`{name}` is not a name: a letter, then letters, digits and `_`")
        } else if name.bytes().any(|byte| byte.is_ascii_uppercase()) {
            format!("field `{name}` has capital letters; write `{}`", names::lower_case(name))
        } else if let Some(language) = names::reserved(name) {
            format!("field `{name}` cannot have this name: it is a keyword of {language}")
        } else {
            return Some(name.to_string());
        };
        self.notes.fault(line, fault);
        None
    }

    /// Splits `px4/float32[3]` into `float32` and 3.
    fn array_type(&mut self, line: u32, text: &str) -> Option<(String, Option<u32>)> {
        let (base, length) = match text.split_once('[') {
            Some((base, length)) => (base, Some(length)),
            None => (text, None),
        };
        let name = base.split_once('/').map_or(base, |(_package, name)| name);
        if !names::is_word(name) {
            self.notes.fault(line, format!("`{base}` is not a type"));
            return None;
        }
        let Some(length) = length else { return Some((name.to_string(), None)) };
        let fault = match length.strip_suffix(']') {
            Some("") => {
                format!("`{text}` has no length; a message has a fixed size: `{base}[8]`")
            }
            Some(digits) if digits.bytes().all(|byte| byte.is_ascii_digit()) => {
                match digits.parse::<u32>() {
                    Ok(0) => format!("`{text}` is an array of no elements"),
                    Ok(length) if u64::from(length) <= MESSAGE_SIZE_MAX_BYTES => {
                        return Some((name.to_string(), Some(length)));
                    }
                    _ => format!(
                        "`{text}` is longer than a message can be, {MESSAGE_SIZE_MAX_BYTES} bytes"
                    ),
                }
            }
            Some(inner) if inner.contains('[') => {
                format!("`{text}` has two dimensions; an array has one")
            }
            _ => format!("`{text}` is not an array type: `{base}[8]`"),
        };
        self.notes.fault(line, fault);
        None
    }

    fn constant(
        &mut self,
        line: u32,
        declared: &str,
        value: &str,
        comment: Comment,
    ) -> Option<Constant> {
        let words: Vec<&str> = declared.split_whitespace().collect();
        let &[type_name, name] = words.as_slice() else {
            let declared = declared.trim();
            let text = format!("`{declared} = {value}` is not a constant: type, name, `=`, value");
            self.notes.fault(line, text);
            return None;
        };
        let scalar = Scalar::from_msg_name(type_name);
        let name_fault = if !names::is_word(name) {
            Some(format!("`{name}` is not a name: a letter, then letters, digits and `_`"))
        } else {
            names::reserved(name).map(|language| {
                format!("constant `{name}` cannot have this name: it is a keyword of {language}")
            })
        };
        if let Some(text) = &name_fault {
            self.notes.fault(line, text.as_str());
        }
        let Some(scalar) = scalar else {
            let types = Scalar::ALL.iter().map(|scalar| scalar.msg_name());
            let hint = match names::nearest(type_name, types) {
                Some(near) => format!("; did you mean `{near}`?"),
                None => String::new(),
            };
            self.notes.fault(line, format!("`{type_name}` is not a constant's type{hint}"));
            return None;
        };
        match scalar.read(value) {
            Ok(value) if name_fault.is_none() => {
                Some(Constant { scalar, name: name.to_string(), value, comment, line })
            }
            Ok(_) => None,
            Err(text) => {
                self.notes.fault(line, format!("constant `{name}`: {text}"));
                None
            }
        }
    }
}

impl Block {
    fn is_of_above(&self) -> bool {
        self.touches_above && (self.indented || self.comment.begins_as_list())
    }
}

/// What follows `# TOPICS` at the start of a line.
fn topics(line: &str) -> Option<&str> {
    let names = line.strip_prefix("# TOPICS")?;
    (names.is_empty() || names.starts_with(char::is_whitespace)).then_some(names)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Ast {
        let mut notes = Notes::new("test.msg");
        let ast = parse(text, &mut notes);
        assert_eq!(notes.faults, []);
        ast
    }

    #[test]
    fn fields_are_read_whatever_separates_the_words() {
        let ast =
            parsed("\u{feff}float32[3]\txyz\r\nuint8  is_external # if 1\r\npx4/EscReport[8] esc");
        let fields: Vec<_> = ast
            .fields
            .iter()
            .map(|field| (&*field.type_name, field.array_length, &*field.name, field.line))
            .collect();
        assert_eq!(
            fields,
            [
                ("float32", Some(3), "xyz", 1),
                ("uint8", None, "is_external", 2),
                ("EscReport", Some(8), "esc", 3)
            ]
        );
        assert_eq!(ast.fields[1].comment.lines, ["if 1"]);
    }

    #[test]
    fn constants_need_no_blanks() {
        let ast = parsed("uint8 A=1\nint32\tB\t=\t-2 # two");
        let names: Vec<_> = ast.constants.iter().map(|one| (&*one.name, one.value)).collect();
        assert_eq!(names, [("A", Value::Int(1)), ("B", Value::Int(-2))]);
        assert_eq!(ast.constants[1].comment.lines, ["two"]);
    }

    #[test]
    fn topics_accumulate_and_become_snake_case() {
        let ast = parsed("# TOPICS a b\nuint8 x\n# TOPICS ActuatorControls1\n");
        let names: Vec<_> = ast.topics.iter().map(|topic| &*topic.name).collect();
        assert_eq!(names, ["a", "b", "actuator_controls1"]);
    }

    #[test]
    fn a_comment_finds_what_it_speaks_about() {
        let ast = parsed(
            "# The message.\n#\n# More.\n\nuint8 a # of a\n  # also of a\n\n# of nobody\n\n\
             # above b\nuint8 b # of b\nuint8 bits # of bits\n# 0 - first\n# 1 - second\nuint8 c\n",
        );
        assert_eq!(ast.comment.lines, ["The message.", "", "More."]);
        let words: Vec<_> = ast.fields.iter().map(|field| field.comment.lines.join("|")).collect();
        assert_eq!(words, ["of a|also of a", "above b|of b", "of bits|0 - first|1 - second", ""]);
    }

    #[test]
    fn a_topics_line_that_px4_would_not_see_is_a_warning() {
        let mut notes = Notes::new("test.msg");
        let ast = parse("uint8 x\n #TOPICS a b\n", &mut notes);
        assert!(ast.topics.is_empty());
        assert_eq!(notes.warnings[0].line, Some(2));
    }
}
