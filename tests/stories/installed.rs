//! `uorb msg`, what `scripts/install` makes, and programs in C built with both.

use std::fmt::Write;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::SystemTime;

use uorb_core::{FieldType, Layout};
use uorb_msg::{SensorAccel, TOPICS};
use uorb_tests::{Bus, Installed, Language, is_there, program};

const REPOSITORY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// An empty directory of a story's own.
fn directory(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("installed").join(name);
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).expect("a directory of its own");
    path
}

fn words(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Checks that a command went well, and returns what it printed.
#[track_caller]
fn fine(command: &mut Command) -> String {
    let output = command.output().expect("it runs");
    let printed = String::from_utf8(output.stdout.clone()).expect("UTF-8");
    assert!(output.status.success(), "{command:?}: {printed}{}", words(&output));
    printed
}

/// Runs `uorb msg` in a directory.
fn uorb_msg(directory: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(program("uorb"));
    command.arg("msg").args(arguments).current_dir(directory).output().expect("it runs")
}

/// What a program in C is told of all topics, in the words of the program below.
fn described() -> String {
    let mut text = String::new();
    for (id, topic) in TOPICS.iter().enumerate() {
        let layout = &topic.layout;
        let (size, size_no_padding) = (layout.size_bytes, layout.size_no_padding_bytes());
        let (hash, queue) = (layout.message_hash, topic.queue_length.get());
        let (name, o_fields) = (&topic.name, layout.o_fields());
        let _ =
            writeln!(text, "{name} {size} {size_no_padding} {hash:08x} {id} {queue} {o_fields}");
        describe(&mut text, layout);
    }
    text
}

fn describe(text: &mut String, layout: &Layout) {
    let Layout { name, message_hash, size_bytes, fields } = layout;
    let _ = writeln!(text, "{name} {message_hash:08x} {size_bytes} {}", fields.len());
    for field in &**fields {
        // With its length, which stands in a column of its own.
        let ty = field.c_type();
        let ty = ty.split('[').next().expect("one at least");
        let (length, offset) = (field.array_length.unwrap_or(0), field.offset_bytes);
        let _ = writeln!(text, "\t{ty} {length} {} {offset} \"{}\"", field.name, field.unit);
        if let FieldType::Message(inner) = &field.ty {
            describe(text, inner);
        }
    }
}

const DESCRIBES_TOPICS: &str = r#"
#include <stdio.h>
#include <uORB/topics/sensor_accel.h>
#include <uORB/topics/uORBTopics.h>

static void describe(const struct orb_layout *layout)
{
	printf("%s %08x %u %u\n", layout->name, layout->message_hash, layout->size, layout->field_count);

	for (unsigned i = 0; i < layout->field_count; i++) {
		const struct orb_field *field = &layout->fields[i];

		printf("\t%s %u %s %u \"%s\"\n", field->type, field->array_length, field->name, field->offset,
		       field->unit);

		if (field->nested != NULL) {
			describe(field->nested);
		}
	}
}

int main(void)
{
#ifdef __cplusplus
	const struct orb_metadata *accel = get_orb_meta(ORB_ID::sensor_accel);
	const struct orb_metadata *none = get_orb_meta(ORB_ID::INVALID);
#else
	const struct orb_metadata *accel = get_orb_meta(ORB_ID_sensor_accel);
	const struct orb_metadata *none = get_orb_meta(ORB_ID_INVALID);
#endif

	if (accel != ORB_ID(sensor_accel) || none != NULL || orb_get_topics()[orb_topics_count()] != NULL) {
		return 1;
	}

	for (size_t i = 0; i < ORB_TOPICS_COUNT; i++) {
		const struct orb_metadata *topic = orb_get_topics()[i];

		printf("%s %u %u %08x %u %u %s\n", topic->o_name, topic->o_size, topic->o_size_no_padding,
		       topic->message_hash, topic->o_id, topic->o_queue, topic->o_fields);
		describe(topic->o_layout);
	}

	return 0;
}
"#;

#[test]
fn a_program_in_c_or_cpp_is_told_of_all_topics_what_one_in_rust_is() {
    if !is_there("pkg-config") || !is_there("c++") {
        return;
    }
    let installed = Installed::get();
    for (language, ending) in [(Language::C, "c"), (Language::Cpp, "cpp")] {
        let source = directory(ending).join(format!("describes_topics.{ending}"));
        fs::write(&source, DESCRIBES_TOPICS).unwrap();

        let name = format!("describes_topics_{ending}");
        let program = installed.compile(language, &[&source], &name, &["-Wpedantic"]).unwrap();

        let printed = fine(&mut Command::new(program));
        for (printed, expected) in printed.lines().zip(described().lines()) {
            assert_eq!(printed, expected, "in {ending}");
        }
        assert_eq!(printed.len(), described().len());
    }
}

#[test]
fn what_does_not_compile_comes_with_the_compilers_words() {
    if !is_there("pkg-config") {
        return;
    }
    let source = directory("wrong").join("wrong.c");
    fs::write(&source, "#include <uORB/uORB.h>\nint main(void) { return none; }\n").unwrap();

    let words = Installed::get().compile(Language::C, &[&source], "wrong", &[]).unwrap_err();

    assert!(words.contains("none"), "{words}");
}

#[test]
fn uorb_msg_compiles_a_folder() {
    let here = directory("msg");
    fs::create_dir(here.join("mine")).unwrap();
    fs::write(here.join("mine/Wheel.msg"), "float32 speed\nesc_report motor\n").unwrap();
    fs::write(here.join("mine/picture.msg"), "uint8[70000] data\n").unwrap();

    let search = format!("{REPOSITORY}/msg");
    let done = uorb_msg(&here, &["mine", "--search", &search, "-o", "made/here"]);

    assert!(done.status.success() && done.stdout.is_empty(), "{}", words(&done));
    assert!(
        words(&done).starts_with("uorb: warning: mine/picture.msg: topic picture: 70008 bytes")
    );
    assert_eq!(words(&done).lines().count(), 1, "{}", words(&done));
    for made in ["include/uORB/topics/wheel.h", "include/uORB/uORBTopics.h", "src/esc_report.c"] {
        assert!(here.join("made/here").join(made).is_file(), "no {made}");
    }

    fs::remove_file(here.join("mine/picture.msg")).unwrap();
    let done = uorb_msg(&here, &["mine", "--search", &search, "-o", "made/here"]);
    let removed = "made/here/include/uORB/topics/picture.h";
    assert_eq!(words(&done), format!("uorb: removed {removed}: an earlier run wrote it\n"));
}

#[test]
fn uorb_msg_tells_all_faults_and_writes_nothing() {
    let here = directory("faults");
    fs::create_dir(here.join("mine")).unwrap();
    fs::write(here.join("mine/a.msg"), "float x\nuint8 linux\n").unwrap();

    let done = uorb_msg(&here, &["mine"]);

    assert_eq!((done.status.code(), done.stdout.len()), (Some(1), 0));
    let words = words(&done);
    for fault in ["2 errors", "mine/a.msg:1: unknown type `float`", "mine/a.msg:2: field `linux`"] {
        assert!(words.contains(fault), "no {fault} in {words}");
    }
    assert!(!here.join("generated").exists());
}

#[test]
fn uorb_msg_names_the_folder_that_it_cannot_read_or_write() {
    let here = directory("unwritable");
    fs::create_dir(here.join("mine")).unwrap();
    fs::create_dir(here.join("empty")).unwrap();
    fs::write(here.join("mine/a.msg"), "uint8 x\n").unwrap();
    fs::write(here.join("file"), "").unwrap();
    for (arguments, expected) in [
        (&["nowhere"][..], "uorb: nowhere: No such file"),
        (&["empty"], "uorb: empty: there is no .msg file"),
        (&["mine", "-o", "file/below"], "uorb: file/below/include/uORB/topics: Not a directory"),
    ] {
        let done = uorb_msg(&here, arguments);
        assert_eq!(done.status.code(), Some(1), "{arguments:?}");
        assert!(words(&done).starts_with(expected), "{}", words(&done));
    }
    assert_eq!(uorb_msg(&here, &[]).status.code(), Some(2));
}

/// Checks a program of `uorb-c/examples/build`.
fn check_odometer(odometer: &Path) {
    let mut bus = Bus::start();
    let mut accel = bus.advertise::<SensorAccel>();
    accel.publish(&SensorAccel { x: 0.5, y: -0.25, z: -9.81, ..Default::default() }).unwrap();

    let printed = fine(&mut bus.command(odometer));

    let expected = "wheel 0: 10.0 rad/s\nwheel 1: 11.0 rad/s\nwheel 2: 12.0 rad/s\n\
                    wheel 3: 13.0 rad/s\nacceleration: 0.50 -0.25 -9.81 m/s^2\n";
    assert_eq!(printed, expected);
    assert!(bus.uorb(&["info", "wheel_speed"]).fine().contains("rad/s"));
}

fn example(file: &str) -> String {
    format!("{REPOSITORY}/uorb-c/examples/build/{file}")
}

#[test]
fn make_builds_the_example_and_again_only_what_has_changed() {
    if !is_there("make") || !is_there("pkg-config") {
        return;
    }
    let (installed, here) = (Installed::get(), directory("make"));
    fs::create_dir(here.join("messages")).unwrap();
    for file in ["Makefile", "odometer.c", "messages/wheel_speed.msg"] {
        fs::copy(example(file), here.join(file)).unwrap();
    }
    let make =
        || fine(installed.command("make").arg("CFLAGS=-Wall -Wextra -Werror").current_dir(&here));

    make();

    check_odometer(&here.join("odometer"));
    assert!(make().contains("up to date"));
    let write_message = |text: &str| {
        fs::write(here.join("messages/wheel_speed.msg"), text).unwrap();
        // Times of files may be too coarse to tell what was written last.
        let stamp = fs::File::open(here.join("generated/stamp")).unwrap();
        stamp.set_modified(SystemTime::UNIX_EPOCH).unwrap();
    };
    let text = fs::read_to_string(example("messages/wheel_speed.msg")).unwrap();
    write_message(&text);
    let said = make();
    assert!(said.contains("uorb msg") && !said.contains(" -c "), "{said}");
    write_message(&text.replace("float32 speed", "float64 speed"));
    let said = make();
    assert!(said.contains("-o odometer.o") && said.contains("-o odometer "), "{said}");
    assert!(make().contains("up to date"));
}

#[test]
fn cmake_builds_the_example() {
    if !is_there("cmake") {
        return;
    }
    let (installed, here) = (Installed::get(), directory("cmake"));
    let mut cmake = installed.command("cmake");
    fine(cmake.arg("-S").arg(example("")).arg("-B").arg(&here).arg("-DCMAKE_C_FLAGS=-Werror"));

    fine(installed.command("cmake").arg("--build").arg(&here));

    check_odometer(&here.join("odometer"));
}

#[test]
fn cmake_makes_a_program_of_a_module_of_px4() {
    let (installed, here) = (Installed::get(), directory("module"));
    if !is_there("cmake") {
        return;
    }
    let lists = "cmake_minimum_required(VERSION 3.16)\nproject(modules)\n\
        find_package(uorb REQUIRED)\n\
        px4_add_module(MODULE modules__one MAIN one STACK_MAIN 2000 SRCS one.cpp\n\
        COMPILE_FLAGS -Werror DEPENDS px4_work_queue)\n\
        px4_add_module(MODULE modules__two MAIN two SRCS two.c)\n";
    let one = "extern \"C\" int one_main(int, char *[]);\n\
        int one_main(int, char *[])\n{\n\treturn MODULE_NAME[0] != 'o';\n}\n";
    let two = "int two_main(int argc, char *argv[]);\n\
        int two_main(int argc, char *argv[])\n{\n\treturn argc + (argv == 0) - 1;\n}\n";
    for (file, text) in [("CMakeLists.txt", lists), ("one.cpp", one), ("two.c", two)] {
        fs::write(here.join(file), text).unwrap();
    }
    fine(installed.command("cmake").arg("-S").arg(&here).arg("-B").arg(&here));

    fine(installed.command("cmake").arg("--build").arg(&here));

    for module in ["one", "two"] {
        fine(&mut Bus::start().command(&here.join(module)));
    }
}

#[test]
fn install_says_what_it_misses() {
    let here = directory("install");
    let script = format!("{REPOSITORY}/scripts/install");
    let install = |prefix: &str, set: &[(&str, &str)]| {
        let mut command = Command::new(&script);
        command.args(["--no-build", "--debug", "--prefix", prefix]).envs(set.iter().copied());
        let output = command.current_dir(&here).output().expect("it runs");
        assert_eq!((output.status.code(), output.stdout.len()), (Some(1), 0));
        words(&output)
    };

    assert!(install("a", &[("CC", "no-such-cc")]).starts_with("install: no no-such-cc in PATH"));
    let nowhere = here.to_str().unwrap();
    let words = install("b", &[("CARGO_TARGET_DIR", nowhere)]);
    assert!(words.contains("debug/uorb is not built: leave out --no-build"), "{words}");
    assert_eq!(fs::read_dir(here.join("b")).unwrap().count(), 0, "it wrote before it looked");
    fs::write(here.join("file"), "").unwrap();
    assert!(install("file", &[]).starts_with("install: cannot write to file: "));
    let usage = Command::new(&script).output().unwrap();
    assert_eq!(usage.status.code(), Some(2));
}

#[test]
fn an_installed_tree_is_complete() {
    let prefix = Installed::get().prefix;
    for file in [
        "bin/uorbd",
        "bin/sensor_sim",
        "include/uORB/topics/uORBTopics.hpp",
        "lib/libuorb.a",
        "lib/libuorb_px4.a",
        "share/man/man1/uorb-msg.1",
        "share/man/man1/uorb-ulog-info.1",
        "share/uorb/msg/sensor_accel.msg",
    ] {
        assert!(prefix.join(file).is_file(), "no {file}");
    }
    for (link, file) in [("bin/listener", "uorb"), ("lib/libuorb.so", "libuorb.so.0")] {
        assert_eq!(fs::read_link(prefix.join(link)).unwrap(), Path::new(file));
    }
    let mode = fs::metadata(prefix.join("bin/uorb")).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o755);
    let library = fs::read(prefix.join("lib/libuorb.so.0")).unwrap();
    assert!(library.windows(13).any(|bytes| bytes == b"libuorb.so.0\0"), "it has no such soname");
}
