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
    ("t_s,length_mm\n0,300\n0.1\n0.2,300\n", "", "E0112", "trace.csv:3:4:"),
    ("t_s,length_mm\n03/04/2024 10:00:00,300\n", "", "E1103", "trace.csv:2:1:"),
    ("t_s,length_mm\n1/2/24 10:00,300\n", "", "E1103", "trace.csv:2:1:"),
    ("t_s,length_mm\n10:00,300\n", "[time]\nformat = \"%H.%M\"\n", "E1103", "trace.csv:2:1:"),
    ("t_s,length_mm\n0,300\n", "[time]\nformat = \"%H:%Q\"\n", "E1101", "map.toml:2:1:"),
    // A number of another form is no missing reading.
    ("t_s;length_mm\n0;300,5\n1;1.000,5\n2;300,5\n", "", "E0111", "trace.csv:3:3:"),
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
        "0 300\n1\n2 300\n",
        "[file]\nheader = false\n[time]\ncolumn = 1\n[length]\ncolumn = 2\n",
        "E0112",
        "trace.csv:2:2:",
    ),
    ("t_s,length_mm\nnoon,300\n", "[time]\nunit = \"iso\"\n", "E1103", "trace.csv:2:1:"),
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

/// 200 readings of a bar of 300 mm, 50 a second, from a second before midnight of 14 September 2024. `row` writes one.
fn trace(header: &str, row: impl Fn(u32, f64) -> String) -> String {
    let rows = (0..200).map(|at| row(at, 300.0 + f64::from(at % 9) / 4096.0));
    rows.fold(header.to_owned(), |text, row| text + &row + "\n")
}

/// Imports a trace; returns the output and the capture.
fn imported(dir: &Path, text: &[u8], mapping: &str) -> (std::process::Output, Option<capture::Capture>) {
    fs::write(dir.join("trace.csv"), text).unwrap();
    fs::write(dir.join("map.toml"), mapping).unwrap();
    _ = fs::remove_file(dir.join("out"));
    let args = ["import", "trace.csv", "--plan", "plan/plan.csv", "--mapping", "map.toml", "--out", "out"];
    let output = dbbd(dir, &args);
    let capture = fs::read(dir.join("out")).ok().map(|bytes| capture::read_capture(&bytes));
    (output, capture)
}

#[test]
fn rows_without_a_reading_are_kept_as_not_valid() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    short_plan(at);
    let with = |word: &str, rows: std::ops::Range<u32>| {
        trace("t_s,length_mm\n", |row, mm| {
            let length = if rows.contains(&row) { word.to_owned() } else { mm.to_string() };
            format!("{},{length}", f64::from(row) / 50.0)
        })
    };
    for word in ["", "NaN", "-FFFFFFF", "---", "OL", "####", "+Inf", "1.#QNAN", "-999.999", "9999.99", "0"] {
        for rows in [0..10, 50..60, 190..200] {
            let (output, capture) = imported(at, with(word, rows.clone()).as_bytes(), "");
            assert_eq!(output.status.code(), Some(3), "{word}: {}", stderr(&output));
            assert_eq!(codes(&output), ["W1182", "W1110"], "{word}");
            let said = format!("trace.csv:{}: 10 of 200 rows", rows.start + 2);
            assert!(stderr(&output).contains(&said), "{word}: {}", stderr(&output));
            for (row, (_, sample)) in (0..).zip(capture.unwrap().samples()) {
                assert_eq!(sample.valid, !rows.contains(&row), "{word}: {row}");
                assert!((0.0..0.01).contains(&sample.reading_mm), "{word}: {row}: {}", sample.reading_mm);
            }
        }
        // Where many are missing, the column or the unit is wrong.
        let (output, capture) = imported(at, with(word, 50..71).as_bytes(), "");
        assert!(["E0111", "E1105"].contains(&codes(&output)[0].as_str()) && capture.is_none(), "{word}");
        assert!(stderr(&output).contains("21 of 200 rows"), "{word}: {}", stderr(&output));
    }
}

#[test]
fn lines_above_and_below_the_readings_are_left_out() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    short_plan(at);
    let plain =
        trace("Zeit;Weg\ns;mm\n", |row, mm| format!("{};{mm}", f64::from(row) / 50.0).replace('.', ","));
    let mapping = "[time]\ncolumn = \"Zeit\"\n[length]\ncolumn = \"Weg\"\n";
    for (end, said) in [
        ("", "1 lines below the header"),
        ("\nAnzahl Werte: 200\nMittelwert;300,0\nMax;300,1;x\n", "3 lines at the end"),
        ("4,", "the last line is cut off"),
    ] {
        let (output, capture) = imported(at, format!("{plain}{end}").as_bytes(), mapping);
        assert!(stderr(&output).contains(said), "{end}: {}", stderr(&output));
        assert_eq!(capture.unwrap().samples().count(), 200, "{end}");
    }
    let (output, _) = imported(at, format!("{plain}Ende\n4,0;300,0\n").as_bytes(), mapping);
    assert_eq!(codes(&output), ["E0112"]);
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut packed, plain.as_bytes()).unwrap();
    let packed = packed.finish().unwrap();
    let (_, capture) = imported(at, &packed, mapping);
    assert_eq!(capture.unwrap().samples().count(), 200);
    let (output, _) = imported(at, &packed[..packed.len() / 2], mapping);
    assert_eq!(output.status.code(), Some(1));
}

