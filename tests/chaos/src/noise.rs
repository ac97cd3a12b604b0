//! The control: how long this machine keeps anybody waiting who wants nothing of
//! the bus. Two threads only sleep and wake; what they overslept is noise.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use uorb_core::now_us;

/// What is overslept by less is not kept.
const KEPT_US: u64 = 2_000;
const NAP: Duration = Duration::from_millis(1);

#[derive(Debug)]
pub(crate) struct Noise {
    slept: Arc<Mutex<Vec<(u64, u64)>>>,
    over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Noise {
    pub(crate) fn listen() -> Self {
        let slept = Arc::new(Mutex::new(Vec::new()));
        let over = Arc::new(AtomicBool::new(false));
        let listen = || {
            let (slept, over) = (slept.clone(), over.clone());
            std::thread::spawn(move || {
                while !over.load(Ordering::Relaxed) {
                    let from = now_us();
                    std::thread::sleep(NAP);
                    let to = now_us();
                    if to - from > KEPT_US {
                        slept.lock().expect("no thread panics").push((from, to));
                    }
                }
            })
        };
        let threads = (0..2).map(|_| listen()).collect();
        Self { slept, over, threads }
    }

    /// What was overslept between two times, all together, in microseconds.
    pub(crate) fn between(&self, from_us: u64, to_us: u64) -> u64 {
        let slept = self.slept.lock().expect("no thread panics");
        let overlaps = slept.iter().filter(|(from, to)| *from < to_us && *to > from_us);
        overlaps.map(|(from, to)| to - from).sum()
    }

    /// The longest, and forgets all.
    pub(crate) fn take_longest(&self) -> u64 {
        let mut slept = self.slept.lock().expect("no thread panics");
        let longest = slept.iter().map(|(from, to)| to - from).max().unwrap_or(0);
        slept.clear();
        longest
    }
}

impl Drop for Noise {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        self.threads.drain(..).for_each(|thread| _ = thread.join());
    }
}
