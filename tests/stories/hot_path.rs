use std::os::unix::process::CommandExt;
use std::process::Stdio;

use nix::sys::ptrace;
use nix::sys::wait::{WaitStatus, waitpid};
use nix::unistd::Pid;
use uorb_tests::{Bus, program};

/// Where the kernel's clock has to be asked, a publish asks it.
fn clock_source() -> String {
    let path = "/sys/devices/system/clocksource/clocksource0/current_clocksource";
    std::fs::read_to_string(path).unwrap_or_default().trim().to_string()
}

/// The system calls of an actor's first thread after each of its marks (a
/// getppid), and what it prints.
#[allow(unsafe_code)]
// Its end is seen by `waitpid`, as its tracer sees all that it does.
#[allow(clippy::zombie_processes)]
fn calls_after_marks(what: &str) -> (Vec<Vec<i64>>, String) {
    let bus = Bus::start();
    let mut command = bus.command(&program("actor"));
    command.arg(what).stdout(Stdio::piped());
    // SAFETY: one system call, between fork and exec.
    unsafe { command.pre_exec(|| ptrace::traceme().map_err(Into::into)) };
    let actor = command.spawn().expect("an actor that can be traced");
    let pid = Pid::from_raw(actor.id() as i32);
    assert!(matches!(waitpid(pid, None), Ok(WaitStatus::Stopped(..))), "at its exec");
    ptrace::setoptions(pid, ptrace::Options::PTRACE_O_TRACESYSGOOD).unwrap();

    // Each call stops it twice, on its way in and on its way out.
    let (mut calls, mut entering) = (Vec::<Vec<i64>>::new(), true);
    loop {
        ptrace::syscall(pid, None).unwrap();
        match waitpid(pid, None).unwrap() {
            WaitStatus::PtraceSyscall(_) => {
                if entering {
                    let info = ptrace::syscall_info(pid).unwrap();
                    // SAFETY: the kernel has filled it for a stop on the way in.
                    let number = unsafe { info.u.entry.nr } as i64;
                    match calls.last_mut() {
                        _ if number == libc::SYS_getppid => calls.push(Vec::new()),
                        Some(calls) => calls.push(number),
                        None => {}
                    }
                }
                entering = !entering;
            }
            WaitStatus::Exited(_, code) => {
                assert_eq!(code, 0);
                break;
            }
            _ => {}
        }
    }
    let source = clock_source();
    eprintln!("clock source: {source}");
    if !["tsc", "arch_sys_counter"].contains(&&*source) {
        let asks = |call: &i64| *call == libc::SYS_clock_gettime;
        calls.iter_mut().for_each(|calls| calls.retain(|call| !asks(call)));
    }
    let mut output = String::new();
    std::io::Read::read_to_string(&mut actor.stdout.expect("piped"), &mut output).unwrap();
    (calls, output)
}

#[test]
fn publish_updated_and_copy_make_no_system_call_and_allocate_nothing() {
    let (calls, output) = calls_after_marks("hot-path");
    assert_eq!(calls.len(), 2, "marks");
    assert!(calls[0].is_empty(), "system calls between the marks: {:?}", calls[0]);
    assert_eq!(output, "allocations 0\n");
}

#[test]
fn a_stream_that_is_followed_makes_no_system_call_and_copies_nothing_aside() {
    let (calls, output) = calls_after_marks("hot-path-of-a-stream");
    let [joining, _, following, _] = &calls[..] else { panic!("{} marks", calls.len()) };
    // The thread that joins is one of them, and the bell is rung for it.
    let mut kinds = joining.clone();
    kinds.sort_unstable();
    kinds.dedup();
    eprintln!("while somebody joins: {} system calls, of kinds {kinds:?}", joining.len());
    assert!(following.is_empty(), "system calls between the marks: {following:?}");
    // iceoryx2 allocates 48 bytes for each message that it loans.
    assert_eq!(output, "allocations 1000\n");
}
