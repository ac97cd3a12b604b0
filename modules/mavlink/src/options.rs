//! A link on the command line, in PX4's words.
//!
//! Several links stand one after the other, with `--` between them. Without any,
//! it is PX4 SITL's pair: one for a ground station and one for programs.

use std::ffi::OsString;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs};
use std::path::PathBuf;

use clap::{ArgGroup, Args};

use uorb_mavlink::outgoing::Mode;
use uorb_mavlink::transport::Address;
use uorb_modules::system_id;

/// The ports of PX4's simulated vehicle 0: ours, and where the partner listens.
const GROUND_STATION: (u16, u16) = (18570, 14550);
const PROGRAMS: (u16, u16) = (14580, 14540);

/// PX4's ports for a link of which nothing is said.
const DEFAULT_PORTS: (u16, u16) = (14556, 14550);

/// What PX4 gives a simulated vehicle's links: as good as no limit.
const NETWORK_DATA_RATE: u32 = 4_000_000;

/// A link.
#[derive(Clone, Debug, Args)]
#[command(group(ArgGroup::new("way").args(["device", "tcp", "tcp_listen"])))]
pub(crate) struct LinkOptions {
    /// UDP port to be at [default: 14556]
    #[arg(short = 'u', value_name = "PORT", conflicts_with = "way")]
    port: Option<u16>,

    /// UDP port to send to until the partner has spoken [default: 14550]
    #[arg(short = 'o', value_name = "PORT", conflicts_with = "way")]
    remote_port: Option<u16>,

    /// Partner's address [default: 127.0.0.1]
    #[arg(short = 't', value_name = "IP", conflicts_with = "way")]
    partner: Option<IpAddr>,

    /// Address to be at: 0.0.0.0 lets other machines speak to the vehicle
    /// [default: 127.0.0.1, or ::1 where the partner's is one of IPv6]
    #[arg(long, value_name = "IP", conflicts_with_all = ["device", "tcp"])]
    bind: Option<IpAddr>,

    /// Serial device, instead of UDP
    #[arg(short = 'd', value_name = "DEVICE")]
    device: Option<PathBuf>,

    /// Its speed [default: 57600]
    #[arg(short = 'b', value_name = "BAUD", requires = "device")]
    baud: Option<u32>,

    /// Connect to a partner by TCP, instead of UDP
    #[arg(long, value_name = "HOST:PORT")]
    tcp: Option<String>,

    /// Wait for a partner to connect by TCP, instead of UDP
    #[arg(long, value_name = "PORT")]
    tcp_listen: Option<u16>,

    /// What goes out [default: normal]
    #[arg(short = 'm', value_enum)]
    mode: Option<Mode>,

    /// How many bytes a second may go out [default: half of what a serial
    /// device takes, 4000000 elsewhere]
    #[arg(short = 'r', value_name = "B/S",
        value_parser = clap::value_parser!(u32).range(10..=10_000_000))]
    data_rate: Option<u32>,

    /// Number of the vehicle: it is 1 more in MAVLink [default: the system's
    /// number]
    #[arg(short = 'i', value_name = "N")]
    vehicle: Option<u32>,

    /// Sign what goes out, and take only what is signed, with the key in this
    /// file: 64 hexadecimal digits
    #[arg(long, value_name = "FILE")]
    pub(crate) signing_key: Option<PathBuf>,

    /// Keep parameters in this file, `NAME VALUE` a line, or QGroundControl's
    /// .params [default: the file parameters in the system's directory, which
    /// goes with the system]
    #[arg(long, value_name = "FILE")]
    pub(crate) parameters: Option<PathBuf>,
}

impl LinkOptions {
    /// Whether nothing is said about where the link goes.
    pub(crate) fn has_no_way(&self) -> bool {
        let Self { port, remote_port, partner, device, tcp, tcp_listen, .. } = self;
        port.is_none()
            && remote_port.is_none()
            && partner.is_none()
            && device.is_none()
            && tcp.is_none()
            && tcp_listen.is_none()
    }

