//! Programs look for the library by this name: the next one that they cannot be
//! run with has another number. What the crates within export for each other is
//! not for programs, who may have those crates from elsewhere, too.

fn main() {
    println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libuorb.so.0");
    println!("cargo::rustc-cdylib-link-arg=-Wl,--exclude-libs,ALL");
    println!("cargo::rerun-if-changed=build.rs");
}
