//! Bad input: a message with file, line and reason, exit code 1, no panic.

use std::fs;
use std::path::Path;

use tempfile::tempdir;

use crate::cell::{CENTRE, DESIGNED, dbbd, horizontal, measure, stderr, three_planes, with_errors};

const HEADER: &str = "index,centre,a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,length_mm,sigma_mm\n";
const ROW: &str = "1,1,0,-60,90,0,60,0,300.1,0.01\n";

fn identify(dir: &Path, observations: &str, more: &[&str]) -> (Option<i32>, String) {
    fs::write(dir.join("obs.csv"), observations).unwrap();
    fs::write(dir.join("C.csv"), "centre,x_mm,y_mm,z_mm\n1,1300,0,800\n").unwrap();
    let mut args = vec!["identify", "obs.csv", "--centres", "C.csv", "--out", "out"];
    args.extend(more);
    let output = dbbd(dir, &args);
    (output.status.code(), stderr(&output))
}

fn refused(observations: &str, more: &[&str], words: &[&str]) {
    let dir = tempdir().unwrap();
    let (code, said) = identify(dir.path(), observations, more);
    assert_eq!(code, Some(1), "{said}");
    assert!(!said.contains("panicked"), "{said}");
    for word in words {
        assert!(said.contains(word), "`{word}` is not in: {said}");
    }
}

/// The file is read a row at a time, and names the row.
#[test]
fn observations_that_are_no_text() {
    let dir = tempdir().unwrap();
    let bytes = [HEADER.as_bytes(), ROW.as_bytes(), b"2,1,0,-60,90,0,60,0,30\xff,0.01\n"].concat();
    fs::write(dir.path().join("bytes.csv"), bytes).unwrap();
    fs::write(dir.path().join("C.csv"), "centre,x_mm,y_mm,z_mm\n1,1300,0,800\n").unwrap();
    let args = ["identify", "bytes.csv", "--robot", "kr60ha", "--centres", "C.csv", "--out", "out"];
    let output = dbbd(dir.path(), &args);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("bytes.csv:3: is not UTF-8 text"), "{}", stderr(&output));
    let absent = args.map(|arg| if arg == "bytes.csv" { "absent.csv" } else { arg });
    assert!(stderr(&dbbd(dir.path(), &absent)).contains("absent.csv: cannot be read"));
}

/// Lengths between 298 and 302 mm at poses about the ball, by the nominal robot; then the same table in other units.
#[test]
fn tables_in_other_units_and_plans() {
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/paper");
    let text = fs::read_to_string(example.join("observations.csv")).unwrap();
    let mut rows = csv::Reader::from_reader(text.as_bytes());
    let header = rows.headers().unwrap().clone();
    let records: Vec<csv::StringRecord> = rows.records().map(Result::unwrap).collect();
    let table = |factor: &dyn Fn(&str) -> f64| {
        let lines = records.iter().map(|record| {
            let cells = header.iter().zip(record).map(|(name, cell)| match factor(name) {
                1.0 => cell.to_owned(),
                factor => (cell.parse::<f64>().unwrap() * factor).to_string(),
            });
            cells.collect::<Vec<_>>().join(",") + "\n"
        });
        header.iter().collect::<Vec<_>>().join(",") + "\n" + &lines.collect::<String>()
    };
    let centres = example.join("centres.csv");
    let said = |table: &str| {
        let dir = tempdir().unwrap();
        fs::write(dir.path().join("obs.csv"), table).unwrap();
        let centres = centres.to_str().unwrap();
        let output = dbbd(
            dir.path(),
            &["identify", "obs.csv", "--robot", "kr60ha", "--centres", centres, "--out", "out"],
        );
        (output.status.code(), stderr(&output))
    };
    for (column, factor, unit) in [
        ("length_mm", 1e-3, "metres"),
        ("length_mm", 1.0 / 25.4, "inches"),
        ("_deg", 1_f64.to_radians(), "radians"),
    ] {
        let (code, said) = said(&table(&|name| if name.ends_with(column) { factor } else { 1.0 }));
        assert!(code == Some(1) && said.contains(&format!("seem to be {unit}")), "{unit}: {said}");
    }
    let plan = format!(
        "{},kind,move,dwell_s\n{}",
        header.iter().collect::<Vec<_>>().join(","),
        records
            .iter()
            .map(|record| record.iter().collect::<Vec<_>>().join(",") + ",measure,ptp,0.5\n")
            .collect::<String>()
    );
    let (code, plan_said) = said(&plan);
    assert!(code == Some(1) && plan_said.contains("is a plan"), "{plan_said}");
    // What only checks is held to the same.
    let dir = tempdir().unwrap();
    let metres = table(&|name| if name == "length_mm" { 1e-3 } else { 1.0 });
    for (name, table, words) in
        [("m.csv", &metres, "m.csv: length_mm seem to be metres"), ("p.csv", &plan, "p.csv: is a plan")]
    {
        fs::write(dir.path().join("obs.csv"), &text).unwrap();
        fs::write(dir.path().join(name), table).unwrap();
        let args = [
            "identify",
            "obs.csv",
            "--robot",
            "kr60ha",
            "--centres",
            centres.to_str().unwrap(),
            "--out",
            "out",
        ];
        let output = dbbd(dir.path(), &[&args[..], &["--validate", name]].concat());
        assert!(output.status.code() == Some(1) && stderr(&output).contains(words), "{}", stderr(&output));
    }
}

