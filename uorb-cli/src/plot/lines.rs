//! Fields of a topic as lines: what they are called, and where their points are.

use std::collections::VecDeque;

use anyhow::bail;
use uorb_core::{FieldType, Layout};

use crate::fields::path::{self, Place};
use crate::fields::{Content, Scalar};
use crate::topics::compiled_in;

/// The most points of a line that are kept: of a window, the newest.
const POINTS_MAX: usize = 1 << 20;

/// A value beyond is drawn here: the difference of any two must be a number, with
/// room around it. plotters looks for marks on an endless axis for ever.
const VALUE_MAX: f64 = 1e300;

/// Lines over one time.
#[derive(Debug)]
pub(super) struct Lines {
    layout: Layout,
    pub(super) lines: Vec<Line>,
}

/// One number of a message over time.
#[derive(Debug)]
pub(super) struct Line {
    /// The field: `q[1]`.
    pub(super) path: String,
    /// Empty: not known.
    pub(super) unit: String,
    /// Seconds and values. NaN: a gap.
    pub(super) points: VecDeque<(f64, f64)>,
}

impl Line {
    /// What stands beside it: `x [m/s^2]`.
    pub(super) fn label(&self) -> String {
        match &*self.unit {
            "" => self.path.clone(),
            unit => format!("{} [{unit}]", self.path),
        }
    }

    fn push(&mut self, seconds: f64, value: f64) {
        let value = if value.is_finite() { value.clamp(-VALUE_MAX, VALUE_MAX) } else { value };
        self.points.push_back((seconds, value));
        if self.points.len() > POINTS_MAX {
            self.points.pop_front();
        }
    }

    /// Its parts without a gap.
    pub(super) fn segments(&self) -> Vec<Vec<(f64, f64)>> {
        let mut segments = vec![Vec::new()];
        for &point in &self.points {
            match point.1.is_finite() {
                true => segments.last_mut().expect("there is one").push(point),
                false => segments.push(Vec::new()),
            }
        }
        segments.retain(|segment| !segment.is_empty());
        segments
    }
}

impl Lines {
    /// # Errors
    ///
    /// A field is not there, is no number, or none is named.
    pub(super) fn new(topic: &str, layout: &Layout, fields: &[String]) -> anyhow::Result<Self> {
        let mut lines = Vec::new();
        for field in fields {
            let place = path::find(layout, field)?;
            let line = |path: String| {
                let unit = unit_of(topic, layout, &path);
                Line { path, unit, points: VecDeque::new() }
            };
            match (place.ty, place.array_length) {
                (FieldType::Message(_), _) | (FieldType::Char, Some(_)) => {
                    bail!("{field} is {}, which is no number: name one in it", place.type_name())
                }
                (_, None) => lines.push(line(field.clone())),
                (_, Some(length)) => {
                    lines.extend((0..length).map(|index| line(format!("{field}[{index}]"))));
                }
            }
        }
        if lines.is_empty() {
            let names: Vec<String> = path::all(layout).into_iter().map(|it| it.path).collect();
            bail!("which fields of {topic}? It has {}", names.join(", "));
        }
        Ok(Self { layout: layout.clone(), lines })
    }

    pub(super) fn are_of(&self, layout: &Layout) -> bool {
        self.layout == *layout
    }

    /// Counts the seconds from here.
    pub(super) fn begin_at(&mut self, seconds: f64) {
        let points = self.lines.iter_mut().flat_map(|line| &mut line.points);
        points.for_each(|point| point.0 -= seconds);
    }

    pub(super) fn are_empty(&self) -> bool {
        self.lines.iter().all(|line| line.points.is_empty())
    }

    /// Adds a point of a message to each line.
    pub(super) fn add(&mut self, seconds: f64, message: &[u8]) {
        for line in &mut self.lines {
            // It was found before.
            let place = path::find(&self.layout, &line.path).ok();
            let value = place.and_then(|place| value_of(&place, message)).unwrap_or(f64::NAN);
            line.push(seconds, value);
        }
    }

    /// Forgets what is older.
    pub(super) fn forget_before(&mut self, seconds: f64) {
        for line in &mut self.lines {
            while line.points.front().is_some_and(|point| point.0 < seconds) {
                line.points.pop_front();
            }
        }
    }

    /// From the least to the greatest value between two moments, with some room;
    /// None where there is none.
    pub(super) fn y_range(&self, from: f64, to: f64) -> Option<(f64, f64)> {
        let values = self.lines.iter().flat_map(|line| &line.points);
        let values = values.filter(|point| (from..=to).contains(&point.0) && point.1.is_finite());
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), point| {
            (low.min(point.1), high.max(point.1))
        });
        if low > high {
            return None;
        }
        let room = match high - low {
            // All the same, or so near that there are no marks in between.
            room if room <= low.abs() * 1e-9 => low.abs().max(1.0) * 0.1,
            room => room * 0.05,
        };
        Some((low - room, high + room))
    }

    pub(super) fn x_range(&self) -> Option<(f64, f64)> {
        let seconds = || self.lines.iter().flat_map(|line| &line.points).map(|point| point.0);
        Some((seconds().reduce(f64::min)?, seconds().reduce(f64::max)?))
    }

    /// The unit of all lines; empty where they differ.
    pub(super) fn unit(&self) -> &str {
        let first = self.lines.first().map_or("", |line| &line.unit);
        if self.lines.iter().all(|line| line.unit == first) { first } else { "" }
    }
}

