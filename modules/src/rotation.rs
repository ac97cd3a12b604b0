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
