//! `dbbd compare`: changes are found without false alarms, and inputs that are not comparable are refused.

use std::fs;
use std::path::Path;

use dbbd_model::measurement::Measurements;
use dbbd_model::robot::Robot;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use serde_json::Value;
use tempfile::{TempDir, tempdir};

use crate::cell::{
    CENTRE, Circle, DESIGNED, centres_csv, codes, dbbd, measure, stderr, three_planes, with_errors,
};
use crate::support::drawn_robots::{BALLS, drawn, lengths};
use crate::support::spoken::assert_spoken;

/// Calibrations of one robot from lengths of 2 um noise; `theta3` moves by `step` rad from one to the next.
fn calibrations(count: u32, step: f64) -> TempDir {
    let dir = tempdir().unwrap();
    let circles: Vec<Circle> = [three_planes(1, CENTRE), three_planes(2, [1100.0, 500.0, 500.0])].concat();
    fs::write(dir.path().join("C.csv"), centres_csv(&circles)).unwrap();
    for number in 0..count {
        let drift = ("theta3", step * f64::from(number));
        let mut data = measure(&with_errors(DESIGNED.into_iter().chain([drift])), &circles, 12, 40.0);
        let mut random = Pcg64::seed_from_u64(u64::from(number) + 7);
        for row in &mut data.rows {
            let z: f64 = StandardNormal.sample(&mut random);
            row.length_mm += 0.002 * z;
        }
        fs::write(dir.path().join("obs.csv"), data.to_csv()).unwrap();
        let name = format!("r{number}");
        let args = [
            "identify",
            "obs.csv",
            "--robot",
            "kr60ha",
            "--tool",
            "30,20,10",
            "--centres",
            "C.csv",
            "--out",
            &name,
        ];
        let output = dbbd(dir.path(), &[&args[..], &["--sigma", "0.002", "--folds", "0"]].concat());
        assert!(output.status.success(), "{}", stderr(&output));
    }
    dir
}

