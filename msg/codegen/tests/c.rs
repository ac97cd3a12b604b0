//! What is written in C and C++: the text, whether compilers take it without a
//! word, and what it refuses.
//!
//! The text is that of the example crate's folder, as it was when somebody last
//! looked at it. After a change on purpose: `UORB_BLESS=1 cargo test -p
//! uorb-codegen`, and read the difference.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use uorb_codegen::{Config, Error, Fault, GeneratedC, Written};

const HERE: &str = env!("CARGO_MANIFEST_DIR");

/// An empty directory of a test's own.
fn directory(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("c").join(name);
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).unwrap();
    path
}

fn own_crate() -> Config {
    Config::new().folder(format!("{HERE}/tests/own_crate/msg")).search(format!("{HERE}/.."))
}

fn generate(files: &[(&str, &str)]) -> GeneratedC {
    files
        .iter()
        .fold(Config::new(), |config, (path, text)| config.text(*path, *text))
        .generate_c()
        .unwrap()
}

#[track_caller]
fn faults(path: &str, text: &str) -> Vec<String> {
    match Config::new().text(path, text).generate_c() {
        Ok(_) => Vec::new(),
        Err(Error::Messages(faults)) => faults.iter().map(Fault::to_string).collect(),
        Err(error) => panic!("{error}"),
    }
}

fn text<'a>(generated: &'a GeneratedC, path: &str) -> &'a str {
    let mut files = generated.files.iter();
    let found = files.find(|(name, _)| name == path);
    &found.unwrap_or_else(|| panic!("no file {path}")).1
}

/// Has a compiler look at these sources. Any word is a failure. False: there is no such compiler.
fn compiles(compiler: &str, flags: &[&str], generated: &GeneratedC, name: &str) -> bool {
    let folder = directory(name);
    generated.write_to(&folder).unwrap();
    let sources = generated.files.iter().filter(|(path, _)| path.ends_with(".c"));
    let mut command = Command::new(compiler);
    command.args(flags).args(["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only"]);
    command
        .arg("-I")
        .arg(folder.join("include"))
        .arg("-I")
        .arg(format!("{HERE}/../../uorb-c/include"));
    let Ok(done) = command.args(sources.map(|(path, _)| folder.join(path))).output() else {
        eprintln!("skipped: no {compiler} in PATH");
        return false;
    };
    let words = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success() && words.is_empty(), "{compiler} {flags:?} says: {words}");
    true
}

#[track_caller]
fn compile_in_both(generated: &GeneratedC, name: &str) {
    compiles("cc", &["-std=c11"], generated, &format!("{name}_c"));
    compiles("c++", &["-x", "c++", "-std=c++17"], generated, &format!("{name}_cpp"));
}

#[test]
fn the_text_is_the_one_that_was_last_looked_at() {
    let path = format!("{HERE}/tests/golden/own_crate_c.txt");
    let generated = own_crate().generate_c().unwrap();
    let ours: String =
        generated.files.iter().map(|(path, text)| format!("===== {path}\n{text}\n")).collect();
    if std::env::var_os("UORB_BLESS").is_some() {
        fs::write(&path, &ours).unwrap();
    }
    let golden = fs::read_to_string(&path).unwrap();
    for (number, (ours, golden)) in ours.lines().zip(golden.lines()).enumerate() {
        assert_eq!(ours, golden, "line {} of {path}; UORB_BLESS=1 takes it over", number + 1);
    }
    assert_eq!(ours.len(), golden.len());
}

#[test]
fn compilers_have_no_word_to_say() {
    let installed = Config::new().folder(format!("{HERE}/..")).generate_c().unwrap();
    assert_eq!(installed.warnings, []);
    compile_in_both(&installed, "installed");
    compile_in_both(&own_crate().generate_c().unwrap(), "own_crate");
}

