//! Which topics to record, and how often.
//!
//! A rule is `TOPIC` or `TOPIC:HZ`, where `*` stands for any letters. The last
//! rule that matches a topic counts; without any rule all topics are recorded,
//! every message of them. A profile is a file of rules, one a line.

use std::str::FromStr;

use crate::pattern::is_match;

/// Which topics to record.
#[derive(Clone, Debug, Default)]
pub struct Choice {
    rules: Vec<Rule>,
}

/// One rule of a [`Choice`].
#[derive(Clone, Debug, PartialEq)]
pub struct Rule {
    pattern: String,
    rate_hz: Option<f64>,
}

/// How often a topic is recorded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Rate {
    EveryMessage,
    Hz(f64),
}

impl FromStr for Rule {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (pattern, rate) =
            text.split_once(':').map_or((text, None), |(one, two)| (one, Some(two)));
        let is_letter = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'*';
        if pattern.is_empty() || !pattern.bytes().all(is_letter) {
            return Err(format!("{pattern:?} is no topic, and no pattern of one"));
        }
        let rate_hz = rate.map(|rate| match rate.parse::<f64>() {
            Ok(hz) if (1e-3..=1e6).contains(&hz) => Ok(hz),
            _ => Err(format!("{rate:?} is no rate: it is 0.001 to 1000000 Hz")),
        });
        Ok(Self { pattern: pattern.to_string(), rate_hz: rate_hz.transpose()? })
    }
}

impl Choice {
    /// All topics for which the last rule that matches is one of these.
    pub fn new(rules: Vec<Rule>) -> Self {
        Self { rules }
    }

    /// The rules of a profile. Empty lines, and what follows a `#`, are left out.
    ///
    /// # Errors
    ///
    /// In words, which name the line.
    pub fn parse_profile(text: &str) -> Result<Vec<Rule>, String> {
        let lines = (1..).zip(text.lines());
        let lines =
            lines.map(|(number, line)| (number, line.split('#').next().unwrap_or("").trim()));
        lines
            .filter(|(_, line)| !line.is_empty())
            .map(|(number, line)| line.parse().map_err(|why| format!("line {number}: {why}")))
            .collect()
    }

    /// The names and patterns of rules that none of these topics matches.
    pub fn unmatched<'c>(&'c self, topics: &'c [String]) -> impl Iterator<Item = &'c str> {
        let patterns = self.rules.iter().map(|rule| &*rule.pattern);
        patterns.filter(|pattern| !topics.iter().any(|topic| is_match(pattern, topic)))
    }

    /// How often to record a topic; None: not at all.
    pub(super) fn rate(&self, topic: &str) -> Option<Rate> {
        if self.rules.is_empty() {
            return Some(Rate::EveryMessage);
        }
        let rule = self.rules.iter().rfind(|rule| is_match(&rule.pattern, topic))?;
        Some(rule.rate_hz.map_or(Rate::EveryMessage, Rate::Hz))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_that_match_nothing_are_known() {
        let rules = ["sensor_*", "nosuch:5", "plain"].map(|rule| rule.parse().unwrap());
        let choice = Choice::new(rules.to_vec());
        let topics = ["sensor_gyro", "plain"].map(String::from);
        assert_eq!(choice.unmatched(&topics).collect::<Vec<_>>(), ["nosuch"]);
    }

    #[test]
    fn the_last_rule_that_matches_a_topic_counts() {
        let rules = Choice::parse_profile("# mine\nsensor_*:10\n\nsensor_gyro # all\n").unwrap();
        let choice = Choice::new(rules);
        assert_eq!(choice.rate("sensor_accel"), Some(Rate::Hz(10.0)));
        assert_eq!(choice.rate("sensor_gyro"), Some(Rate::EveryMessage));
        assert_eq!(choice.rate("vehicle_attitude"), None);
        assert_eq!(Choice::default().rate("vehicle_attitude"), Some(Rate::EveryMessage));
    }

    #[test]
    fn a_rule_that_makes_no_sense_is_named() {
        for bad in ["", ":5", "a b", "a:", "a:x", "a:0", "a:-1", "a:nan", "a:1:2"] {
            assert!(bad.parse::<Rule>().is_err(), "{bad}");
        }
        assert!(Choice::parse_profile("a\n:5").unwrap_err().starts_with("line 2: "));
    }
}
