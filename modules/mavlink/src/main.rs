//! PX4's mavlink: the bus, spoken to ground stations and companion programs.
//!
//! Without a command it runs until Ctrl-C, SIGTERM or `uorb stop`, as every
//! module; `start`, `status` and `stop` are PX4's.

mod background;
mod options;

use std::error::Error;
use std::io::{ErrorKind, Write};
use std::process::ExitCode;
use std::sync::Arc;
use std::thread;

use clap::Parser;
use uorb_core::Error::Refused;
use uorb_core::{Refusal, Session};
use uorb_mavlink::incoming::Incoming;
use uorb_mavlink::link::{Link, Settings};
use uorb_mavlink::parameter_file::{ParameterFile, ParameterFileError};
use uorb_mavlink::signing::signing;
use uorb_mavlink::transport;
use uorb_modules::{Outcome, Stop, run};

use options::{LinkOptions, split};

const EXAMPLES: &str = "\
Examples:
  mavlink start                        PX4 SITL's two links: a ground station at
                                       port 14550, programs at port 14540
  mavlink start -u 14556 -o 14550 -t 192.168.1.5 --bind 0.0.0.0 -m normal -r 20000
  mavlink start -d /dev/ttyUSB0 -b 57600 -m minimal
  mavlink start -u 14556 -m custom -- --tcp-listen 5760 -m onboard
                                       two links in one process
  mavlink start --parameters vehicle.params
                                       what PARAM_SET changes is kept there
  mavlink start --signing-key key      both sides have the key, or are not heard
  mavlink status
  mavlink stop

Links listen to this machine alone unless --bind says otherwise. Answers go to
whoever has spoken last. UORB_DIR and UORB_SYSTEM name the system, as for uorb;
vehicle N is system N+1 in MAVLink.

Exit code 0: it went well; 1: an error; of `status` and `stop` also: no bridge
runs.";

/// Speaks MAVLink for a vehicle on the bus.
#[derive(Parser)]
#[command(name = "mavlink", version, after_help = EXAMPLES, args_conflicts_with_subcommands = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,

    #[command(flatten)]
    link: LinkOptions,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Bridge in the background, until `mavlink stop`
    Start(LinkOptions),
    /// Say which links there are, who is there, and what was lost
    Status,
    /// End all bridges of this system
    #[command(visible_alias = "stop-all")]
    Stop,
}

/// A link behind a `--`.
#[derive(Parser)]
#[command(name = "mavlink")]
struct Another {
    #[command(flatten)]
    link: LinkOptions,
}

fn main() -> ExitCode {
    let mut parts = split(std::env::args_os()).into_iter();
    let arguments = Arguments::parse_from(parts.next().unwrap_or_default());
    let others: Vec<_> = parts.map(|part| Another::parse_from(part).link).collect();
    run(|stop, out| match arguments.command {
        Some(Command::Start(_)) => background::start(stop, out),
        Some(Command::Status) => background::status(out),
        Some(Command::Stop) => background::stop(stop, out),
        None => {
            let links: Vec<_> = [arguments.link].into_iter().chain(others).collect();
            bridge(links, stop, out)
        }
    })
}

fn bridge(links: Vec<LinkOptions>, stop: &Stop, out: &mut impl Write) -> Outcome {
    let session = Session::connect()?;
    let system = session.system().number();
    let links = match &links[..] {
        [alone] if alone.has_no_way() => alone.pair(alone.system_id(system)?)?,
        _ => links,
    };
    let mut opened = Vec::new();
    for (number, options) in links.iter().enumerate() {
        let file = parameter_file(&session, options)?;
        let link = open(&session, number, options)?;
        writeln!(out, "[mavlink] {}", link.describe())?;
        let incoming = Incoming::new(&link, number, file);
        opened.push((link, incoming));
    }
    out.flush()?;
    // Each ends when it is asked to, or with the system; so do all others.
    thread::scope(|scope| {
        let threads: Vec<_> = opened
            .into_iter()
            .map(|(link, incoming)| scope.spawn(move || link.run(incoming, stop)))
            .collect();
        threads.into_iter().try_for_each(|thread| match thread.join() {
            Ok(ended) => Ok(ended?),
            Err(_) => Err("a link's thread panicked".into()),
        })
    })
}

/// Where a link's parameters are kept. That it makes sense is known at once.
fn parameter_file(
    session: &Session,
    options: &LinkOptions,
) -> Result<ParameterFile, ParameterFileError> {
    let path = options.parameters.clone();
    let file =
        ParameterFile::new(path.unwrap_or_else(|| session.system().dir().join("parameters")));
    file.read().map(|_| file)
}

/// Opens a link. Its number is in its signatures.
fn open(session: &Session, number: usize, options: &LinkOptions) -> Result<Link, Box<dyn Error>> {
    let settings = Settings {
        system_id: options.system_id(session.system().number())?,
        mode: options.mode(),
        data_rate: options.data_rate(),
    };
    let address = options.address()?;
    let transport = transport::open(&address).map_err(|error| match error.kind() {
        ErrorKind::AddrInUse => {
            format!(
                "{address} is in use, perhaps by a bridge that `mavlink status` shows: say another"
            )
        }
        _ => format!("{address}: {error}"),
    })?;
    let signing = options.signing_key.as_deref().map(|path| signing(path, number as u8));
    let signing = signing.transpose()?.map(Arc::new);
    Link::new(session, transport, signing, settings).map_err(|error| match error {
        Refused(Refusal::InstancesTaken { .. }) => {
            "a system has ten links at most: use fewer, or end others with `mavlink stop`".into()
        }
        error => error.into(),
    })
}
