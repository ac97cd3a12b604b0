//! Every mistake is told with its line and the word, and all of them at once.

use uorb_codegen::{Config, Error, Fault};

/// Compiles one file, `test.msg`, and expects exactly these faults, each as
/// `line: text`. A text may end in `..`, and then only begins so.
#[track_caller]
fn check(text: &str, expected: &[&str]) {
    let faults = faults(Config::new().text("test.msg", text));
    compare(&faults, expected, |fault| {
        let line = fault.line.map_or("-".to_string(), |line| line.to_string());
        format!("{line}: {}", fault.text)
    });
}

#[track_caller]
fn compare(faults: &[Fault], expected: &[&str], show: impl Fn(&Fault) -> String) {
    let shown: Vec<String> = faults.iter().map(show).collect();
    let fits = |shown: &String, expected: &&str| match expected.strip_suffix("..") {
        Some(start) => shown.starts_with(start),
        None => shown == expected,
    };
    let all_fit =
        shown.len() == expected.len() && shown.iter().zip(expected).all(|(s, e)| fits(s, e));
    assert!(all_fit, "expected {expected:#?}\nbut it says {shown:#?}");
}

fn faults(config: Config) -> Vec<Fault> {
    match config.generate() {
        Ok(_) => Vec::new(),
        Err(Error::Messages(faults)) => faults,
        Err(error) => panic!("{error}"),
    }
}

#[test]
fn a_good_file_has_no_faults() {
    check("float32 x\nuint8 A = 1\n", &[]);
    check("", &[]);
}

#[test]
fn a_field_is_a_type_and_a_name() {
    check("float32", &["1: `float32` is not a field: .."]);
    check("float32 x y", &["1: `float32 x y` is not a field: .."]);
    check("float32 x;", &["1: `x;` is not a name: .."]);
    check("float32 1x", &["1: `1x` is not a name: .."]);
    check("flo&t x", &["1: `flo&t` is not a type"]);
    check("float32 _x", &["1: `_x` is not a name: .."]);
}

#[test]
fn field_names_work_in_all_languages() {
    check(
        "float32 voltage5V_v",
        &["1: field `voltage5V_v` has capital letters; write `voltage5v_v`"],
    );
    check(
        "float32 altitudeSp",
        &["1: field `altitudeSp` has capital letters; write `altitude_sp`"],
    );
    check(
        "uint8 default",
        &["1: field `default` cannot have this name: it is a keyword of C and C++"],
    );
    check("uint8 class", &["1: field `class` cannot have this name: it is a keyword of C and C++"]);
    check("uint8 self", &["1: field `self` cannot have this name: it is a keyword of Rust"]);
    check("uint8 type\nuint8 match", &[]);
}

#[test]
fn an_unknown_type_comes_with_a_suggestion() {
    check("float x", &["1: unknown type `float`; did you mean `float32`?"]);
    check("double x", &["1: unknown type `double`; did you mean `float64`?"]);
    check("uint8_t x", &["1: unknown type `uint8_t`; did you mean `uint8`?"]);
    check("unit8 x", &["1: unknown type `unit8`; did you mean `uint8`?"]);
    check("string x", &["1: unknown type `string`: text has a fixed size here, as `char[32]`"]);
    check("time x", &["1: unknown type `time`: write microseconds as `uint64`"]);
    check("duration x", &["1: unknown type `duration`: write microseconds as `uint64`"]);
    check("byte x", &["1: unknown type `byte`; did you mean `int8`?"]);
    check(
        "VehicleRoi x",
        &["1: unknown type `VehicleRoi`; there is no file VehicleRoi.msg beside this one"],
    );
    let two = Config::new().text("esc_report.msg", "").text("b.msg", "EscReports[8] esc");
    compare(
        &faults(two),
        &["b.msg:1: unknown type `EscReports`; did you mean `esc_report`?"],
        Fault::to_string,
    );
}

#[test]
fn an_array_has_one_length() {
    check(
        "float32[] x",
        &["1: `float32[]` has no length; a message has a fixed size: `float32[8]`"],
    );
    check("float32[0] x", &["1: `float32[0]` is an array of no elements"]);
    check("float32[2][3] x", &["1: `float32[2][3]` has two dimensions; an array has one"]);
    check("float32[N] x", &["1: `float32[N]` is not an array type: `float32[8]`"]);
    check("float32[3 x", &["1: `float32[3` is not an array type: `float32[8]`"]);
    check("float32[-1] x", &["1: `float32[-1]` is not an array type: `float32[8]`"]);
    check(
        "uint8[268435457] x",
        &["1: `uint8[268435457]` is longer than a message can be, 268435456 bytes"],
    );
    check("float32 x[3]", &["1: `x[3]`: the length goes to the type, `float32[3] x`"]);
}

