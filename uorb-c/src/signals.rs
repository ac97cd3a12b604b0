//! Is this a signal handler?
//!
//! A publish is safe in one, except for its last step where somebody follows
//! the topic's stream: iceoryx2 may allocate there, and the allocator may be
//! what the signal has interrupted. Nothing tells a program that it is in a
//! handler. But the signal that is being handled is blocked meanwhile
//! (unless it was installed with SA_NODEFER), and a signal that is blocked and
//! has a handler is rare elsewhere: those who block signals to read them from a
//! signalfd have none for them.

use nix::libc;
use nix::sys::signal::{SigSet, SigmaskHow, Signal, pthread_sigmask};

/// Whether a signal that has a handler is blocked in this thread. System calls
/// only, so it may itself be called in a handler.
pub(crate) fn may_be_in_handler() -> bool {
    let mut blocked = SigSet::empty();
    if pthread_sigmask(SigmaskHow::SIG_BLOCK, None, Some(&mut blocked)).is_err() {
        return true;
    }
    Signal::iterator().any(|signal| blocked.contains(signal) && has_handler(signal))
        || real_time_signals().any(|signal| {
            // SAFETY: the set is one, and the number is a signal's.
            let is_blocked = unsafe { libc::sigismember(blocked.as_ref(), signal) } == 1;
            is_blocked && has_handler_numbered(signal)
        })
}

fn has_handler(signal: Signal) -> bool {
    has_handler_numbered(signal as libc::c_int)
}

fn has_handler_numbered(signal: libc::c_int) -> bool {
    let mut action = std::mem::MaybeUninit::<libc::sigaction>::zeroed();
    // SAFETY: asks what is installed, and installs nothing; the kernel writes
    // the whole struct, whose zeroed bytes are a valid one as it is.
    let action = unsafe {
        libc::sigaction(signal, std::ptr::null(), action.as_mut_ptr());
        action.assume_init()
    };
    !matches!(action.sa_sigaction, libc::SIG_DFL | libc::SIG_IGN)
}

fn real_time_signals() -> impl Iterator<Item = libc::c_int> {
    libc::SIGRTMIN()..=libc::SIGRTMAX()
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use nix::sys::signal::{SaFlags, SigAction, SigHandler, raise, sigaction};

    use super::*;

    static INSIDE: AtomicBool = AtomicBool::new(false);

    extern "C" fn note(_: libc::c_int) {
        INSIDE.store(may_be_in_handler(), Ordering::Relaxed);
    }

    #[test]
    fn a_handler_knows_itself_and_a_blocked_signal_alone_is_none() {
        SigSet::from(Signal::SIGUSR1).thread_block().unwrap();
        assert!(!may_be_in_handler(), "it has no handler");
        SigSet::from(Signal::SIGUSR1).thread_unblock().unwrap();
        let action = SigAction::new(SigHandler::Handler(note), SaFlags::empty(), SigSet::empty());
        // SAFETY: the handler stores a flag.
        unsafe { sigaction(Signal::SIGUSR2, &action).unwrap() };
        assert!(!may_be_in_handler());
        raise(Signal::SIGUSR2).unwrap();
        assert!(INSIDE.load(Ordering::Relaxed));
        assert!(!may_be_in_handler(), "it is over");
    }
}