#[test]
fn compilers_have_no_word_to_say_of_odd_messages_either() {
    let many: String = (0..600).map(|number| format!("float32 field_{number}\n")).collect();
    let odd = "# It ends */ here, or /* begins ??/\n# \u{202e}sdrawkcab\n\
        float32 a # [°C] \"warm\\\n\
        uint8[3] type # [m/s] trailing backslash \\\n\
        char[2] printf\n\
        many[2] more\nodd_inner one\nuint64 timestamp\n# TOPICS odd odd_1\n";
    let inner = "uint8 x\n";
    let generated = generate(&[
        ("odd.msg", odd),
        ("many.msg", &many),
        ("odd_inner.msg", inner),
        ("only.msg", ""),
    ]);
    compile_in_both(&generated, "odd");
    assert!(text(&generated, "src/odd.c").contains(r#"offsetof(struct odd_s, a), "\302\260C""#));
}

#[test]
fn constants_have_their_values_in_both_languages() {
    let values = "int8 A = -128\nuint8 B = 255\nint16 C = -32768\nuint16 D = 65535\n\
        int32 E = -2147483648\nuint32 F = 4294967295\nint64 G = -9223372036854775808\n\
        int64 H = 9223372036854775807\nuint64 I = 18446744073709551615\nfloat32 J = 0.1\n\
        float64 K = 0.1\nfloat32 L = nan\nfloat64 M = nan\nfloat32 N = inf\nfloat64 O = -inf\n\
        bool P = True\nbool Q = False\nchar R = 'A'\nchar S = 255\nfloat32 T = -1e-30\n\
        float64 U = 1e300\nint64 V = -5\n";
    let checks = "#include <math.h>
#include <uORB/topics/values.h>
#ifdef __cplusplus
#define V(name) values_s::name
#else
#define V(name) VALUES_##name
#endif
int main(void)
{
	int wrong = 0;
	wrong += V(A) != INT8_MIN;
	wrong += V(B) != UINT8_MAX;
	wrong += V(C) != INT16_MIN;
	wrong += V(D) != UINT16_MAX;
	wrong += V(E) != INT32_MIN;
	wrong += V(F) != UINT32_MAX;
	wrong += V(G) != INT64_MIN;
	wrong += V(H) != INT64_MAX;
	wrong += V(I) != UINT64_MAX;
	wrong += V(J) != 0.1f || sizeof(V(J)) != sizeof(float);
	wrong += V(K) != 0.1 || sizeof(V(K)) != sizeof(double);
	wrong += !isnan(V(L)) || sizeof(V(L)) != sizeof(float);
	wrong += !isnan(V(M)) || sizeof(V(M)) != sizeof(double);
	wrong += V(N) != INFINITY;
	wrong += V(O) != -INFINITY || sizeof(V(O)) != sizeof(double);
	wrong += V(P) != true;
	wrong += V(Q) != false;
	wrong += V(R) != 'A';
	wrong += V(S) != (char)255;
	wrong += V(T) != -1e-30f;
	wrong += V(U) != 1e300;
	wrong += 2 - V(V) != 7;
	return wrong;
}
";
    let generated = generate(&[("values.msg", values)]);
    for (compiler, flags, ending) in
        [("cc", ["-std=c11", "-Wall"], "c"), ("c++", ["-std=c++17", "-Wall"], "cpp")]
    {
        if !compiles(
            compiler,
            if ending == "c" { &flags } else { &["-x", "c++"] },
            &generated,
            ending,
        ) {
            continue;
        }
        let folder = directory("constants");
        generated.write_to(&folder).unwrap();
        let (source, program) = (folder.join(format!("checks.{ending}")), folder.join("checks"));
        fs::write(&source, checks).unwrap();
        let mut command = Command::new(compiler);
        command
            .args(flags)
            .args(["-Wextra", "-Wpedantic", "-Werror", "-o"])
            .args([&program, &source]);
        command.arg("-I").arg(folder.join("include"));
        let done = command.arg(format!("-I{HERE}/../../uorb-c/include")).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let wrong = Command::new(program).status().unwrap().code();
        assert_eq!(wrong, Some(0), "so many constants are wrong in {compiler}");
    }
}

#[test]
fn names_that_are_words_of_the_language_are_refused_in_c_alone() {
    for (path, text, expected) in [
        (
            "a.msg",
            "float32 x\nuint8 typeof",
            "a.msg:2: field `typeof` cannot have this name: it is a keyword of C and C++",
        ),
        (
            "a.msg",
            "uint8 linux",
            "a.msg:1: field `linux` cannot have this name: it is a macro of C and C++",
        ),
        (
            "a.msg",
            "float32 int8_t",
            "a.msg:1: field `int8_t` cannot have this name: it is a type of C and C++",
        ),
        (
            "a.msg",
            "uint8 NULL = 1",
            "a.msg:1: constant `NULL` cannot have this name: it is a macro of C and C++",
        ),
        (
            "a.msg",
            "uint8 a_s = 1",
            "a.msg:1: constant `a_s` cannot have this name: it is the struct around it",
        ),
        (
            "class.msg",
            "uint8 x",
            "class.msg: topic `class` cannot have this name: it is a keyword of C and C++",
        ),
        (
            "a.msg",
            "uint8 x\n# TOPICS a int",
            "a.msg:2: topic `int` cannot have this name: it is a keyword of C and C++",
        ),
    ] {
        assert_eq!(faults(path, text), [expected]);
        assert!(Config::new().text(path, text).generate().is_ok(), "{text}");
    }
    // A keyword of all eras is one in Rust output, too, and is told once.
    let class = "a.msg:1: field `class` cannot have this name: it is a keyword of C and C++";
    assert_eq!(faults("a.msg", "uint8 class"), [class]);
    // The name of the message alone is none.
    assert_eq!(faults("class.msg", "uint8 x\n# TOPICS b"), [""; 0]);
}

#[test]
fn all_faults_are_told_at_once() {
    let faults = faults("a.msg", "float x\nuint8 typeof\nuint8 Y");
    let lines: Vec<&str> = faults.iter().map(|fault| &fault[..8]).collect();
    assert_eq!(lines, ["a.msg:1:", "a.msg:2:", "a.msg:3:"]);
}

#[test]
fn a_large_topic_is_left_out_and_its_header_says_so() {
    let generated = generate(&[
        ("image.msg", "uint8[65528] data\n# TOPICS image thumbnail"),
        ("most.msg", "uint8[65520] data"),
    ]);

    let header = text(&generated, "include/uORB/topics/image.h");
    let error = header.lines().find(|line| line.starts_with("#error")).expect("an error");
    for word in ["image", "thumbnail", "65536 bytes", "65535", "Rust"] {
        assert!(error.contains(word), "no {word} in {error}");
    }
    assert!(text(&generated, "include/uORB/topics/thumbnail.h").contains("uORB/topics/image.h"));
    let sources: Vec<&str> = generated.files.iter().map(|(path, _)| &**path).collect();
    assert!(!sources.contains(&"src/image.c"), "{sources:?}");
    let list = text(&generated, "include/uORB/topics/uORBTopics.h");
    assert!(list.contains("ORB_ID_most = 0") && !list.contains("image"), "{list}");
    let warnings: Vec<String> = generated.warnings.iter().map(Fault::to_string).collect();
    assert_eq!(warnings.len(), 1);
    assert!(warnings[0].starts_with("image.msg: topics image, thumbnail: "), "{warnings:?}");
    compile_in_both(&generated, "large");
}

#[test]
fn a_folder_of_large_topics_alone_has_an_empty_list() {
    let generated = generate(&[("image.msg", "uint8[100000] data")]);
    assert!(text(&generated, "src/uORBTopics.c").contains("uorb_topics[ORB_TOPICS_COUNT + 1]"));
    compiles("cc", &["-std=c11"], &generated, "none");
}

#[test]
fn two_constants_that_are_one_macro_are_a_warning() {
    let a = ("a.msg", "uint8 B_C = 1");
    let warnings = generate(&[a, ("a_b.msg", "uint8 C = 2")]).warnings;
    let text = "a_b.msg:1: constant `A_B_C` of C has another value in a.msg";
    assert_eq!(warnings.iter().map(Fault::to_string).collect::<Vec<_>>(), [text]);
    assert_eq!(generate(&[a, ("a_b.msg", "uint8 C = 1")]).warnings, []);
}

#[test]
fn a_message_of_a_search_folder_has_its_layout_but_no_topic() {
    let generated = own_crate().generate_c().unwrap();
    let source = text(&generated, "src/esc_report.c");
    assert!(source.contains("__uorb_layout_esc_report __attribute__((weak));"), "{source}");
    assert!(!source.contains("UORB_DEFINE"), "{source}");
    // Its header goes before the installed one, and has to serve as that one does.
    let header = text(&generated, "include/uORB/topics/esc_report.h");
    assert!(header.contains("ORB_DECLARE(esc_report);"), "{header}");
}

#[test]
fn only_what_has_changed_is_written_and_only_what_was_ours_is_removed() {
    let folder = directory("written");
    let both = generate(&[("a.msg", "uint8 x"), ("b.msg", "uint8 x")]);
    let first = both.write_to(&folder).unwrap();
    assert_eq!(first.changed.len(), both.files.len());
    assert_eq!(both.write_to(&folder).unwrap(), Written::default());
    for name in ["src/main.c", "include/uORB/topics/other.h"] {
        fs::write(folder.join(name), "int main(void) { return 0; }\n").unwrap();
    }

    let written = generate(&[("a.msg", "uint8 x # more words")]).write_to(&folder).unwrap();

    let paths = |names: &[&str]| names.iter().map(|name| folder.join(name)).collect::<Vec<_>>();
    let (changed, removed) = (
        ["include/uORB/topics/a.h", "include/uORB/topics/uORBTopics.h", "src/uORBTopics.c"],
        ["include/uORB/topics/b.h", "src/b.c"],
    );
    assert_eq!(written, Written { changed: paths(&changed), removed: paths(&removed) });
    assert!(paths(&["src/main.c", "include/uORB/topics/other.h"]).iter().all(|path| path.exists()));
}
