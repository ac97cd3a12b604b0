//! The key of a signed link: 64 hexadecimal digits in a file.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use mavlink_core::{SigningConfig, SigningData};

/// Why there is no key.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The file cannot be read.
    #[error("cannot read the key {}: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file has something else in it.
    #[error(
        "{} is no key: a key is 64 hexadecimal digits, as `openssl rand -hex 32` makes them",
        path.display()
    )]
    NoKey {
        /// The file.
        path: PathBuf,
    },
}

/// Reads the key of a link that signs what it sends, and takes only what is
/// signed with the same key. Signatures have the link's number in them.
///
/// # Errors
///
/// Where the file has no key.
pub fn signing(path: &Path, link_id: u8) -> Result<SigningData, KeyError> {
    let text = fs::read_to_string(path)
        .map_err(|source| KeyError::Unreadable { path: path.into(), source })?;
    let key = key(text.trim()).ok_or_else(|| KeyError::NoKey { path: path.into() })?;
    Ok(SigningData::from_config(SigningConfig::new(key, link_id, true, false)))
}

fn key(text: &str) -> Option<[u8; 32]> {
    let digits: Option<Vec<u8>> =
        text.chars().map(|digit| digit.to_digit(16).map(|value| value as u8)).collect();
    let bytes: Vec<u8> = digits?.chunks_exact(2).map(|pair| pair[0] << 4 | pair[1]).collect();
    bytes.try_into().ok().filter(|_| text.len() == 64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_64_digits() {
        let text = "00".repeat(31) + "fF";
        assert_eq!(key(&text).unwrap()[31], 255);
        for wrong in [&text[1..], "", &"0g".repeat(32), &"00".repeat(33)] {
            assert_eq!(key(wrong), None, "{wrong}");
        }
    }
}
