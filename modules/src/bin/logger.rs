//! PX4's logger: records the bus from its start on, as `uorb record` does.
//!
//! It runs until Ctrl-C, SIGTERM or `uorb stop`, as every module. What it writes
//! and what it demands of a disk is said in `uorb record --help`.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use uorb_core::Session;
use uorb_modules::run;
use uorb_ulog::{Choice, Place, Plan, Rule, record};

const EXAMPLES: &str = "\
Examples:
  logger                               log/sess001/log001.ulg, all topics
  logger -t -d /var/log/uorb           /var/log/uorb/2026-11-28/14_05_59.ulg
  logger --topic 'sensor_*:50'         50 a second of each sensor

UORB_DIR and UORB_SYSTEM name the system, as for uorb.";

/// Records all topics, or some, in ULog flight logs.
#[derive(Parser)]
#[command(name = "logger", version, after_help = EXAMPLES)]
struct Arguments {
    /// Name directories and files by date and time, in UTC
    #[arg(short = 't')]
    by_time: bool,

    /// Where the directories of logs go
    #[arg(short = 'd', long = "dir", default_value = "log")]
    dir: PathBuf,

    /// Memory for what the disk has not taken yet, in KiB
    #[arg(short = 'b', long = "buffer", value_name = "KIB", default_value = "16384",
        value_parser = clap::value_parser!(u32).range(64..=4_194_304))]
    buffer: u32,

    /// Only topics of this name, so often; `*` stands for any letters. May be
    /// repeated
    #[arg(long, value_name = "TOPIC[:HZ]")]
    topic: Vec<Rule>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    run(|stop, out| {
        let session = Session::connect()?;
        let known = uorb_msg::TOPICS
            .iter()
            .map(|topic| (topic.name.to_string(), topic.layout.clone().into_owned()));
        let place = if arguments.by_time { Place::Dated } else { Place::Sessions };
        let plan = Plan {
            choice: Choice::new(arguments.topic),
            place: place(arguments.dir),
            max_size_bytes: None,
            rotate_every: None,
            duration: None,
            back_pressure: false,
            buffer_bytes: (arguments.buffer as usize) << 10,
            parameters: Vec::new(),
            known: known.collect(),
        };
        let tally = record(&session, &plan, &|| stop.requested(), &mut |_| {})?;
        for file in &tally.files {
            writeln!(out, "[logger] closed {}", file.display())?;
        }
        let (messages, lost, dropouts) = (tally.messages, tally.lost, tally.dropouts);
        writeln!(out, "[logger] {messages} messages, {lost} lost in {dropouts} dropouts")?;
        Ok(())
    })
}