fn compared(dir: &Path, args: &[&str]) -> Value {
    let output = dbbd(dir, &[&["compare"], args, &["--out", "out", "--json"]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let file: Value =
        serde_json::from_str(&fs::read_to_string(dir.join("out/compare.json")).unwrap()).unwrap();
    assert_eq!(json["inputs"], file["inputs"]);
    json
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn a_drift_is_found_and_forecast() {
    let step = 0.02f64.to_radians();
    let dir = calibrations(3, step);
    let dates = "2025-01-01,2025-01-31,2025-03-02";
    let found = compared(dir.path(), &["r0", "r1", "r2/result.json", "--dates", dates, "--tolerance", "2"]);
    let changed: Vec<&Value> = found["parameters"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|parameter| parameter["change"]["significant"] == true)
        .collect();
    assert_eq!(changed.iter().map(|p| p["name"].as_str().unwrap()).collect::<Vec<_>>(), ["theta3"]);
    let change = &changed[0]["change"];
    let off = number(&change["change"]) - 2.0 * step;
    assert!(off.abs() < 4.0 * number(&change["sd"]), "{off} rad");
    assert!((number(&changed[0]["trend"]["slope"]) / (step / 30.0) - 1.0).abs() < 0.2);
    // The drift leads to the tolerance in proportion to what it has done in 60 days.
    let position = &found["position_change_mm"];
    let expected = 60.0 * 2.0 / number(&position["significant"]["p95"]);
    assert!((number(&position["reaches_tolerance"]["at"]) / expected - 1.0).abs() < 0.05);
    let table = fs::read_to_string(dir.path().join("out/compare.csv")).unwrap();
    assert!(table.lines().next().unwrap().starts_with("family,name,unit,value_1,sd_1,value_2"));
    let page = fs::read_to_string(dir.path().join("out/compare.html")).unwrap();
    assert!(page.matches("<svg").count() >= 5 && !page.contains("NaN"));
    assert_spoken(&page);
    if let Some(folder) = std::env::var_os("DBBD_PAGES") {
        fs::write(Path::new(&folder).join("compare.html"), page).unwrap();
    }
}

#[test]
fn no_change_is_found_without_one_and_inputs_are_checked() {
    let dir = calibrations(2, 0.0);
    let at = dir.path();
    let found = compared(at, &["r0", "r1"]);
    let none =
        |family: &Value| family.as_array().unwrap().iter().all(|p| p["change"]["significant"] == false);
    assert!(none(&found["parameters"]) && none(&found["set_up"]));
    // Two values are a difference, not a trend.
    assert!(found["parameters"].as_array().unwrap().iter().all(|p| p["trend"].is_null()));
    assert_eq!(found["provenance"]["from"].as_array().unwrap().last().unwrap()["name"], "result.json");
    let change = &found["position_change_mm"];
    assert!(number(&change["whole"]["mean"]) < 0.1 && change["is_significant"] == false, "{change}");
    let text = fs::read_to_string(at.join("r1/result.json")).unwrap();
    let edited = |name: &str, edit: &dyn Fn(&mut Value)| {
        let mut json: Value = serde_json::from_str(&text).unwrap();
        edit(&mut json);
        fs::write(at.join(name), json.to_string()).unwrap();
    };
    edited("schema.json", &|json| json["schema"] = 7.into());
    edited("robot.json", &|json| json["robot"] = "another".into());
    edited("unit.json", &|json| json["parameters"][1]["unit"] = "rad/Nm".into());
    edited("name.json", &|json| json["parameters"][1]["name"] = "elbow".into());
    edited("nominal.json", &|json| json["parameters"][7]["nominal"] = 17.into());
    edited("part.json", &|json| json["measurements"] = Value::Null);
    fs::write(at.join("no.json"), "{\"schema\":").unwrap();
    fs::write(at.join("other.json"), "{\"schema\":1}").unwrap();
    fs::create_dir(at.join("empty")).unwrap();
    fs::create_dir(at.join("alone")).unwrap();
    fs::copy(at.join("r0/result.json"), at.join("alone/result.json")).unwrap();
    let circle = r#"{"schema":1,"circle":1,"radius_mm":300.0,"Gb":0.1,"Gb_u95":0.01,"traces":[]}"#;
    fs::write(at.join("circle.json"), circle).unwrap();
    let dates = |given: &'static str| vec!["r0", "r1", "--dates", given];
    for (args, code) in [
        (vec!["r0", "no.json"], "E1901"),
        (vec!["r0", "other.json"], "E1901"),
        (vec!["r0", "empty"], "E1901"),
        (vec!["r0", "schema.json"], "E1901"),
        (vec!["r0", "part.json"], "E1901"),
        (vec!["r0", "robot.json"], "E1902"),
        (vec!["r0", "unit.json"], "E1902"),
        (vec!["r0", "name.json"], "E1901"),
        (vec!["r0", "nominal.json"], "E1902"),
        (vec!["r0", "circle.json"], "E1902"),
        (vec!["r0", "r1", "r0/result.json"], "E1903"),
        (dates("2025-01-01"), "E1904"),
        (dates("2025-01-01,2024-01-01"), "E1904"),
        (dates("2025-01-01,soon"), "E1904"),
        (vec!["alone", "r1"], "E1905"),
    ] {
        let output = dbbd(at, &[&["compare"], &args[..], &["--out", "out"]].concat());
        assert_eq!((output.status.code(), codes(&output)), (Some(1), vec![code.to_owned()]), "{args:?}");
    }
    let one = dbbd(at, &["compare", "r0", "--out", "out"]);
    assert_eq!(one.status.code(), Some(2));
    edited("few.json", &|json| json["parameters"][8]["sd"] = Value::Null);
    let few = dbbd(at, &["compare", "r0", "few.json", "--out", "out"]);
    // One parameter is not compared, and a result has no robot file beside it.
    assert_eq!((few.status.code(), codes(&few)), (Some(0), vec!["I1927".to_owned(), "I1906".to_owned()]));
    let by_parameters: Value =
        serde_json::from_str(&fs::read_to_string(at.join("out/compare.json")).unwrap()).unwrap();
    assert!(by_parameters["position_change_mm"]["expected"].is_null());
}

fn result(dir: &Path, name: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(dir.join(name).join("result.json")).unwrap()).unwrap()
}

fn write_balls(at: &Path) {
    let balls = (1..).zip(BALLS).map(|(ball, [x, y, z])| format!("{ball},{x},{y},{z}\n"));
    fs::write(at.join("C.csv"), format!("centre,x_mm,y_mm,z_mm\n{}", balls.collect::<String>())).unwrap();
}

/// Identifies lengths of a drawn robot, which have no day, so that nothing fades.
fn identify_drawn(at: &Path, truth: &Robot, seed: u64, robot: &str, out: &str) {
    identify_lengths(at, truth, &lengths(truth, 70, 3, seed), robot, out);
}

fn identify_lengths(at: &Path, truth: &Robot, lengths: &Measurements, robot: &str, out: &str) {
    fs::write(at.join(format!("{out}.csv")), lengths.to_csv()).unwrap();
    let tool = truth.geometry.tool.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
    let input = format!("{out}.csv");
    let args =
        ["identify", &input, "--robot", robot, "--centres", "C.csv", "--bar-u", "0.002", "--folds", "0"];
    let tool = if robot == "kr60ha" { vec!["--tool", &tool] } else { vec![] };
    let done = dbbd(at, &[&args[..], &tool, &["--out", out]].concat());
    assert!(matches!(done.status.code(), Some(0 | 3)), "{}", stderr(&done));
}

/// Identified robots of one drawn robot: twice, with its tool ball mounted elsewhere, and with the first as the prior.
fn of_a_drawn_robot() -> TempDir {
    let dir = tempdir().unwrap();
    let at = dir.path();
    write_balls(at);
    let truth = drawn(4);
    identify_drawn(at, &truth, 1, "kr60ha", "first");
    identify_drawn(at, &truth, 2, "kr60ha", "again");
    identify_drawn(at, &truth.clone().with_tool([60.0, -5.0, 45.0]), 3, "kr60ha", "elsewhere");
    identify_drawn(at, &truth, 4, "first/robot-identified.toml", "further");
    dir
}

/// The predictions of calibrations of one robot differ by what their uncertainties let expect, wherever its tool ball is mounted, and
/// less if one goes on from the other. A zero that moved is a change.
#[test]
fn a_difference_that_the_uncertainties_explain_is_no_change() {
    let dir = of_a_drawn_robot();
    let at = dir.path();
    let change = |last: &str| compared(at, &["first", last])["position_change_mm"].clone();
    for (last, tool) in
        [("again", [30.0, 20.0, 10.0]), ("elsewhere", [60.0, -5.0, 45.0]), ("further", [30.0, 20.0, 10.0])]
    {
        let found = change(last);
        let [mean, expected] = [&found["whole"]["mean"], &found["expected"]["mean"]].map(number);
        assert!(mean < 2.5 * expected && expected > 0.02, "{last} {found}");
        assert_eq!(found["is_significant"], false, "{last} {found}");
        let off = found["tool"]["at_mm"].as_array().unwrap().iter().zip(tool).map(|(mm, at)| number(mm) - at);
        assert!(off.into_iter().all(|off| off.abs() < 0.3), "{last} {found}");
        assert!(found["tool"]["of"].as_str().unwrap().starts_with(last), "{found}");
    }
    let [independent, updated] = ["again", "further"].map(|last| number(&change(last)["expected"]["sd"]));
    assert!(updated < 0.95 * independent, "{updated} {independent}");
    let mut moved = drawn(4);
    *moved.geometry.value_mut("theta3".parse().unwrap()).unwrap() += 1e-3;
    identify_drawn(at, &moved, 5, "kr60ha", "moved");
    let found = change("moved");
    // A milliradian about joint 3 moves the ball by a millimetre.
    assert_eq!(found["is_significant"], true, "{found}");
    assert!((0.3..1.2).contains(&number(&found["whole"]["mean"])), "{found}");
}

/// A check on the day of the calibration and a comparison state the uncertainty of the result.
#[test]
fn one_uncertainty_is_stated_by_result_check_and_comparison() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    write_balls(at);
    let (truth, mut random) = (drawn(4), Pcg64::seed_from_u64(9));
    for (seed, out) in [(1, "first"), (2, "again")] {
        let mut lengths = lengths(&truth, 70, 3, seed);
        // Scatter of the visits that neither the bar nor the repeatability explains.
        for visit in lengths.rows.chunks_mut(3) {
            let off: f64 = StandardNormal.sample(&mut random);
            visit.iter_mut().for_each(|row| row.length_mm += 0.1 * off);
        }
        identify_lengths(at, &truth, &lengths, "kr60ha", out);
    }
    let stated = |name: &str| result(at, name)["predicted_position_uncertainty_mm"]["identified"].clone();
    let uncertainty = fs::read_to_string(at.join("first/robot-identified.toml")).unwrap();
    assert!(uncertainty.contains("unexplained_mm") && !uncertainty.contains("unexplained_mm = 0.0\n"));
    let args = ["check", "again.csv", "--robot", "first", "--centres", "C.csv", "--bar-u", "0.002"];
    let checked = dbbd(at, &[&args[..], &["--out", "check", "--json"]].concat());
    let checked: Value = serde_json::from_slice(&checked.stdout).unwrap();
    let calibrated = &checked["predicted_position_uncertainty_mm"]["calibrated"];
    let compared = dbbd(at, &["compare", "first", "again", "--out", "out", "--json"]);
    let compared: Value = serde_json::from_slice(&compared.stdout).unwrap();
    let both = &compared["predicted_position_uncertainty_mm"];
    for (found, expected) in [(calibrated, "first"), (&both[0], "first"), (&both[1], "again")] {
        for key in ["mean", "p95", "max"] {
            let [found, expected] = [&found[key], &stated(expected)[key]].map(number);
            assert!((found / expected - 1.0).abs() < 1e-9, "{key}: {found} {expected}");
        }
    }
}

/// The table of a prediction has the covariance of each position, which belongs to its standard deviation, and degrees of freedom
/// below those of the result.
#[test]
fn predictions_have_covariances() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    write_balls(at);
    identify_drawn(at, &drawn(4), 1, "kr60ha", "first");
    let poses: String = (0..12).map(|at| format!("{},-60,90,{},40,0\n", 5 * at, 7 * at)).collect();
    fs::write(at.join("axes.csv"), format!("a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg\n{poses}")).unwrap();
    let freedom = number(&result(at, "first")["noise_mm"]["degrees_of_freedom"]);
    for more in [&[][..], &["--tool", "0,0,100"], &["--model", "geometric"]] {
        let args = ["predict", "axes.csv", "--robot", "first", "--out", "p.csv"];
        let done = dbbd(at, &[&args[..], more].concat());
        assert!(matches!(done.status.code(), Some(0 | 3)), "{}", stderr(&done));
        let text = fs::read_to_string(at.join("p.csv")).unwrap();
        let names: Vec<&str> = text.lines().next().unwrap().split(',').collect();
        assert_eq!(names[17..], ["cxx", "cxy", "cxz", "cyy", "cyz", "czz", "nu"]);
        for row in text.lines().skip(1) {
            let values: Vec<f64> = row.split(',').map(|value| value.parse().unwrap()).collect();
            let [xx, xy, xz, yy, yz, zz] = [17, 18, 19, 20, 21, 22].map(|column| values[column]);
            assert!(((xx + yy + zz) / values[15].powi(2) - 1.0).abs() < 1e-12, "{row}");
            // Positive semidefinite: no principal minor is negative.
            let whole = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
            assert!(xx > 0.0 && xx * yy >= xy * xy && whole >= 0.0, "{row}");
            // Tails of visits make a 95 % region larger than the noise of a length alone.
            assert!(values[23] > 4.0 && values[23] < freedom, "{row}");
        }
    }
}

