//! `reach`: topics of one machine on another, over zenoh.
//!
//! One process a machine. Which topics cross is said by [`rules`]; under which keys
//! they are in zenoh, by [`keys`]; what a message looks like on the way, by [`wire`].
//! [`communicator`] is the network. [`exports`] and [`imports`] look a hundred times
//! a second at what has changed here and there; messages leave on the threads of
//! [`outgoing`] and come in on those of zenoh ([`imported`]).
#![deny(unsafe_code)]

mod clock;
mod communicator;
mod config;
mod counts;
mod exports;
mod imported;
mod imports;
mod keys;
mod ledger;
mod outgoing;
mod rules;
mod status;
mod tell;
mod translate;
mod wire;

use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::{Context, anyhow, bail};
use clap::Parser;
use nix::sys::resource::{Resource, getrlimit, setrlimit};
use uorb_core::broker_side::{Node, Role};
use uorb_core::{Error, Instance, Session, Topic, now_us};
use uorb_modules::{Stop, run, say};
use uorb_msg::ReachStatus;

use communicator::Communicator;
use exports::Exports;
use imports::Imports;
use keys::{MACHINE_NAME_MAX_BYTES, Place, is_machine_name};
use ledger::Ledger;
use rules::{Rule, Rules};
use tell::Telling;

const EXAMPLES: &str = "\
Examples:
  reach --name gcs --listen tcp/[::]:7447 --import 'drone*/vehicle_*' --export vehicle_command,reliable
  reach --name drone7 --connect tcp/gcs.local:7447 --export 'vehicle_*:10' --import 'gcs/*'
  reach --rules reach.rules --config zenoh.json5     a rule a line; TLS, passwords, access control
  reach status                                       what crosses, what it costs, what was lost

A topic is TOPIC, TOPIC/INSTANCE, or has a * that stands for any letters; an import
has the MACHINE it comes from before it. :HZ limits the rate. Behind a comma stands how an
export crosses: best-effort (what has no room on the link is dropped), reliable (it
waits) or express (at once, alone). A ! before it makes an exception. The last rule
that matches counts.

A topic crosses while somebody over there subscribes to it. docs/reach.md says more.
UORB_DIR and UORB_SYSTEM name the system, as for uorb.";

/// How often to look at what has changed.
const LOOK_EVERY_US: u64 = 10_000;

/// How long a reach that was killed may still be known to the broker.
const PREDECESSOR_US: u64 = 1_000_000;

/// How long to wait before it says that it waits.
const SAY_AFTER_US: u64 = 1_000_000;

const ANOTHER_RUNS: &str = "a reach runs on this system already; `reach status` says what it does";

/// Topics of this machine on others, and of others on this one.
#[derive(Parser, Debug)]
#[command(name = "reach", version, after_help = EXAMPLES, args_conflicts_with_subcommands = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,

    #[command(flatten)]
    options: Options,
}

#[derive(clap::Subcommand, Debug)]
enum Command {
    /// Say what crosses, at which rates, what was lost, and how clocks differ
    Status {
        /// Print one JSON object instead
        #[arg(long)]
        json: bool,
    },
}

#[derive(clap::Args, Debug)]
struct Options {
    /// Topics that others may have. May be repeated
    #[arg(long, value_name = "TOPIC", value_parser = Rule::parse_export)]
    export: Vec<Rule>,

    /// Topics of others to have here. May be repeated
    #[arg(long, value_name = "MACHINE/TOPIC", value_parser = Rule::parse_import)]
    import: Vec<Rule>,

    /// A file with a rule a line: `export TOPIC` or `import MACHINE/TOPIC`
    #[arg(long, value_name = "FILE")]
    rules: Option<PathBuf>,

    /// Where another reach, or a router of zenoh, listens: tcp/HOST:PORT, tls/HOST:PORT.
    /// May be repeated
    #[arg(long, value_name = "ENDPOINT", value_parser = config::endpoint)]
    connect: Vec<String>,

    /// Where to listen; nowhere, if not given. May be repeated
    #[arg(long, value_name = "ENDPOINT", value_parser = config::endpoint)]
    listen: Vec<String>,

    /// A configuration of zenoh, in JSON5: what it says has the last word
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// What this machine is called [default: its host name]
    #[arg(long, value_name = "MACHINE")]
    name: Option<String>,

    /// Translate `timestamp` fields of what comes in to this machine's clock
    #[arg(long)]
    translate_time: bool,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    run(|stop, out| {
        let session = Session::connect()?;
        let done = match arguments.command {
            Some(Command::Status { json }) => status::print(&session, json, out),
            None => reach(&arguments.options, &session, stop, out),
        };
        if session.has_ended() {
            return Err(Error::Ended { path: session.system().dir() }.into());
        }
        done.map_err(|error| format!("{error:#}").into())
    })
}

