//! Foreign programs: Python with packages from PyPI, and nothing of ours.
//!
//! The virtual environments that they need are made once and kept beside the
//! programs of this workspace, in cargo's target directory. Where one cannot be
//! made, because Python or PyPI is out of reach, the stories about foreign
//! programs say so and pass.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use nix::fcntl::{Flock, FlockArg};
use uorb_core::{Instance, World, broker_side::service_name};

use crate::{Actor, Bus, program};

/// The packages of a virtual environment, under the name of its directory.
struct Packages {
    environment: &'static str,
    names: &'static [&'static str],
    /// Those that are had without what they depend on.
    alone: &'static [&'static str],
}

/// Of one release with the iceoryx2 that this workspace uses: programs of
/// different ones do not meet.
const ICEORYX2: Packages =
    Packages { environment: "foreign-python", names: &["iceoryx2==0.10.0"], alone: &[] };

/// What reads flight logs, and what is made of them.
const LOG_READERS: Packages = Packages {
    environment: "log-readers-python",
    names: &["pyulog==1.3.0", "mcap==1.6.0", "mcap-ros2-support==0.6.0"],
    alone: &[],
};

/// Ground stations. MAVProxy's maps and pictures are some hundred megabytes, and
/// only its modules of these names want them.
const GROUND_STATIONS: Packages = Packages {
    environment: "mavlink-python",
    names: &["pymavlink==2.4.50", "mavsdk==4.1.0", "pyserial==3.5", "pyulog==1.3.0"],
    alone: &["MAVProxy==1.8.75"],
};

/// How long what could not be had is not asked for again.
const REFUSAL_HOLDS: Duration = Duration::from_secs(600);

/// The program that `tests/foreign/actor.py` is.
const ACTOR: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/foreign/actor.py");

/// The program that `tests/foreign/exported.py` is.
const EXPORTED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/foreign/exported.py");

/// The program that `tests/foreign/recorded.py` is.
const RECORDED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/foreign/recorded.py");

/// Where the programs `mavlink_station.py` and `mavsdk_station.py` are.
const FOREIGN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/foreign");

/// A Python with the packages that it was made with.
#[derive(Debug)]
pub struct Python {
    interpreter: PathBuf,
}

impl Python {
    /// A Python that can be an iceoryx2 program.
    pub fn with_iceoryx2() -> Option<Self> {
        Self::with(&ICEORYX2)
    }

    /// A Python that reads ULog and MCAP.
    pub fn with_log_readers() -> Option<Self> {
        Self::with(&LOG_READERS)
    }

    /// A Python that has pymavlink, MAVSDK and MAVProxy.
    pub fn with_ground_stations() -> Option<Self> {
        Self::with(&GROUND_STATIONS)
    }

    /// Spawns a program of `tests/foreign` that takes a story and its arguments.
    pub fn spawn_story(&self, bus: &Bus, program: &str, story: &[&str]) -> Actor {
        let mut command = self.in_dir_of(bus);
        command.arg(Path::new(FOREIGN).join(program)).args(story);
        Actor::spawn(command)
    }

    /// Spawns MAVProxy without a terminal.
    pub fn spawn_mavproxy(&self, bus: &Bus, master: &str) -> Actor {
        let mut command = self.in_dir_of(bus);
        command.arg(self.interpreter.with_file_name("mavproxy.py"));
        command.args(["--non-interactive", "--default-modules", "", "--master", master]);
        Actor::spawn(command)
    }

    /// Ground stations write logs where they are, and leave files in TMPDIR: these
    /// go with the bus.
    fn in_dir_of(&self, bus: &Bus) -> Command {
        let dir = bus.system.base();
        let mut command = Command::new(&self.interpreter);
        command.arg("-B").current_dir(dir).env("TMPDIR", dir);
        command
    }

    /// Makes the environment, if nobody has. None where that is not possible:
    /// then it has said why.
    fn with(packages: &Packages) -> Option<Self> {
        match environment(packages) {
            Ok(interpreter) => Some(Self { interpreter }),
            Err(why) => {
                let names = [packages.names, packages.alone].concat().join(", ");
                eprintln!("skipped: Python with {names} cannot be had here: {why}");
                None
            }
        }
    }

    /// Has `exported.py` compare an export with the log, as others read both.
    /// Returns what it counted.
    pub fn compare_exported(&self, mode: &str, log: &Path, exported: &Path) -> String {
        let mut command = Command::new(&self.interpreter);
        command.args(["-B", EXPORTED, mode]).args([log, exported]).stderr(Stdio::piped());
        Actor::spawn(command).end().fine()
    }

