//! Two programs publish the same topic, and a third can tell them apart.
//!
//! A BeiDou and a GPS receiver both know the position. Each advertises it, and
//! is told which instance it has become; whoever wants that receiver's position
//! subscribes to that instance. The broker keeps the register of who sends what
//! to whom, so it can name the sender of a message, too.

use std::io::Write;
use std::process::ExitCode;
use std::time::Duration;

use clap::{Args, Parser, Subcommand};
use uorb_core::{Instance, Priority, Publication, Session, Subscription, now_us, poll};
use uorb_modules::random::Random;
use uorb_modules::search::Search;
use uorb_modules::{Outcome, Stop, Ticks, parse_rate, run};

uorb_core::topic! {
    /// Where the vehicle is, in centimetres from where it started.
    pub(crate) struct Position = "position" {
        pub(crate) x: i32,
        pub(crate) y: i32,
        pub(crate) z: i32,
    }
}

const EXAMPLES: &str = "\
Examples, each in a shell of its own:
  position beidou             prints: instance_beidou = 0
  position gps --rate 5       prints: instance_gps = 1
  position show               both receivers' positions, and who sends them
  position show --instance 1  only the second one's

UORB_DIR and UORB_SYSTEM name the system, as for uorb.";

const BEIDOU_EXAMPLES: &str = "\
Examples:
  position beidou                 prints: instance_beidou = 0
  position beidou --priority 100  subscribers may prefer it
  position beidou --count 1       one position, and the node keeps it";

const GPS_EXAMPLES: &str = "\
Examples:
  position gps                    prints: instance_gps = 1, after beidou
  position gps --rate 5           five positions a second";

const SHOW_EXAMPLES: &str = "\
Examples:
  position show                   all receivers' positions, and who sends them
  position show --instance 1      only the second one's
  position show --count 10        ends after ten positions";

/// Publishes a position, as one of several receivers, or shows them.
#[derive(Parser)]
#[command(name = "position", version, after_help = EXAMPLES)]
struct Arguments {
    #[command(subcommand)]
    role: Role,
}

#[derive(Subcommand)]
enum Role {
    /// Publish as the BeiDou receiver
    #[command(after_help = BEIDOU_EXAMPLES)]
    Beidou(Receiver),
    /// Publish as the GPS receiver
    #[command(after_help = GPS_EXAMPLES)]
    Gps(Receiver),
    /// Print each position and which process has sent it
    #[command(after_help = SHOW_EXAMPLES)]
    Show {
        /// One instance, 0 to 9, or all
        #[arg(long, value_name = "N|all", value_parser = parse_instance, default_value = "all")]
        instance: Shown,
        /// End after so many positions
        #[arg(long, value_name = "N")]
        count: Option<u64>,
    },
}

#[derive(Args)]
struct Receiver {
    /// How many positions a second
    #[arg(long, value_name = "HZ", value_parser = parse_rate, allow_negative_numbers = true, default_value = "1")]
    rate: f64,
    /// What subscribers may choose by: 1 (the lowest) to 255
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..))]
    priority: u8,
    /// End after so many positions
    #[arg(long, value_name = "N")]
    count: Option<u64>,
}

#[derive(Clone, Copy)]
enum Shown {
    All,
    One(Instance),
}

fn parse_instance(text: &str) -> Result<Shown, String> {
    if text == "all" {
        return Ok(Shown::All);
    }
    let instance = text.parse().ok().and_then(Instance::new);
    instance.map(Shown::One).ok_or_else(|| "not an instance (0 to 9), nor all".into())
}

fn main() -> ExitCode {
    let Arguments { role } = Arguments::parse();
    run(|stop, out| match role {
        // Where each thinks it is, and by how much it errs, in centimetres.
        Role::Beidou(receiver) => receive("beidou", [120, 80, -20], 25.0, &receiver, stop, out),
        Role::Gps(receiver) => receive("gps", [90, 110, 10], 40.0, &receiver, stop, out),
        Role::Show { instance, count } => show(instance, count.unwrap_or(u64::MAX), stop, out),
    })
}

fn receive(
    name: &str,
    place: [i32; 3],
    noise: f64,
    receiver: &Receiver,
    stop: &Stop,
    out: &mut impl Write,
) -> Outcome {
    let session = Session::connect()?;
    let priority = Priority(receiver.priority);
    let mut position_pub = Publication::<Position>::advertise_multi(&session, priority)?;
    writeln!(out, "instance_{name} = {}", position_pub.instance())?;

    let mut random = Random::new(now_us());
    let mut ticks = Ticks::new(now_us(), receiver.rate);
    let mut left = receiver.count.unwrap_or(u64::MAX);
    while left > 0 && ticks.wait(stop) {
        let [x, y, z] = place.map(|axis| axis + random.gauss(noise).round() as i32);
        position_pub.publish(&Position { x, y, z })?;
        left -= 1;
    }
    Ok(())
}

/// One instance, and who has sent its last position.
struct Sender {
    position_sub: Subscription<Position>,
    peer: Option<u16>,
    name: String,
}

impl Sender {
    fn new(position_sub: Subscription<Position>) -> Self {
        Self { position_sub, peer: None, name: String::new() }
    }

    fn instance(&self) -> Instance {
        self.position_sub.instance()
    }

    /// The broker is asked only when it is another process than before.
    fn name_of(&mut self, session: &Session, peer: u16) -> &str {
        if self.peer != Some(peer) {
            self.peer = Some(peer);
            self.name = match session.process(peer) {
                Ok(Some(process)) => format!("{} (pid {})", process.name, process.pid),
                Ok(None) => "a process that has ended".into(),
                Err(_) => format!("process {peer}, whose name nobody knows without a broker"),
            };
        }
        &self.name
    }
}

fn show(instance: Shown, count: u64, stop: &Stop, out: &mut impl Write) -> Outcome {
    let session = Session::connect()?;
    let first = match instance {
        Shown::One(instance) => instance,
        Shown::All => Instance::FIRST,
    };
    let mut senders = vec![Sender::new(Subscription::subscribe_instance(&session, first)?)];
    let mut search = Search::default();
    let mut left = count;
    while left > 0 && !stop.requested() {
        if matches!(instance, Shown::All) {
            let is_known = |instance| senders.iter().any(|sender| sender.instance() == instance);
            let new = search.subscribe_new(&session, is_known)?;
            senders.extend(new.into_iter().map(Sender::new));
        }
        let mut subscriptions: Vec<_> =
            senders.iter_mut().map(|sender| &mut *sender.position_sub).collect();
        // A second at most: then there may be another instance.
        poll(&mut subscriptions, Some(Duration::from_secs(1)))?;
        for sender in &mut senders {
            let Some(Position { x, y, z }) = sender.position_sub.update() else { continue };
            let Some(copied) = sender.position_sub.last_copied() else { continue };
            let instance = sender.instance();
            let name = sender.name_of(&session, copied.peer);
            writeln!(out, "instance {instance}: x {x:4}  y {y:4}  z {z:4}  sent by {name}")?;
            left = left.saturating_sub(1);
        }
    }
    Ok(())
}