#[test]
fn observations() {
    let robot = ["--robot", "kr60ha"];
    let missing = HEADER.replace(",length_mm", "") + "1,1,0,-60,90,0,60,0,0.01\n";
    refused(&missing, &robot, &["obs.csv:1", "no column `length_mm`"]);
    refused(
        &format!("{HEADER}{ROW}2,1,0,-60,NaN,0,60,0,300,0.01\n"),
        &robot,
        &["obs.csv:3", "a3_deg", "finite"],
    );
    refused(
        &format!("{HEADER}{ROW}2,1,0,-60,inf,0,60,0,300,0.01\n"),
        &robot,
        &["obs.csv:3", "a3_deg", "finite"],
    );
    refused(
        &format!("{HEADER}1,1,0,-60,90,0,60,0,-300,0.01\n"),
        &robot,
        &["obs.csv:2", "length_mm", "positive"],
    );
    refused(&format!("{HEADER}1,1,0,-60,90,0,60,0,300,0\n"), &robot, &["obs.csv:2", "sigma_mm", "positive"]);
    refused(&format!("{HEADER}1,0,0,-60,90,0,60,0,300,0.01\n"), &robot, &["obs.csv:2", "centre"]);
    refused(&format!("{HEADER}1,2,0,-60,90,0,60,0,300,0.01\n"), &robot, &["obs.csv", "base ball 2"]);
    refused(&format!("{HEADER}1,1,0,-60,90,0,60\n"), &robot, &["obs.csv:2"]);
    refused(HEADER, &robot, &["obs.csv", "no observation"]);
    refused("", &robot, &["obs.csv", "no column `index`, `centre`, "]);
}

#[test]
fn robots_lists_and_numbers() {
    let good = format!("{HEADER}{ROW}");
    refused(&good, &["--robot", "kr60"], &["kr60", "did you mean `kr60ha`"]);
    refused(&good, &["--robot", "nowhere.toml"], &["nowhere.toml", "cannot be read"]);
    refused(&good, &[], &["--robot"]);
    refused(&good, &["--robot", "kr60ha", "--estimate", "alpha9"], &["alpha9", "is not a parameter"]);
    refused(&good, &["--robot", "kr60ha", "--estimate", "centre2_x"], &["centre2_x", "1 base ball"]);
    refused(&good, &["--robot", "kr60ha", "--prior", "nowhere.csv"], &["nowhere.csv"]);
    let dir = tempdir().unwrap();
    // Nor is one pose, twenty times: there is nothing to hold out.
    let same: String = (0..20).map(|i| ROW.replacen("1", &(i + 1).to_string(), 1)).collect();
    let (code, said) = identify(dir.path(), &format!("{HEADER}{same}"), &["--robot", "kr60ha"]);
    assert_eq!(code, Some(3), "{said}");
    // One length is no mistake in the file: the answer comes with its doubt.
    let (code, said) = identify(dir.path(), &good, &["--robot", "kr60ha", "--estimate", "geometric"]);
    assert_eq!(code, Some(3), "{said}");
    assert!(said.contains("leave nothing to check the result by"), "{said}");
    let (code, said) = identify(dir.path(), &good, &["--robot", "kr60ha", "--sigma", "-1"]);
    assert_eq!(code, Some(2), "{said}");
}

