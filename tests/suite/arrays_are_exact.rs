//! A fixed-length array of a TOML file has as many values as it needs, and a decimal comma is suspected where it has more.

use std::fs;

use tempfile::tempdir;

use crate::cell::{codes, dbbd, stderr};

const ROBOT: &str = crate::cell::KR60HA;
const STAGES: &str = include_str!("../../examples/stages.toml");
const BAR: &str = include_str!("../../protocols/microepsilon-ild1420.toml");
const SERVICE: &str = "[alarm]\nstroke_mm = [-1.0, 1.0]\n";
const WORLD: &str = "backlash_deg = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-1.0, 1.0]\n\
                     [[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n";

/// The tables of a job that the example leaves out.
fn job() -> String {
    let more = "\n[[circle]]\nnormal = [0.0, 0.0, 1.0]\npoints = 12\nturns_deg = [[0.0, 0.0, 0.0]]\n\
                [[obstacle]]\nshape = \"box\"\nlow_mm = [9000.0, 9000.0, 0.0]\nhigh_mm = [9100.0, 9100.0, 100.0]\n\
                [[obstacle]]\nshape = \"cylinder\"\nfrom_mm = [9000.0, 9000.0, 0.0]\nto_mm = [9100.0, 9100.0, 100.0]\n\
                radius_mm = 1.0\n[motion.outputs]\nindex = [9, 16]\n";
    format!("{STAGES}{more}")
}

/// The values of the innermost first array in a line, with its range; none if it is a list of words or a comment.
fn array(line: &str) -> Option<(std::ops::Range<usize>, Vec<&str>)> {
    let line = line.split('#').next()?;
    let end = line.find(']')?;
    let start = line[..end].rfind('[')?;
    let values: Vec<&str> = line.get(start + 1..end)?.split(',').map(str::trim).collect();
    let numbers = line.contains('=') && values.iter().all(|value| value.parse::<f64>().is_ok());
    numbers.then_some((start..end + 1, values))
}

/// The array with a value too many, a value too few, and with decimal commas.
fn wrong(values: &[&str]) -> [(Vec<String>, bool); 3] {
    let owned: Vec<String> = values.iter().map(|&value| value.to_owned()).collect();
    let comma = |value: &String| value.parse::<f64>().unwrap().trunc().to_string() + ",5";
    let commas = owned.iter().map(comma).collect();
    [
        ([owned.clone(), vec!["0.5".into()]].concat(), false),
        (owned[..owned.len() - 1].to_vec(), false),
        (commas, true),
    ]
}

#[test]
fn every_array_of_every_file() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("P.src"), "DEF P ( )\r\nPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\r\nEND\r\n").unwrap();
    let job = job();
    let files: [(&str, &str, &[&str]); 5] = [
        ("bad.toml", ROBOT, &["robots", "check", "bad.toml"]),
        ("bad.toml", &job, &["plan", "bad.toml", "--out", "plan"]),
        (
            "bad.toml",
            WORLD,
            &[
                "simulate",
                "--program",
                "P.src",
                "--robot",
                "kr60ha",
                "--tool",
                "30,20,10",
                "--world",
                "bad.toml",
            ],
        ),
        ("bad.toml", SERVICE, &["serve", "--check", "--config", "bad.toml"]),
        ("bad.toml", BAR, &["protocols", "check", "bad.toml"]),
    ];
    let mut tried = 0;
    for (name, text, args) in files {
        for (number, line) in text.lines().enumerate() {
            let Some((range, values)) = array(line) else { continue };
            // Of the lists in a definition only this one has a fixed length.
            let in_definition = text == BAR;
            if in_definition && !line.contains("valid = ") {
                continue;
            }
            for (values, by_comma) in wrong(&values) {
                let mut line = line.to_owned();
                line.replace_range(range.clone(), &format!("[{}]", values.join(", ")));
                let changed: Vec<&str> = text
                    .lines()
                    .enumerate()
                    .map(|(at, was)| if at == number { &line } else { was })
                    .collect();
                fs::write(at.join(name), changed.join("\n")).unwrap();
                let output = dbbd(at, args);
                let said = stderr(&output);
                let code = if in_definition { "E0307" } else { "E0121" };
                assert_eq!(
                    (output.status.code(), codes(&output)),
                    (Some(1), vec![code.into()]),
                    "{line}: {said}"
                );
                assert!(said.contains(&format!("{name}:{}:", number + 1)), "{line}: {said}");
                // Two whole numbers and a third might be two with a comma.
                if !in_definition && !line.starts_with("index") {
                    assert_eq!(said.contains("decimal"), by_comma, "{line}: {said}");
                }
                tried += 1;
            }
        }
    }
    assert!(tried > 50, "{tried} tried");
}

/// One number is no array: TOML itself refuses its comma, and the message suspects it.
#[test]
fn a_single_decimal_comma() {
    let dir = tempdir().unwrap();
    let text = ROBOT.replacen("a_mm = 350.0", "a_mm = 350,5", 1);
    fs::write(dir.path().join("bad.toml"), text).unwrap();
    let output = dbbd(dir.path(), &["robots", "check", "bad.toml"]);
    assert_eq!((output.status.code(), codes(&output)), (Some(1), vec!["E0120".into()]));
    assert!(stderr(&output).contains("decimal"), "{}", stderr(&output));
}
