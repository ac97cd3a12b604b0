//! How the command behaves where no broker runs: words, streams, exit codes.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A directory in which no system is.
fn nowhere() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("nowhere")
}

fn run(program: &Path, arguments: &[&str]) -> Output {
    Command::new(program)
        .args(arguments)
        .env("UORB_DIR", nowhere())
        .env_remove("UORB_SYSTEM")
        .output()
        .expect("the command runs")
}

fn uorb(arguments: &[&str]) -> Output {
    run(env!("CARGO_BIN_EXE_uorb").as_ref(), arguments)
}

fn words(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).expect("words are UTF-8")
}

#[test]
fn without_a_broker_every_command_says_how_to_start_one() {
    let commands: [&[&str]; 6] = [
        &["status"],
        &["ls", "/obj"],
        &["listener", "sensor_accel"],
        &["info", "sensor_accel"],
        &["pub", "orb_test", "val=1"],
        &["test", "test_single"],
    ];
    for arguments in commands {
        let output = uorb(arguments);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        let words = words(&output);
        let socket = nowhere().join("0/broker.sock");
        assert!(words.contains("`uorb start`"), "{arguments:?}: {words}");
        assert!(words.contains(socket.to_str().unwrap()), "{arguments:?}: {words}");
        assert!(output.stdout.is_empty(), "{arguments:?} prints data");
    }
    assert!(!nowhere().exists(), "looking makes nothing");
}

#[test]
fn to_stop_what_does_not_run_is_no_error() {
    let output = uorb(&["--system", "3", "stop"]);
    assert_eq!(output.status.code(), Some(0));
    assert_eq!(words(&output), format!("uorb: not running at {}/3\n", nowhere().display()));
}

#[test]
fn a_command_line_that_makes_no_sense_has_its_own_exit_code() {
    let nonsense: [&[&str]; 9] = [
        &[],
        &["lisener", "sensor_accel"],
        &["listener"],
        &["listener", "sensor_accel", "-i", "10"],
        &["listener", "sensor_accel", "5", "-n", "6"],
        &["listener", "sensor_accel", "-r", "0"],
        &["listener", "sensor_accel", "--json", "--csv"],
        &["pub", "orb_test", "--priority", "256"],
        &["test", "test_nothing"],
    ];
    for arguments in nonsense {
        assert_eq!(uorb(arguments).status.code(), Some(2), "{arguments:?}");
    }
    let instance = words(&uorb(&["listener", "sensor_accel", "-i", "10"]));
    assert!(instance.contains("instance 10 is not in 0..9"), "{instance}");
}

#[test]
fn a_number_below_its_range_is_told_the_range() {
    let listener = ["listener", "sensor_accel"];
    let publish = ["pub", "orb_test"];
    let replay = ["replay", "flight.ulg"];
    for (command, number, range) in [
        (&listener[..], &["-i", "-1"][..], "it is not in 0..9"),
        (&listener, &["-n", "-3"], "it is not a number from 1 up"),
        (&listener, &["-3"], "it is not a number from 1 up"),
        (&listener, &["-r", "-1"], "it is not a number from 0.000001 to 1000000000"),
        (&listener, &["--timeout", "-1"], "it is not a number from 0.000001 to 1000000000"),
        (&publish, &["-i", "-1"], "it is not in 0..9"),
        (&publish, &["-n", "-3"], "it is not a number from 1 up"),
        (&publish, &["-r", "-0.5"], "it is not a number from 0.000001 to 1000000000"),
        (&publish, &["--priority", "-1"], "-1 is not in 0..=255"),
        (&replay, &["--speed", "-1"], "neither a number above 0 nor `max`"),
        (&replay, &["--start", "-1"], "not a number from 0 up"),
        (&replay, &["--queue", "-1"], "-1 is not in 1..=128"),
        (&replay, &["--queue", "129"], "129 is not in 1..=128"),
        (&["info", "orb_test"], &["--window", "-1"], "it is not a number from 0 to 3600"),
    ] {
        let output = uorb(&[command, number].concat());
        assert_eq!(output.status.code(), Some(2), "{command:?} {number:?}");
        let words = words(&output);
        assert!(words.contains(range), "{command:?} {number:?}: {words}");
    }
}

#[test]
fn a_system_s_number_is_one() {
    let output = Command::new(env!("CARGO_BIN_EXE_uorb"))
        .arg("ls")
        .env("UORB_SYSTEM", "one")
        .output()
        .expect("the command runs");
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(words(&output), "uorb: UORB_SYSTEM=\"one\" is not a number, 0 and up\n");
}

#[test]
fn under_the_name_of_the_listener_it_is_the_listener() {
    for name in ["listener", "px4-listener"] {
        let link = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        let _ = std::fs::remove_file(&link);
        std::os::unix::fs::symlink(env!("CARGO_BIN_EXE_uorb"), &link).expect("a link");
        let help = run(&link, &["--help"]);
        let help = String::from_utf8(help.stdout).expect("help is UTF-8");
        assert!(help.starts_with("Show the messages of a topic"), "{help}");
        assert!(help.contains(&format!("Usage: {name} [OPTIONS] <TOPIC> [COUNT]")), "{help}");
        let output = run(&link, &["sensor_accel", "5"]);
        assert_eq!(output.status.code(), Some(1));
        std::fs::remove_file(&link).expect("it is ours");
    }
}

#[test]
fn the_shell_completes_topics() {
    let completed = Command::new(env!("CARGO_BIN_EXE_uorb"))
        .args(["--", "uorb", "listener", "sensor_a"])
        .env("UORB_DIR", nowhere())
        .env("UORB_COMPLETE", "bash")
        .env("_CLAP_COMPLETE_INDEX", "2")
        .env("_CLAP_IFS", "\n")
        .output()
        .expect("the command runs");
    assert_eq!(String::from_utf8_lossy(&completed.stdout).trim_end(), "sensor_accel");
}

#[test]
fn every_command_has_a_page_in_the_manual() {
    for command in [&["man"][..], &["man", "listener"], &["man", "pub"]] {
        let page = uorb(command);
        assert_eq!(page.status.code(), Some(0));
        assert!(String::from_utf8_lossy(&page.stdout).contains(".SH NAME"), "{command:?}");
    }
    assert_eq!(
        words(&uorb(&["man", "lisener"])),
        "uorb: no command \"lisener\" of `uorb`; did you mean listener?\n"
    );
}
