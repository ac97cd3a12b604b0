//! The topics of the colours: what PX4's example keeps in `color_counter.h`,
//! because the counter and the publishers both need it.

uorb_core::topic! {
    /// Published on color_red, color_green, color_blue and color_timeouts.
    pub struct ColorUpdate {
        /// How often it has happened.
        pub number: i32,
    }
    /// How often it was red.
    pub topic ColorRed = "color_red";
    /// How often it was green.
    pub topic ColorGreen = "color_green";
    /// How often it was blue.
    pub topic ColorBlue = "color_blue";
    /// How often nothing came for a second.
    pub topic ColorTimeouts = "color_timeouts";
}
