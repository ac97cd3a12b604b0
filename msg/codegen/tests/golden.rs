//! The Rust text of a folder with every sort of declaration, as it was when
//! somebody last looked at it.
//!
//! The folder is the example crate's, which is built with this very text. After
//! a change on purpose: `UORB_BLESS=1 cargo test -p uorb-codegen`, and read the
//! difference.

use std::fs;

const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/own_crate.rs");

#[test]
fn the_module_is_the_one_that_was_last_looked_at() {
    let own_crate = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/own_crate");
    let generated = uorb_codegen::Config::new()
        .folder(format!("{own_crate}/msg"))
        .search(format!("{own_crate}/../../.."))
        .generate()
        .unwrap();
    assert_eq!(generated.warnings, []);
    if std::env::var_os("UORB_BLESS").is_some() {
        fs::write(GOLDEN, &generated.rust).unwrap();
    }
    let golden = fs::read_to_string(GOLDEN).unwrap();
    for (number, (ours, golden)) in generated.rust.lines().zip(golden.lines()).enumerate() {
        assert_eq!(ours, golden, "line {} of {GOLDEN}; UORB_BLESS=1 takes it over", number + 1);
    }
    assert_eq!(generated.rust.len(), golden.len());
}