fn value_of(place: &Place<'_>, message: &[u8]) -> Option<f64> {
    let Content::Scalar(scalar) = place.part(message)?.content()? else { return None };
    Some(match scalar {
        Scalar::Int(value) => value as f64,
        Scalar::Uint(value) => value as f64,
        Scalar::Float32(value) => value.into(),
        Scalar::Float64(value) => value,
        Scalar::Bool(value) => u8::from(value).into(),
        Scalar::Char(value) => value.into(),
    })
}

/// The unit of a field, as the layout or the .msg file that was compiled in has
/// it. A log has no units.
fn unit_of(topic: &str, layout: &Layout, path: &str) -> String {
    let ours = compiled_in(topic).map(|metadata| &*metadata.layout);
    let units = [Some(layout), ours].into_iter().flatten().filter_map(|layout| {
        let mut layout = layout;
        let mut unit = None;
        for step in path.split('.') {
            let name = step.split('[').next().unwrap_or(step);
            let field = layout.fields.iter().find(|field| field.name == name)?;
            unit = Some(&*field.unit);
            if let FieldType::Message(nested) = &field.ty {
                layout = nested;
            }
        }
        unit.filter(|unit| !unit.is_empty())
    });
    units.map(str::to_string).next().unwrap_or_default()
}

#[cfg(test)]
pub(super) mod tests {
    use uorb_core::Message as _;
    use uorb_msg::SensorAccel;

    use super::*;
    use crate::fields::samples;

    /// A path, a unit, and points.
    type Described<'a> = (&'a str, &'a str, &'a [(f64, f64)]);

    /// Such lines.
    pub(in super::super) fn lines(described: &[Described<'_>]) -> Lines {
        let line = |&(path, unit, points): &Described<'_>| {
            let mut line = Line { path: path.into(), unit: unit.into(), points: VecDeque::new() };
            points.iter().for_each(|&(seconds, value)| line.push(seconds, value));
            line
        };
        let lines = described.iter().map(line).collect();
        Lines { layout: SensorAccel::LAYOUT.clone(), lines }
    }

    #[test]
    fn numbers_become_lines_and_nothing_else_does() {
        let (layout, message) = samples::one_of_each();
        let fields = ["i8", "flag", "points[1].x", "q"].map(str::to_string);
        let mut lines = Lines::new("sample", &layout, &fields).unwrap();
        lines.add(0.5, &message);
        let of = |line: &Line| (line.path.clone(), line.points[0].1);
        let named: Vec<_> = lines.lines.iter().map(of).collect();
        assert_eq!(
            named[..5],
            [
                ("i8".into(), -128.0),
                ("flag".into(), 1.0),
                ("points[1].x".into(), 5.0),
                ("q[0]".into(), 1.0),
                ("q[1]".into(), 0.0)
            ]
        );
        assert!(named[5].1.is_nan());
        for (field, words) in [
            ("name", "name is char[8], which is no number"),
            ("point", "which is no number: name one in it"),
            ("points", "which is no number"),
            ("nothing", "has no field \"nothing\""),
        ] {
            let error = Lines::new("sample", &layout, &[field.into()]).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
        let error = Lines::new("sample", &layout, &[]).unwrap_err().to_string();
        assert!(error.starts_with("which fields of sample? It has timestamp, i64, "), "{error}");
    }

    #[test]
    fn a_log_has_the_units_of_what_is_compiled_in() {
        let mut layout = SensorAccel::LAYOUT.clone();
        let unit = layout.fields.iter().find(|field| field.name == "x").unwrap().unit.to_string();
        assert!(!unit.is_empty());
        layout.fields.to_mut().iter_mut().for_each(|field| field.unit = "".into());
        let lines = Lines::new("sensor_accel", &layout, &["x".into(), "y".into()]).unwrap();
        assert_eq!((lines.unit(), lines.lines[0].label()), (&*unit, format!("x [{unit}]")));
        let lines = Lines::new("other", &layout, &["x".into()]).unwrap();
        assert_eq!((lines.unit(), &*lines.lines[0].label()), ("", "x"));
    }

    #[test]
    fn nan_is_a_gap() {
        let one = lines(&[(
            "x",
            "",
            &[(0.0, f64::NAN), (1.0, 1.0), (2.0, 2.0), (3.0, f64::NAN), (4.0, 4.0)],
        )]);
        assert_eq!(one.lines[0].segments(), [vec![(1.0, 1.0), (2.0, 2.0)], vec![(4.0, 4.0)]]);
    }

    #[test]
    fn the_range_has_room_around_what_is_seen() {
        let mut some = lines(&[
            ("x", "", &[(0.0, -900.0), (1.0, 0.0), (2.0, 10.0)]),
            ("y", "", &[(2.0, f64::NAN)]),
        ]);
        assert_eq!(some.y_range(1.0, 2.0), Some((-0.5, 10.5)));
        some.forget_before(2.0);
        assert_eq!((some.x_range(), some.y_range(0.0, 2.0)), (Some((2.0, 2.0)), Some((9.0, 11.0))));
        assert_eq!(some.y_range(3.0, 4.0), None);
        let far = lines(&[("x", "", &[(0.0, f64::MAX), (0.0, f64::MIN)])]);
        assert_eq!(far.y_range(0.0, 0.0), Some((-1.1e300, 1.1e300)));
        let near = lines(&[("x", "", &[(0.0, 1e17), (0.0, 1e17 + 16.0)])]);
        assert_eq!(near.y_range(0.0, 0.0), Some((0.9e17, 1.1e17 + 16.0)));
    }
}
