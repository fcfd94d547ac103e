//! Definitions are checked: an error names its line.

use dbbd_device::protocol::ProtocolDefinition;
use dbbd_model::diagnostic::Diagnostic;

const COBS: &str = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../protocols/dbb-cobs-1.toml"));

#[test]
fn built_in_definitions_pass_their_own_vectors() {
    for (name, text) in ProtocolDefinition::built_in() {
        let definition = ProtocolDefinition::from_toml(name, text).unwrap();
        assert_eq!(definition.id, *name);
    }
}

/// The definition that accompanies the specification of the frame.
#[test]
fn reference_definition_is_accepted() {
    let Ok(text) = std::fs::read_to_string("../shared/reference/protocol-samples/dbb-cobs-1.toml") else {
        eprintln!("skipped: ../shared is not there");
        return;
    };
    ProtocolDefinition::from_toml("dbb-cobs-1.toml", &text).unwrap();
}

/// The error after replacing `old` with `new`.
fn refusal(old: &str, new: &str) -> Diagnostic {
    assert_eq!(COBS.matches(old).count(), 1, "{old}");
    let text = COBS.replace(old, new);
    ProtocolDefinition::from_toml("bar.toml", &text).unwrap_err()
}

/// The line of `needle` in the shipped file.
fn line_of(needle: &str) -> usize {
    COBS.lines().position(|line| line.contains(needle)).unwrap() + 1
}