#[test]
fn a_constant_is_checked_against_its_type() {
    check("uint8 A = 256", &["1: constant `A`: `256` does not fit uint8: 0 to 255"]);
    check("int8 A = -129", &["1: constant `A`: `-129` does not fit int8: -128 to 127"]);
    check("uint8 A =", &["1: constant `A`: `` is not an integer, as uint8 asks for"]);
    check("uint8 A = B", &["1: constant `A`: `B` is not an integer, as uint8 asks for"]);
    check("uint8 A == 1", &["1: constant `A`: `= 1` is not an integer, as uint8 asks for"]);
    check("bool A = 2", &["1: constant `A`: `2` does not fit bool: 0 to 1"]);
    check("float32 A = fast", &["1: constant `A`: `fast` is not a number"]);
    check("uint8 = 1", &["1: `uint8 = 1` is not a constant: type, name, `=`, value"]);
    check("uint8[2] A = 1", &["1: `uint8[2]` is not a constant's type.."]);
    check("unit8 A = 1", &["1: `unit8` is not a constant's type; did you mean `uint8`?"]);
    check("uint8 register = 1", &["1: constant `register` cannot have this name: .."]);
}

#[test]
fn a_name_is_declared_once() {
    check("uint8 x\n\nfloat32 x", &["3: field `x` is declared already, in line 1"]);
    check("uint8 A = 1\nuint8 A = 2", &["2: constant `A` is declared already, in line 1"]);
    check("uint8 a = 1\nuint8 a", &["2: field `a` is declared already, in line 1"]);
}

#[test]
fn a_timestamp_is_a_uint64() {
    check("uint32 timestamp", &["1: `timestamp` is a `uint64` in every message; .."]);
    check("uint64[2] timestamp", &["1: `timestamp` is a `uint64` in every message; .."]);
    let nested = Config::new().text("a.msg", "b inner").text("b.msg", "float64 timestamp");
    compare(&faults(nested), &["b.msg:1: `timestamp` is a `uint64` .."], Fault::to_string);
}

#[test]
fn a_queue_length_is_a_number_up_to_128() {
    let rule = "a queue's length is a whole number from 1 to 128";
    for wrong in ["0", "129", "256", "-4"] {
        let expected = format!("1: `ORB_QUEUE_LENGTH = {wrong}`: {rule}");
        check(&format!("int16 ORB_QUEUE_LENGTH = {wrong}"), &[&expected]);
    }
    check("float32 ORB_QUEUE_LENGTH = 4", &["1: `ORB_QUEUE_LENGTH = 4`: .."]);
    check("uint8 ORB_QUEUE_LENGTH = 128", &[]);
}

#[test]
fn a_queue_length_of_old_becomes_a_power_of_two() {
    for (written, rounded) in [("3", "4"), ("5", "8"), ("10", "16"), ("65", "128")] {
        let text = format!("uint8 ORB_QUEUE_LENGTH = {written}");
        let generated = Config::new().text("test.msg", text).generate().unwrap();
        assert_eq!(
            generated.warnings[0].to_string(),
            format!(
                "test.msg:1: `ORB_QUEUE_LENGTH = {written}`: a queue's length is a power of two; \
                 this one becomes {rounded}"
            )
        );
        assert!(generated.rust.contains(&format!("QueueLength::at_least({rounded})")));
    }
}

#[test]
fn topics_have_names_that_can_be_files() {
    check("# TOPICS test a/b", &["1: `a/b` cannot be a topic's name"]);
    check("# TOPICS test test", &["1: topic `test` is listed already"]);
    check("# TOPICS", &["1: `# TOPICS` names no topic"]);
    let long = "x".repeat(58);
    let expected = format!("1: `{long}` is longer than a topic's name may be, 57 bytes");
    check(&format!("# TOPICS test {long}"), &[&expected]);
}

