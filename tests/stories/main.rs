//! Whole-bus stories, by what they are about.

/// One publisher, one subscriber, and what they may expect of each other.
mod basics;
/// Several processes on one node.
mod crowds;
/// Processes that die, brokers that die, systems that end.
mod deaths;
/// A subscription is a file descriptor: poll(2), epoll, tokio, intervals.
mod descriptors;
/// Instances: who gets which.
mod instances;
/// Layouts that do not match, topics that nobody has described yet.
mod layouts;
/// Directories, limits and leftovers.
mod places;
