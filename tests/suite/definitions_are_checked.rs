//! A definition that contradicts itself is refused with the line where it does.

use dbbd::protocol::Definition;

const COBS: &str = include_str!("../../protocols/dbb-cobs-1.toml");

#[test]
fn built_in_definitions_pass_their_own_vectors() {
    for (name, text) in Definition::built_in() {
        let definition = Definition::from_toml(name, text).unwrap();
        assert_eq!(definition.id, *name);
    }
}

/// The sketch that the frame was specified with.
#[test]
fn the_reference_sketch_is_accepted() {
    let Ok(text) = std::fs::read_to_string("../shared/reference/protocol-samples/dbb-cobs-1.toml") else {
        eprintln!("skipped: ../shared is not there");
        return;
    };
    Definition::from_toml("dbb-cobs-1.toml", &text).unwrap();
}

/// Puts `new` in the place of `old` and gives the refusal.
fn refusal(old: &str, new: &str) -> String {
    assert_eq!(COBS.matches(old).count(), 1, "{old}");
    let text = COBS.replace(old, new);
    Definition::from_toml("bar.toml", &text).unwrap_err().to_string()
}

/// The line of `needle` in the shipped file.
fn line_of(needle: &str) -> usize {
    COBS.lines().position(|line| line.contains(needle)).unwrap() + 1
}

#[test]
fn every_refusal_names_its_line() {
    let length = "role = \"length\"";
    let cases = [
        ("stall_ms = 50", "stal_ms = 50", "stall_ms = 50", "unknown field `stal_ms`"),
        ("kind = \"cobs\"", "kind = \"slip\"", "kind = \"cobs\"", "slip"),
        (
            "bits = 32, endian = \"le\", role = \"t_dev\"",
            "bits = 12, endian = \"le\", role = \"t_dev\"",
            "t_dev\"",
            "8, 16, 24 or 32",
        ),
        (
            "role = \"length\", unit = \"mm\", scale_num = 1, scale_den = 100000",
            "role = \"length\", unit = \"C\"",
            length,
            "needs `unit`",
        ),
        ("scale_den = 100000", "scale_den = 0", length, "must not be 0"),
        ("match = [{ at = 0, eq = 1 }]", "match = [{ at = 1, eq = 1 }]", "match = [", "skip"),
        ("modulo = 65536", "modulo = 65537", "modulo", "2^16"),
        ("wrap_bits = 32", "wrap_bits = 33", "wrap_bits", "wrap_bits"),
        ("5 = \"low_battery\"", "8 = \"low_battery\"", "low_battery", "not a bit"),
        (
            "kind = \"skip\", bytes = 1",
            "kind = \"skip\", bytes = 1, bits = 8",
            "kind = \"skip\"",
            "`bits` has no meaning",
        ),
        ("CRC-16/IBM-3740", "CRC-16", "CRC-16/IBM-3740", "no CRC `CRC-16`"),
        ("max_len = 64 ", "max_len = 12 ", "[[message]]", "room for"),
        (
            "length_mm = -0.12345, temp_c",
            "length_mm = -0.12346, temp_c",
            "temp_c = 21.5",
            "length_mm = -0.12345",
        ),
        ("expect = [{ resync = 18 }]", "expect = [{ resync = 17 }]", "resync = 18", "resync = 18"),
        (
            "expect = [{ ignored = 1 }, { seq = 258 }]",
            "expect = [{ ignored = 1 }]",
            "rx = \"00 07",
            "not expected",
        ),
        ("hex = \"02 53 00\"", "hex = \"02 5\"", "start =", "pairs"),
        ("schema = 1", "schema = 2", "schema = 1", "schema 2"),
    ];
    let mut wrong = Vec::new();
    for (old, new, place, said) in cases {
        let message = refusal(old, new);
        let at = format!("bar.toml:{}:", line_of(place));
        if !message.contains(said) || !message.starts_with(&at) {
            wrong.push(format!("{new}: expected {at} and `{said}`, got {message}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Check value 4B37 of CRC-16/MODBUS: the CRC catalogue, docs.rs/crc-catalog.
#[test]
fn crc_parameters_are_verified_by_their_check_value() {
    let by_parameters = |check: &str| {
        let crc = format!(
            "width = 16\npoly = 0x8005\ninit = 0xffff\nrefin = true\nrefout = true\nxorout = 0\ncheck = {check}"
        );
        let text = COBS.replace("name = \"CRC-16/IBM-3740\"", &crc);
        // The shipped vectors hold for the other CRC.
        let (head, _) = text.split_once("[[test]]").unwrap();
        Definition::from_toml("bar.toml", head)
    };
    by_parameters("0x4b37").unwrap();
    let wrong = by_parameters("0x4b38").unwrap_err();
    assert!(wrong.to_string().contains("check 0x4b37"), "{wrong}");
    assert_eq!(wrong.excerpt.as_deref(), Some("check = 0x4b38"));
    assert_eq!(wrong.column, 9);
}

/// The frames of reference section 3, byte for byte.
#[test]
fn the_encoder_writes_the_published_vectors() {
    let nmea = b"$DBB,258,1000000,-0.12345,21.50,01*4D\r\n".to_vec();
    let cobs =
        [7, 1, 2, 1, 0x40, 0x42, 0x0f, 0x0a, 0xc7, 0xcf, 0xff, 0xff, 0x66, 8, 1, 0x84, 0x9e, 0].to_vec();
    for (name, frame) in [("dbb-cobs-1", cobs), ("dbb-nmea-1", nmea)] {
        let definition = Definition::by_name(name).unwrap().unwrap();
        let sample = dbbd::protocol::Sample {
            reading_mm: -0.12345,
            sequence: Some(0x0102),
            ticks: Some(dbbd::units::DeviceTicks(1_000_000)),
            trigger: Some(false),
            temperature_c: Some(21.5),
            valid: true,
            status: 1,
            offset: 0,
        };
        let mut bytes = Vec::new();
        definition.encoder().encode(&sample, &mut bytes).unwrap();
        assert_eq!(bytes, frame, "{name}");
    }
}

#[test]
fn no_vendor_is_named_in_the_engine() {
    let vendors = [
        "renishaw",
        "sylvac",
        "mitutoyo",
        "heidenhain",
        "magnescale",
        "keyence",
        "epsilon",
        "riftek",
        "us digital",
    ];
    for entry in std::fs::read_dir("src/protocol").unwrap() {
        let path = entry.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap().to_lowercase();
        for vendor in vendors {
            assert!(!text.contains(vendor), "{}: {vendor}", path.display());
        }
    }
}
