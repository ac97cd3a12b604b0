//! `logger start`, `status` and `stop`: a logger that nobody's shell waits for.

use std::fs;
use std::io::Write;
use std::path::PathBuf;

use uorb_core::Session;
use uorb_modules::background::{self, Running, running};
use uorb_modules::{Outcome, Stop};
use uorb_msg::LoggerStatus;

/// How long a disk may take to have the last of a log.
const END_TIMEOUT_US: u64 = 30_000_000;

pub(super) fn start(stop: &Stop, out: &mut impl Write) -> Outcome {
    let session = Session::connect()?;
    if let Some(logger) = running::<LoggerStatus>(&session)?.first() {
        return Err(
            format!("it runs already: pid {}; end it with `logger stop`", logger.pid).into()
        );
    }
    let arguments = std::env::args_os().skip(1).filter(|argument| argument != "start");
    if let Some(pid) = background::start::<LoggerStatus>(&session, arguments, stop)? {
        writeln!(out, "[logger] started: pid {pid}")?;
    }
    Ok(())
}

pub(super) fn status(out: &mut impl Write) -> Outcome {
    let running = running::<LoggerStatus>(&Session::connect()?)?;
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
    let all = running::<LoggerStatus>(&session)?;
    if all.is_empty() {
        return Err("none runs".into());
    }
    for Running { pid, .. } in all {
        if !background::end::<LoggerStatus>(&session, pid, END_TIMEOUT_US, stop)? {
            if stop.requested() {
                return Ok(());
            }
            return Err(format!("pid {pid} does not end: its disk does not answer").into());
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
