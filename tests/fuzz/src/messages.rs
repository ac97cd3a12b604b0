//! The message compiler: whatever a .msg file holds, it is refused, or what
//! comes out of it can be compiled.
//!
//! A compiler for each input would be too slow, so the Rust is parsed, its names
//! are compared, and letters that rustc refuses are looked for; of the C what is
//! outside comments and strings is looked at.

mod grammar;

use std::collections::BTreeSet;

use syn::visit::Visit;
use uorb_codegen::Config;

/// Any bytes as a file: its first line is the file's name, the rest its text.
pub(crate) fn any_text(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let (stem, text) = text.split_once('\n').unwrap_or(("message", &text));
    compile(Config::new().text(format!("{stem}.msg"), text));
}

/// Two files of lines that are nearly right, put together as the bytes choose.
pub(crate) fn near_valid_lines(bytes: &[u8]) {
    let mut choices = arbitrary::Unstructured::new(bytes);
    let mut file = || grammar::file(&mut choices).ok();
    let (Some((first, first_text)), Some((second, second_text))) = (file(), file()) else { return };
    compile(Config::new().text(first, first_text).text(second, second_text));
}

fn compile(config: Config) {
    if let Ok(generated) = config.generate() {
        check_rust(&generated.rust);
    }
    if let Ok(generated) = config.generate_c() {
        let mut paths = BTreeSet::new();
        for (path, text) in &generated.files {
            assert!(paths.insert(path), "{path} is written twice");
            check_c(path, text);
        }
    }
}

fn check_rust(text: &str) {
    check_letters("the Rust module", text);
    let file = syn::parse_file(text).unwrap_or_else(|error| panic!("{error} in:\n{text}"));
    let mut names = Names::default();
    names.visit_file(&file);
}

/// Letters that rustc does not have in a source, and gcc warns of.
fn check_letters(what: &str, text: &str) {
    let refused = |letter: char| {
        letter.is_control() && letter != '\n' && letter != '\t'
            || matches!(letter, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}')
    };
    if let Some(letter) = text.chars().find(|letter| refused(*letter)) {
        panic!("{what} has a {letter:?} in it:\n{text}");
    }
}

/// Two items of one name in one place do not compile.
#[derive(Default)]
struct Names {
    types: BTreeSet<String>,
}

fn distinct(what: &str, names: impl Iterator<Item = String>) {
    let mut seen = BTreeSet::new();
    for name in names {
        assert!(!seen.contains(&name), "{what} has two of the name {name}");
        seen.insert(name);
    }
}

impl<'f> Visit<'f> for Names {
    fn visit_item_struct(&mut self, item: &'f syn::ItemStruct) {
        let name = item.ident.to_string();
        let fields = item.fields.iter().filter_map(|field| field.ident.as_ref());
        distinct(&name, fields.map(ToString::to_string));
        assert!(self.types.insert(name.clone()), "two types of the name {name}");
    }

    fn visit_item_enum(&mut self, item: &'f syn::ItemEnum) {
        let name = item.ident.to_string();
        distinct(&name, item.variants.iter().map(|variant| variant.ident.to_string()));
        assert!(self.types.insert(name.clone()), "two types of the name {name}");
    }

    fn visit_item_impl(&mut self, item: &'f syn::ItemImpl) {
        let names = item.items.iter().filter_map(|item| match item {
            syn::ImplItem::Const(constant) => Some(constant.ident.to_string()),
            syn::ImplItem::Fn(function) => Some(function.sig.ident.to_string()),
            _ => None,
        });
        distinct("an impl", names);
    }
}

/// Outside comments and strings there is only ASCII, with as many brackets
/// closed as opened; and each comment and string ends.
fn check_c(path: &str, text: &str) {
    check_letters(path, text);
    assert!(!text.contains("??/"), "a trigraph of a backslash in {path}:\n{text}");
    let mut rest = text;
    let mut depth = 0;
    while let Some(letter) = rest.chars().next() {
        let after = &rest[letter.len_utf8()..];
        rest = match letter {
            '/' if after.starts_with('*') => {
                let inner = &after[1..];
                let end = inner.find("*/").unwrap_or_else(|| panic!("{path}: no end:\n{text}"));
                assert!(!inner[..end].contains("/*"), "{path}: a comment in a comment:\n{text}");
                &inner[end + 2..]
            }
            '/' if after.starts_with('/') => {
                let line = after.find('\n').unwrap_or(after.len());
                assert!(!after[..line].ends_with('\\'), "{path}: a line goes on:\n{text}");
                &after[line..]
            }
            '"' => end_of_string(after).unwrap_or_else(|| panic!("{path}: no end:\n{text}")),
            _ => {
                assert!(letter.is_ascii(), "{path} has {letter:?} outside of comments:\n{text}");
                depth += i32::from("({[".contains(letter)) - i32::from(")}]".contains(letter));
                assert!(depth >= 0, "{path}: a bracket too many is closed:\n{text}");
                after
            }
        };
    }
    assert_eq!(depth, 0, "{path}: a bracket stays open:\n{text}");
}

/// What follows the quote that ends the string.
fn end_of_string(text: &str) -> Option<&str> {
    let mut escaped = false;
    for (place, letter) in text.char_indices() {
        match letter {
            '\n' => return None,
            '"' if !escaped => return Some(&text[place + 1..]),
            _ => escaped = letter == '\\' && !escaped,
        }
    }
    None
}
