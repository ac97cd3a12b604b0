//! Whole-bus stories, by what they are about.

/// `uorb listener --all-messages`, and large topics.
mod all_messages;
/// One publisher, one subscriber, and what they may expect of each other.
mod basics;
/// Processes in C beside processes in Rust.
mod c_and_rust;
/// The C door: headers, symbols, functions and classes.
mod c_door;
/// The programs of the seed documents.
mod c_examples;
/// C programs that fork, have threads, and publish from signal handlers.
mod c_processes;
/// `uorb start`, `stop` and `status`.
mod command;
/// The module `commander`.
mod commander;
/// Several processes on one node.
mod crowds;
/// Processes that die, brokers that die, systems that end.
mod deaths;
/// A subscription is a file descriptor: poll(2), epoll, tokio, intervals.
mod descriptors;
/// `uorb ulog info` and `uorb export`.
mod exports;
/// What the kernel does not give.
mod faults;
/// Real flight logs.
mod flight_logs;
/// Programs of another house, which join by iceoryx2.
mod foreign;
/// A partner of the MAVLink bridge.
mod ground_station;
/// What publish and copy never do.
mod hot_path;
/// `uorb msg`, `scripts/install`, and programs in C built with what they make.
mod installed;
/// Instances: who gets which.
mod instances;
/// Layouts that do not match, topics that nobody has described yet.
mod layouts;
/// `uorb listener`.
mod listening;
/// Readers of flight logs, of another house.
mod log_readers;
/// The MAVLink bridge: links, and what goes out.
mod mavlink;
/// The MAVLink bridge in the background.
mod mavlink_background;
/// The MAVLink bridge: pymavlink, MAVSDK and MAVProxy.
mod mavlink_clients;
/// The MAVLink bridge: what comes in.
mod mavlink_commands;
/// A node does what a model of it in plain Rust does.
mod model;
/// The modules and `scripts/rc.sensors`.
mod modules;
/// Directories, limits and leftovers.
mod places;
/// `uorb plot`.
mod plots;
/// `uorb pub`, `info` and `ls`.
mod publishing;
/// `reach`, between buses of one machine.
mod reach;
/// `reach`, between machines.
mod reach_hosts;
/// `uorb record`.
mod recording;
/// `uorb record` when the disk, or it itself, gets into trouble.
mod recording_in_need;
/// Rotation, rates, parameters, words, and the module `logger`.
mod recording_ways;
/// `uorb replay`.
mod replay;
/// `uorb replay`, again and again, in part, under other names, and key by key.
mod replay_ways;
/// Processes that the broker cannot trust, and a broker in need.
mod strangers;
/// Streams whose publishers and followers are killed.
mod stream_deaths;
/// Streams: every message, without a copy.
mod streams;
/// Programs on a terminal.
mod terminal;
/// `uorb top`.
mod top;
/// `uorb test`.
mod unit_tests;
