//! `dbbd circle` writes the quantities, a page and a plot; the same input gives the same bytes.

use std::f64::consts::TAU;

use crate::cell::codes;
use crate::process::run;
use crate::support::circular_cases::{CASES, Case, GOLDEN};
use crate::support::spoken::assert_spoken;

fn csv(case: &Case, noise_mm: f64) -> String {
    let mut text = String::from("run,direction,angle_deg,length_mm,temp_c\n");
    for (at, trace) in case.traces().iter().enumerate() {
        for (k, point) in trace.points.iter().enumerate() {
            let noise = noise_mm * (TAU * 0.37 * (k * k) as f64 + at as f64).sin();
            text +=
                &format!("{at},{},{},{},20\n", trace.sense.word(), point.angle_deg, point.length_mm + noise);
        }
    }
    text
}

#[test]
fn command_writes_json_html_and_svg() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(path("a.csv"), csv(&CASES[0], 0.0003)).unwrap();
    std::fs::write(path("b.csv"), csv(&Case { phi: 90e-6, ..CASES[0] }, 0.0003)).unwrap();
    let output = run(&[
        "circle",
        &path("a.csv"),
        &path("b.csv"),
        "--out",
        &path("out"),
        "--radius",
        "150",
        "--sigma",
        "0.0003",
        "--json",
    ]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let file = std::fs::read_to_string(path("out/circle.json")).unwrap();
    let mut json: serde_json::Value = serde_json::from_str(&file).unwrap();
    // The file has its hash; the document on stdout has the findings besides.
    let mut document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    document.as_object_mut().unwrap().remove("findings");
    assert!(json.as_object_mut().unwrap().remove("sha256").is_some());
    assert_eq!(json, document);
    for key in ["G_lsc", "G_mzc", "Gb", "D", "F_max", "F_min", "H", "x", "y"] {
        let value = json[key].as_f64().unwrap();
        let golden = GOLDEN.iter().find(|(case, name, _)| *case == "full" && *name == key).unwrap().2;
        assert!((value - golden).abs() < 0.001, "{key}: {value}");
        assert!((0.0..0.003).contains(&json[format!("{key}_u95")].as_f64().unwrap()), "{key}");
    }
    assert_eq!(json["tests"].as_array().unwrap().len(), 2);
    let page = std::fs::read_to_string(path("out/circle.html")).unwrap();
    for foreign in ["<script src", "http://", "https://", "src=", "url(", "@import", "<link"] {
        assert!(!page.contains(foreign), "the page holds {foreign}");
    }
    assert!(
        page.contains("Trend") && page.contains("id=\"standard-not-read\""),
        "the page says what it rests on"
    );
    assert_spoken(&page);
    let svg = std::fs::read_to_string(path("out/circle.svg")).unwrap();
    assert!(svg.starts_with("<svg xmlns=") && svg.ends_with("</svg>") && !svg.contains("NaN"));
    let again = run(&[
        "circle",
        &path("a.csv"),
        &path("b.csv"),
        "--out",
        &path("2"),
        "--radius",
        "150",
        "--sigma",
        "0.0003",
    ]);
    assert!(again.status.success());
    let assumed = run(&["circle", &path("a.csv"), "--out", &path("3"), "--monte-carlo", "0"]);
    assert_eq!(codes(&assumed), ["I1413", "I1412"]);
    assert_eq!(file, std::fs::read_to_string(path("2/circle.json")).unwrap(), "the same bytes again");
}