#[test]
fn robot_files() {
    let dir = tempdir().unwrap();
    let text = include_str!("../../robots/kr60ha.toml");
    let cases = [
        (text.replacen("a_mm = 350.0", "a_mn = 350.0", 1), "a_mn"),
        (text.replacen("a_mm = 350.0", "a_mm = nan", 1), "finite"),
        (text.replacen("sign = -1", "sign = 2", 1), "sign"),
        (text.replacen("[-135.0, 35.0]", "[35.0, -135.0]", 1), "limits_deg"),
        (text.replacen("modified-dh", "standard-dh", 1), "convention"),
        (text.replacen("[[joint]]", "[[joints]]", 1), "joints"),
        (text[..text.len() / 2].to_owned(), "bad.toml"),
    ];
    for (text, word) in cases {
        fs::write(dir.path().join("bad.toml"), text).unwrap();
        let (code, said) = identify(dir.path(), &format!("{HEADER}{ROW}"), &["--robot", "bad.toml"]);
        assert_eq!(code, Some(1), "{said}");
        assert!(said.contains("bad.toml") && said.contains(word), "`{word}` is not in: {said}");
    }
}

#[test]
fn captures_ports_and_programs() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("torn.dbbd"), b"this is no capture").unwrap();
    fs::write(
        at.join("P.src"),
        "DEF P ( )\r\nPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\r\nFROBNICATE 3\r\nEND\r\n",
    )
    .unwrap();
    let job = include_str!("../../examples/demo.toml").replace("\"dbb-cobs-1\"", "\"dbb-cops-1\"");
    fs::write(at.join("job.toml"), job).unwrap();
    let cases: &[(&[&str], &[&str])] = &[
        (
            &["plan", "job.toml", "--out", "p"],
            &["job.toml: no protocol `dbb-cops-1`", "did you mean `dbb-cobs-1`"],
        ),
        (&["sync", "torn.dbbd", "--out", "o.csv"], &["torn.dbbd"]),
        (&["info", "nowhere.dbbd"], &["nowhere.dbbd", "cannot be read"]),
        (&["acquire", "--port", "/dev/nowhere0", "--out", "r.dbbd"], &["/dev/nowhere0", "dbbd ports"]),
        (&["simulate", "--program", "P.src"], &["P.src:3", "FROBNICATE"]),
        (&["plan", "nowhere.toml", "--out", "p"], &["nowhere.toml"]),
        (&["robots", "show", "kr61ha"], &["kr61ha"]),
        (&["protocols", "show", "dbb-cobs-9"], &["dbb-cobs-9"]),
    ];
    for (args, words) in cases {
        let output = dbbd(at, args);
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "dbbd {}: {said}", args.join(" "));
        for word in *words {
            assert!(said.contains(word), "dbbd {}: `{word}` is not in: {said}", args.join(" "));
        }
    }
    assert!(!at.join("r.dbbd").exists(), "nothing was measured, so there is no capture");
}

/// Nothing of the robot is asked for: no index, no correlation, and no panic.
#[test]
fn the_bar_alone() {
    let dir = tempdir().unwrap();
    let truth = with_errors(DESIGNED);
    let text = measure(&truth, &[horizontal(1, CENTRE)], 40, 25.0).to_csv();
    for list in ["bar", "tool", "centres", "gear"] {
        let more = ["--robot", "kr60ha", "--prior", "datasheet", "--estimate", list];
        let (code, said) = identify(dir.path(), &text, &more);
        assert!(matches!(code, Some(0 | 3)) && !said.contains("panicked"), "{list}: {code:?} {said}");
    }
}

/// Another robot than the one that was measured fits as well, with links that no robot of its kind has.
#[test]
fn another_robot_is_doubted() {
    let dir = tempdir().unwrap();
    let text = measure(&with_errors(DESIGNED), &three_planes(1, CENTRE), 27, 25.0).to_csv();
    let (code, said) = identify(dir.path(), &text, &["--robot", "kr16-2"]);
    assert!(code == Some(3) && said.contains("or it is another robot (--robot)"), "{said}");
}
