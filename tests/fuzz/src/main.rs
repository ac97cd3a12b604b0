//! The fuzzer: libFuzzer's main, and the one target that `UORB_FUZZ_TARGET`
//! names. `scripts/fuzz` builds and runs it; an ordinary build only says so.

#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    static TARGET: std::sync::LazyLock<uorb_fuzz::Target> = std::sync::LazyLock::new(|| {
        let name = std::env::var("UORB_FUZZ_TARGET").unwrap_or_default();
        uorb_fuzz::target(&name).unwrap_or_else(|| panic!("UORB_FUZZ_TARGET={name:?} is no target"))
    });
    TARGET(bytes);
});

#[cfg(not(fuzzing))]
fn main() -> std::process::ExitCode {
    eprintln!("fuzz: this build cannot; run scripts/fuzz");
    std::process::ExitCode::FAILURE
}
