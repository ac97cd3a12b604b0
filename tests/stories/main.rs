//! Whole-bus stories, by what they are about.

/// One publisher, one subscriber, and what they may expect of each other.
mod basics;
