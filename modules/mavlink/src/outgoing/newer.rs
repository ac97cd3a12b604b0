//! Topics that PX4 has had since about 2020, as far as messages need them.
//!
//! A flight log of these years has here what its older topics do not have any
//! more: the rates are not in vehicle_attitude, nor the magnetic field and the
//! air pressure in sensor_combined, and a GPS position is in other units.
//! Nobody publishes them in this layout; they are read by the names of their
//! fields.

use uorb_core::topic;

topic! {
    /// How the vehicle turns.
    pub(super) struct VehicleAngularVelocity = "vehicle_angular_velocity" {
        pub timestamp: u64,
        pub xyz: [f32; 3],
        pub _padding0: [u8; 4],
    }
}

topic! {
    /// The magnetic field.
    pub(super) struct VehicleMagnetometer = "vehicle_magnetometer" {
        pub timestamp: u64,
        pub magnetometer_ga: [f32; 3],
        pub _padding0: [u8; 4],
    }
}

topic! {
    /// The air around it.
    pub(super) struct VehicleAirData = "vehicle_air_data" {
        pub timestamp: u64,
        pub baro_alt_meter: f32,
        pub baro_pressure_pa: f32,
    }
}

topic! {
    /// Where the GPS receiver is, in degrees and metres.
    pub(super) struct GpsDegrees = "vehicle_gps_position" {
        pub timestamp: u64,
        pub latitude_deg: f64,
        pub longitude_deg: f64,
        pub altitude_msl_m: f64,
        pub altitude_ellipsoid_m: f64,
    }
}
