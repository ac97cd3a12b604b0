//! The names that were perhaps meant.

use strsim::damerau_levenshtein;

/// The most names to suggest.
const SUGGESTIONS_MAX: usize = 3;

/// Words to put behind "there is no such thing": the names that are nearest to
/// the one that was asked for. Empty where none is near.
pub(crate) fn did_you_mean<'n>(wanted: &str, names: impl Iterator<Item = &'n str>) -> String {
    match &nearest(wanted, names)[..] {
        [] => String::new(),
        [only] => format!("; did you mean {only}?"),
        [others @ .., last] => format!("; did you mean {} or {last}?", others.join(", ")),
    }
}

fn nearest<'n>(wanted: &str, names: impl Iterator<Item = &'n str>) -> Vec<&'n str> {
    let wanted = wanted.to_ascii_lowercase();
    // A slip in three letters is one. A name of which a part was given is near.
    let far = wanted.len().div_ceil(3);
    let mut near: Vec<(usize, &str)> = names
        .filter_map(|name| {
            let distance = damerau_levenshtein(&wanted, &name.to_ascii_lowercase());
            let is_part = wanted.len() >= 3 && name.contains(&wanted);
            let distance = if is_part { distance.min(1) } else { distance };
            (distance <= far).then_some((distance, name))
        })
        .collect();
    near.sort();
    near.dedup();
    // What is much nearer than the others was meant.
    let nearest = near.first().map_or(0, |(distance, _)| *distance);
    near.retain(|(distance, _)| *distance <= nearest + 1);
    near.into_iter().map(|(_, name)| name).take(SUGGESTIONS_MAX).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOPICS: [&str; 5] = [
        "sensor_accel",
        "sensor_gyro",
        "vehicle_attitude",
        "vehicle_attitude_groundtruth",
        "safety",
    ];

    #[test]
    fn a_slip_of_the_finger_is_understood() {
        assert_eq!(nearest("sensor_acel", TOPICS.into_iter()), ["sensor_accel"]);
        assert_eq!(nearest("snesor_gyro", TOPICS.into_iter()), ["sensor_gyro"]);
    }

    #[test]
    fn a_part_of_a_name_is_understood() {
        assert_eq!(
            nearest("attitude", TOPICS.into_iter()),
            ["vehicle_attitude", "vehicle_attitude_groundtruth"]
        );
    }

    #[test]
    fn nothing_is_suggested_where_nothing_is_near() {
        assert_eq!(did_you_mean("battery", TOPICS.into_iter()), "");
    }
}
