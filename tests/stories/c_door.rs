//! The C door: its headers, its symbols, and what PX4's functions and classes do.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use nix::sys::signal::Signal;
use uorb_tests::{Actor, Bus, Installed, Language, is_there};

/// A program of tests/c.
pub(crate) fn source(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("c").join(name)
}

/// Compiles a program of tests/c that is one file.
fn compile(file: &str, flags: &[&str]) -> PathBuf {
    let (name, ending) = file.split_once('.').expect("a file has an ending");
    let language = if ending == "c" { Language::C } else { Language::Cpp };
    let flags = [&["-pthread", "-Wpedantic"], flags].concat();
    let program = Installed::get().compile(language, &[&source(file)], name, &flags);
    program.unwrap_or_else(|words| panic!("{words}"))
}

/// Runs a program that says PASS and the name of each of its tests. What it says
/// on stderr is returned.
fn passes(bus: &Bus, program: &Path, tests: &[&str]) -> String {
    let mut command = bus.command(program);
    command.stderr(Stdio::piped());
    let ended = Actor::spawn(command).end();
    assert_eq!(ended.code, 0, "{}{}", ended.out, ended.words);
    let passed = ended.out.lines().filter_map(|line| line.strip_prefix("PASS "));
    assert_eq!(passed.collect::<Vec<_>>(), tests);
    ended.words
}

#[test]
fn px4s_unit_tests_pass_through_the_c_door() {
    let bus = Bus::start();
    let words = passes(
        &bus,
        &compile("unit_test.cpp", &[]),
        &[
            "test_single",
            "test_SubscriptionMulti",
            "test_multi",
            "test_multi_reversed",
            "test_unadvertise",
            "test_multi2",
            "test_wrap_around",
            "test_queue",
            "test_queue_poll_notify",
            "latency_test",
            "test_single_unadvertise",
            "updated_subscribes",
        ],
    );
    assert_eq!(words, "");
}

#[test]
fn what_px4s_unit_tests_leave_out_holds_in_c() {
    let bus = Bus::start();
    let words = passes(
        &bus,
        &compile("edges.c", &[]),
        &[
            "nothing_is_published_yet",
            "an_unadvertised_topic_keeps_its_last_message",
            "a_copy_to_nowhere_takes_all_as_seen",
            "null_is_an_errno",
            "a_handle_that_is_none_is_found_out",
            "the_eleventh_instance_is_refused",
            "a_reader_far_behind_gets_the_newest",
            "queues_are_deepened_before_the_first_publish",
            "an_interval_hides_updates_until_it_ends",
            "poll_epoll_and_px4_poll_agree",
            "a_hundred_waiters_are_woken_by_one_publish",
        ],
    );
    // Two calls were refused that a user would want to hear of.
    let words: Vec<&str> = words.lines().collect();
    let [advertise, subscribe] = words[..] else { panic!("{words:?}") };
    assert!(advertise.contains("orb_advertise_multi number: ") && advertise.contains("10"));
    assert!(subscribe.contains("orb_subscribe_multi number: ") && subscribe.contains("10"));
}

#[test]
fn every_method_of_the_classes_does_what_px4s_does() {
    let bus = Bus::start();
    let words = passes(
        &bus,
        &compile("classes.cpp", &[]),
        &[
            "a_publication_is_a_pointer",
            "a_publication_advertises_when_it_first_publishes",
            "a_publication_of_a_queue_stays_advertised",
            "a_publication_may_ask_for_a_queue",
            "publications_and_subscriptions_may_have_their_message_within",
            "publications_of_instances_claim_the_lowest",
            "a_subscription_looks_for_its_node_at_every_call",
            "a_copy_of_a_subscription_has_seen_nothing",
            "a_subscription_changes_to_an_instance_that_exists",
            "an_array_follows_all_instances",
            "an_interval_hides_updates_until_it_ends",
            "a_callback_is_called_after_each_publish",
            "a_blocking_subscription_loses_no_wake",
            "a_blocking_subscription_keeps_up_with_a_fast_publisher",
            "a_blocking_subscription_waits_no_longer_than_it_is_told",
        ],
    );
    // The same refusal three times, said once.
    assert_eq!(words.lines().count(), 1, "{words}");
    assert!(words.contains("orb_advertise_multi_queue instances: "), "{words}");
}

