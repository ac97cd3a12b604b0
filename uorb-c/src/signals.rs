//! Publishing on a stream, and signals.
//!
//! A publish is safe in a signal handler, except for its last step where
//! somebody follows the topic's stream: iceoryx2 may allocate there, and the
//! allocator may be what the signal has interrupted; and some of its system calls
//! it does not repeat when a signal interrupts them. So no signal is handled
//! during that step, and in a handler it is left out: who follows the stream
//! finds the message in the node.
//!
//! Nothing tells a program that it is in a handler. But the signal that is being
//! handled is blocked meanwhile (unless it was installed with SA_NODEFER), and a
//! signal that is blocked and has a handler is rare elsewhere: those who block
//! signals to read them from a signalfd have none for them.

use nix::libc;
use nix::sys::signal::{SigSet, SigmaskHow, Signal, pthread_sigmask};

/// While it is held, this thread handles no signals.
pub(crate) struct NoSignals {
    before: SigSet,
}

impl NoSignals {
    /// None: this may be a signal handler. System calls only, so it may be
    /// called in one.
    pub(crate) fn outside_of_handlers() -> Option<Self> {
        let mut before = SigSet::empty();
        let all = SigSet::all();
        pthread_sigmask(SigmaskHow::SIG_SETMASK, Some(&all), Some(&mut before)).ok()?;
        let blocked = Self { before };
        (!may_be_in_handler(&before)).then_some(blocked)
    }
}

impl Drop for NoSignals {
    fn drop(&mut self) {
        let _ = pthread_sigmask(SigmaskHow::SIG_SETMASK, Some(&self.before), None);
    }
}

/// Whether a signal that has a handler is blocked.
fn may_be_in_handler(blocked: &SigSet) -> bool {
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
        INSIDE.store(NoSignals::outside_of_handlers().is_none(), Ordering::Relaxed);
    }

    #[test]
    fn a_handler_knows_itself_and_a_blocked_signal_alone_is_none() {
        SigSet::from(Signal::SIGUSR1).thread_block().unwrap();
        assert!(NoSignals::outside_of_handlers().is_some(), "it has no handler");
        SigSet::from(Signal::SIGUSR1).thread_unblock().unwrap();
        let action = SigAction::new(SigHandler::Handler(note), SaFlags::empty(), SigSet::empty());
        // SAFETY: the handler stores a flag.
        unsafe { sigaction(Signal::SIGUSR2, &action).unwrap() };
        let blocked = NoSignals::outside_of_handlers().expect("nothing is being handled");
        raise(Signal::SIGUSR2).unwrap();
        assert!(!INSIDE.load(Ordering::Relaxed), "it waits");
        drop(blocked);
        assert!(INSIDE.load(Ordering::Relaxed));
        assert!(NoSignals::outside_of_handlers().is_some(), "it is over");
    }
}
