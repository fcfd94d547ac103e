//! Names that come from outside and become parts of paths.

/// Longest name, bytes.
const LONGEST: usize = 64;

/// Whether a name may be a file's in a directory of ours: letters, digits, `.`, `_`, `-`, no leading dot or
/// dash, so that it is no path, no hidden file and no option of a command.
pub(super) fn is_sound(name: &str) -> bool {
    let sound = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
    name.len() <= LONGEST
        && name.bytes().all(sound)
        && name.bytes().next().is_some_and(|first| first.is_ascii_alphanumeric())
}

#[cfg(test)]
mod tests {
    use super::is_sound;

    #[test]
    fn no_name_leaves_its_directory() {
        for name in ["run-1", "2026-11-21_cell.3", "a"] {
            assert!(is_sound(name), "{name}");
        }
        let long = "a".repeat(65);
        for name in ["", ".", "..", "../a", "a/b", "a\\b", "/etc", ".hidden", "-rf", "a\0", "é", "a b", &long]
        {
            assert!(!is_sound(name), "{name:?}");
        }
    }
}