    /// PX4 SITL's pair of links for the vehicle of this number in MAVLink.
    pub(crate) fn pair(&self, system_id: u8) -> Result<Vec<Self>, String> {
        if self.mode.is_some() {
            return Err("-m is for one link: say which, as with -u 14556".into());
        }
        let offset = u16::from(system_id) - 1;
        let link = |(port, remote_port): (u16, u16), remote_offset, mode| Self {
            port: Some(port + offset),
            remote_port: Some(remote_port + remote_offset),
            mode: Some(mode),
            ..self.clone()
        };
        // All vehicles speak to the one ground station.
        Ok(vec![link(GROUND_STATION, 0, Mode::Normal), link(PROGRAMS, offset, Mode::Onboard)])
    }

    /// Our number in MAVLink.
    pub(crate) fn system_id(&self, system: u32) -> Result<u8, String> {
        system_id(self.vehicle.unwrap_or(system))
    }

    /// What goes out.
    pub(crate) fn mode(&self) -> Mode {
        self.mode.unwrap_or(Mode::Normal)
    }

    /// How many bytes a second may go out.
    pub(crate) fn data_rate(&self) -> u32 {
        let default = match (&self.device, self.baud()) {
            // Ten bits a byte, and half of the time for whoever else sends.
            (Some(_), baud) => baud / 20,
            (None, _) => NETWORK_DATA_RATE,
        };
        self.data_rate.unwrap_or(default)
    }

    fn baud(&self) -> u32 {
        self.baud.unwrap_or(57_600)
    }

    /// Where the link goes.
    pub(crate) fn address(&self) -> Result<Address, String> {
        // Both are of one family: what is not said is what is said of the other.
        let here = IpAddr::V4(Ipv4Addr::LOCALHOST);
        let bind = self.bind.unwrap_or(self.partner.map_or(here, loopback));
        if let Some(device) = &self.device {
            return Ok(Address::Serial { device: device.clone(), baud: self.baud() });
        }
        if let Some(port) = self.tcp_listen {
            return Ok(Address::TcpListen(SocketAddr::new(bind, port)));
        }
        if let Some(partner) = &self.tcp {
            let found = partner
                .to_socket_addrs()
                .map_err(|error| format!("--tcp {partner}: {error}; it takes HOST:PORT"))?;
            let first = found.into_iter().next();
            return first.map(Address::TcpConnect).ok_or_else(|| format!("{partner}: no address"));
        }
        let partner = self.partner.unwrap_or(loopback(bind));
        if bind.is_ipv4() != partner.is_ipv4() {
            return Err(format!(
                "{partner} cannot be reached from {bind}: say two of IPv4, or two of IPv6"
            ));
        }
        if bind.is_loopback() && !partner.is_loopback() {
            let any = if partner.is_ipv4() { "0.0.0.0" } else { "::" };
            return Err(format!(
                "{partner} cannot be reached from {bind}: add --bind {any}, \
                 and other machines can speak to the vehicle"
            ));
        }
        let (port, remote_port) = DEFAULT_PORTS;
        Ok(Address::Udp {
            local: SocketAddr::new(bind, self.port.unwrap_or(port)),
            remote: SocketAddr::new(partner, self.remote_port.unwrap_or(remote_port)),
        })
    }
}

/// This machine, to itself, in the family of an address.
fn loopback(of: IpAddr) -> IpAddr {
    match of {
        IpAddr::V4(_) => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(_) => Ipv6Addr::LOCALHOST.into(),
    }
}

