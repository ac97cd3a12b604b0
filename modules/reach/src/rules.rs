//! What crosses, and how.
//!
//! An export is `TOPIC[/INSTANCE][:HZ][,CROSSING]`, an import
//! `MACHINE/TOPIC[/INSTANCE][:HZ]`; `*` stands for any letters, and a `!` before
//! either makes an exception of it. Of several rules that match a topic the last
//! one counts. A file has one rule a line, behind the word `export` or `import`.

use uorb_core::Instance;
use uorb_ulog::is_match;

/// How messages cross.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Crossing {
    /// What the link has no room for is dropped: what arrives is fresh.
    #[default]
    BestEffort,
    /// What the link has no room for waits, in the topic's own stream.
    Reliable,
    /// As best effort, alone and at once instead of together with others.
    Express,
}

impl Crossing {
    const ALL: [(&'static str, Self); 3] = [
        ("best-effort", Self::BestEffort),
        ("reliable", Self::Reliable),
        ("express", Self::Express),
    ];

    fn parse(text: &str) -> Result<Self, String> {
        let found = Self::ALL.iter().find(|(name, _)| *name == text);
        found
            .map(|(_, crossing)| *crossing)
            .ok_or_else(|| format!("{text:?} is neither best-effort, nor reliable, nor express"))
    }
}

/// Which topics cross in one direction.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Rule {
    is_exception: bool,
    /// Of an export: any.
    machine: String,
    topic: String,
    instance: Option<Instance>,
    /// The highest rate. None: every message.
    pub(crate) rate_hz: Option<f64>,
    /// Of an import: whatever the exporting machine says.
    pub(crate) crossing: Crossing,
}

impl Rule {
    pub(crate) fn parse_export(text: &str) -> Result<Self, String> {
        let (rest, crossing) = text.split_once(',').unwrap_or((text, ""));
        let mut rule = Self::parse(&format!("*/{}", rest.trim_start_matches('!')))?;
        rule.is_exception = rest.starts_with('!');
        if !crossing.is_empty() {
            rule.crossing = Crossing::parse(crossing)?;
        }
        Ok(rule)
    }

    pub(crate) fn parse_import(text: &str) -> Result<Self, String> {
        if text.contains(',') {
            return Err(format!("{text:?}: the machine that exports says how messages cross"));
        }
        let mut rule = Self::parse(text.trim_start_matches('!'))?;
        rule.is_exception = text.starts_with('!');
        Ok(rule)
    }

    /// `MACHINE/TOPIC[/INSTANCE][:HZ]`.
    fn parse(text: &str) -> Result<Self, String> {
        let (names, rate) = text.split_once(':').map_or((text, None), |(it, hz)| (it, Some(hz)));
        let mut names = names.split('/');
        let machine = names.next().unwrap_or_default();
        let topic = names.next().ok_or_else(|| {
            format!(
                "{text:?} names no topic; an import is MACHINE/TOPIC, as in gcs/vehicle_command"
            )
        })?;
        let instance = names.next().map(|number| {
            let parsed = number.parse().ok().and_then(Instance::new);
            parsed.ok_or_else(|| format!("{number:?} is no instance: a topic has 0 to 9"))
        });
        let is_letter = |byte: u8| byte.is_ascii_alphanumeric() || b"_*-".contains(&byte);
        for name in [machine, topic] {
            if name.is_empty() || !name.bytes().all(is_letter) {
                return Err(format!("{name:?} is no name, and no pattern of one"));
            }
        }
        if let Some(more) = names.next() {
            return Err(format!("{more:?} follows the instance, behind which nothing comes"));
        }
        let rate_hz = rate.map(|rate| match rate.parse::<f64>() {
            Ok(hz) if (1e-3..=1e6).contains(&hz) => Ok(hz),
            _ => Err(format!("{rate:?} is no rate: it is 0.001 to 1000000 Hz")),
        });
        Ok(Self {
            is_exception: false,
            machine: machine.into(),
            topic: topic.into(),
            instance: instance.transpose()?,
            rate_hz: rate_hz.transpose()?,
            crossing: Crossing::default(),
        })
    }

