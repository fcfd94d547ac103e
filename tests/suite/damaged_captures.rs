//! The commands read a stored capture, and name the damage of others.

use dbbd_job::recording::capture::{self, CaptureRecord, CaptureWriter};
use dbbd_model::base::units::HostNs;
use dbbd_model::measurement::Measurements;
use dbbd_model::measurement::sample::Sample;

use crate::cell::{codes, dbbd};
use crate::support::short_capture::write;

/// Sum of `reading_mm` in the CSV exported by the version that recorded the fixture, um.
const STORED_SUM_UM: f64 = 852667.9;

/// A stored run over a line that flipped bits; see fixtures/README.md.
#[test]
fn stored_capture_is_evaluated() {
    let capture = capture::read_capture(include_bytes!("../../fixtures/captures/run.dbbd"));
    assert_eq!((capture.version, capture.damages.len(), capture.ended()), (Some(2), 0, true));
    let samples: Vec<&Sample> = capture.samples().map(|(_, sample)| sample).collect();
    assert_eq!(samples.len(), 1784);
    let sum_um: f64 = samples.iter().map(|sample| sample.reading_mm * 1e3).sum();
    assert!((sum_um - STORED_SUM_UM).abs() < 1e-6, "{sum_um}");
    let out = tempfile::tempdir().unwrap();
    let out = out.path().join("observations.csv");
    let run = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/captures/run.dbbd");
    let synced = std::process::Command::new(env!("CARGO_BIN_EXE_dbbd"))
        .args(["sync", run, "--out", out.to_str().unwrap()])
        .output()
        .unwrap();
    // It lacks five samples, which gives a warning.
    assert_eq!(synced.status.code(), Some(3), "{}", String::from_utf8_lossy(&synced.stderr));
    let was = include_str!("../../fixtures/captures/run.csv");
    let (now, was) = (
        Measurements::from_csv("now", &std::fs::read_to_string(&out).unwrap()),
        Measurements::from_csv("was", was),
    );
    for (now, was) in now.unwrap().rows.iter().zip(&was.unwrap().rows) {
        assert_eq!(now.index, was.index);
        assert!((now.length_mm - was.length_mm).abs() < 1e-3, "{} {}", now.length_mm, was.length_mm);
    }
}

/// Files that `info` refuses or warns about, with the codes.
const DAMAGED: [(&str, i32, &str); 4] =
    [("E0405", 1, "none"), ("E0406", 1, "format"), ("W0410", 3, "flipped"), ("W0411", 3, "cut")];

#[test]
fn incomplete_file_has_a_code() {
    let dir = tempfile::tempdir().unwrap();
    let (bytes, ends) = write(&dir.path().join("run"));
    for (code, exit, what) in DAMAGED {
        let bytes = match what {
            "none" => b"index\n1\n".to_vec(),
            "flipped" => {
                let mut bytes = bytes.clone();
                bytes[ends[1] + 20] ^= 1;
                bytes
            }
            "cut" => bytes[..ends[ends.len() - 2]].to_vec(),
            _ => {
                let mut header = bytes[..12].to_vec();
                header[8] = 9;
                let sum = crc::Crc::<u32>::new(&crc::CRC_32_ISCSI).checksum(&header);
                [&header[..], &sum.to_le_bytes(), &bytes[16..]].concat()
            }
        };
        std::fs::write(dir.path().join(what), bytes).unwrap();
        let output = dbbd(dir.path(), &["info", what]);
        assert_eq!((output.status.code(), codes(&output)), (Some(exit), vec![code.to_owned()]), "{what}");
    }
    let made = CaptureWriter::create(&dir.path().join("nowhere/run"));
    assert_eq!(made.err().unwrap().code().as_str(), "E0402");
    let mut writer = CaptureWriter::create(&dir.path().join("long")).unwrap();
    let long = CaptureRecord::Raw(vec![0; 65 << 20]);
    assert_eq!(writer.write(HostNs(0), &long).unwrap_err().code().as_str(), "E0404");
}
