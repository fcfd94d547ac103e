//! SHA-256.

use hmac_sha256::Hash;

/// The hash of content that arrives in pieces.
#[derive(Default)]
pub struct Sha256(Hash);

impl Sha256 {
    pub fn update(&mut self, piece: impl AsRef<[u8]>) {
        self.0.update(piece);
    }

    /// The hash in hexadecimal digits.
    pub fn finish(self) -> String {
        self.0.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

/// The hash in Base64, as a Content-Security-Policy names a script.
pub fn sha256_base64(content: impl AsRef<[u8]>) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let hash = Hash::hash(content.as_ref());
    let digit = |bits: u32| char::from(DIGITS[(bits & 63) as usize]);
    let group = |bytes: &[u8]| {
        let bits = (0..3).fold(0, |bits, at| (bits << 8) | u32::from(bytes.get(at).copied().unwrap_or(0)));
        let digits = [18, 12, 6, 0].map(|shift| digit(bits >> shift));
        let padded = |at| if at <= bytes.len() { digits[at] } else { '=' };
        [0, 1, 2, 3].map(padded)
    };
    hash.chunks(3).flat_map(group).collect()
}

/// The hash in hexadecimal digits.
pub fn sha256(content: impl AsRef<[u8]>) -> String {
    let mut hash = Sha256::default();
    hash.update(content);
    hash.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_matches_openssl() {
        // printf 'abc' | openssl dgst -sha256 -binary | base64
        assert_eq!(sha256_base64("abc"), "ungWv48Bz+pBQUDeXa4iI7ADYaOWF3qctBD/YfIAFa0=");
    }

    /// printf 'abc' | sha256sum (FIPS 180-4, appendix B.1); pieces give the hash of the whole.
    #[test]
    fn hash_matches_the_standard() {
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(sha256("abc"), expected);
        let mut pieces = Sha256::default();
        pieces.update("a");
        pieces.update("bc");
        assert_eq!(pieces.finish(), expected);
    }
}
