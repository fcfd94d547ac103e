//! `dbbd protocols`: the place of an error, the list and the layout of a frame.

use dbbd_device::protocol::ProtocolDefinition;

const COBS: &str = include_str!("../../protocols/dbb-cobs-1.toml");

/// The binary gives exit code 1 and a message on stderr only.
#[test]
fn binary_reports_the_position_of_an_error() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("bar.toml");
    std::fs::write(&path, COBS.replace("stall_ms = 50", "stal_ms = 50")).unwrap();
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_dbbd"))
        .args(["protocols", "check", path.to_str().unwrap()])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let line = COBS.lines().position(|line| line.contains("stall_ms")).unwrap() + 1;
    assert_eq!((output.status.code(), output.stdout.len()), (Some(1), 0), "{said}");
    assert!(said.contains(&format!("error[E0120]: {}:{line}:1:", path.display())), "{said}");
}

/// The list shows the confidence of each definition.
#[test]
fn list_shows_the_confidence_of_each_definition() {
    let output =
        std::process::Command::new(env!("CARGO_BIN_EXE_dbbd")).args(["protocols", "list"]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(said.lines().count(), ProtocolDefinition::built_in().len());
    for (name, text) in ProtocolDefinition::built_in() {
        let line = said.lines().find(|line| line.starts_with(&format!("{name} "))).unwrap();
        let definition = ProtocolDefinition::from_toml(name, text).unwrap();
        assert!(line.contains(definition.confidence) && line.contains("not tried on hardware"), "{line}");
        assert_eq!(line.contains("no check"), definition.undetected() == 1.0, "{line}");
        // The file states it too.
        assert!(definition.confidence == "own" || text.contains("not tried on hardware"), "{name}");
        let without =
            text.contains("# No check") || text.contains("optional = true") || definition.confidence == "own";
        assert!(definition.undetected() < 1.0 || without, "{name} does not say that it has no check");
    }
}

/// `protocols show` prints the layout of the frame above the definition.
#[test]
fn protocols_show_prints_the_frame_layout() {
    for (name, layout) in [
        (
            "dbb-cobs-1",
            &[
                "# frame: COBS, ended by 00, at most 64 bytes",
                "#    1      2  uint16, lowest byte first                 sequence number",
                "#    7      4  int32, lowest byte first                  length, 0.00001 mm a step",
                "#   14      2  CRC-16, polynomial 0x1021                 check",
            ][..],
        ),
        (
            "mitutoyo-push",
            &[
                "# frame: ended by 0d, at most 20 bytes",
                "#    0      3  \"01A\"",
                "#    3      9  decimal, 3 decimals                       length, 0.001 mm a step",
                "# no check: a damaged frame of the right form passes",
            ],
        ),
    ] {
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_dbbd"))
            .args(["protocols", "show", name])
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        for line in layout {
            assert!(said.lines().any(|other| other == *line), "{line}\nis not in\n{said}");
        }
    }
}
