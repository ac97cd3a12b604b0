//! What an actor asks of the kernel.

use nix::sys::ptrace;
use nix::sys::wait::{WaitPidFlag, WaitStatus, waitpid};
use nix::unistd::Pid;

use crate::Actor;

/// The system calls that an actor's main thread makes between two marks, after
/// the story has said something to it. A mark is a call of getppid(2).
///
/// Where the kernel has to be asked for the time, asking for it does not count.
#[allow(unsafe_code)]
pub fn calls_between_marks(actor: &mut Actor, said: &str) -> Vec<i64> {
    let pid = Pid::from_raw(actor.pid() as i32);
    ptrace::seize(pid, ptrace::Options::PTRACE_O_TRACESYSGOOD).expect("a child can be traced");
    ptrace::interrupt(pid).expect("it is traced");
    waitpid(pid, Some(WaitPidFlag::__WALL)).expect("it stops");
    actor.say(said);

    let mut calls = Vec::new();
    let mut marks = 0;
    while marks < 2 {
        ptrace::syscall(pid, None).expect("it is stopped");
        let status = waitpid(pid, Some(WaitPidFlag::__WALL)).expect("it is our child");
        assert!(!matches!(status, WaitStatus::Exited(..)), "it ended before its second mark");
        if !matches!(status, WaitStatus::PtraceSyscall(_)) {
            continue;
        }
        // A call stops it on its way in and on its way out.
        let info = ptrace::syscall_info(pid).expect("it is stopped at a call");
        if info.op != libc::PTRACE_SYSCALL_INFO_ENTRY {
            continue;
        }
        // SAFETY: the kernel has filled it for a stop on the way in.
        let number = unsafe { info.u.entry.nr } as i64;
        if number == libc::SYS_getppid {
            marks += 1;
        } else if marks == 1 {
            calls.push(number);
        }
    }
    ptrace::detach(pid, None).expect("it is stopped");
    let source = clock_source();
    eprintln!("clock source: {source}");
    if !["tsc", "arch_sys_counter"].contains(&&*source) {
        calls.retain(|call| *call != libc::SYS_clock_gettime);
    }
    calls
}

fn clock_source() -> String {
    let path = "/sys/devices/system/clocksource/clocksource0/current_clocksource";
    std::fs::read_to_string(path).unwrap_or_default().trim().to_string()
}
