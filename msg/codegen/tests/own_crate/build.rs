fn main() -> Result<(), uorb_codegen::Error> {
    // `esc_report`, a field of DockStatus, is in the folder of uORB's messages.
    uorb_codegen::Config::new().folder("msg").search("../../..").compile()
}
