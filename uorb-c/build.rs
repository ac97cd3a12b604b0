//! Programs look for the library by this name: the next one that they cannot be
//! run with has another number.

fn main() {
    println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libuorb.so.0");
    println!("cargo::rerun-if-changed=build.rs");
}
