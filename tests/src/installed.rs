//! An installed tree, as `scripts/install` makes it, and programs built with it.
//!
//! The tree is beside the programs that are tested, in cargo's target directory.
//! It is made once for all stories, which may be processes of their own, and
//! again when anything that goes into it is newer.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::SystemTime;

use nix::fcntl::{Flock, FlockArg};

use crate::program;

/// What a source is written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Language {
    /// C11, with what the system has beyond it.
    C,
    /// C++17, with what the system has beyond it.
    Cpp,
}

/// The installed tree.
#[derive(Debug)]
pub struct Installed {
    /// The directory that `--prefix` named.
    pub prefix: PathBuf,
}

impl Installed {
    /// The tree, which is made if nobody has.
    pub fn get() -> Self {
        let built = program("uorbd").parent().expect("it is in a directory").to_path_buf();
        let prefix = built.join("installed");
        let lock = File::create(built.join("installed.lock")).expect("a file beside the programs");
        let _lock = Flock::lock(lock, FlockArg::LockExclusive).expect("nobody keeps it");
        let stamp = built.join("installed.stamp");
        if modified(&stamp) <= newest_input(&built) {
            install(&built, &prefix);
            fs::write(&stamp, "").expect("a file beside the programs");
        }
        Self { prefix }
    }

    /// Compiles and links sources with the flags of `pkg-config uorb`. The program
    /// has a name that no other story uses. Warnings are errors, which flags can
    /// change. Err: what the compiler says. A story asks first whether
    /// [`is_there`] a `c++` and a `pkg-config`; a `cc` is wherever cargo is.
    pub fn compile(
        &self,
        language: Language,
        sources: &[&Path],
        name: &str,
        flags: &[&str],
    ) -> Result<PathBuf, String> {
        let programs = self.prefix.with_file_name("installed-programs");
        fs::create_dir_all(&programs).expect("a directory beside the programs");
        let output = programs.join(name);
        let (compiler, standard) = match language {
            Language::C => ("cc", "-std=gnu11"),
            Language::Cpp => ("c++", "-std=gnu++17"),
        };
        let mut command = self.command(compiler);
        command.args([standard, "-g", "-Wall", "-Wextra", "-Werror"]).args(flags);
        // Sources first: the linker takes from a library what it has missed so far.
        command.arg("-o").arg(&output).args(sources).args(self.pkg_config(&["--cflags", "--libs"]));
        let done = command.output().map_err(|error| format!("{compiler}: {error}"))?;
        match done.status.success() {
            true => Ok(output),
            false => Err(String::from_utf8_lossy(&done.stderr).into_owned()),
        }
    }

    /// What pkg-config says of this tree, word by word.
    pub fn pkg_config(&self, arguments: &[&str]) -> Vec<String> {
        let said = self.command("pkg-config").args(arguments).arg("uorb").output();
        let said = said.expect("pkg-config runs");
        assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stderr));
        let words = String::from_utf8(said.stdout).expect("UTF-8");
        words.split_whitespace().map(str::to_string).collect()
    }

    /// A command of whoever uses this tree: its programs, pkg-config, make, cmake.
    pub fn command(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        let path = std::env::var_os("PATH").unwrap_or_default();
        let paths = [self.prefix.join("bin")].into_iter().chain(std::env::split_paths(&path));
        command.env("PATH", std::env::join_paths(paths).expect("they were joined before"));
        command.env("PKG_CONFIG_PATH", self.prefix.join("lib/pkgconfig"));
        command.env("CMAKE_PREFIX_PATH", &self.prefix);
        // This process may be make's, which tells its own who is who.
        command.env_remove("MAKEFLAGS").env_remove("MAKELEVEL");
        command
    }
}

/// Whether there is a program of this name; says so if not.
pub fn is_there(tool: &str) -> bool {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&path).any(|directory| directory.join(tool).is_file());
    if !found {
        eprintln!("skipped: no {tool} in PATH");
    }
    found
}

fn install(built: &Path, prefix: &Path) {
    let mut command = Command::new(repository().join("scripts/install"));
    command.env("CARGO_TARGET_DIR", built.parent().expect("cargo's target directory"));
    command.args(["--no-build", "--prefix"]).arg(prefix);
    if built.file_name() == Some(OsStr::new("debug")) {
        command.arg("--debug");
    }
    let done = command.output().expect("scripts/install runs");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
}

fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("it is in a folder")
}

/// When what goes into the tree was last changed.
fn newest_input(built: &Path) -> SystemTime {
    let libraries = ["libuorb.so", "libuorb.a", "uorb", "uorbd"].map(|name| built.join(name));
    let sources = ["msg", "modules/src/bin", "scripts/install", "uorb-c"];
    let sources = sources.map(|name| repository().join(name));
    let inputs = libraries.iter().chain(&sources);
    inputs.map(|path| newest(path)).max().expect("there are some")
}

/// When the newest of a file, or of all below a directory, was changed.
fn newest(path: &Path) -> SystemTime {
    let entries = fs::read_dir(path).into_iter().flatten().flatten();
    let below = entries.map(|entry| newest(&entry.path()));
    below.chain([modified(path)]).max().expect("itself at least")
}

/// Never, if there is no such file.
fn modified(path: &Path) -> SystemTime {
    fs::metadata(path).and_then(|data| data.modified()).unwrap_or(SystemTime::UNIX_EPOCH)
}
