//! A table of measurements in the delimiter, decimal separator and encoding of any program gives the same result.

use std::fs;
use std::path::Path;
use std::process::Output;

use tempfile::tempdir;

use crate::cell::{codes, dbbd, stderr};

fn identify(dir: &Path, table: &[u8]) -> Output {
    fs::write(dir.join("obs.csv"), table).unwrap();
    let args = [
        "identify",
        "obs.csv",
        "--robot",
        "kr60ha",
        "--tool",
        "30,20,10",
        "--centres",
        "centres.csv",
        "--out",
        "out",
    ];
    dbbd(dir, &[&args[..], &["--prior", "datasheet", "--folds", "0"]].concat())
}

#[test]
fn dialects_of_a_table_give_the_same_result() {
    let dir = tempdir().unwrap();
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/paper");
    let plain = fs::read_to_string(example.join("observations.csv")).unwrap();
    let centres = fs::read_to_string(example.join("centres.csv")).unwrap();
    let comma = |text: &str, delimiter: &str| text.replace(',', delimiter).replace('.', ",");
    let noted: String = plain
        .lines()
        .enumerate()
        .map(|(at, line)| format!("{line},{}\r\n", if at == 0 { "note" } else { "3 \u{b5}m" }))
        .collect();
    let quoted: String = plain
        .lines()
        .map(|line| {
            line.split(',').map(|cell| format!("\"{}\",", cell.replace('.', ","))).collect::<String>() + "\n"
        })
        .collect();
    let utf_16 = |text: &str, bytes: fn(u16) -> [u8; 2]| -> Vec<u8> {
        format!("\u{feff}{text}").encode_utf16().flat_map(bytes).collect()
    };
    let tables: [(&str, Vec<u8>); 7] = [
        ("semicolons", comma(&plain, ";").into()),
        ("tabs", comma(&plain, "\t").into()),
        ("a line for spreadsheets", format!("sep=|\r\n{}", plain.replace(',', "|")).into()),
        ("quotes", quoted.into()),
        ("Windows-1252", noted.chars().map(|character| character as u8).collect()),
        ("UTF-16, little end first", utf_16(&comma(&plain, "\t"), u16::to_le_bytes)),
        ("UTF-16, big end first", utf_16(&plain, u16::to_be_bytes)),
    ];
    fs::write(dir.path().join("centres.csv"), &centres).unwrap();
    let usual = identify(dir.path(), plain.as_bytes());
    let result = |output: &Output| {
        assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(output));
        fs::read_to_string(dir.path().join("out/parameters.csv")).unwrap()
    };
    let (expected, found) = (result(&usual), codes(&usual));
    assert!(!found.contains(&"I0113".to_owned()));
    for (name, table) in tables {
        let output = identify(dir.path(), &table);
        assert_eq!(result(&output), expected, "{name}");
        assert_eq!(codes(&output), [&["I0113".to_owned()], &found[..]].concat(), "{name}");
    }
    // The other tables by the same reader.
    fs::write(dir.path().join("centres.csv"), comma(&centres, ";")).unwrap();
    assert_eq!(result(&identify(dir.path(), plain.as_bytes())), expected);
}

/// A terminal shows at once that a large table is being read.
#[cfg(target_os = "linux")]
#[test]
fn large_tables_show_progress() {
    use std::io::Read;
    use std::process::{Command, Stdio};
    use std::time::Duration;

    use dbbd_device::clock;

    use serialport::TTYPort;

    let dir = tempdir().unwrap();
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/paper");
    let plain = fs::read_to_string(example.join("observations.csv")).unwrap();
    let (header, rows) = plain.split_once('\n').unwrap();
    let rows: Vec<&str> = rows.lines().collect();
    let many: String = (0..300_000).map(|at| format!("{}\n", rows[at % rows.len()])).collect();
    fs::write(dir.path().join("obs.csv"), format!("{header}\n{many}")).unwrap();
    let (mut screen, terminal) = TTYPort::pair().unwrap();
    let name = serialport::SerialPort::name(&terminal).unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_dbbd"))
        .args(["identify", "obs.csv", "--robot", "kr60ha", "--tool", "30,20,10", "--centres"])
        .arg(example.join("centres.csv"))
        .args(["--out", "out"])
        .current_dir(dir.path())
        .env("TERM", "xterm")
        .env_remove("NO_COLOR")
        .stderr(Stdio::from(fs::File::options().write(true).open(name).unwrap()))
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let begin = clock::now();
    serialport::SerialPort::set_timeout(&mut screen, Duration::from_secs(10)).unwrap();
    let (mut shown, mut piece) = (Vec::new(), [0; 256]);
    while !String::from_utf8_lossy(&shown).contains("obs.csv") && clock::now().seconds_since(begin) < 10.0 {
        let read = screen.read(&mut piece).unwrap_or(0);
        shown.extend(&piece[..read]);
    }
    let after_s = clock::now().seconds_since(begin);
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(after_s < 1.0, "{after_s} s: {}", String::from_utf8_lossy(&shown));
}
