//! A trace that other software recorded goes the same way as a capture, and what is wrong in it is named
//! by line and column.
#![cfg(unix)]

use std::fs;
use std::path::Path;

use dbbd::capture;
use dbbd::identify::result::Identification;
use tempfile::tempdir;

use crate::cell::{dbbd, stderr};

fn step(dir: &Path, args: &[&str]) {
    let output = dbbd(dir, args);
    assert!(matches!(output.status.code(), Some(0 | 3)), "dbbd {}: {}", args.join(" "), stderr(&output));
}

fn short_plan(dir: &Path) {
    let job = include_str!("../../examples/demo.toml").replace("points = 80", "points = 12");
    fs::write(dir.join("job.toml"), job).unwrap();
    step(dir, &["plan", "job.toml", "--out", "plan"]);
}

/// The layout of dbbd's own export.
const OWN: &str = "[time]\ncolumn = \"ticks\"\nunit = \"us\"\n[length]\ncolumn = \"reading_mm\"\nkind = \"reading\"\n\
    [strobe]\ncolumn = \"trigger\"\n[valid]\ncolumn = \"valid\"\n[temperature]\ncolumn = \"temperature_c\"\n";

#[test]
fn an_exported_run_comes_back_and_identifies_the_same() {
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
        serde_json::from_str::<Identification>(&text).unwrap()
    });
    assert!(found[0].rank > 5 && found[0].observations > 30);
    for (one, other) in found[0].parameters.iter().zip(&found[1].parameters) {
        assert_eq!(one.name, other.name);
        let near = (one.identified - other.identified).abs() < 1e-9 * (1.0 + one.identified.abs());
        assert!(near, "{}: {} {}", one.name, one.identified, other.identified);
    }
    // The same readings, and the text they come from.
    let read = |name: &str| capture::read(&fs::read(at.join(name)).unwrap());
    let (run, again) = (read("run.dbbd"), read("again.dbbd"));
    let readings = |capture: &capture::Capture| -> Vec<f64> {
        capture.samples().map(|(_, sample)| sample.reading_mm).collect()
    };
    assert_eq!(readings(&run), readings(&again));
    let text: Vec<u8> = again
        .records
        .iter()
        .filter_map(|stamped| match &stamped.record {
            capture::Record::Raw(text) => Some(text.clone()),
            _ => None,
        })
        .flatten()
        .collect();
    assert_eq!(text, fs::read(at.join("csv/samples.csv")).unwrap());
    // The same input gives the same bytes, and no capture is overwritten.
    step(at, &[&import[..], &["third.dbbd"]].concat());
    assert_eq!(fs::read(at.join("again.dbbd")).unwrap(), fs::read(at.join("third.dbbd")).unwrap());
    let refused = dbbd(at, &[&import[..], &["third.dbbd"]].concat());
    assert_eq!(refused.status.code(), Some(1));
    assert!(stderr(&refused).contains("exists already"), "{}", stderr(&refused));
}

#[test]
fn layouts_are_told_by_a_mapping() {
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
    let traces = [
        ("plain", csv("t_s,length_mm,note\n", &|t, mm| format!("{t},{mm},x\n")), String::new()),
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
    for (name, text, mapping) in traces {
        fs::write(at.join("trace.csv"), text).unwrap();
        fs::write(at.join("map.toml"), mapping).unwrap();
        let output = dbbd(
            at,
            &["import", "trace.csv", "--plan", "plan/plan.csv", "--mapping", "map.toml", "--out", name],
        );
        // Less than a second of a plan of many: taken, and doubted.
        assert_eq!(output.status.code(), Some(3), "{name}: {}", stderr(&output));
        assert!(stderr(&output).contains("warning: the trace lasts 0.8 s and the plan "), "{name}");
        let capture = capture::read(&fs::read(at.join(name)).unwrap());
        assert_eq!(capture.samples().count(), rows.len(), "{name}");
        for ((host, sample), (t_s, mm)) in capture.samples().zip(&rows) {
            assert!((host.0 as f64 - t_s * 1e9).abs() < 1.0, "{name}: {host:?} {t_s}");
            assert!((sample.reading_mm - (mm - 300.0)).abs() < 1e-9, "{name}: {} {mm}", sample.reading_mm);
            assert!(sample.valid);
        }
    }
}

#[test]
fn what_is_wrong_is_named_by_line_and_column() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    short_plan(at);
    let cases = [
        ("t_s,length_mm\n0,300\n0.1,x\n", "", "trace.csv:3:5: `x` is not a number"),
        ("t_s,length_mm\n0,NaN\n", "", "trace.csv:2:3: `NaN` is not a finite number"),
        ("t_s,length_mm\n0,300\n0.1\n", "", "trace.csv:3:4: the line ends before its column 2"),
        ("t_s,length_mm\n1,300\n0.5,300\n", "", "trace.csv:3:1: the time goes back"),
        ("t_s,length_mm\n0,0.01\n", "", "trace.csv:2:3: 0.01 mm is no length of a bar of 300 mm"),
        ("t_s;length_mm\n0;300\n", "", "trace.csv:1:1: the column `t_s` is missing"),
        ("t_s,length_mm\n", "", "holds no reading"),
        ("", "", "holds no reading"),
        (
            "t_s;length_mm\n0;300,5\n",
            "[file]\ndelimiter = \";\"\n",
            "trace.csv:2:3: `300,5` is not a number: is the decimal a comma?",
        ),
        ("t_s,length_mm\n0,300\n", "[file]\ndelimeter = \";\"\n", "map.toml:2:1: unknown field `delimeter`"),
        ("t_s,length_mm\n0,300\n", "[time]\nunit = \"min\"\n", "map.toml:2:8: unknown variant `min`"),
        ("t_s,length_mm\n0,300\n", "[length]\ncolumn = 0\n", "columns are numbered from 1"),
        ("t_s,length_mm\n0,300\n", "[file]\ndecimal = \",\"\n", "map.toml:2:1: is the same as the delimiter"),
        ("0,300\n", "[file]\nheader = false\n", "must be a number from 1"),
        (
            "t_s,length_mm\n12:30,300\n",
            "[time]\nunit = \"iso\"\n",
            "trace.csv:2:1: `12:30` is no date and time",
        ),
    ];
    for (text, mapping, wanted) in cases {
        fs::write(at.join("trace.csv"), text).unwrap();
        fs::write(at.join("map.toml"), mapping).unwrap();
        let args =
            ["import", "trace.csv", "--plan", "plan/plan.csv", "--mapping", "map.toml", "--out", "out.dbbd"];
        let output = dbbd(at, &args);
        assert_eq!(output.status.code(), Some(1), "{wanted}");
        assert!(stderr(&output).contains(wanted), "{wanted}: {}", stderr(&output));
        assert!(!at.join("out.dbbd").exists(), "{wanted}");
    }
    let output = dbbd(at, &["import", "none.csv", "--plan", "plan/plan.csv", "--out", "out.dbbd"]);
    assert!(stderr(&output).contains("none.csv: cannot be read"), "{}", stderr(&output));
}