/// The command line's first part, and those behind each `--`.
pub(crate) fn split(arguments: impl Iterator<Item = OsString>) -> Vec<Vec<OsString>> {
    let mut parts = vec![Vec::new()];
    for argument in arguments {
        if argument == "--" {
            parts.push(vec!["mavlink".into()]);
        } else if let Some(part) = parts.last_mut() {
            part.push(argument);
        }
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        link: LinkOptions,
    }

    fn link(line: &str) -> LinkOptions {
        Line::parse_from(["mavlink"].into_iter().chain(line.split_whitespace())).link
    }

    fn udp(local: &str, remote: &str) -> Address {
        Address::Udp { local: local.parse().unwrap(), remote: remote.parse().unwrap() }
    }

    #[test]
    fn without_words_it_is_the_pair_of_links_of_a_simulated_vehicle() {
        let pair = link("").pair(1).unwrap();
        let addresses: Vec<_> = pair.iter().map(|link| link.address().unwrap()).collect();
        let station = udp("127.0.0.1:18570", "127.0.0.1:14550");
        assert_eq!(addresses, [station, udp("127.0.0.1:14580", "127.0.0.1:14540")]);
        assert_eq!((pair[0].mode(), pair[1].mode()), (Mode::Normal, Mode::Onboard));

        let third = link("").pair(3).unwrap();
        let addresses: Vec<_> = third.iter().map(|link| link.address().unwrap()).collect();
        let station = udp("127.0.0.1:18572", "127.0.0.1:14550");
        assert_eq!(addresses, [station, udp("127.0.0.1:14582", "127.0.0.1:14542")]);
    }

    #[test]
    fn px4_s_words_mean_what_they_mean_there() {
        let one = link("-u 14556 -o 14557 -t 10.0.0.7 --bind 0.0.0.0 -m onboard -r 20000");
        assert_eq!(one.address().unwrap(), udp("0.0.0.0:14556", "10.0.0.7:14557"));
        assert_eq!((one.mode(), one.data_rate()), (Mode::Onboard, 20_000));
        assert!(!one.has_no_way() && link("-m onboard -i 3").has_no_way());

        let serial = link("-d /dev/ttyS1 -b 115200");
        let device = PathBuf::from("/dev/ttyS1");
        assert_eq!(serial.address().unwrap(), Address::Serial { device, baud: 115_200 });
        assert_eq!(serial.data_rate(), 5_760);
        assert_eq!(link("-d /dev/ttyS1").data_rate(), 2_880);
    }

    #[test]
    fn nothing_listens_beyond_this_machine_unless_told() {
        let words = link("-u 1 -t 192.168.1.5").address().unwrap_err();
        assert!(words.contains("--bind 0.0.0.0"), "{words}");
        let words = link("-u 1 -t fd00::1").address().unwrap_err();
        assert!(words.contains("--bind ::,"), "{words}");
        let Address::TcpListen(local) = link("--tcp-listen 5760").address().unwrap() else {
            panic!("it listens")
        };
        assert!(local.ip().is_loopback());
    }

    #[test]
    fn a_link_is_at_an_address_of_its_partner_s_family() {
        let address = |line| link(line).address();
        assert_eq!(address("-u 1 -o 2 -t ::1"), Ok(udp("[::1]:1", "[::1]:2")));
        assert_eq!(address("-u 1 -o 2 --bind ::"), Ok(udp("[::]:1", "[::1]:2")));
        let words = address("-u 1 -t fd00::1 --bind 0.0.0.0").unwrap_err();
        assert!(words.contains("0.0.0.0") && words.contains("fd00::1"), "{words}");
    }

    #[test]
    fn vehicles_are_numbered_from_1_in_mavlink() {
        assert_eq!(link("").system_id(0), Ok(1));
        assert_eq!(link("-i 249").system_id(0), Ok(250));
        assert!(link("").system_id(250).is_err());
        assert!(link("-i 4294967295").system_id(0).is_err());
    }

    #[test]
    fn a_mode_is_that_of_a_link_and_not_of_the_pair() {
        let words = link("-m minimal").pair(1).unwrap_err();
        assert!(words.contains("-m") && words.contains("-u"), "{words}");
    }

    #[test]
    fn links_are_parted_by_two_dashes() {
        let line = "mavlink -u 1 -- -u 2 -m onboard".split(' ').map(OsString::from);
        let parts = split(line);
        assert_eq!(parts[0], ["mavlink", "-u", "1"]);
        assert_eq!(parts[1], ["mavlink", "-u", "2", "-m", "onboard"]);
    }
}