#[test]
fn a_module_has_px4s_tasks_log_time_and_options() {
    let installed = Installed::get();
    let [main] = &installed.pkg_config(&["--variable=px4_main"])[..] else {
        panic!("pkg-config says where px4_main.c is")
    };
    let sources = [source("px4_shims.c"), main.into()];
    let sources = sources.each_ref().map(PathBuf::as_path);
    let flags = ["-Wpedantic", "-DPX4_MAIN=px4_shims"];
    let program = installed.compile(Language::C, &sources, "px4_shims", &flags);

    let bus = Bus::start();
    let mut command = bus.command(&program.unwrap_or_else(|words| panic!("{words}")));
    command.arg("hello").stderr(Stdio::piped());
    let ended = Actor::spawn(command).end();

    // err(4, ..) in the module's own thread ends the program, after its tasks.
    assert_eq!((ended.code, &*ended.words), (4, ""), "{}", ended.out);
    assert_eq!(
        ended.out,
        "INFO  [px4_shims] hello\n\
         WARN  [px4_shims] a warning\n\
         ERROR [px4_shims] an error: 7\n\
         PANIC [px4_shims] panic\n\
         raw\n\
         WARN  [px4_shims] warnx\n\
         INFO  [px4] Active Tasks:\n\
         INFO  [px4]    No running tasks\n\
         ERROR [px4_shims] err\n\
         ERROR [px4_shims] Task exited with errno=2 (No such file or directory)\n\
         INFO  [px4_shims] the last task ends\n"
    );
}

#[test]
fn the_classes_bring_px4s_words_to_modules_and_to_nobody_else() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("words");
    fs::create_dir_all(&folder).unwrap();
    let classes = "#include <uORB/PublicationMulti.hpp>\n\
        #include <uORB/SubscriptionBlocking.hpp>\n\
        #include <uORB/SubscriptionMultiArray.hpp>\n";
    let compile = |name: &str, text: &str, flags: &[&str]| {
        let source = folder.join(format!("{name}.cpp"));
        fs::write(&source, format!("{classes}{text}")).unwrap();
        let program = Installed::get().compile(Language::Cpp, &[&source], name, flags);
        program.unwrap_or_else(|words| panic!("{words}"));
    };
    let module = "int main() { PX4_INFO(\"%d\", hrt_absolute_time() > 0); return PX4_OK + OK; }";
    compile("words_of_px4", module, &["-DMODULE_NAME=\"words\""]);
    let other = "enum class Status { OK, ERROR };\n\
        static int warn(int err) { return err; }\n\
        int main() { return warn(static_cast<int>(Status::OK)); }";
    compile("words_of_others", other, &[]);
}

/// All headers below a directory.
fn headers(directory: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(directory).expect("it is installed").flatten();
    let below = entries.flat_map(|entry| match entry.path() {
        path if path.is_dir() => headers(&path),
        path => vec![path],
    });
    let mut found: Vec<PathBuf> = below.collect();
    found.sort();
    found
}

#[test]
fn every_public_header_compiles_alone_as_c_and_as_cpp() {
    let installed = Installed::get();
    let include = installed.prefix.join("include");
    let all = headers(&include);
    for expected in ["uORB/uORB.h", "uORB/Subscription.hpp", "uorb-px4/px4_log.h"] {
        assert!(all.contains(&include.join(expected)), "{expected}");
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("headers");
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    let check = |compiler: &str, standard: &str, ending: &str| {
        // One compiler for all of them: it names the header that it does not like.
        let sources: Vec<PathBuf> = all
            .iter()
            .enumerate()
            .filter(|(_, header)| ending == "cpp" || header.extension().unwrap() == "h")
            .map(|(number, header)| {
                let source = folder.join(format!("header{number}.{ending}"));
                let header = header.strip_prefix(&include).unwrap().display().to_string();
                let header = header.trim_start_matches("uorb-px4/").to_string();
                // Twice, and something of its own: an empty file is not C.
                let text = format!("#include <{header}>\n#include <{header}>\nextern int it;\n");
                fs::write(&source, text).unwrap();
                source
            })
            .collect();
        assert!(sources.len() > 60, "{} headers", sources.len());
        let mut command = installed.command(compiler);
        command.args([standard, "-fsyntax-only", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]);
        command.args(installed.pkg_config(&["--cflags"])).args(&sources);
        let done = command.output().expect("it runs");
        let words = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success(), "{compiler} {standard}: {words}");
    };
    check("cc", "-std=c11", "c");
    check("c++", "-std=c++14", "cpp");
    check("c++", "-std=c++17", "cpp");
}