    fn is_for(&self, machine: &str, topic: &str, instance: Instance) -> bool {
        is_match(&self.machine, machine)
            && is_match(&self.topic, topic)
            && self.instance.is_none_or(|only| only == instance)
    }
}

/// The rules of both directions.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rules {
    exports: Vec<Rule>,
    imports: Vec<Rule>,
}

impl Rules {
    /// Those of a file, and behind them those of the command line, which so have
    /// the last word.
    pub(crate) fn new(file: &str, exports: Vec<Rule>, imports: Vec<Rule>) -> Result<Self, String> {
        let mut rules = Self::default();
        for (number, line) in (1..).zip(file.lines()) {
            let line = line.split('#').next().unwrap_or_default().trim();
            rules.add(line).map_err(|why| format!("line {number}: {why}"))?;
        }
        rules.exports.extend(exports);
        rules.imports.extend(imports);
        Ok(rules)
    }

    fn add(&mut self, line: &str) -> Result<(), String> {
        match line.split_once(char::is_whitespace) {
            None if line.is_empty() => {}
            Some(("export", rule)) => self.exports.push(Rule::parse_export(rule.trim())?),
            Some(("import", rule)) => self.imports.push(Rule::parse_import(rule.trim())?),
            _ => return Err(format!("{line:?} begins neither with export nor with import")),
        }
        Ok(())
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.exports.is_empty() && self.imports.is_empty()
    }

    /// The rule by which a topic of ours may leave, if it may.
    pub(crate) fn export(&self, topic: &str, instance: Instance) -> Option<&Rule> {
        choose(&self.exports, "", topic, instance)
    }

    /// The rule by which a topic of another machine may come in, if it may.
    pub(crate) fn import(&self, machine: &str, topic: &str, instance: Instance) -> Option<&Rule> {
        choose(&self.imports, machine, topic, instance)
    }
}

fn choose<'a>(
    rules: &'a [Rule],
    machine: &str,
    topic: &str,
    instance: Instance,
) -> Option<&'a Rule> {
    let last = rules.iter().rfind(|rule| rule.is_for(machine, topic, instance))?;
    (!last.is_exception).then_some(last)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIRST: Instance = Instance::FIRST;

    #[test]
    fn the_last_rule_that_matches_counts_and_the_command_line_comes_last() {
        let file = "# mine\nexport vehicle_*:10,reliable\n\nexport !vehicle_odometry # big\n\
                    import gcs/*\n";
        let more = vec![Rule::parse_export("vehicle_attitude/0:50,express").unwrap()];
        let rules = Rules::new(file, more, Vec::new()).unwrap();
        let chosen = |topic, instance| {
            let rule = rules.export(topic, Instance::new(instance).unwrap())?;
            Some((rule.rate_hz, rule.crossing))
        };
        assert_eq!(chosen("vehicle_status", 3), Some((Some(10.0), Crossing::Reliable)));
        assert_eq!(chosen("vehicle_attitude", 0), Some((Some(50.0), Crossing::Express)));
        assert_eq!(chosen("vehicle_attitude", 1), Some((Some(10.0), Crossing::Reliable)));
        assert_eq!(chosen("vehicle_odometry", 0), None);
        assert_eq!(chosen("sensor_accel", 0), None);
        assert!(rules.import("gcs", "vehicle_command", FIRST).is_some());
        assert!(rules.import("drone1", "vehicle_command", FIRST).is_none());
    }

    #[test]
    fn what_is_no_rule_says_what_is_wrong_with_it() {
        for (text, word) in [
            ("gcs", "names no topic"),
            ("gcs/", "\"\""),
            ("gcs/a b", "\"a b\""),
            ("gcs/a/10", "no instance"),
            ("gcs/a/1/2", "\"2\""),
            ("gcs/a:0", "no rate"),
            ("gcs/a,reliable", "the machine that exports"),
        ] {
            let why = Rule::parse_import(text).unwrap_err();
            assert!(why.contains(word), "{text}: {why}");
        }
        assert!(Rule::parse_export("a,slow").unwrap_err().contains("\"slow\""));
        let why = Rules::new("export a\nexprot b\n", Vec::new(), Vec::new()).unwrap_err();
        assert!(why.starts_with("line 2: "), "{why}");
    }
}
