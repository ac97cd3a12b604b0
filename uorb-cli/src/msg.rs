//! `uorb msg`: .msg files to headers and sources in C and C++.

use std::path::PathBuf;

use uorb_codegen::Config;

use crate::exit::say;

/// Compile .msg files to headers and sources in C and C++.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// Folders with .msg files, which have topics
    #[arg(required = true, value_name = "FOLDER")]
    folders: Vec<PathBuf>,

    /// Look here, too, for messages that are fields of others
    #[arg(long, value_name = "DIR")]
    search: Vec<PathBuf>,

    /// Where the files go, in DIR/include/uORB and DIR/src
    #[arg(short, long, value_name = "DIR", default_value = "generated")]
    out: PathBuf,
}

const EXAMPLES: &str = "\
Examples:
  uorb msg my_messages
  uorb msg -o build my_messages --search /usr/local/share/uorb/msg
  uorb msg -o build my_messages \"$(pkg-config --variable=msgdir uorb)\"

Of a message wheel_speed there is then <uORB/topics/wheel_speed.h>, with struct
wheel_speed_s, and src/wheel_speed.c, which goes into the program. Give the
compiler -IDIR/include before the flags of `pkg-config --cflags uorb`.

The messages that are installed have their headers and their library already, so
a folder of one's own is enough: programs use both. The list of all topics
(orb_get_topics, ORB_ID::wheel_speed) then has the folder's own. To have one list
of both, name both folders, as the last example does. Messages of one's own have
names that no installed one has.

Files whose text would be the same are not written again. Files that an earlier
run wrote to DIR and this one does not are removed.

A message has 65,535 bytes at most in C and C++. Larger ones are left out, with a
warning; their headers are errors that say so.";

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let config = args.folders.iter().fold(Config::new(), |config, folder| config.folder(folder));
    let config = args.search.iter().fold(config, |config, folder| config.search(folder));
    let generated = config.generate_c()?;
    for warning in &generated.warnings {
        say(format_args!("warning: {warning}"));
    }
    let written = generated.write_to(&args.out)?;
    for path in &written.removed {
        say(format_args!("removed {}: an earlier run wrote it", path.display()));
    }
    Ok(())
}