#[test]
fn errors_name_their_line() {
    let length = "role = \"length\"";
    let cases = [
        ("stall_ms = 50", "stal_ms = 50", "stall_ms = 50", "E0120"),
        ("kind = \"cobs\"", "kind = \"slip\"", "kind = \"cobs\"", "E0120"),
        (
            "bits = 32, endian = \"le\", role = \"t_dev\"",
            "bits = 12, endian = \"le\", role = \"t_dev\"",
            "t_dev\"",
            "E0307",
        ),
        (
            "role = \"length\", unit = \"mm\", scale_num = 1, scale_den = 100000",
            "role = \"length\", unit = \"C\"",
            length,
            "E0307",
        ),
        ("scale_den = 100000", "scale_den = 0", length, "E0307"),
        ("match = [{ at = 0, eq = 1 }]", "match = [{ at = 1, eq = 1 }]", "match = [", "E0306"),
        ("modulo = 65536", "modulo = 65537", "modulo", "E0307"),
        ("wrap_bits = 32", "wrap_bits = 33", "wrap_bits", "E0307"),
        ("5 = \"low_battery\"", "8 = \"low_battery\"", "low_battery", "E0307"),
        ("kind = \"skip\", bytes = 1", "kind = \"skip\", bytes = 1, bits = 8", "kind = \"skip\"", "E0307"),
        ("CRC-16/IBM-3740", "CRC-16", "CRC-16/IBM-3740", "E0305"),
        ("max_len = 64 ", "max_len = 12 ", "[[message]]", "E0306"),
        ("length_mm = -0.12345, temp_c", "length_mm = -0.12346, temp_c", "temp_c = 21.5", "E0311"),
        ("expect = [{ resync = 18 }]", "expect = [{ resync = 17 }]", "resync = 18", "E0311"),
        ("expect = [{ ignored = 1 }, { seq = 258 }]", "expect = [{ ignored = 1 }]", "rx = \"00 07", "E0311"),
        ("hex = \"02 53 00\"", "hex = \"02 5\"", "start =", "E0309"),
        ("schema = 1", "schema = 2", "schema = 1", "E0302"),
    ];
    let mut wrong = Vec::new();
    for (old, new, place, code) in cases {
        let refusal = refusal(old, new);
        let line = line_of(place);
        if (refusal.code().as_str(), refusal.line_number()) != (code, line) {
            wrong.push(format!("{new}: expected {code} in line {line}, got {} {refusal}", refusal.code()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

const SHIPPED: [(&str, &str); 7] = [
    ("cobs", COBS),
    ("nmea", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../protocols/dbb-nmea-1.toml"))),
    (
        "tagged",
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../protocols/microepsilon-ild1420.toml")),
    ),
    ("modbus", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../protocols/modbus-rtu.toml"))),
    ("opto", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../protocols/sylvac-opto.toml"))),
    ("nd28x", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../protocols/heidenhain-nd28x.toml"))),
    ("delim", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../protocols/touchdro.toml"))),
];

/// File, text to be replaced, its replacement, text at the reported position, and code.
type Case = (&'static str, &'static str, &'static str, &'static str, &'static str);

/// One case for each error of the loader.
const REFUSED: &[Case] = &[
    // the file as a whole
    ("cobs", "id = \"dbb-cobs-1\"", "id = \"\"", "id =", "E0302"),
    ("cobs", "[timing]", "[tuning]", "[tuning]", "E0120"),
    ("cobs", "confidence = \"own\"", "confidence = \"sure\"", "confidence", "E0120"),
    ("cobs", "latch = \"device\"", "latch = \"request\"", "latch =", "E0303"),
    ("tagged", "latch = \"first_byte\"", "latch = \"device\"", "latch =", "E0303"),
    ("cobs", "nominal_hz = 1000", "nominal_hz = 0", "nominal_hz", "E0303"),
    ("opto", "prefix = [\"SY\", ", "prefix = [\"\", ", "prefix = [\"\"", "E0302"),
    // the line
    ("cobs", "baud = 460800 ", "baud = 0 ", "[line]", "E0303"),
    ("cobs", "bits = 8\n", "bits = 9\n", "[line]", "E0303"),
    ("cobs", "stop = 1\n", "stop = 3\n", "[line]", "E0303"),
    ("cobs", "stop = 1\n", "stop = 1\nbaud_probe = [9600]\n", "baud_probe", "E0309"),
    ("tagged", "baud_probe = [1000000", "baud_probe = [0", "[line]", "E0303"),
    ("cobs", "[cmd]", "[cmd]\nident = [{ send = \"?\" }]", "ident =", "E0309"),
    // the mode
    ("cobs", "stall_ms = 50", "poll_hz = 5", "[mode]", "E0303"),
    ("opto", "poll_hz = 10 ", "poll_hz = 0 ", "poll_hz", "E0303"),
    ("opto", "poll_hz = 10 ", "# ", "[mode]", "E0303"),
    ("opto", "poll = [{ send = \"?\\r\" }]", "", "[mode]", "E0303"),
    // the framing
    ("nmea", "start = \"$\"", "start = \"$$\"", "[framing]", "E0304"),
    ("nmea", "end = [\"\\r\\n\", \"\\n\"]", "end = []", "[framing]", "E0304"),
    ("delim", "end = \"3b\"", "end = \"3\"", "[framing]", "E0304"),
    ("tagged", "data_bits = 6", "data_bits = 8", "[framing]", "E0304"),
    ("tagged", "\"00\", \"01\"", "\"00\", \"011\"", "[framing]", "E0304"),
    ("tagged", "\"00\", \"01\"", "\"00\", \"0?\"", "[framing]", "E0304"),
    ("tagged", "\"00\", \"01\"", "\"00\", \"0s\"", "[framing]", "E0304"),
    ("modbus", "len = [5, 9]", "len = []", "[framing]", "E0304"),
    ("cobs", "max_len = 64 ", "max_len = 5000 ", "[framing]", "E0304"),
    // the check
    ("cobs", "kind = \"crc\"", "kind = \"xor8\"", "[check]", "E0305"),
    ("nmea", "after = \"*\"", "after = \"**\"", "after =", "E0305"),
    ("nmea", "after = \"*\"", "", "[check]", "E0305"),
    ("cobs", "enc = \"le\"\n\n[[m", "enc = \"le\"\nwidth = 16\n\n[[m", "[check]", "E0305"),
    ("cobs", "enc = \"le\"\n\n[[m", "\n[[m", "[check]", "E0305"),
    ("cobs", "name = \"CRC-16/IBM-3740\"", "width = 16", "[check]", "E0305"),
    ("cobs", "CRC-16/IBM-3740", "CRC-16/IBM-3741", "name = \"CRC", "E0305"),
    // messages and fields
    ("cobs", "kind = \"uint\", bits = 8, role", "kind = \"bits\", bits = 7, role", "[[message]]", "E0306"),
    ("cobs", "role = \"temp\", unit = \"C\"", "role = \"length\", unit = \"mm\"", "[[message]]", "E0306"),
    ("tagged", "bits = 24", "bits = 32", "[[message]]", "E0306"),
    ("tagged", "bits = 24", "bits = 16", "[[message]]", "E0306"),
    ("cobs", "kind = \"skip\", bytes = 1", "kind = \"skip\"", "kind = \"skip\"", "E0307"),
    ("cobs", "bits = 16, endian = \"le\", role = \"seq\"", "bits = 16, role = \"seq\"", "\"seq\"", "E0307"),
    ("cobs", "\"int\", bits = 32", "\"float\", bits = 24", "\"float\"", "E0307"),
    ("cobs", "kind = \"uint\", bits = 8, role", "kind = \"bits\", bits = 33, role", "bits = 33", "E0307"),
    ("nmea", "text = \"DBB,\"", "text = \"\"", "kind = \"lit\", text = \"\"", "E0307"),
    ("nmea", "decimals = 5", "decimals = 13", "decimals = 13", "E0307"),
    ("nd28x", "blanks = true", "blanks = false", "blanks = false", "E0307"),
    ("nmea", "decimals = 5", "decimals = 5, decimal = ';'", "decimal = ';'", "E0307"),
    ("opto", "mm = [2, 4]", "mm = [4, 2]", "mm = [4, 2]", "E0307"),
    (
        "nmea",
        "\"dec\", role = \"t_dev\", tick_ns = 1000",
        "\"dec\", decimals = 4, role = \"t_dev\", tick_ns = 1000",
        "decimals = 4",
        "E0307",
    ),
    (
        "cobs",
        "bits = 16, endian = \"le\", role = \"seq\"",
        "bits = 16, endian = \"cdab\", role = \"seq\"",
        "\"seq\"",
        "E0307",
    ),
    ("nmea", "digits = 2", "digits = 9", "digits = 9", "E0307"),
    (
        "nd28x",
        "role = \"unit\", default = \" \"",
        "role = \"unit\", default = \"x\"",
        "default = \"x\"",
        "E0307",
    ),
    ("nd28x", "{ kind = \"lit\", text = \" \" }", "{ kind = \"column\" }", "column", "E0307"),
    (
        "nmea",
        "{ kind = \"lit\", text = \"DBB,\" }",
        "{ kind = \"lit\", text = \"DBB,\", role = \"seq\" }",
        "text = \"DBB,\"",
        "E0307",
    ),
    (
        "cobs",
        "role = \"status\", flags = { 0 = \"valid\", 1 = \"over\", 2 = \"under\", 3 = \"overspeed\", 4 = \"trigger\", 5 = \"low_battery\" }",
        "role = \"quality\"",
        "quality",
        "E0307",
    ),
    ("cobs", "role = \"temp\", unit = \"C\"", "role = \"unit\"", "role = \"unit\"", "E0307"),
    ("nd28x", "\"\\\"\" = \"inch\"", "\"\\\"\" = \"foot\"", "foot", "E0307"),
    ("nd28x", "\"?\" = \"fault\"", "\"\" = \"fault\"", "\"\" = \"fault\"", "E0307"),
    ("nd28x", "{ \" \" = \"mm\", ", "{ \" \" = \"um\", ", "\"um\"", "E0307"),
    ("nd28x", "role = \"unit\", default", "role = \"temp\", default", "role = \"temp\"", "E0307"),
    ("tagged", "262076 = \"no peak\"", "peak = \"no peak\"", "peak = ", "E0307"),
    ("tagged", "valid = [643, 64887]", "valid = [64887, 643]", "valid =", "E0307"),
    ("delim", ", per = \"${counts_per_mm}\"", "", "unit = \"count\"", "E0307"),
    ("cobs", "unit = \"C\"", "unit = \"mm\"", "role = \"temp\"", "E0307"),
    ("tagged", "times = \"${range_mm}\"", "times = 0.0", "times = 0.0", "E0307"),
    // rejects and commands
    ("opto", "eq = \"OR\"", "eq = \"\"", "[[reject]]", "E0308"),
    ("opto", "eq = \"OR\"", "eq = \"OR\"\ncode = \"dec\"", "[[reject]]", "E0308"),
    ("modbus", "map = { 1 = \"function\"", "map = { x = \"function\"", "[[reject]]", "E0308"),
    ("cobs", "{ drain_ms = 50 }", "{ drain_ms = 50, wait_ms = 5 }", "wait_ms", "E0309"),
    ("cobs", "{ drain_ms = 50 }", "{ drain_ms = 50, check = true }", "check = true", "E0309"),
    ("opto", "{ send = \"?\\r\" }", "{ send = \"?\\r\", check = true }", "check = true", "E0309"),
    (
        "tagged",
        "start = [{ send = \"OUTPUT RS422\\n\", expect = \"->\", timeout_ms = 500 }]",
        "start = [{ send = \"OUTPUT RS422\\n\", expect = \"->\" }]",
        "start =",
        "E0309",
    ),
    // parameters
    ("delim", "default = 1000.0", "default = 0.0", "counts_per_mm = {", "E0310"),
    ("delim", "default = \"X\"", "default = \"Q\"", "axis = {", "E0310"),
    ("delim", "text = \"${axis}\"", "text = \"${axes}\"", "${axes}", "E0310"),
    // test vectors
    ("cobs", "rx = \"00 07", "rx = \"0 07", "rx = \"0 07", "E0311"),
    ("opto", "pad_to = 9, ", "pad_to = 9, width = 4, ", "expect", "E0311"),
    ("nd28x", "decimals = 4", "decimals = 9", "rx =", "E0311"),
];

#[test]
fn errors_name_file_line_column_and_remedy() {
    let mut wrong = Vec::new();
    for (name, old, new, place, code) in REFUSED {
        let text = SHIPPED.iter().find(|(file, _)| file == name).unwrap().1;
        assert!(text.contains(old), "{name} has no {old}");
        let text = text.replacen(old, new, 1);
        let Err(refusal) = ProtocolDefinition::from_toml("bar.toml", &text) else {
            wrong.push(format!("{name}: {new} is taken"));
            continue;
        };
        let message = refusal.to_string();
        let line =
            text.lines().position(|line| line.contains(place)).unwrap_or_else(|| panic!("{place}")) + 1;
        let pointed =
            refusal.excerpt().and_then(|line| line.chars().nth(refusal.column_number().wrapping_sub(1)));
        if refusal.line_number() != line
            || pointed.is_none_or(char::is_whitespace)
            || refusal.help_line().is_none()
            || !message.starts_with(&format!("bar.toml:{line}:{}: ", refusal.column_number()))
            || refusal.code().as_str() != *code
        {
            wrong.push(format!(
                "{name}: {new}: expected line {line} and {code}, got {} {message}",
                refusal.code()
            ));
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
        // The shipped vectors hold for another CRC.
        let (head, _) = text.split_once("[[test]]").unwrap();
        ProtocolDefinition::from_toml("bar.toml", head)
    };
    by_parameters("0x4b37").unwrap();
    let wrong = by_parameters("0x4b38").unwrap_err();
    assert_eq!((wrong.code().as_str(), &wrong.values()["check"]), ("E0305", &0x4b37.into()), "{wrong}");
    assert_eq!(wrong.excerpt(), Some("check = 0x4b38"));
    assert_eq!(wrong.column_number(), 9, "the value");
}

/// The frames of reference section 3, byte for byte.
#[test]
fn encoder_writes_the_published_vectors() {
    let nmea = b"$DBB,258,1000000,-0.12345,21.50,01*4D\r\n".to_vec();
    let cobs =
        [7, 1, 2, 1, 0x40, 0x42, 0x0f, 0x0a, 0xc7, 0xcf, 0xff, 0xff, 0x66, 8, 1, 0x84, 0x9e, 0].to_vec();
    for (name, frame) in [("dbb-cobs-1", cobs), ("dbb-nmea-1", nmea)] {
        let definition = ProtocolDefinition::by_name(name).unwrap().unwrap();
        let sample = dbbd_model::measurement::sample::Sample {
            sequence: Some(0x0102),
            ticks: Some(dbbd_model::base::units::DeviceTicks(1_000_000)),
            trigger: Some(false),
            temperature_c: Some(21.5),
            status: 1,
            ..dbbd_model::measurement::sample::Sample::of(-0.12345)
        };
        let mut bytes = Vec::new();
        definition.encoder().encode(&sample, &mut bytes).unwrap();
        assert_eq!(bytes, frame, "{name}");
    }
}

/// A definition with these keys of its message, its test bytes and the length that they mean.
fn line_definition(fields: &str, rx: &str, expect: &str) -> String {
    let rx: Vec<String> = rx.bytes().map(|byte| format!("{byte:02x}")).collect();
    format!(
        "schema = 1\nid = \"own\"\nconfidence = \"own\"\n[line]\nbaud = 9600\n\
        [framing]\nkind = \"line\"\nend = [\"\\r\\n\"]\nmax_len = 40\n\
        [[message]]\nname = \"value\"\nfields = [{fields}]\n\
        [[test]]\nrx = \"{}\"\nexpect = [{expect}]\n",
        rx.join(" ")
    )
}

#[test]
fn numbers_of_multimeters_german_gauges_and_microcontrollers_are_read() {
    let length = "role = \"length\", unit = \"mm\"";
    let clock = "{ kind = \"dec\", decimals = 6, role = \"t_dev\", tick_ns = 1000000000, wrap_bits = 40 }, \
        { kind = \"lit\", text = \",\" }";
    for (fields, rx, expect) in [
        (
            format!("{{ kind = \"dec\", decimals = 8, {length} }}"),
            "+1.25000000E-01\r\n",
            "{ length_mm = 0.125 }",
        ),
        (
            format!(
                "{{ kind = \"dec\", decimals = 3, decimal = \",\", {length} }}, {{ kind = \"lit\", text = \" mm\" }}"
            ),
            "+0012,345 mm\r\n",
            "{ length_mm = 12.345 }",
        ),
        (
            format!("{clock}, {{ kind = \"dec\", decimals = 4, {length} }}"),
            "12.345600,0.5\r\n",
            "{ t_dev_us = 12345600, length_mm = 0.5 }",
        ),
    ] {
        let text = line_definition(&fields, rx, expect);
        assert!(
            ProtocolDefinition::from_toml("own.toml", &text).is_ok(),
            "{rx}: {:?}",
            ProtocolDefinition::from_toml("own.toml", &text).err()
        );
    }
}

/// 0x00012345 is 74565; by its two words and the bytes in them in each order.
#[test]
fn words_of_a_register_pair_come_in_each_order() {
    for (endian, bytes) in
        [("be", "00 01 23 45"), ("le", "45 23 01 00"), ("cdab", "23 45 00 01"), ("badc", "01 00 45 23")]
    {
        let text = format!(
            "schema = 1\nid = \"own\"\nconfidence = \"own\"\n[line]\nbaud = 9600\n\
            [framing]\nkind = \"fixed\"\nsync = \"aa\"\nlen = 5\n\
            [[message]]\nname = \"value\"\nfields = [{{ kind = \"skip\", bytes = 1 }}, \
            {{ kind = \"int\", bits = 32, endian = \"{endian}\", role = \"length\", unit = \"count\", per = 1000.0 }}]\n\
            [[test]]\nrx = \"aa {bytes}\"\nexpect = [{{ length_mm = 74.565 }}]\n"
        );
        assert!(
            ProtocolDefinition::from_toml("own.toml", &text).is_ok(),
            "{endian}: {:?}",
            ProtocolDefinition::from_toml("own.toml", &text).err()
        );
    }
}

/// The message says which field does not match, and at which bytes.
#[test]
fn vector_that_fails_names_the_field() {
    let fields = "{ kind = \"dec\", decimals = 3, role = \"length\", unit = \"mm\" }, { kind = \"lit\", text = \" mm\" }";
    let text = line_definition(fields, "+0012.345 in\r\n", "{ length_mm = 12.345 }");
    let wrong = ProtocolDefinition::from_toml("own.toml", &text).unwrap_err();
    assert_eq!(wrong.code().as_str(), "E0311");
    let message = wrong.message();
    assert!(message.contains("its field 2 (no role, \" mm\") does not match ` in`"), "{message}");
}
