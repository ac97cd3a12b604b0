//! The broker of a run and its processes: started, killed, stopped, by their
//! process ids.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use uorb_core::now_us;
use uorb_tests::{Bus, program};

use crate::ledger::{Cell, Ledger, Word};

/// What is to happen to a process at a fail point.
#[derive(Clone, Debug)]
pub(crate) struct Fate {
    pub(crate) variable: &'static str,
    pub(crate) place: String,
}

pub(crate) fn signal(pid: u32, signal: Signal) {
    let _ = kill(Pid::from_raw(pid as i32), signal);
}

/// The broker that can die between any two steps.
const OF_CHAOS: &str = "uorbd-with-fail-points";

/// The broker of this build, in and out of life.
#[derive(Debug)]
pub(crate) struct Broker {
    child: Option<Child>,
    /// When there was none, in microseconds; the last may still be open.
    pub(crate) down_us: Vec<(u64, u64)>,
    program: PathBuf,
    /// Whether it is to die somewhere.
    fate: Option<String>,
    /// Where it died of its fate.
    pub(crate) died_at: Vec<String>,
}

impl Broker {
    pub(crate) fn new() -> Self {
        let program = program(OF_CHAOS);
        Self {
            child: None,
            down_us: vec![(now_us(), u64::MAX)],
            program,
            fate: None,
            died_at: Vec::new(),
        }
    }

    /// Starts one. False: it died while it started.
    pub(crate) fn start(&mut self, bus: &Bus, fate: Option<&Fate>) -> anyhow::Result<bool> {
        let mut command = command(&self.program, bus);
        if let Some(fate) = fate {
            command.env(fate.variable, &fate.place);
        }
        let (mut child, word) = spawn(command)?;
        match word.trim_end() {
            "ready" => {
                self.fate = fate.map(|fate| fate.place.clone());
                self.child = Some(child);
                if let Some(down) = self.down_us.last_mut() {
                    down.1 = now_us();
                }
                Ok(true)
            }
            "" => {
                child.wait()?;
                self.died_at.extend(fate.map(|fate| fate.place.clone()));
                Ok(false)
            }
            other => anyhow::bail!("the broker says {other:?} when it starts"),
        }
    }

    /// The other build takes the place of the one that runs, as in an upgrade.
    pub(crate) fn upgrade(&mut self, bus: &Bus) -> anyhow::Result<()> {
        let other = match self.program.ends_with(OF_CHAOS) {
            true => "uorbd",
            false => OF_CHAOS,
        };
        self.program = program(other);
        let mut command = command(&self.program, bus);
        command.arg("--replace");
        let down_us = now_us();
        let (child, word) = spawn(command)?;
        anyhow::ensure!(word.trim_end() == "ready", "the new broker says {word:?}");
        self.down_us.push((down_us, now_us()));
        let before = self.child.replace(child);
        before.map(|mut before| before.wait()).transpose()?;
        Ok(())
    }

    /// When the one that runs was ready.
    pub(crate) fn up_us(&self) -> u64 {
        self.down_us.last().map_or(0, |(_, up)| *up)
    }

    pub(crate) fn pid(&self) -> Option<u32> {
        self.child.as_ref().map(Child::id)
    }

    /// Whether it runs. If it has died, notes since when.
    pub(crate) fn runs(&mut self) -> bool {
        let ended = self.child.as_mut().is_some_and(|child| !matches!(child.try_wait(), Ok(None)));
        if ended {
            self.child = None;
            self.died_at.extend(self.fate.take());
            self.down_us.push((now_us(), u64::MAX));
        }
        self.child.is_some()
    }

    /// Instead of one that is to die somewhere, one that is not.
    pub(crate) fn replace_the_fated(&mut self, bus: &Bus) -> anyhow::Result<()> {
        if self.fate.is_some() {
            self.kill();
        }
        if !self.runs() {
            self.start(bus, None)?;
        }
        Ok(())
    }

    pub(crate) fn kill(&mut self) {
        if let Some(mut child) = self.child.take() {
            self.down_us.push((now_us(), u64::MAX));
            let _ = child.kill();
            let _ = child.wait();
        }
    }

