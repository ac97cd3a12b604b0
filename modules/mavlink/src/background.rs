//! `mavlink start`, `status` and `stop`: a bridge that nobody's shell waits for.

use std::collections::BTreeSet;
use std::io::Write;

use clap::ValueEnum;
use uorb_core::{Session, now_us};
use uorb_mavlink::outgoing::Mode;
use uorb_modules::background::{self, running};
use uorb_modules::{Outcome, Stop};
use uorb_msg::MavlinkStatus;

/// How long a bridge may take to end: it looks five times a second.
const END_TIMEOUT_US: u64 = 10_000_000;

/// A link, and what it said last.
type Running = background::Running<MavlinkStatus>;

/// Starts this program again, in the background.
pub(super) fn start(stop: &Stop, out: &mut impl Write) -> Outcome {
    let session = Session::connect()?;
    let mut arguments: Vec<_> = std::env::args_os().skip(1).collect();
    arguments.retain({
        let mut is_first = true;
        move |argument| !(argument == "start" && std::mem::take(&mut is_first))
    });
    if let Some(pid) = background::start::<MavlinkStatus>(&session, arguments, stop)? {
        writeln!(out, "[mavlink] started: pid {pid}")?;
    }
    Ok(())
}

pub(super) fn status(out: &mut impl Write) -> Outcome {
    let running = running::<MavlinkStatus>(&Session::connect()?)?;
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
    // A bridge has a status for each of its links.
    let all: BTreeSet<u32> =
        running::<MavlinkStatus>(&session)?.iter().map(|link| link.pid).collect();
    if all.is_empty() {
        return Err("none runs".into());
    }
    for pid in all {
        if !background::end::<MavlinkStatus>(&session, pid, END_TIMEOUT_US, stop)? {
            if stop.requested() {
                return Ok(());
            }
            return Err(format!("pid {pid} does not end: kill -9 {pid} ends it").into());
        }
        writeln!(out, "[mavlink] ended: pid {pid}")?;
    }
    Ok(())
}