/// Radius 150 mm in both senses; an ellipse that grows.
fn circle_csv(ellipse_mm: f64, seed: u64) -> String {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut text = String::from("run,direction,angle_deg,length_mm\n");
    for direction in ["ccw", "cw"] {
        for step in 0..120 {
            let angle =
                if direction == "ccw" { f64::from(step) * 3.0 } else { 360.0 - f64::from(step) * 3.0 };
            let z: f64 = StandardNormal.sample(&mut random);
            let length = 150.0 + ellipse_mm * (2.0 * angle.to_radians()).cos() + 0.0005 * z;
            text.push_str(&format!("1,{direction},{angle},{length}\n"));
        }
    }
    text
}

#[test]
fn circular_tests_are_compared_and_forecast() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    for number in 0..4 {
        let name = format!("c{number}");
        let csv = format!("{name}.csv");
        fs::write(at.join(&csv), circle_csv(0.01 + 0.005 * number as f64, number + 1)).unwrap();
        let output = dbbd(at, &["circle", &csv, "--radius", "150", "--out", &name]);
        assert!(output.status.success(), "{}", stderr(&output));
    }
    let found = compared(at, &["c0", "c1", "c2", "c3", "--tolerance", "0.1"]);
    assert_eq!(found["kind"], "circles");
    let circle = &found["circles"][0];
    let deviation = circle["quantities"].as_array().unwrap().iter().find(|q| q["name"] == "Gb").unwrap();
    assert_eq!(deviation["change"]["significant"], true);
    // Gb is twice the ellipse: 0.02 mm and 0.01 mm a test, 0.1 mm at number 8 (0.003 mm of it noise).
    assert!(
        (number(&circle["reaches_tolerance"]["at"]) - 8.0).abs() < 0.8,
        "{}",
        circle["reaches_tolerance"]
    );
    let page = fs::read_to_string(at.join("out/compare.html")).unwrap();
    assert!(page.contains("Circles overlaid") && page.contains("number 2") && !page.contains("NaN"));
    assert_spoken(&page);
    if let Some(folder) = std::env::var_os("DBBD_PAGES") {
        fs::write(Path::new(&folder).join("compare-circles.html"), page).unwrap();
    }
    // As the same machine would repeat to a tenth of a millimetre, nothing changed.
    let repeated = compared(at, &["c0", "c3", "--repeat-u", "0.1"]);
    let quantities = repeated["circles"][0]["quantities"].as_array().unwrap();
    assert!(quantities.iter().all(|quantity| quantity["change"]["significant"] == false));
    let text = fs::read_to_string(at.join("c1/circle.json")).unwrap();
    let (unsealed, _) = text.rsplit_once(",\n  \"sha256\"").unwrap();
    let other = unsealed.replace("\"radius_mm\": 150.0", "\"radius_mm\": 151.0") + "\n}\n";
    fs::write(at.join("other.json"), other).unwrap();
    let refused = dbbd(at, &["compare", "c0", "other.json", "--out", "out"]);
    assert_eq!((refused.status.code(), codes(&refused)), (Some(1), vec!["E1902".to_owned()]));
}