    /// Ends the system, and waits for the end.
    pub(crate) fn stop(&mut self) -> anyhow::Result<ExitStatus> {
        let mut child = self.child.take().ok_or_else(|| anyhow::anyhow!("no broker runs"))?;
        signal(child.id(), Signal::SIGTERM);
        Ok(child.wait()?)
    }
}

fn command(program: &Path, bus: &Bus) -> Command {
    let mut command = Command::new(program);
    command.args(["--ready-fd", "1", "--dir"]).arg(bus.system.base());
    // What it says is shown where something is wrong.
    command.env("UORB_LOG", "debug");
    command
}

/// A broker, and its word: whether it is ready.
fn spawn(mut command: Command) -> anyhow::Result<(Child, String)> {
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn()?;
    let mut line = String::new();
    if let Some(stdout) = &mut child.stdout {
        BufReader::new(stdout).read_line(&mut line)?;
    }
    Ok((child, line))
}

impl Drop for Broker {
    fn drop(&mut self) {
        self.kill();
    }
}

/// A process of the run.
#[derive(Debug)]
pub(crate) struct Process {
    pub(crate) child: Child,
    pub(crate) cell: Cell,
    pub(crate) kind: &'static str,
    pub(crate) sender: u64,
    pub(crate) ended: Option<ExitStatus>,
    /// Killed or stopped by us, or to be by a fail point.
    pub(crate) fate: Option<String>,
    pub(crate) was_stopped: bool,
}

impl Process {
    pub(crate) fn spawn(
        bus: &Bus,
        ledger: &Ledger,
        cell: Cell,
        kind: &'static str,
        sender: u64,
        (topic, storm_us): (&str, u64),
        fate: Option<&Fate>,
    ) -> anyhow::Result<Self> {
        cell.clear();
        let mut command = bus.command(&std::env::current_exe()?);
        command.arg("actor").arg(&ledger.path);
        command.args([&cell.index.to_string(), &sender.to_string(), kind, topic]);
        command.arg(storm_us.to_string()).stdin(Stdio::null()).stdout(Stdio::null());
        if let Some(fate) = fate {
            command.env(fate.variable, &fate.place);
        }
        let fate = fate.map(|fate| format!("{} {}", fate.variable, fate.place));
        let child = command.spawn()?;
        Ok(Self { child, cell, kind, sender, ended: None, fate, was_stopped: false })
    }

    pub(crate) fn pid(&self) -> u32 {
        self.child.id()
    }

    pub(crate) fn lives(&mut self) -> bool {
        if self.ended.is_none() {
            self.ended = self.child.try_wait().ok().flatten();
        }
        self.ended.is_none()
    }

    pub(crate) fn publishes(&self) -> bool {
        matches!(self.kind, "publisher" | "claimer" | "changer")
    }

    /// Whether it follows the shared topic.
    pub(crate) fn copies(&self) -> bool {
        !self.publishes()
    }

    pub(crate) fn kill(&mut self) {
        let _ = self.child.kill();
        self.ended = self.child.wait().ok();
    }

    /// Whether it is to stop somewhere, and may do so yet.
    pub(crate) fn is_to_stop(&self) -> bool {
        let fate = self.fate.as_ref();
        self.ended.is_none() && fate.is_some_and(|fate| fate.starts_with("UORB_STOP_AT"))
    }

    /// What is known of it, where it does not do what it should.
    pub(crate) fn describe(&self) -> String {
        let words = [Word::State, Word::PausedIn, Word::Requests, Word::Seen];
        let words = words.map(|word| format!("{word:?} {}", self.cell.get(word)));
        let waits = fs::read_to_string(format!("/proc/{}/wchan", self.pid())).unwrap_or_default();
        let (kind, pid, ended, fate) = (self.kind, self.pid(), self.ended, &self.fate);
        format!("  {kind} {pid}: {}, in {waits}, {ended:?}, {fate:?}", words.join(", "))
    }

    pub(crate) fn is_stopped(&self) -> bool {
        let stat = fs::read_to_string(format!("/proc/{}/stat", self.pid())).unwrap_or_default();
        stat.rsplit(") ").next().is_some_and(|rest| rest.starts_with('T'))
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if self.ended.is_none() {
            self.kill();
        }
    }
}
