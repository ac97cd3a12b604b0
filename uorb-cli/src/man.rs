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
    #[arg(value_name = "COMMAND")]
    words: Vec<String>,
}

const EXAMPLES: &str = "\
Examples:
  uorb man | man -l -
  uorb man ulog info | man -l -
  uorb man listener > uorb-listener.1";

pub(crate) fn run(args: &Args, mut uorb: clap::Command, out: &mut dyn Write) -> anyhow::Result<()> {
    uorb.build();
    let mut command = &uorb;
    let mut title = uorb.get_name().to_owned();
    for word in &args.words {
        let Some(found) = command.find_subcommand(word) else {
            let names = command.get_subcommands().map(clap::Command::get_name);
            bail!(
                "no command {word:?} of `{}`{}",
                title.replace('-', " "),
                did_you_mean(word, names)
            );
        };
        command = found;
        // A page's name has no blank: uorb-listener(1), as git-log(1).
        title = format!("{title}-{}", found.get_name());
    }
    let mut page = Vec::new();
    Man::new(command.clone().display_name(title)).render(&mut page)?;
    out.write_all(&page)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page(words: &[&str]) -> anyhow::Result<String> {
        let uorb = clap::Command::new("uorb")
            .subcommand(clap::Command::new("ulog").subcommand(clap::Command::new("info")));
        let words = words.iter().map(|word| (*word).to_owned()).collect();
        let mut page = Vec::new();
        run(&Args { words }, uorb, &mut page)?;
        Ok(String::from_utf8(page)?)
    }

    #[test]
    fn a_command_of_a_command_has_a_page() {
        assert!(page(&[]).unwrap().contains(".TH uorb 1"));
        assert!(page(&["ulog", "info"]).unwrap().contains(".TH uorb-ulog-info 1"));
    }

    #[test]
    fn a_command_that_there_is_not_is_named() {
        let error = page(&["ulog", "infos"]).unwrap_err().to_string();
        assert_eq!(error, "no command \"infos\" of `uorb ulog`; did you mean info?");
    }
}
