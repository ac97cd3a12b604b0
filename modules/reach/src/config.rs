//! How zenoh is set up: what a file says, over what the command line says, over
//! what we think is right.
//!
//! Unless somebody asks for it, it listens nowhere and looks for nobody. Whoever
//! listens is a router of zenoh, and who only connects its client: so those who connect
//! reach each other, too. Of several places to connect to a client takes the first that
//! answers.

use std::path::Path;

use anyhow::{Context, anyhow};
use serde_json::{Map, Value, json};
use zenoh::Config;

/// How long a link may be silent before it is given up. zenoh says something at
/// least four times in this time.
const LEASE_MS: u64 = 4_000;

/// What a socket keeps for the link, and how much goes into it at once. What waits
/// there ages, so it is little: a third of a second at 1 Mbit/s. It is what is under
/// way at most, too: 5 Mbit/s with a round trip of 50 ms.
const SOCKET_BYTES: u32 = 32 << 10;
const BATCH_BYTES: u32 = 8 << 10;

/// An endpoint that can work: zenoh tries others again and again, and says nothing.
pub(crate) fn endpoint(text: &str) -> Result<String, String> {
    let way = ["tcp/", "tls/"].into_iter().find_map(|way| text.strip_prefix(way));
    // Options of zenoh's may stand behind it.
    let address = way.map(|way| way.split(['?', '#']).next().unwrap_or(way));
    let is_address = |(host, port): (&str, &str)| !host.is_empty() && port.parse::<u16>().is_ok();
    match address.and_then(|address| address.rsplit_once(':')).is_some_and(is_address) {
        true => Ok(text.to_string()),
        false => Err("it takes tcp/HOST:PORT or tls/HOST:PORT".into()),
    }
}

pub(crate) fn config(
    connect: &[String],
    listen: &[String],
    file: Option<&Path>,
) -> anyhow::Result<Config> {
    let mut value = defaults(connect, listen);
    if let Some(path) = file {
        let name = path.display();
        let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {name}"))?;
        let theirs = json5::from_str(&text).with_context(|| format!("{name} is not JSON5"))?;
        overlay(&mut value, theirs);
    }
    let words = |error: zenoh::Error| match file {
        Some(path) => anyhow!("{} is no configuration of zenoh: {error}", path.display()),
        None => anyhow!("zenoh does not take this: {error}"),
    };
    Config::from_json5(&value.to_string()).map_err(words)
}

fn defaults(connect: &[String], listen: &[String]) -> Value {
    let mode = if listen.is_empty() { "client" } else { "router" };
    json!({
        "mode": mode,
        "listen": { "endpoints": listen },
        "connect": {
            "endpoints": connect,
            "timeout_ms": -1,
            "exit_on_failure": false,
            "retry": {
                "period_init_ms": 100,
                "period_max_ms": 1_000,
                "period_increase_factor": 2,
            },
        },
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": false } },
        "adminspace": { "enabled": false },
        "transport": { "link": {
            "tcp": { "so_sndbuf": SOCKET_BYTES },
            "tls": { "so_sndbuf": SOCKET_BYTES },
            "tx": {
                "lease": LEASE_MS,
                "batch_size": BATCH_BYTES,
                "queue": { "congestion_control": { "drop": { "wait_before_drop": 0 } } },
            },
        } },
    })
}

/// Puts what is in `above` over what is below, member by member.
fn overlay(below: &mut Value, above: Value) {
    match (below, above) {
        (Value::Object(below), Value::Object(above)) => {
            for (name, value) in above {
                overlay(below.entry(name).or_insert(Value::Object(Map::new())), value);
            }
        }
        (below, above) => *below = above,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(config: &Config, key: &str) -> String {
        config.get_json(key).unwrap()
    }

    #[test]
    fn an_endpoint_has_a_way_a_host_and_a_port() {
        for good in ["tcp/[::]:7447", "tls/gcs.local:1", "tcp/127.0.0.1:0#so_sndbuf=1"] {
            assert_eq!(endpoint(good).as_deref(), Ok(good));
        }
        for bad in ["gcs:7447", "udp/gcs:7447", "tcp/gcs", "tcp/:7447", "tcp/gcs:70000", ""] {
            assert!(endpoint(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn it_listens_nowhere_and_looks_for_nobody_unless_asked() {
        let config = config(&["tcp/127.0.0.1:7447".into()], &[], None).unwrap();
        assert_eq!(at(&config, "listen/endpoints"), "[]");
        assert_eq!(at(&config, "connect/endpoints"), "[\"tcp/127.0.0.1:7447\"]");
        assert_eq!(at(&config, "scouting/multicast/enabled"), "false");
        assert_eq!(at(&config, "mode"), "\"client\"");
    }

    #[test]
    fn a_file_has_the_last_word_on_what_it_names() {
        let mut below = defaults(&["a".into()], &[]);
        overlay(
            &mut below,
            json!({ "mode": "peer", "transport": { "link": { "tls": { "x": 1 } } } }),
        );
        assert_eq!(below["mode"], "peer");
        assert_eq!(below["connect"]["endpoints"], json!(["a"]));
        assert_eq!(below["transport"]["link"]["tls"]["x"], 1);
        assert_eq!(below["transport"]["link"]["tx"]["lease"], LEASE_MS);
    }
}
