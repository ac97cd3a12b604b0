//! A process of a story: it does one thing on the bus, and says so in lines.
fn main() {}
