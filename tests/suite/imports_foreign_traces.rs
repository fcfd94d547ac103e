//! A trace recorded by other software is evaluated like a capture, and its errors are reported by line and column.
#![cfg(unix)]

use std::fs;
use std::path::Path;

use dbbd_job::recording::capture;
use dbbd_model::estimation::CalibrationResult;
use tempfile::tempdir;

use crate::cell::{codes, dbbd, stderr};

fn step(dir: &Path, args: &[&str]) {
    let output = dbbd(dir, args);
    assert!(matches!(output.status.code(), Some(0 | 3)), "dbbd {}: {}", args.join(" "), stderr(&output));
}

fn short_plan(dir: &Path) {
    let job = include_str!("../../examples/circles.toml").replace("points = 80", "points = 12");
    fs::write(dir.join("job.toml"), job).unwrap();
    step(dir, &["plan", "job.toml", "--out", "plan"]);
}

/// The layout of dbbd's own export.
const OWN: &str = "[time]\ncolumn = \"ticks\"\nunit = \"us\"\n[length]\ncolumn = \"reading_mm\"\nkind = \"reading\"\n\
    [strobe]\ncolumn = \"trigger\"\n[valid]\ncolumn = \"valid\"\n[temperature]\ncolumn = \"temperature_c\"\n";

#[test]
fn exported_run_is_imported_with_the_same_result() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    short_plan(at);
    step(at, &["acquire", "--port", "sim", "--plan", "plan/plan.csv", "--out", "run.dbbd"]);
    step(at, &["export", "run.dbbd", "--out", "csv"]);
    fs::write(at.join("own.toml"), OWN).unwrap();
    let import = ["import", "csv/samples.csv", "--plan", "plan/plan.csv", "--mapping", "own.toml", "--out"];
    step(at, &[&import[..], &["again.dbbd"]].concat());
    let found = ["run", "again"].map(|name| {
        let run = format!("{name}.dbbd");
        step(at, &["identify", &run, "--out", name]);
        let text = fs::read_to_string(at.join(name).join("result.json")).unwrap();
        serde_json::from_str::<CalibrationResult>(&text).unwrap()
    });
    assert!(found[0].rank > 5 && found[0].measurements > 30);
    for (one, other) in found[0].parameters.iter().zip(&found[1].parameters) {
        assert_eq!(one.name, other.name);
        let near = (one.identified - other.identified).abs() < 1e-9 * (1.0 + one.identified.abs());
        assert!(near, "{}: {} {}", one.name, one.identified, other.identified);
    }
    // The same readings, and their text.
    let read = |name: &str| capture::read_capture(&fs::read(at.join(name)).unwrap());
    let (run, again) = (read("run.dbbd"), read("again.dbbd"));
    let readings = |capture: &capture::Capture| -> Vec<f64> {
        capture.samples().map(|(_, sample)| sample.reading_mm).collect()
    };
    assert_eq!(readings(&run), readings(&again));
    let text: Vec<u8> = again
        .records
        .iter()
        .filter_map(|stamped| match &stamped.record {
            capture::CaptureRecord::Raw(text) => Some(text.clone()),
            _ => None,
        })
        .flatten()
        .collect();
    assert_eq!(text, fs::read(at.join("csv/samples.csv")).unwrap());
    // The same input gives the same bytes, and no capture is overwritten.
    step(at, &[&import[..], &["third.dbbd"]].concat());
    assert_eq!(fs::read(at.join("again.dbbd")).unwrap(), fs::read(at.join("third.dbbd")).unwrap());
    let refused = dbbd(at, &[&import[..], &["third.dbbd"]].concat());
    assert_eq!((refused.status.code(), codes(&refused)), (Some(1), vec!["E0401".to_owned()]));
}

