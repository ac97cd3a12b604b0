//! `uorb man`: the manual, made from what `--help` says.

use std::io::Write;

use anyhow::bail;
use clap_mangen::Man;

use crate::nearest::did_you_mean;

/// Print a page of the manual.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// Of which command [default: of uorb itself]
    command: Option<String>,
}

const EXAMPLES: &str = "\
Examples:
  uorb man | man -l -
  uorb man listener > uorb-listener.1";

pub(crate) fn run(args: &Args, mut uorb: clap::Command, out: &mut dyn Write) -> anyhow::Result<()> {
    uorb.build();
    let mut page = Vec::new();
    match &args.command {
        None => Man::new(uorb).render(&mut page)?,
        Some(name) => {
            let Some(command) = uorb.find_subcommand(name) else {
                let names = uorb.get_subcommands().map(clap::Command::get_name);
                bail!("no command {name:?}{}", did_you_mean(name, names));
            };
            // A page's name has no blank: uorb-listener(1), as git-log(1).
            let title = format!("uorb-{name}");
            Man::new(command.clone().display_name(title)).render(&mut page)?;
        }
    }
    out.write_all(&page)?;
    Ok(())
}
