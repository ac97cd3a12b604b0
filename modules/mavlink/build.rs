//! Makes the messages of `dialect/uorb.xml` into Rust.

use std::env;
use std::error::Error;
use std::path::PathBuf;

use mavlink_bindgen::{XmlDefinitions, generate};

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=dialect");
    let out_dir = PathBuf::from(env::var("OUT_DIR")?);
    generate(XmlDefinitions::Files(vec!["dialect/uorb.xml"]), &out_dir)?;
    Ok(())
}