/// What a command prints.
fn printed(command: &mut Command) -> String {
    let done = command.stderr(Stdio::inherit()).output().expect("it runs");
    assert!(done.status.success(), "{command:?}");
    String::from_utf8(done.stdout).expect("UTF-8")
}

#[test]
fn the_library_exports_exactly_what_its_headers_declare() {
    let installed = Installed::get();
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let (source, prototypes) = (folder.join("declared.c"), folder.join("declared.txt"));
    fs::write(&source, "#include <uORB/uORBFollower.h>\n#include <px4_platform_common/posix.h>\n")
        .unwrap();
    let mut command = installed.command("cc");
    command.args(["-std=gnu11", "-fsyntax-only", "-aux-info"]).arg(&prototypes);
    printed(command.args(installed.pkg_config(&["--cflags"])).arg(&source));
    let declared: BTreeSet<String> = fs::read_to_string(&prototypes)
        .unwrap()
        .lines()
        .filter_map(|line| {
            // /* .../uORB.h:199:NC */ extern int orb_advertise (const struct ...);
            let (place, prototype) = line.split_once(" */ extern ")?;
            let (before, _) = prototype.split_once(" (")?;
            let name = before.rsplit([' ', '*']).next()?;
            let is_ours = place.contains("/uORB/") || name == "px4_poll";
            is_ours.then(|| name.to_string())
        })
        .collect();

    let library = installed.prefix.join("lib/libuorb.so");
    let mut command = installed.command("nm");
    command.args(["-D", "--defined-only", "--format=just-symbols"]).arg(library);
    let exported: BTreeSet<String> = printed(&mut command).lines().map(str::to_string).collect();

    assert!(declared.len() > 25, "{declared:?}");
    assert_eq!(exported, declared);
}

/// Runs a program under valgrind to its end, or until it has printed this, and
/// returns what valgrind has found.
pub(crate) fn valgrind(bus: &Bus, name: &str, program: &Path, arguments: &[&str], until: &str) {
    let log = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("valgrind-{name}.txt"));
    let mut command = bus.command(Path::new("valgrind"));
    // Fair: a thread that is busy would keep the others from ever running.
    command.args(["--leak-check=full", "--errors-for-leak-kinds=definite", "--fair-sched=try"]);
    // Nothing is left in /tmp when it is ended.
    command.arg("--vgdb=no");
    command.arg(format!("--log-file={}", log.display())).arg(program).args(arguments);
    let mut actor = Actor::spawn(command);
    if !until.is_empty() {
        actor.until(&[until]);
        actor.signal(Signal::SIGTERM);
    }
    // Valgrind reports before its output ends.
    while actor.line().is_some() {}
    let found = fs::read_to_string(&log).expect("valgrind has written it");
    assert!(found.contains("ERROR SUMMARY: 0 errors from 0 contexts"), "{name}: {found}");
}

#[test]
fn the_functions_and_the_classes_are_clean_under_valgrind() {
    if !is_there("valgrind") {
        return;
    }
    for (language, file) in [(Language::C, "edges.c"), (Language::Cpp, "classes.cpp")] {
        let bus = Bus::start();
        let name = format!("{}_valgrind", file.replace('.', "_"));
        let flags = ["-pthread", "-DFEWER"];
        let program = Installed::get().compile(language, &[&source(file)], &name, &flags);
        valgrind(&bus, &name, &program.unwrap_or_else(|words| panic!("{words}")), &[], "");
    }
}
