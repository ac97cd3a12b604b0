//! Rotations, as messages have them.

/// The quaternion (w, x, y, z) from the body frame to north-east-down, of roll,
/// pitch and yaw in radians: about the axis down first, then right, then forward.
pub fn quaternion([roll, pitch, yaw]: [f32; 3]) -> [f32; 4] {
    let ((sr, cr), (sp, cp), (sy, cy)) =
        ((roll / 2.0).sin_cos(), (pitch / 2.0).sin_cos(), (yaw / 2.0).sin_cos());
    [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
}

/// Roll, pitch and yaw of a quaternion, in radians.
pub fn euler([w, x, y, z]: [f32; 4]) -> [f32; 3] {
    [
        (2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y)),
        (2.0 * (w * y - z * x)).clamp(-1.0, 1.0).asin(),
        (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_come_back_from_a_quaternion() {
        let angles = [0.3, -0.7, 2.5];
        for (angle, back) in angles.iter().zip(euler(quaternion(angles))) {
            assert!((angle - back).abs() < 1e-5, "{back}");
        }
    }
}
