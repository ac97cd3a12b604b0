//! A private system with a broker, for a bench.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use uorb_core::{System, World};

/// A private system with a broker.
#[derive(Debug)]
pub(crate) struct Bus {
    pub(crate) system: System,
    base: PathBuf,
    broker: Child,
}

impl Bus {
    pub(crate) fn start(name: &str) -> Self {
        let base = PathBuf::from(format!("/dev/shm/uorb-bench-{name}-{}", std::process::id()));
        std::fs::create_dir(&base).expect("a new directory in /dev/shm");
        let bench = std::env::current_exe().expect("every program has a file");
        let uorbd = bench.ancestors().map(|dir| dir.join("uorbd")).find(|path| path.is_file());
        let uorbd = uorbd.expect("uorbd is not built: run `cargo build --release` first");
        let mut broker = Command::new(uorbd)
            .args(["--ready-fd", "1", "--dir"])
            .arg(&base)
            .stdout(Stdio::piped())
            .spawn()
            .expect("uorbd starts");
        let mut line = String::new();
        let stdout = broker.stdout.as_mut().expect("piped");
        BufReader::new(stdout).read_line(&mut line).expect("a line");
        assert_eq!(line, "ready\n");
        Self { system: System::new(&base, 0), base, broker }
    }
}

impl Drop for Bus {
    fn drop(&mut self) {
        let _ = self.broker.kill();
        let _ = self.broker.wait();
        World::of(&self.system).remove();
        let _ = std::fs::remove_dir_all(&self.base);
    }
}
