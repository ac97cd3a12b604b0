//! PX4's logger: records the bus from its start on, as `uorb record` does.
//!
//! Without a command it runs until Ctrl-C, SIGTERM or `uorb stop`, as every
//! module; `start`, `status` and `stop` are PX4's. What it writes and what it
//! demands of a disk is said in `uorb record --help`.

mod background;

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use uorb_core::{Priority, Publication, Session, now_us};
use uorb_modules::run;
use uorb_msg::LoggerStatus;
use uorb_ulog::{Choice, Place, Plan, Rule, Tally, record};

const EXAMPLES: &str = "\
Examples:
  logger                               log/sess001/log001.ulg, all topics
  logger start -t -d /var/log/uorb     /var/log/uorb/2026-11-28/14_05_59.ulg
  logger status
  logger stop
  logger --topic 'sensor_*:50'         50 a second of each sensor

Once a second it publishes logger_status, as PX4's does: how much it has written,
and what was lost. UORB_DIR and UORB_SYSTEM name the system, as for uorb.

Exit code 0: it went well; 1: an error; of `status` and `stop` also: no logger
runs.";

/// Records all topics, or some, in ULog flight logs.
#[derive(Parser)]
#[command(name = "logger", version, after_help = EXAMPLES, args_conflicts_with_subcommands = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,

    #[command(flatten)]
    options: Options,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Record in the background, until `logger stop`
    Start(Options),
    /// Say who records, where to, and what was lost
    Status,
    /// End the logger; its log is complete then
    Stop,
}

#[derive(clap::Args)]
struct Options {
    /// Name directories and files by date and time, in UTC
    #[arg(short = 't')]
    by_time: bool,

    /// PX4's: log from the start on. This logger always does
    #[arg(short = 'e')]
    from_the_start: bool,

    /// PX4's: log until the end. This logger always does
    #[arg(short = 'f')]
    until_the_end: bool,

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
    run(|stop, out| match arguments.command {
        Some(Command::Start(_)) => background::start(stop, out),
        Some(Command::Status) => background::status(out),
        Some(Command::Stop) => background::stop(stop, out),
        None => {
            let session = Session::connect()?;
            let mut status =
                Publication::<LoggerStatus>::advertise_multi(&session, Priority::DEFAULT)?;
            let plan = arguments.options.plan();
            let (mut opened, mut before) = (0, Tally::default());
            let mut tell = |tally: &Tally| {
                for file in &tally.files[opened..] {
                    let _ = writeln!(out, "[logger] opened {}", file.display());
                }
                opened = tally.files.len();
                // That nobody can be told is no reason not to record.
                let _ = status.publish(&told(&plan, tally, &before));
                before = tally.clone();
            };
            let tally = record(&session, &plan, &|| stop.requested(), &mut tell)?;
            for file in &tally.files {
                writeln!(out, "[logger] closed {}", file.display())?;
            }
            let (messages, lost, dropouts) = (tally.messages, tally.lost, tally.dropouts);
            writeln!(out, "[logger] {messages} messages, {lost} lost in {dropouts} dropouts")?;
            Ok(())
        }
    })
}

impl Options {
    fn plan(self) -> Plan {
        let known = uorb_msg::TOPICS
            .iter()
            .map(|topic| (topic.name.to_string(), topic.layout.clone().into_owned()));
        let place = if self.by_time { Place::Dated } else { Place::Sessions };
        Plan {
            choice: Choice::new(self.topic),
            place: place(self.dir),
            max_size_bytes: None,
            rotate_every: None,
            duration: None,
            back_pressure: false,
            buffer_bytes: (self.buffer as usize) << 10,
            parameters: Vec::new(),
            known: known.collect(),
        }
    }
}

/// What `logger_status` says.
fn told(plan: &Plan, tally: &Tally, before: &Tally) -> LoggerStatus {
    let seconds = (tally.seconds - before.seconds).max(0.001);
    LoggerStatus {
        timestamp: now_us(),
        r#type: LoggerStatus::LOGGER_TYPE_FULL,
        backend: LoggerStatus::BACKEND_FILE,
        is_logging: true.into(),
        total_written_kb: tally.bytes as f32 / 1e3,
        write_rate_kb_s: ((tally.bytes - before.bytes) as f64 / 1e3 / seconds) as f32,
        dropouts: tally.dropouts as u32,
        message_gaps: tally.lost as u32,
        buffer_used_bytes: tally.buffered_bytes as u32,
        buffer_size_bytes: plan.buffer_bytes as u32,
        num_messages: tally.topics.min(u8::MAX.into()) as u8,
        ..LoggerStatus::default()
    }
}
