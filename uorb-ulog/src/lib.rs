//! ULog, the format of PX4's flight logs.
//!
//! [`read`] tells what is in a log: which topics there are, with the layouts of
//! their messages, and the messages themselves, in the order of the file. What is
//! wrong with a log is a [`Fault`] that names the byte.
//!
//! [`Writer`] writes one, record by record, to whatever takes bytes, and [`record()`]
//! a bus.
//!
//! The format is described at <https://docs.px4.io/main/en/dev_log/ulog_file_format>.
#![deny(missing_docs)]
#![deny(unsafe_code)]

mod format;
mod log;
mod note;
mod parameters;
mod pattern;
mod record;
mod recorder;
mod schema;
mod writer;

pub use self::{
    format::FormatFault,
    log::{Ending, Fault, Message, RecordFault, Said, Series, Told, read, read_all},
    note::{Info, InfoValue, Note, RawNote},
    parameters::{ParameterFault, parse_parameters},
    pattern::is_match,
    record::{NoLog, Source},
    recorder::{Choice, Place, Plan, RecordError, ReplayReady, Rule, Tally, record},
    schema::Unloggable,
    writer::{Announced, Head, Level, Parameter, ParameterValue, SeriesId, Value, Writer},
};
