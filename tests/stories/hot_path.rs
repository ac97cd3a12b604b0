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

#[test]
#[allow(unsafe_code)]
// Its end is seen by `waitpid`, as its tracer sees all that it does.
#[allow(clippy::zombie_processes)]
fn publish_updated_and_copy_make_no_system_call_and_allocate_nothing() {
    let bus = Bus::start();
    let mut command = bus.command(&program("actor"));
    command.arg("hot-path").stdout(Stdio::piped());
    // SAFETY: one system call, between fork and exec.
    unsafe { command.pre_exec(|| ptrace::traceme().map_err(Into::into)) };
    let actor = command.spawn().expect("an actor that can be traced");
    let pid = Pid::from_raw(actor.id() as i32);
    assert!(matches!(waitpid(pid, None), Ok(WaitStatus::Stopped(..))), "at its exec");
    ptrace::setoptions(pid, ptrace::Options::PTRACE_O_TRACESYSGOOD).unwrap();

    // Each call stops it twice, on its way in and on its way out.
    let mut calls = Vec::new();
    let (mut marks, mut entering) = (0, true);
    loop {
        ptrace::syscall(pid, None).unwrap();
        match waitpid(pid, None).unwrap() {
            WaitStatus::PtraceSyscall(_) => {
                if entering {
                    let info = ptrace::syscall_info(pid).unwrap();
                    // SAFETY: the kernel has filled it for a stop on the way in.
                    let number = unsafe { info.u.entry.nr } as i64;
                    if number == libc::SYS_getppid {
                        marks += 1;
                    } else if marks == 1 {
                        calls.push(number);
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
    let mut output = String::new();
    std::io::Read::read_to_string(&mut actor.stdout.expect("piped"), &mut output).unwrap();

    assert_eq!(marks, 2);
    let source = clock_source();
    eprintln!("clock source: {source}");
    if !["tsc", "arch_sys_counter"].contains(&&*source) {
        calls.retain(|call| *call != libc::SYS_clock_gettime);
    }
    assert!(calls.is_empty(), "system calls between the marks: {calls:?}");
    assert_eq!(output, "allocations 0\n");
}
