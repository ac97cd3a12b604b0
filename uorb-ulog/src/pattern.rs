//! Names of topics with a `*` in them, as command lines have them.

/// Whether a name matches a pattern, in which `*` stands for any letters.
pub fn is_match(pattern: &str, name: &str) -> bool {
    let mut parts = pattern.split('*');
    let first = parts.next().unwrap_or_default();
    let Some(mut rest) = name.strip_prefix(first) else { return false };
    let parts: Vec<&str> = parts.collect();
    let Some((last, middle)) = parts.split_last() else { return rest.is_empty() };
    for part in middle {
        // The first place is as good as any: what is left is longest.
        let Some(at) = rest.find(part) else { return false };
        rest = &rest[at + part.len()..];
    }
    rest.ends_with(last)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_star_stands_for_any_letters() {
        for (pattern, name, expected) in [
            ("sensor_accel", "sensor_accel", true),
            ("sensor_accel", "sensor_accel_fifo", false),
            ("sensor_*", "sensor_accel", true),
            ("sensor_*", "vehicle_imu", false),
            ("*imu*", "vehicle_imu_status", true),
            ("*_status", "vehicle_imu_status", true),
            ("*_status", "vehicle_status_flags", false),
            ("*", "", true),
            ("a*a", "a", false),
            ("*a*ab", "aab", true),
        ] {
            assert_eq!(is_match(pattern, name), expected, "{pattern} {name}");
        }
    }
}
