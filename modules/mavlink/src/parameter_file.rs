//! The parameters' file: `NAME VALUE [DEFAULT]` a line, or QGroundControl's .params.
//!
//! The same that `uorb record --parameters` reads. A value is changed where it
//! stands, so comments and order stay. The new file takes the old one's name when
//! it is whole: whoever reads or dies has one or the other. Where there is no file
//! yet, there are defaults, and the first change writes them.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

use uorb_ulog::{Parameter, ParameterFault, ParameterValue, parse_parameters};

/// What ground stations ask for.
const DEFAULTS: &str = "\
# Parameters, for ground stations. NAME VALUE, or NAME VALUE DEFAULT.
COM_RC_IN_MODE 1
MIS_TAKEOFF_ALT 2.5
MPC_XY_CRUISE 5.0
RTL_RETURN_ALT 60.0
SYS_AUTOSTART 4001
";

/// Where parameters are kept.
#[derive(Clone, Debug)]
pub struct ParameterFile {
    path: PathBuf,
}

/// What is wrong with the file.
#[derive(Debug, thiserror::Error)]
pub enum ParameterFileError {
    /// It cannot be read or written.
    #[error("cannot {action} {path}: {source}")]
    Io {
        /// What was tried.
        action: &'static str,
        /// Which file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// A line makes no sense. Mend it, or remove the file: defaults take its place.
    #[error("{path}, {fault}")]
    Fault {
        /// Which file.
        path: PathBuf,
        /// Which line.
        fault: ParameterFault,
    },
}

impl ParameterFile {
    /// The file at `path`, which need not be there yet.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    /// All parameters, in the file's order.
    ///
    /// # Errors
    ///
    /// [`ParameterFileError`], which names the file.
    pub fn read(&self) -> Result<Vec<Parameter>, ParameterFileError> {
        self.parse(&self.text()?)
    }

    /// Changes one that is there.
    ///
    /// # Errors
    ///
    /// [`ParameterFileError`], and then the file is as it was.
    pub fn set(&self, name: &str, value: ParameterValue) -> Result<(), ParameterFileError> {
        let folder = self.path.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new("."));
        // Links and processes change it one after the other. Ends with `lock`.
        let lock = File::open(folder).map_err(self.failed("lock"))?;
        lock.lock().map_err(self.failed("lock"))?;
        let text = with(&self.text()?, name, value);
        self.parse(&text)?;
        self.replace(&text).map_err(self.failed("write"))
    }

    fn text(&self) -> Result<String, ParameterFileError> {
        match fs::read_to_string(&self.path) {
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(DEFAULTS.into()),
            text => text.map_err(self.failed("read")),
        }
    }

    fn parse(&self, text: &str) -> Result<Vec<Parameter>, ParameterFileError> {
        let fault = |fault| ParameterFileError::Fault { path: self.path.clone(), fault };
        parse_parameters(text).map_err(fault)
    }

    fn replace(&self, text: &str) -> io::Result<()> {
        let mut new = self.path.clone().into_os_string();
        new.push(".new");
        let new = PathBuf::from(new);
        let mut file = File::create(&new)?;
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(&new, &self.path)
    }

    fn failed(&self, action: &'static str) -> impl Fn(io::Error) -> ParameterFileError {
        move |source| ParameterFileError::Io { action, path: self.path.clone(), source }
    }
}

/// The text with another value for `name`.
fn with(text: &str, name: &str, value: ParameterValue) -> String {
    let value = match value {
        ParameterValue::Int32(value) => value.to_string(),
        // With a point or an exponent: it stays a float.
        ParameterValue::Float(value) => format!("{value:?}"),
    };
    let lines = text.lines().map(|line| changed(line, name, &value).unwrap_or(line.into()) + "\n");
    lines.collect()
}

/// The line with another value, if it is the one of `name`.
fn changed(line: &str, name: &str, value: &str) -> Option<String> {
    let columns: Vec<&str> = line.split_whitespace().collect();
    match columns[..] {
        [it, _] if it == name => Some(format!("{it} {value}")),
        [it, _, default] if it == name => Some(format!("{it} {value} {default}")),
        [vehicle, component, it, _, kind] if it == name => {
            Some(format!("{vehicle}\t{component}\t{it}\t{value}\t{kind}"))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ParameterValue::{Float, Int32};

    #[test]
    fn a_value_is_changed_where_it_stands() {
        let text = "# mine\nA 1\n1\t1\tB\t2.5\t9\nC 3 4\n";
        assert_eq!(with(text, "A", Int32(-7)), "# mine\nA -7\n1\t1\tB\t2.5\t9\nC 3 4\n");
        assert_eq!(with(text, "B", Float(1.0)), "# mine\nA 1\n1\t1\tB\t1.0\t9\nC 3 4\n");
        assert_eq!(with(text, "C", Int32(9)), "# mine\nA 1\n1\t1\tB\t2.5\t9\nC 9 4\n");
    }

    #[test]
    fn floats_stay_floats_and_exact() {
        for value in [0.0, 1.0, -2.0, 0.1, 1e30, 1e-30, f32::MIN_POSITIVE, f32::MAX] {
            let parameters = parse_parameters(&with("A 0.5\n", "A", Float(value))).unwrap();
            assert_eq!(parameters[0].value, Float(value));
        }
    }

    #[test]
    fn the_first_change_writes_the_defaults() {
        let folder = std::env::temp_dir().join(format!("uorb-parameters-{}", std::process::id()));
        fs::create_dir(&folder).unwrap();
        let file = ParameterFile::new(folder.join("parameters"));
        let before = file.read().unwrap();
        file.set("MIS_TAKEOFF_ALT", Float(10.0)).unwrap();
        let after = file.read().unwrap();
        assert_eq!(before.len(), after.len());
        let altitude = after.iter().find(|it| it.name == "MIS_TAKEOFF_ALT").unwrap();
        assert_eq!(altitude.value, Float(10.0));
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1, "nothing else is left there");
        fs::write(folder.join("parameters"), "nonsense\n").unwrap();
        let error = file.read().unwrap_err().to_string();
        assert!(error.contains("line 1"), "{error}");
        fs::remove_dir_all(&folder).unwrap();
    }
}
