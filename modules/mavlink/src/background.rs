//! `mavlink start`, `status` and `stop`: a bridge that nobody's shell waits for.
//!
//! Who runs is not kept in a file, which could be wrong: whoever publishes
//! `mavlink_status` is a link, and its process a bridge.

use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};

use clap::ValueEnum;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use uorb_core::{Error, Instance, Session, Subscription, now_us};
use uorb_mavlink::outgoing::Mode;
use uorb_modules::{Outcome, Stop};
use uorb_msg::MavlinkStatus;

/// How often to look whether it has come, or has gone.
const LOOK_EVERY_US: u64 = 20_000;

/// How long a bridge may take to end: it looks five times a second.
const END_TIMEOUT_US: u64 = 10_000_000;

/// A link, and what it said last.
struct Running {
    pid: u32,
    status: MavlinkStatus,
}

/// The links of this system.
fn running(session: &Session) -> Result<Vec<Running>, Error> {
    let mut running = Vec::new();
    for instance in Instance::all() {
        if !session.exists("mavlink_status", instance)? {
            continue;
        }
        let mut status = Subscription::<MavlinkStatus>::subscribe_instance(session, instance)?;
        let Some(said) = status.copy() else { continue };
        let peer = status.last_copied().map(|copied| copied.peer);
        let process = peer.map(|peer| session.process(peer)).transpose()?.flatten();
        running.extend(process.map(|process| Running { pid: process.pid, status: said }));
    }
    Ok(running)
}

fn pids(session: &Session) -> Result<BTreeSet<u32>, Error> {
    Ok(running(session)?.iter().map(|link| link.pid).collect())
}

/// Starts this program again, in the background.
pub(super) fn start(stop: &Stop, out: &mut impl Write) -> Outcome {
    let session = Session::connect()?;
    let mut arguments: Vec<_> = std::env::args_os().skip(1).collect();
    arguments.retain({
        let mut is_first = true;
        move |argument| !(argument == "start" && std::mem::take(&mut is_first))
    });
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
            return Err(words.trim().trim_start_matches("mavlink: ").to_string().into());
        }
        if pids(&session)?.contains(&child.id()) {
            break;
        }
    }
    writeln!(out, "[mavlink] started: pid {}", child.id())?;
    Ok(())
}

pub(super) fn status(out: &mut impl Write) -> Outcome {
    let running = running(&Session::connect()?)?;
    if running.is_empty() {
        return Err("none runs; begin with `mavlink start`".into());
    }
    for (number, link) in running.iter().enumerate() {
        print(out, number, link)?;
    }
    Ok(())
}

fn print(out: &mut impl Write, number: usize, link: &Running) -> std::io::Result<()> {
    let Running { pid, status } = link;
    let end = status.link.iter().position(|byte| *byte == 0).unwrap_or(status.link.len());
    let mode = Mode::value_variants().iter().find(|mode| **mode as u8 == status.mode);
    let mode = mode.and_then(|mode| mode.to_possible_value());
    let mode = mode.as_ref().map_or("?", |mode| mode.get_name());
    let signed = if status.is_signed.get() { ", signed" } else { "" };
    writeln!(out, "instance #{number}: {}", String::from_utf8_lossy(&status.link[..end]))?;
    writeln!(
        out,
        "  pid {pid}, mode {mode}, system {}, component {}, MAVLink 2{signed}",
        status.system_id, status.component_id
    )?;
    match status.heard {
        0 => writeln!(out, "  heard: nobody yet")?,
        heard => {
            let ago = now_us().saturating_sub(heard) as f64 / 1e6;
            writeln!(out, "  heard: {ago:.1} s ago")?;
        }
    }
    writeln!(
        out,
        "  tx: {} messages, {:.1} kB/s of {:.1}, rate multiplier {:.3}, dropped {}",
        status.tx_messages,
        f64::from(status.tx_rate) / 1e3,
        f64::from(status.data_rate) / 1e3,
        status.rate_multiplier,
        status.tx_dropped
    )?;
    writeln!(
        out,
        "  rx: {} messages, {:.1} kB/s, lost {}, bad checksum {}, bad signature {}, unknown {}, \
         garbage {} B",
        status.rx_messages,
        f64::from(status.rx_rate) / 1e3,
        status.rx_lost,
        status.rx_bad_checksum,
        status.rx_bad_signature,
        status.rx_unknown,
        status.rx_garbage_bytes
    )?;
    if status.rate_multiplier < 1.0 {
        let percent = status.rate_multiplier * 100.0;
        writeln!(out, "  the link is too slow for its mode: rates are at {percent:.0} %")?;
    }
    Ok(())
}

pub(super) fn stop(stop: &Stop, out: &mut impl Write) -> Outcome {
    let session = Session::connect()?;
    let all = pids(&session)?;
    if all.is_empty() {
        return Err("none runs".into());
    }
    for pid in all {
        kill(Pid::from_raw(pid as i32), Signal::SIGTERM)?;
        let deadline_us = now_us() + END_TIMEOUT_US;
        while pids(&session)?.contains(&pid) {
            if now_us() > deadline_us {
                return Err(format!("pid {pid} does not end: kill -9 {pid} ends it").into());
            }
            if !stop.sleep_until(now_us() + LOOK_EVERY_US) {
                return Ok(());
            }
        }
        writeln!(out, "[mavlink] ended: pid {pid}")?;
    }
    Ok(())
}