fn reach(
    options: &Options,
    session: &Session,
    stop: &Stop,
    out: &mut impl Write,
) -> anyhow::Result<()> {
    let rules = Arc::new(options.rules()?);
    let place = Place { machine: options.machine()?, system: session.system().number() };
    let config = config::config(&options.connect, &options.listen, options.config.as_deref())?;
    wait_for_predecessor(session, stop)?;
    raise_descriptor_limit();
    let mut telling = Telling::new(session)?;
    give_way(session)?;
    let Some(communicator) = connect(config, &place, session, stop)? else { return Ok(()) };
    writeln!(out, "[reach] this is {place}")?;

    // What this run is called: none before it, and none at the same time elsewhere.
    let run = now_us() as u32;
    let (ledger, brought_in) = Ledger::open(session);
    let mut exports = Exports::begin(session, &communicator, &rules, (run, &brought_in))?;
    let mut imports = Imports::new(session, &communicator, &rules, options.translate_time, ledger);
    while !session.has_ended() && stop.sleep_until(now_us() + LOOK_EVERY_US) {
        exports.look()?;
        imports.look()?;
        telling.tell(&exports, &imports)?;
    }
    Ok(())
}

/// Opens the network, which takes until somebody answers where it only connects. None:
/// it is to end before that.
fn connect(
    config: zenoh::Config,
    place: &Place,
    session: &Session,
    stop: &Stop,
) -> anyhow::Result<Option<Arc<Communicator>>> {
    let its = place.clone();
    let opening = std::thread::spawn(move || Communicator::open(config, its));
    let (begun_us, mut has_said) = (now_us(), false);
    while !opening.is_finished() {
        if session.has_ended() || !stop.sleep_until(now_us() + LOOK_EVERY_US) {
            return Ok(None);
        }
        if !has_said && now_us() > begun_us + SAY_AFTER_US {
            say(&format_args!("nobody lets {place} in yet; it goes on trying"));
            has_said = true;
        }
    }
    let opened = opening.join().map_err(|_| anyhow!("zenoh has panicked"))?;
    Ok(Some(Arc::new(opened?)))
}

impl Options {
    fn rules(&self) -> anyhow::Result<Rules> {
        let mut file = String::new();
        if let Some(path) = &self.rules {
            let name = path.display();
            file = fs::read_to_string(path).with_context(|| format!("cannot read {name}"))?;
        }
        let rules = Rules::new(&file, self.export.clone(), self.import.clone());
        let rules = rules.map_err(|why| match &self.rules {
            Some(path) => anyhow!("{}, {why}", path.display()),
            None => anyhow!(why),
        })?;
        if rules.is_empty() {
            bail!("nothing is to cross; say what with --export, --import or --rules");
        }
        if self.connect.is_empty() && self.listen.is_empty() && self.config.is_none() {
            bail!("nobody can be reached; say how with --connect, --listen or --config");
        }
        Ok(rules)
    }

    fn machine(&self) -> anyhow::Result<String> {
        if let Some(name) = &self.name {
            if !is_machine_name(name) {
                bail!(
                    "{name:?} is no name for a machine: it has letters, digits, - and _, \
                     {MACHINE_NAME_MAX_BYTES} at most"
                );
            }
            return Ok(name.clone());
        }
        let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        let first = host.trim().split('.').next().unwrap_or_default().to_string();
        if !is_machine_name(&first) {
            bail!("the host name {first:?} is no name for a machine; give one with --name");
        }
        Ok(first)
    }
}

/// There is one reach on a system: of two, each would send out what the other has
/// brought in.
fn wait_for_predecessor(session: &Session, stop: &Stop) -> anyhow::Result<()> {
    let deadline_us = now_us() + PREDECESSOR_US;
    while session.exists(&ReachStatus::METADATA.name, Instance::FIRST)? {
        if now_us() > deadline_us || !stop.sleep_until(now_us() + LOOK_EVERY_US) {
            bail!(ANOTHER_RUNS);
        }
    }
    Ok(())
}

/// Of two that have begun at the same time the one stays that is there first.
fn give_way(session: &Session) -> anyhow::Result<()> {
    let topic = &ReachStatus::METADATA.name;
    let node = Node::open(session.system(), topic, Instance::FIRST, Role::Observer)?;
    let publishers = node.status().publishers;
    if publishers.first().is_some_and(|first| first.peer != session.peer()) {
        bail!(ANOTHER_RUNS);
    }
    Ok(())
}

/// Each topic that leaves takes a few descriptors.
fn raise_descriptor_limit() {
    if let Ok((_, hard)) = getrlimit(Resource::RLIMIT_NOFILE) {
        // With the old limit it goes as far as it goes.
        let _ = setrlimit(Resource::RLIMIT_NOFILE, hard, hard);
    }
}
