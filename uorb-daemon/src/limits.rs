//! What the broker takes on, in one place.

use std::time::Duration;

/// Processes at a time. Each costs the broker two descriptors.
pub(crate) const PEERS_MAX: usize = 2_048;

/// Connections at a time, those included that have not said who they are.
pub(crate) const CONNECTIONS_MAX: usize = PEERS_MAX + 64;

/// Nodes, that is instances of all topics together.
pub(crate) const NODES_MAX: usize = 8_192;

/// Publications and subscriptions of one process.
pub(crate) const HANDLES_MAX: usize = 65_536;

/// Bytes that wait for a process which does not read. One that lets so many
/// pile up is cut off: the broker waits for nobody.
pub(crate) const OUTBOUND_MAX_BYTES: usize = 1 << 20;

/// Users that a layout mismatch names.
pub(crate) const USERS_NAMED_MAX: usize = 8;

/// Packets taken from one process before the others have their turn.
pub(crate) const PACKETS_A_TURN: usize = 64;

/// The size at which the log is put aside and begun anew, in bytes. Two files
/// are kept, so it takes twice this.
pub(crate) const LOG_MAX_BYTES: u64 = 1 << 20;

/// How long a second `uorb start` waits for the first to answer.
pub(crate) const RUNNING_TIMEOUT: Duration = Duration::from_secs(5);

/// How often processes are looked at that live without a connection.
pub(crate) const DOUBT_INTERVAL: Duration = Duration::from_secs(1);

/// How often the streams are looked at for foreign programs: one that begins to
/// follow a stream misses what is published until it is seen.
pub(crate) const LOOK_INTERVAL: Duration = Duration::from_millis(100);

/// How long the ports of a dead process are kept for those who follow and have not
/// looked since.
pub(crate) const DEAD_KEPT_FOR: Duration = Duration::from_secs(1);

/// Dead processes whose ports are kept: they take places from living publishers,
/// and a stream has as many for the dead as for the living.
pub(crate) const DEAD_MAX: usize = 16;

/// How often it is looked whether they are still needed.
pub(crate) const DEAD_LOOK_INTERVAL: Duration = Duration::from_millis(5);

/// How often iceoryx2 cleans up after dead foreign programs. After processes of
/// ours it does as soon as nobody needs what they have sent.
pub(crate) const CLEAN_UP_INTERVAL: Duration = Duration::from_secs(2);

/// How often it is looked for what somebody who was killed has left unfinished in
/// the memory of streams: whoever opens that waits until it is gone.
pub(crate) const UNFINISHED_INTERVAL: Duration = Duration::from_millis(250);
