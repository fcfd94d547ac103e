//! Names that come from outside and become parts of paths.

/// Longest name, bytes.
const LONGEST: usize = 64;

/// Names that Windows has for devices, with any ending.
const DEVICES: [&str; 6] = ["con", "prn", "aux", "nul", "com", "lpt"];

/// Whether a name may be a file's in a directory of ours: letters, digits, `.`, `_`, `-`, no leading dot or
/// dash, so that it is no path, no hidden file and no option of a command; and none that Windows cannot have, so that
/// runs may be copied there.
pub(super) fn is_sound(name: &str) -> bool {
    let sound = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
    name.len() <= LONGEST
        && name.bytes().all(sound)
        && name.bytes().next().is_some_and(|first| first.is_ascii_alphanumeric())
        && !name.ends_with('.')
        && !is_device(name)
}

/// `con`, `NUL.txt`, `COM5`: the last two with one digit.
fn is_device(name: &str) -> bool {
    let stem = name.split('.').next().unwrap_or_default().to_ascii_lowercase();
    let numbered = stem.len() == 4 && stem.ends_with(|last: char| last.is_ascii_digit());
    let kind = if numbered { &stem[..3] } else { &stem[..] };
    DEVICES.iter().position(|device| *device == kind).is_some_and(|place| numbered == (place >= 4))
}

#[cfg(test)]
mod tests {
    use super::is_sound;

    #[test]
    fn no_name_leaves_its_directory() {
        for name in ["run-1", "2026-11-21_cell.3", "a", "com10", "console", "con-1", "com"] {
            assert!(is_sound(name), "{name}");
        }
        let long = "a".repeat(65);
        for name in [
            "", ".", "..", "../a", "a/b", "a\\b", "/etc", ".hidden", "-rf", "a\0", "é", "a b", "NUL",
            "con.txt", "Com5", "lpt1.a", "a.", &long,
        ] {
            assert!(!is_sound(name), "{name:?}");
        }
    }
}
