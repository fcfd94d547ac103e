//! SHA-256 of texts and files.

use hmac_sha256::Hash;

/// The hash of what comes in pieces.
#[derive(Default)]
pub struct Sha256(Hash);

impl Sha256 {
    pub fn update(&mut self, piece: impl AsRef<[u8]>) {
        self.0.update(piece);
    }

    /// In hexadecimal digits.
    pub fn finish(self) -> String {
        self.0.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

/// The hash of a text or of bytes, in hexadecimal digits.
pub fn sha256(content: impl AsRef<[u8]>) -> String {
    let mut hash = Sha256::default();
    hash.update(content);
    hash.finish()
}