#[test]
fn times_are_read_as_loggers_write_them() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    short_plan(at);
    // Day, hour, minute, second and milliseconds of a row, from 23:59:59.
    let parts = |row: u32| {
        let ms = 86_399_000 + 20 * row;
        let (day, ms) = (14 + ms / 86_400_000, ms % 86_400_000);
        (day, ms / 3_600_000, ms / 60_000 % 60, ms / 1000 % 60, ms % 1000)
    };
    type Writer<'a> = &'a dyn Fn((u32, u32, u32, u32, u32)) -> String;
    let half = |h: u32| (if h.is_multiple_of(12) { 12 } else { h % 12 }, if h < 12 { "AM" } else { "PM" });
    let spellings: [(&str, Writer<'_>); 12] = [
        ("", &|(d, h, m, s, ms)| {
            let (h, half) = half(h);
            format!("9/{d}/2024 {h}:{m:02}:{s:02}.{ms:03} {half}")
        }),
        ("", &|(_, h, m, s, ms)| format!("{h:02}:{m:02}:{s:02}.{ms:03}")),
        ("", &|(_, h, m, s, ms)| {
            let (h, half) = half(h);
            format!("{h}:{m:02}:{s:02}.{ms:03} {half}")
        }),
        ("", &|(d, h, m, s, ms)| format!("2024/09/{d} {h:02}:{m:02}:{s:02}.{ms:03}")),
        ("", &|(d, h, m, s, ms)| format!("{d}/09/2024 {h:02}:{m:02}:{s:02}.{ms:03}")),
        ("", &|(d, h, m, s, ms)| format!("\"{d}.09.2024 {h:02}:{m:02}:{s:02},{ms:03}\"")),
        ("", &|(d, h, m, s, ms)| format!("2024-09-{d}T{h:02}:{m:02}:{s:02}:{ms:03}")),
        ("", &|(d, h, m, s, ms)| format!("{d}-Sep-2024 {h:02}:{m:02}:{s:02}.{ms:03}")),
        ("format = \"%d/%m/%y %H:%M:%S.%f\"", &|(d, h, m, s, ms)| {
            format!("{d}/09/24 {h:02}:{m:02}:{s:02}.{ms:03}")
        }),
        ("format = \"%Y%m%dT%H%M%S%f\"", &|(d, h, m, s, ms)| format!("202409{d}T{h:02}{m:02}{s:02}{ms:03}")),
        ("date_column = \"day\"", &|(d, h, m, s, ms)| format!("{h:02}:{m:02}:{s:02}.{ms:03},2024-09-{d}")),
        ("date_column = \"day\"\nformat = \"%d.%m.%y %H:%M:%S.%f\"", &|(d, h, m, s, ms)| {
            format!("{h:02}:{m:02}:{s:02}.{ms:03},{d}.09.24")
        }),
    ];
    for (keys, time) in spellings {
        let header = if keys.contains("date_column") { "length_mm,t_s,day\n" } else { "length_mm,t_s\n" };
        let text = trace(header, |row, mm| format!("{mm},{}", time(parts(row))));
        let (output, capture) = imported(at, text.as_bytes(), &format!("[time]\n{keys}\n"));
        let example = time(parts(0));
        assert_eq!(output.status.code(), Some(3), "{example}: {}", stderr(&output));
        let capture = capture.unwrap();
        assert_eq!(capture.samples().count(), 200, "{example}");
        for (row, (host, _)) in (0..).zip(capture.samples()) {
            assert_eq!(host.0, row * 20_000_000, "{example}: {row}");
        }
    }
    // A day above 12 in any row shows the order.
    for (first, second, hours) in [("12/09/2024", "13/09/2024", 24), ("09/12/2024", "09/13/2024", 24)] {
        let text = format!("t_s,length_mm\n{first} 10:00:00,300\n{second} 10:00:00,300\n");
        let (_, capture) = imported(at, text.as_bytes(), "");
        assert_eq!(capture.unwrap().samples().last().unwrap().0.0, hours * 3_600_000_000_000);
    }
}

#[test]
fn strobes_are_read_as_loggers_write_them() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    short_plan(at);
    let strobe = "[strobe]\ncolumn = \"s\"\n";
    let volts = "[strobe]\ncolumn = \"s\"\nthreshold = 12\n";
    for (on, off, mapping) in [
        ("1.0", "0.0", strobe),
        ("High", "Low", strobe),
        ("ON", "OFF", strobe),
        ("TRUE", "FALSE", strobe),
        ("23.85", "0.12", volts),
    ] {
        let text = trace("t_s,length_mm,s\n", |row, mm| {
            format!("{},{mm},{}", f64::from(row) / 50.0, if row % 50 < 25 { on } else { off })
        });
        let (output, capture) = imported(at, text.as_bytes(), mapping);
        assert_eq!(output.status.code(), Some(3), "{on}: {}", stderr(&output));
        for (row, (_, sample)) in (0u32..).zip(capture.unwrap().samples()) {
            assert_eq!(sample.trigger, Some(row % 50 < 25), "{on}: {row}");
        }
    }
    let text = trace("t_s,length_mm,s\n", |row, mm| format!("{},{mm},4.98", f64::from(row) / 50.0));
    let (output, _) = imported(at, text.as_bytes(), strobe);
    assert!(codes(&output) == ["E1103"] && stderr(&output).contains("threshold"), "{}", stderr(&output));
}