#[test]
fn layouts_are_detected_or_given_by_a_mapping() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    short_plan(at);
    // The bar of the job is 300 mm long. Steps of 0.25 um and of 1/128 s are exact in binary.
    let rows: Vec<(f64, f64)> =
        (0..100).map(|i| (f64::from(i) / 128.0, 300.0 + f64::from(i % 9) / 4096.0)).collect();
    let comma = |value: f64| value.to_string().replace('.', ",");
    let csv = |header: &str, row: &dyn Fn(f64, f64) -> String| -> String {
        rows.iter().fold(header.to_owned(), |text, &(t_s, mm)| text + &row(t_s, mm))
    };
    // Without a mapping, in formats of spreadsheets and instruments.
    let shown: [(&str, Vec<u8>, &[&str]); 5] = [
        ("plain", csv("t_s,length_mm,note\n", &|t, mm| format!("{t},{mm},x\n")).into(), &[]),
        (
            "semicolons",
            csv("sep=;\r\nlength_mm;t_s\r\n", &|t, mm| format!("{};{};\r\n", comma(mm), comma(t))).into(),
            &["I0113"],
        ),
        (
            "tabs, dates and readings",
            csv("t_s\tlength_mm\n", &|t, mm| {
                format!("21.11.2026 14:02:{}\t{}\n", comma(11.0 + t), comma(mm - 300.0))
            })
            .into(),
            &["I0113", "I1112", "I1112"],
        ),
        (
            "windows-1252",
            csv("t_s,length_mm,T @\n", &|t, mm| format!("{t},{mm},20\n"))
                .replace('@', "\u{b0}")
                .chars()
                .map(|c| c as u8)
                .collect(),
            &["I0113"],
        ),
        (
            "utf-16",
            csv("\u{feff}t_s,length_mm\n", &|t, mm| format!("{t},{mm}\n"))
                .encode_utf16()
                .flat_map(u16::to_le_bytes)
                .collect(),
            &["I0113"],
        ),
    ];
    let mapped = [
        (
            "example",
            csv("Messung 7\r\n\r\nZeit;Weg\r\n# seen\r\n", &|t, mm| {
                format!("{};{}\r\n", comma(t * 1e3), comma((mm - 300.0) * 1e3))
            }),
            include_str!("../../examples/mapping.toml").to_owned(),
        ),
        (
            "rate",
            csv("", &|_, mm| format!("  x   {}\n", mm / 25.4)),
            "[file]\ndelimiter = \"space\"\nheader = false\n[time]\nrate_hz = 128\n[length]\ncolumn = 2\nunit = \"inch\"\n"
                .to_owned(),
        ),
        (
            "iso",
            csv("when,m\n", &|t, mm| format!("2026-11-21T14:02:{:012.9}Z,{}\n", 11.0 + t, mm / 1e3)),
            "[time]\ncolumn = \"when\"\nunit = \"iso\"\n[length]\ncolumn = \"m\"\nunit = \"m\"\n".to_owned(),
        ),
    ];
    // Milliseconds taken for seconds.
    fs::write(at.join("ms.csv"), "t_s,length_mm\n0,300\n10000000,300\n").unwrap();
    let long = dbbd(at, &["import", "ms.csv", "--plan", "plan/plan.csv", "--out", "long"]);
    assert!(long.status.code() == Some(3) && codes(&long).contains(&"W1110".to_owned()));
    let none: &[&str] = &[];
    let mapped = mapped.map(|(name, text, mapping)| (name, text.into_bytes(), mapping, none));
    let shown = shown.map(|(name, bytes, told)| (name, bytes, String::new(), told));
    for (name, bytes, mapping, told) in shown.into_iter().chain(mapped) {
        fs::write(at.join("trace.csv"), bytes).unwrap();
        fs::write(at.join("map.toml"), mapping).unwrap();
        let output = dbbd(
            at,
            &["import", "trace.csv", "--plan", "plan/plan.csv", "--mapping", "map.toml", "--out", name],
        );
        // Less than a second of a long plan: accepted with a warning.
        assert_eq!(output.status.code(), Some(3), "{name}: {}", stderr(&output));
        assert_eq!(codes(&output), told.iter().chain(&["W1110"]).copied().collect::<Vec<_>>(), "{name}");
        let capture = capture::read_capture(&fs::read(at.join(name)).unwrap());
        assert_eq!(capture.samples().count(), rows.len(), "{name}");
        for ((host, sample), (t_s, mm)) in capture.samples().zip(&rows) {
            assert!((host.0 as f64 - t_s * 1e9).abs() < 1.0, "{name}: {host:?} {t_s}");
            assert!((sample.reading_mm - (mm - 300.0)).abs() < 1e-9, "{name}: {} {mm}", sample.reading_mm);
            assert!(sample.valid);
        }
    }
}