#[test]
fn names_are_given_once_among_all_files() {
    let topics = Config::new().text("a.msg", "# TOPICS a b").text("b.msg", "uint8 x");
    compare(
        &faults(topics),
        &["b.msg:1: topic `b` is defined already, by a.msg"],
        Fault::to_string,
    );

    let files = Config::new().text("msg/SensorAccel.msg", "").text("msg/sensor_accel.msg", "");
    compare(
        &faults(files),
        &["msg/sensor_accel.msg: message `sensor_accel` exists already: msg/SensorAccel.msg"],
        Fault::to_string,
    );

    let structs = Config::new().text("group_1.msg", "").text("group1.msg", "");
    compare(
        &faults(structs),
        &["group_1.msg: this would be the Rust type `Group1`, which group1.msg has"],
        Fault::to_string,
    );

    let marker = Config::new().text("a.msg", "# TOPICS a b_1").text("b1.msg", "");
    compare(
        &faults(marker),
        &["a.msg:1: topic `b_1` would be the Rust type `B1`, which b1.msg has"],
        Fault::to_string,
    );
    let id = Config::new().text("orb_id.msg", "");
    compare(
        &faults(id),
        &["orb_id.msg: this would be the Rust type `OrbId`, which every module has"],
        Fault::to_string,
    );
    check("# TOPICS test orb_id", &["1: topic `orb_id` would be the Rust type `OrbId`, .."]);
}

#[test]
fn a_message_does_not_contain_itself() {
    check("test inner", &["1: message `test` contains itself: test > test"]);
    let ring = Config::new().text("a.msg", "b x").text("b.msg", "c x").text("c.msg", "\na[2] x");
    compare(
        &faults(ring),
        &["c.msg:2: message `a` contains itself: a > b > c > a"],
        Fault::to_string,
    );
}

#[test]
fn a_message_is_not_larger_than_a_topic_takes() {
    check("uint8[6220800] x", &[]);
    check("uint8[268435448] x", &[]);
    check(
        "uint8 y\nuint8[268435448] x",
        &["2: message `test` has 268435464 bytes, most of them in `x`; \
           a topic takes at most 268435456"],
    );
    let mut deep = Config::new().text("m0.msg", "");
    for level in 1..9 {
        deep = deep.text(format!("m{level}.msg"), format!("m{} inner", level - 1));
    }
    compare(
        &faults(deep),
        &["m8.msg:1: messages nest more than 8 levels deep in `m8`"],
        Fault::to_string,
    );
    // Each level alone would overflow the next one's size.
    let huge = Config::new()
        .text("a.msg", "uint64[268435455] x")
        .text("b.msg", "a[268435455] x")
        .text("c.msg", "b[268435455] x");
    compare(&faults(huge), &["a.msg:1: ..", "b.msg:1: ..", "c.msg:1: .."], Fault::to_string);
}

#[test]
fn all_mistakes_of_all_files_come_at_once() {
    let config = Config::new()
        .text("msg/a.msg", "float x\nuint8 y\nuint8 A = 999\n# TOPICS a !\nuint8 Y")
        .text("msg/b.msg", "uint8[] z");
    let error = config.generate().unwrap_err();
    let expected = "5 errors in the messages
msg/a.msg:1: unknown type `float`; did you mean `float32`?
msg/a.msg:3: constant `A`: `999` does not fit uint8: 0 to 255
msg/a.msg:4: `!` cannot be a topic's name
msg/a.msg:5: field `Y` has capital letters; write `y`
msg/b.msg:1: `uint8[]` has no length; a message has a fixed size: `uint8[8]`";
    assert_eq!(error.to_string(), expected);
    // What a build script prints that ends with `?`.
    assert_eq!(format!("{error:?}"), expected);
}

#[test]
fn odd_things_are_warnings() {
    let warnings = |text: &str| -> Vec<String> {
        let generated = Config::new().text("test.msg", text).generate().unwrap();
        generated.warnings.iter().map(Fault::to_string).collect()
    };
    assert_eq!(
        warnings("# TOPICS other another"),
        ["test.msg:1: the first topic is `other`, not `test` as the file is named; there is no \
          topic `test`"]
    );
    assert_eq!(
        warnings("# TOPICS other test"),
        ["test.msg:1: the first topic is `other`, not `test` as the file is named"]
    );
    assert!(
        warnings("uint8 x\n#TOPICS a")[0].starts_with("test.msg:2: this line defines no topics")
    );
    assert_eq!(warnings("# TOPICS test other"), [""; 0]);
}

#[test]
fn a_folder_that_is_not_there_or_empty_is_told_with_its_path() {
    let error = Config::new().folder("no/such/folder").generate().unwrap_err();
    assert!(error.to_string().starts_with("no/such/folder: "), "{error}");
    let error = Config::new().folder("src").generate().unwrap_err();
    assert_eq!(error.to_string(), "src: there is no .msg file in this folder");
}

#[test]
fn a_topic_named_self_would_be_the_rust_type_self() {
    check("# TOPICS test self", &["1: topic `self` would be the Rust type `Self`, .."]);
}
