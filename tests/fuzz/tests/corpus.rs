//! What fuzzing has found to be worth trying is tried again.

use std::fs;
use std::path::Path;

use uorb_fuzz::TARGETS;

#[test]
fn nothing_falls_over_the_bytes_that_fuzzing_has_kept() {
    let corpora = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    for (name, target) in TARGETS {
        let corpus = corpora.join(name);
        let files = fs::read_dir(&corpus).unwrap_or_else(|error| panic!("{corpus:?}: {error}"));
        let paths: Vec<_> = files.map(|file| file.expect("it can be listed").path()).collect();
        assert!(paths.len() >= 10, "{corpus:?} is nearly empty");
        for path in paths {
            // Shown where the test fails.
            println!("{}", path.display());
            target(&fs::read(&path).expect("it can be read"));
        }
    }
}
