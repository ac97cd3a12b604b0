//! `logger start`, `status` and `stop`: a logger that nobody's shell waits for.
//!
//! Who runs is not kept in a file, which could be wrong: whoever publishes
//! `logger_status` is a logger.

use std::fs;
use std::io::{Read, Write};
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use uorb_core::{Error, Instance, Session, Subscription, now_us};
use uorb_modules::{Outcome, Stop};
use uorb_msg::LoggerStatus;

/// How often to look whether it has come, or has gone.
const LOOK_EVERY_US: u64 = 20_000;

/// How long a disk may take to have the last of a log.
const END_TIMEOUT_US: u64 = 30_000_000;

/// A logger, and what it said last.
struct Running {
    pid: u32,
    status: LoggerStatus,
}

/// The loggers of this system.
fn running(session: &Session) -> Result<Vec<Running>, Error> {
    let mut running = Vec::new();
    for instance in Instance::all() {
        if !session.exists("logger_status", instance)? {
            continue;
        }
        let mut status = Subscription::<LoggerStatus>::subscribe_instance(session, instance)?;
        let Some(said) = status.copy() else { continue };
        let peer = status.last_copied().map(|copied| copied.peer);
        let process = peer.map(|peer| session.process(peer)).transpose()?.flatten();
        running.extend(process.map(|process| Running { pid: process.pid, status: said }));
    }
    Ok(running)
}

pub(super) fn start(stop: &Stop, out: &mut impl Write) -> Outcome {
    let session = Session::connect()?;
    if let Some(logger) = running(&session)?.first() {
        return Err(
            format!("it runs already: pid {}; end it with `logger stop`", logger.pid).into()
        );
    }
    let arguments = std::env::args_os().skip(1).filter(|argument| argument != "start");
    let mut child = Command::new(std::env::current_exe()?)
        .args(arguments)
        .process_group(0)
        .stdin(Stdio::null())
        // Whoever waits for the end of our output must not wait for its.
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()?;
    while stop.sleep_until(now_us() + LOOK_EVERY_US) {
        if child.try_wait()?.is_some() {
            let mut words = String::new();
            if let Some(stderr) = &mut child.stderr {
                stderr.read_to_string(&mut words)?;
            }
            return Err(words.trim().trim_start_matches("logger: ").to_string().into());
        }
        if running(&session)?.iter().any(|logger| logger.pid == child.id()) {
            break;
        }
    }
    writeln!(out, "[logger] started: pid {}", child.id())?;
    Ok(())
}

pub(super) fn status(out: &mut impl Write) -> Outcome {
    let running = running(&Session::connect()?)?;
    if running.is_empty() {
        return Err("none runs; begin with `logger start`".into());
    }
    for Running { pid, status } in running {
        writeln!(out, "[logger] running: pid {pid}")?;
        for file in open_logs(pid) {
            writeln!(out, "Log file: {}", file.display())?;
        }
        let (mb, kb_s) = (status.total_written_kb / 1e3, status.write_rate_kb_s);
        writeln!(out, "Wrote {mb:.2} MB ({kb_s:.2} kB/s), {} topics", status.num_messages)?;
        let (dropouts, lost) = (status.dropouts, status.message_gaps);
        let (used, size) = (status.buffer_used_bytes, status.buffer_size_bytes);
        writeln!(out, "Dropouts: {dropouts} ({lost} messages), buffer: {used} / {size} B")?;
    }
    Ok(())
}

pub(super) fn stop(stop: &Stop, out: &mut impl Write) -> Outcome {
    let session = Session::connect()?;
    let all = running(&session)?;
    if all.is_empty() {
        return Err("none runs".into());
    }
    for Running { pid, .. } in all {
        kill(Pid::from_raw(pid as i32), Signal::SIGTERM)?;
        let deadline_us = now_us() + END_TIMEOUT_US;
        while running(&session)?.iter().any(|logger| logger.pid == pid) {
            if now_us() > deadline_us {
                return Err(format!("pid {pid} does not end: its disk does not answer").into());
            }
            if !stop.sleep_until(now_us() + LOOK_EVERY_US) {
                return Ok(());
            }
        }
        writeln!(out, "[logger] ended: pid {pid}")?;
    }
    Ok(())
}

/// The logs that a process of ours has open.
fn open_logs(pid: u32) -> Vec<PathBuf> {
    let open = fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
    let paths = open.filter_map(|entry| fs::read_link(entry.path()).ok());
    paths.filter(|path| path.extension().is_some_and(|ending| ending == "ulg")).collect()
}
