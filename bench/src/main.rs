//! How fast the bus is, beside the kernel and its peers in the same run.
//!
//! `scripts/bench` builds and runs it. Each file in `rows/` measures one kind of
//! thing, `doors/` has the peers, `figures.rs` says how turns are taken, and
//! `promises.rs` what is hoped for. No figure is asserted; what cannot be
//! measured ends the run.

#![deny(unsafe_code)]
#![allow(missing_debug_implementations)]

mod doors;
mod figures;
mod machine;
mod place;
mod plots;
mod promises;
mod report;
mod role;
mod rows;
mod times;

use std::fs::create_dir_all;
use std::io::{Write, stdout};
use std::path::PathBuf;

use anyhow::{Context, bail};
use uorb_tests::raise_descriptor_limit;

use crate::figures::{Effort, Figures};
use crate::place::Cores;
use crate::rows::Run;

const USAGE: &str = "\
usage: uorb-bench [--quick] [--out DIR] [ROW...]

  --quick    few repetitions: whether all can be measured, not how fast it is
  --out DIR  where results.csv, histograms.csv and the plots go
  ROW        kernel hot peers sizes wakes blocked flat-out streams scale costs mavlink c";

struct Args {
    effort: Effort,
    out: PathBuf,
    rows: Vec<String>,
}

fn main() -> anyhow::Result<()> {
    raise_descriptor_limit();
    if role::play_if_asked()? {
        return Ok(());
    }
    let args = parse(std::env::args().skip(1))?;
    create_dir_all(&args.out).with_context(|| format!("cannot make {}", args.out.display()))?;

    #[cfg(feature = "zenoh")]
    let _leftovers = doors::zenoh::Leftovers::of_others();
    let cores = Cores::of_this_process();
    let machine = machine::describe(cores);
    let mut run = Run { figures: Figures::new(args.effort), cores };
    run.all(&|name| args.rows.is_empty() || args.rows.iter().any(|row| row == name));

    report::write(&run.figures, &machine, &args.out)?;
    plots::draw(&run.figures, &args.out)?;
    let mut out = stdout().lock();
    writeln!(out, "{machine}")?;
    if args.effort.is_quick {
        writeln!(out, "--quick: these figures say that all can be measured, nothing else.")?;
    }
    if !cfg!(feature = "zenoh") {
        writeln!(out, "zenoh was left out: it is not built in.")?;
    }
    report::print(&run.figures, &mut out)?;
    promises::print(&run.figures, &mut out)?;
    writeln!(out, "\nall figures: {}", args.out.display())?;
    Ok(())
}

fn parse(words: impl Iterator<Item = String>) -> anyhow::Result<Args> {
    let mut args =
        Args { effort: Effort::FULL, out: PathBuf::from("target/bench"), rows: Vec::new() };
    let mut words = words;
    while let Some(word) = words.next() {
        match &*word {
            "--quick" => args.effort = Effort::QUICK,
            "--out" => args.out = words.next().context(USAGE)?.into(),
            "-h" | "--help" => {
                println!("{USAGE}");
                std::process::exit(0);
            }
            flag if flag.starts_with('-') => bail!("{flag}?\n{USAGE}"),
            _ => args.rows.push(word),
        }
    }
    Ok(args)
}
