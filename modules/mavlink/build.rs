//! Makes the messages of `dialect/uorb.xml` into Rust.

use std::env;
use std::error::Error;
use std::fs;
use std::path::PathBuf;

use mavlink_bindgen::{XmlDefinitions, generate};

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=dialect");
    // Features that the generated code has for others.
    println!("cargo:rustc-check-cfg=cfg(feature, values(\"arbitrary\", \"serde\", \"ts-rs\"))");
    let out_dir = PathBuf::from(env::var("OUT_DIR")?);
    generate(XmlDefinitions::Files(vec!["dialect/uorb.xml"]), &out_dir)?;
    // The generator's own has a cargo feature for each dialect; this is the only one.
    fs::write(out_dir.join("mod.rs"), "pub mod uorb;")?;
    Ok(())
}
