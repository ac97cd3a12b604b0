//! What `scripts/install` makes, and programs in C built with it.

use std::fs;
use std::path::{Path, PathBuf};

use uorb_tests::{Installed, Language};

/// A directory of a story's own, empty.
fn directory(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("installed").join(name);
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).expect("a directory of its own");
    path
}

/// A program that needs nothing of the library but the topics.
const PRINTS_TOPICS: &str = "
#include <stdio.h>
#include <uORB/topics/sensor_accel.h>
#include <uORB/topics/uORBTopics.h>

int main()
{
	printf(\"%zu %s\\n\", orb_topics_count(), (ORB_ID(sensor_accel))->o_fields);
	for (const struct orb_metadata *const *topic = orb_get_topics(); *topic != NULL; topic++) {
		printf(\"%s\\n\", (*topic)->o_name);
	}
	return 0;
}
";

#[test]
fn a_program_is_built_with_the_words_of_pkg_config() {
    let installed = Installed::get();
    for (language, ending) in [(Language::C, "c"), (Language::Cpp, "cpp")] {
        let source = directory(ending).join(format!("prints_topics.{ending}"));
        fs::write(&source, PRINTS_TOPICS).unwrap();

        let name = format!("prints_topics_{ending}");
        let program = installed.compile(language, &[&source], &name, &["-Wpedantic"]);

        let printed = installed.command(program.unwrap().to_str().unwrap()).output().unwrap();
        let printed = String::from_utf8(printed.stdout).unwrap();
        let mut lines = printed.lines();
        let topics: Vec<&str> = uorb_msg::TOPICS.iter().map(|topic| &*topic.name).collect();
        let accel = &uorb_msg::OrbId::SensorAccel.metadata().layout;
        let first = format!("{} {}", topics.len(), accel.o_fields());
        assert_eq!(lines.next(), Some(&*first));
        assert_eq!(lines.collect::<Vec<_>>(), topics);
    }
}

#[test]
fn what_does_not_compile_comes_with_the_compilers_words() {
    let source = directory("wrong").join("wrong.c");
    fs::write(&source, "#include <uORB/uORB.h>\nint main(void) { return none; }\n").unwrap();

    let words = Installed::get().compile(Language::C, &[&source], "wrong", &[]).unwrap_err();

    assert!(words.contains("none"), "{words}");
}