/// A trace, its mapping, the code, and the position.
const WRONG: &[(&str, &str, &str, &str)] = &[
    ("t_s,length_mm\n0,300\n0.1,x\n", "", "E0111", "trace.csv:3:5:"),
    ("t_s,length_mm\n0,NaN\n", "", "E0111", "trace.csv:2:3:"),
    ("t_s,length_mm\n0,300\n0.1\n", "", "E0112", "trace.csv:3:4:"),
    ("t_s,length_mm\n1,300\n0.5,300\n", "", "E1104", "trace.csv:3:1:"),
    ("t_s,length_mm\n0,0.01\n", "[length]\nkind = \"distance\"\n", "E1105", "trace.csv:2:3:"),
    ("t_s,length_mm\n0,300\n", "[length]\nkind = \"reading\"\n", "E1105", "trace.csv:2:3:"),
    ("t_s,length_mm\n", "", "E1106", "trace.csv:"),
    ("", "", "E1106", "trace.csv:"),
    ("t_s;length_mm\n0;300,5\n", "[file]\ndecimal = \".\"\n", "E0111", "trace.csv:2:3:"),
    ("t_s,length_mm,on\n0,300,x\n", "[strobe]\ncolumn = \"on\"\n", "E1103", "trace.csv:2:7:"),
    ("t_s,length_mm\n0,300\n", "[file]\ndelimeter = \";\"\n", "E0120", "map.toml:2:1:"),
    ("t_s,length_mm\n0,300\n", "[time]\nunit = \"min\"\n", "E0120", "map.toml:2:8:"),
    ("t_s,length_mm\n0,300\n", "[length]\ncolumn = 0\n", "E0120", "map.toml:"),
    ("t_s,length_mm\n0,300\n", "[file]\ndecimal = \",\"\ndelimiter = \",\"\n", "E1101", "map.toml:2:1:"),
    ("0,300\n", "[file]\nheader = false\n", "E1101", "trace.csv:"),
    (
        "0 300\n1\n",
        "[file]\nheader = false\n[time]\ncolumn = 1\n[length]\ncolumn = 2\n",
        "E0112",
        "trace.csv:2:2:",
    ),
    ("t_s,length_mm\n12:30,300\n", "[time]\nunit = \"iso\"\n", "E1103", "trace.csv:2:1:"),
    // The format of the first row holds for all.
    ("t_s,length_mm\n0,300.5\n1,0.5\n", "", "E1105", "trace.csv:3:3:"),
    ("t_s,length_mm\n0,0.5\n1,300.5\n", "", "E1105", "trace.csv:3:3:"),
    ("t_s;length_mm\n0;300,5\n1;300.5\n", "", "E0111", "trace.csv:3:3:"),
    ("t_s;length_mm\n21.11.2026 14:02:11,5;300\n1;300\n", "", "E1103", "trace.csv:3:1:"),
    // Decimal commas between commas.
    ("t_s,length_mm\n0,5,300,5\n", "", "E0112", "trace.csv:2:5:"),
    ("Zeit;Weg\n0;300\n", "", "E0110", "trace.csv:1:"),
    ("t_s,length_mm\n0,\"300\n", "", "E0112", "trace.csv:2:"),
];

#[test]
fn import_errors_have_a_code_and_a_position() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    short_plan(at);
    let import = |text: &str, mapping: &str| {
        fs::write(at.join("trace.csv"), text).unwrap();
        fs::write(at.join("map.toml"), mapping).unwrap();
        let args =
            ["import", "trace.csv", "--plan", "plan/plan.csv", "--mapping", "map.toml", "--out", "out.dbbd"];
        dbbd(at, &args)
    };
    for (text, mapping, code, place) in WRONG {
        let output = import(text, mapping);
        assert_eq!((output.status.code(), codes(&output)), (Some(1), vec![(*code).to_owned()]), "{text}");
        assert!(stderr(&output).contains(&format!("]: {place}")), "{place}: {}", stderr(&output));
        assert!(!at.join("out.dbbd").exists(), "{code}");
    }
    let output = dbbd(at, &["import", "none.csv", "--plan", "plan/plan.csv", "--out", "out.dbbd"]);
    assert_eq!(codes(&output), ["E0101"]);
    // Beyond the stroke: accepted as invalid.
    let output = import("t_s,length_mm\n0,300\n1,330\n", "");
    assert_eq!(codes(&output), ["I1111", "W1110", "W1181"]);
}
