fn main() -> Result<(), uorb_codegen::Error> {
    uorb_codegen::compile(".")
}