    /// Spawns a program's text as on a shell with this bus, that has `uorb`.
    pub fn spawn_text(&self, bus: &Bus, text: &str) -> Actor {
        // As all actors it ends with the story (PR_SET_PDEATHSIG, SIGKILL).
        let text = format!("import ctypes; ctypes.CDLL(None).prctl(1, 9)\n{text}");
        let path = std::env::var_os("PATH").unwrap_or_default();
        let paths = programs().into_iter().chain(std::env::split_paths(&path));
        let mut command = bus.command(&self.interpreter);
        command.env("PATH", std::env::join_paths(paths).expect("they were joined before"));
        command.args(["-c", &text]);
        Actor::spawn(command)
    }

    /// Has `recorded.py` say what is in each of these logs, a line of JSON each.
    pub fn read_logs(&self, logs: &[PathBuf]) -> Vec<String> {
        let mut command = Command::new(&self.interpreter);
        command.args(["-B", RECORDED]).args(logs);
        let said = Actor::spawn(command).finish();
        assert_eq!(said.len(), logs.len(), "{said:?}");
        said
    }

    /// Spawns `actor.py` in a mode, on instance 0 of a topic's stream.
    pub fn spawn(&self, bus: &Bus, mode: &str, topic: &str, arguments: &[&str]) -> Actor {
        let World { prefix, root } = World::of(&bus.system);
        let service = service_name(&bus.system, topic, Instance::FIRST);
        let mut command = Command::new(&self.interpreter);
        // Without -B it would leave files beside the program.
        command.args(["-B", ACTOR, mode, &prefix]).arg(root).arg(service).args(arguments);
        Actor::spawn(command)
    }
}

/// The directory of the programs of this workspace.
fn programs() -> Option<PathBuf> {
    program("uorbd").parent().map(Path::to_path_buf)
}

/// The interpreter of the environment, or what could not be had.
fn environment(packages: &Packages) -> Result<PathBuf, String> {
    let programs = programs().expect("there is a broker to be tested");
    let environment = programs.join(packages.environment);
    let interpreter = environment.join("bin/python");
    // Written last: what was left half-made does not count.
    let ready = environment.join("ready");

    // Stories run side by side, each in a process: one makes it, others wait.
    let lock = File::create(environment.with_extension("lock")).expect("a file beside ours");
    let _lock = Flock::lock(lock, FlockArg::LockExclusive).expect("it can be locked");
    let names = [packages.names, packages.alone].concat().join("\n");
    if fs::read(&ready).is_ok_and(|made_of| made_of == names.as_bytes()) {
        return Ok(interpreter);
    }
    // Each story would wait for PyPI in vain.
    let refused = environment.with_extension("refused");
    let refused_at = fs::metadata(&refused).and_then(|file| file.modified());
    if refused_at.is_ok_and(|at| at.elapsed().is_ok_and(|since| since < REFUSAL_HOLDS)) {
        return Err(fs::read_to_string(refused).unwrap_or_default());
    }
    make(&environment, &interpreter, packages).inspect_err(|why| _ = fs::write(&refused, why))?;
    fs::write(&ready, names).expect("a file in a directory of ours");
    Ok(interpreter)
}

fn make(environment: &Path, interpreter: &Path, packages: &Packages) -> Result<(), String> {
    let _ = fs::remove_dir_all(environment);
    run(Path::new("python3"), &["-m".as_ref(), "venv".as_ref(), environment.as_ref()])?;
    let install = ["-m", "pip", "install", "--quiet", "--no-cache-dir", "--retries", "1"];
    let have = |options: &[&str], names: &[&str]| {
        let arguments = install.iter().chain(options).chain(names).map(OsStr::new);
        run(interpreter, &arguments.collect::<Vec<_>>())
    };
    have(&[], packages.names)?;
    if packages.alone.is_empty() { Ok(()) } else { have(&["--no-deps"], packages.alone) }
}

/// Runs a command to its end. What it says is heard if it fails.
fn run(program: &Path, arguments: &[&OsStr]) -> Result<(), String> {
    let name = program.display();
    let ended =
        Command::new(program).args(arguments).output().map_err(|why| format!("{name}: {why}"))?;
    if ended.status.success() {
        return Ok(());
    }
    let words = [ended.stdout, ended.stderr].concat();
    let words = String::from_utf8_lossy(&words);
    let last = words.lines().map(str::trim).rfind(|line| !line.is_empty());
    Err(format!("{name} says {:?}", last.unwrap_or("nothing")))
}
