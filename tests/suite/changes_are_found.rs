//! `dbbd check`: a changed robot is found and the change identified; an unchanged one passes at the stated rate.

use std::fs;
use std::path::Path;

use dbbd_model::robot::Robot;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use serde_json::{Value, json};
use tempfile::{TempDir, tempdir};

use crate::cell::{
    CENTRE, Circle, DESIGNED, centres_csv, codes, dbbd, measure, stderr, three_planes, with_errors,
};
use crate::support::checked_robot::{SIGMA, calibration, normal};
use crate::support::spoken::assert_spoken;

/// The lengths of a check as their file; the robot's true errors are those that it was calibrated with.
fn lengths(truth: &Robot, circles: &[Circle], points: usize, seed: u64) -> String {
    let mut data = measure(truth, circles, points, 40.0);
    let mut random = Pcg64::seed_from_u64(seed);
    for row in &mut data.rows {
        row.length_mm += SIGMA * normal(&mut random);
        row.sigma_mm = Some(SIGMA);
    }
    data.to_csv()
}

#[test]
fn the_command_decides_and_refuses() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let write = |name: &str, text: &str| fs::write(at.join(name), text).unwrap();
    let robot = Robot { repeatability_mm: None, ..calibration() };
    write("robot.toml", &robot.to_toml().unwrap());
    write("bare.toml", &Robot { posterior: None, ..robot.clone() }.to_toml().unwrap());
    let mut other = robot.clone();
    other.geometry.rows[2].a += 0.5;
    write("other.toml", &other.to_toml().unwrap());
    let circles = three_planes(1, CENTRE);
    write("C.csv", &centres_csv(&circles));
    write("same.csv", &lengths(&with_errors(DESIGNED), &circles, 8, 1));
    let moved = with_errors(DESIGNED.into_iter().chain([("theta3", 0.06f64.to_radians())]));
    write("moved.csv", &lengths(&moved, &circles, 8, 2));
    write("again.csv", &lengths(&moved, &circles, 8, 4));
    let many = [
        ("theta3", 0.003),
        ("alpha3", -0.004),
        ("a2", 3.0),
        ("theta5", 0.006),
        ("alpha5", 0.005),
        ("d4", -2.0),
    ];
    write("many.csv", &lengths(&with_errors(DESIGNED.into_iter().chain(many)), &circles, 8, 3));
    write("few.csv", &lengths(&moved, &circles, 2, 2));
    let bare = lengths(&moved, &circles, 8, 2);
    let without: Vec<String> = bare.lines().map(|line| line.rsplit_once(',').unwrap().0.to_owned()).collect();
    write("bare.csv", &(without.join("\n") + "\n"));
    let check = |lengths: &str, robot: &str, more: &[&str]| {
        let mut args = vec!["check", lengths, "--robot", robot, "--out", "out", "--bar-u", "0.005"];
        if !more.contains(&"--centres") {
            args.extend(["--centres", "C.csv"]);
        }
        dbbd(at, &[&args[..], more].concat())
    };
    let json = || -> Value {
        serde_json::from_str(&fs::read_to_string(at.join("out/check.json")).unwrap()).unwrap()
    };
    // Unchanged: passes, without and with a tolerance.
    let same = check("same.csv", "robot.toml", &["--tolerance", "2", "--update"]);
    assert_eq!(same.status.code(), Some(0), "{}", stderr(&same));
    assert!(codes(&same).contains(&"I1917".to_owned()) && !at.join("out/robot-identified.toml").exists());
    let found = json();
    assert_eq!((&found["decision"], &found["rule"]), (&"pass".into(), &"guard_band".into()));
    assert!(
        found["changes"].as_array().unwrap().is_empty() && found["specific_risk"].as_f64().unwrap() <= 0.05
    );
    // Changed: named, fails, is repaired, and the repaired robot passes.
    let changed = check("moved.csv", "robot.toml", &["--update"]);
    assert_eq!(changed.status.code(), Some(4), "{}", stderr(&changed));
    let found = json();
    let likeliest = &found["changes"][0];
    assert_eq!(likeliest["parameters"], serde_json::json!(["theta3"]));
    assert!(likeliest["probability"].as_f64().unwrap() > 0.8, "{likeliest}");
    let page = fs::read_to_string(at.join("out/check.html")).unwrap();
    assert!(page.contains("theta3") && page.contains("<svg") && !page.contains("NaN"));
    assert_spoken(&page);
    if let Some(folder) = std::env::var_os("DBBD_PAGES") {
        fs::write(Path::new(&folder).join("check.html"), page).unwrap();
    }
    // The lengths of the update are no check of it.
    let known = check("moved.csv", "out/robot-identified.toml", &[]);
    let says = |code: &str| codes(&known).contains(&code.to_owned());
    assert!(known.status.code() == Some(3) && says("W1918") && !says("W1915"), "{}", stderr(&known));
    let no_check = json();
    let is_kept = no_check["findings"].as_array().unwrap().iter().any(|finding| finding["code"] == "W1918");
    assert!(no_check["decision"] == "undecided" && no_check["validity"].is_null() && is_kept, "{no_check}");
    fs::rename(at.join("out/robot-identified.toml"), at.join("updated.toml")).unwrap();
    let again = check("again.csv", "updated.toml", &[]);
    assert_eq!(again.status.code(), Some(0), "{}", stderr(&again));
    // A damaged result beside the robot is not passed over.
    fs::write(at.join("result.json"), "{").unwrap();
    let damaged = check("again.csv", "updated.toml", &[]);
    assert_eq!((damaged.status.code(), codes(&damaged)), (Some(1), vec!["E1901".to_owned()]));
    fs::remove_file(at.join("result.json")).unwrap();
    // A base ball that moved is a change only where it should have stayed.
    let [x, y, z] = CENTRE;
    let away = three_planes(1, [x + 0.3, y - 0.2, z + 0.25]);
    write("ball.csv", &lengths(&with_errors(DESIGNED), &away, 8, 6));
    let again = check("ball.csv", "robot.toml", &[]);
    assert_eq!((again.status.code(), codes(&again).contains(&"I1924".to_owned())), (Some(0), true));
    let kept = check("ball.csv", "robot.toml", &["--balls-kept"]);
    assert_eq!((kept.status.code(), codes(&kept).contains(&"I1924".to_owned())), (Some(4), false));
    assert_eq!(json()["changes"][0]["parameters"], json!(["centre1_x", "centre1_y", "centre1_z"]));
    assert_eq!(check("same.csv", "robot.toml", &["--balls-kept"]).status.code(), Some(0));
    // By the position error: far beyond, near, and below what can be decided.
    let error = found["position_error_mm"].as_f64().unwrap();
    assert_eq!(check("moved.csv", "robot.toml", &["--tolerance", "0.05"]).status.code(), Some(4));
    let near = check("moved.csv", "robot.toml", &["--tolerance", &format!("{error:.4}")]);
    assert_eq!((near.status.code(), codes(&near).contains(&"W1915".to_owned())), (Some(3), true));
    let simple = check(
        "moved.csv",
        "robot.toml",
        &["--tolerance", &format!("{}", 1.01 * error), "--simple-acceptance"],
    );
    assert_eq!(
        (json()["rule"].clone(), json()["decision"].clone()),
        ("simple_acceptance".into(), "pass".into())
    );
    assert!(simple.status.code() == Some(0) || codes(&simple).contains(&"W1914".to_owned()));
    let undecidable = check("same.csv", "robot.toml", &["--tolerance", "0.0001"]);
    assert_eq!(
        (undecidable.status.code(), codes(&undecidable).contains(&"W1914".to_owned())),
        (Some(3), true)
    );
    let unexplained = check("many.csv", "robot.toml", &[]);
    assert_eq!(
        (unexplained.status.code(), codes(&unexplained).contains(&"W1916".to_owned())),
        (Some(4), true)
    );
    let known = robot.posterior.as_ref().unwrap();
    let no_balls = known.keeping(|id| known.ids().contains(&id));
    write("no-balls.toml", &Robot { posterior: no_balls, ..robot.clone() }.to_toml().unwrap());
    let far = three_planes(1, [x + 60.0, y, z]);
    write("far.csv", &centres_csv(&far));
    for (lengths, robot, more, code) in [
        ("same.csv", "bare.toml", &[][..], "E1910"),
        ("same.csv", "other.toml", &[], "E1910"),
        ("few.csv", "robot.toml", &[], "E1911"),
        ("bare.csv", "robot.toml", &[], "E1912"),
        ("same.csv", "no-balls.toml", &["--balls-kept"], "E1923"),
        ("same.csv", "robot.toml", &["--balls-kept", "--centres", "far.csv"], "E1923"),
    ] {
        let refused = check(lengths, robot, more);
        assert_eq!(refused.status.code(), Some(1), "{code}: {}", stderr(&refused));
        assert!(codes(&refused).contains(&code.to_owned()), "{code}: {}", stderr(&refused));
    }
    let blind = check("same.csv", "robot.toml", &["--sigma", "1"]);
    assert_eq!(blind.status.code(), Some(3), "{}", stderr(&blind));
    assert!(codes(&blind).contains(&"W1921".to_owned()), "{}", stderr(&blind));
    assert_eq!(check("same.csv", "robot.toml", &["--risk", "0.7"]).status.code(), Some(2));
}

/// The job of a check about one ball.
const JOB: &str = r#"
robot = "kr60ha"
optimise = { points = 60, candidates = 600 }
[tool]
ball_mm = [30.0, 20.0, 10.0]
[bar]
length_mm = 500.0
stroke_mm = [-5.0, 5.0]
sigma_um = 10.0
length_u_mm = 0.01
[[centre]]
id = 1
xyz_mm = [1200.0, 0.0, 600.0]
"#;

fn cell() -> TempDir {
    let dir = tempdir().unwrap();
    let robot = Robot { repeatability_mm: None, ..calibration() };
    fs::write(dir.path().join("robot.toml"), robot.to_toml().unwrap()).unwrap();
    fs::write(dir.path().join("bare.toml"), Robot { posterior: None, ..robot }.to_toml().unwrap()).unwrap();
    fs::write(dir.path().join("job.toml"), JOB).unwrap();
    dir
}

fn read(dir: &Path, file: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(dir.join(file)).unwrap()).unwrap()
}

/// The check that is planned finds what it says, and is what `check` says of its lengths.
#[test]
fn a_check_is_planned_for_detectable_changes() {
    let dir = cell();
    let at = dir.path();
    let plan = |more: &[&str]| {
        let args = ["plan", "--check", "job.toml", "--robot", "robot.toml", "--out", "plan"];
        dbbd(at, &[&args[..], more].concat())
    };
    let planned = plan(&["--poses", "16", "--tolerance", "1"]);
    assert_eq!(planned.status.code(), Some(0), "{}", stderr(&planned));
    assert!(codes(&planned).contains(&"I1920".to_owned()));
    let power = read(at, "plan/plan.json")["check"].clone();
    let least = power["least_tolerance_mm"].as_f64().unwrap();
    // Poses to which no path leads are said, and are not among the lengths.
    let said = stderr(&planned);
    let left_out = said
        .split_once(" of 16 chosen poses were left out")
        .map_or(0, |(before, _)| before.rsplit(' ').next().and_then(|count| count.parse().ok()).unwrap());
    assert!(
        (16..=17).contains(&(power["lengths"].as_u64().unwrap() + left_out))
            && left_out <= 1
            && power["power"] == 0.95
            && power["false_alarm"] == 0.01,
        "{power}"
    );
    let smallest = |name: &str| {
        let found = power["detectable"].as_array().unwrap().iter().find(|found| found["name"] == name);
        found.unwrap_or_else(|| panic!("{name}"))["smallest"].as_f64()
    };
    // The free ball carries the zero of axis 1; a joint in the middle of the arm is seen well.
    assert!(smallest("theta1").is_none() && smallest("theta3").unwrap().to_degrees() < 0.02, "{power}");
    let shift = |power: &Value| {
        let mut found = power["detectable"].as_array().unwrap().iter();
        found.find(|found| found["name"] == "centre1_x").and_then(|found| found["smallest"].as_f64())
    };
    assert_eq!(shift(&power), None);
    let page = fs::read_to_string(at.join("plan/plan.html")).unwrap();
    assert!(page.contains("What this check will find") && !page.contains("NaN"));
    assert_spoken(&page);
    if let Some(folder) = std::env::var_os("DBBD_PAGES") {
        fs::write(Path::new(&folder).join("plan-check.html"), page).unwrap();
    }
    // A base ball that stays is one of the changes, if it is where the calibration had it.
    let elsewhere = plan(&["--balls-kept"]);
    assert_eq!((elsewhere.status.code(), codes(&elsewhere).contains(&"E1923".to_owned())), (Some(1), true));
    fs::write(at.join("job.toml"), JOB.replace("[1200.0, 0.0, 600.0]", &format!("{CENTRE:?}"))).unwrap();
    let kept = plan(&["--balls-kept"]);
    assert_eq!(kept.status.code(), Some(0), "{}", stderr(&kept));
    fs::write(at.join("job.toml"), JOB).unwrap();
    assert!(shift(&read(at, "plan/plan.json")["check"]).is_some_and(|mm| mm < 1.0));
    // What no such check can decide is reported before anything is measured.
    let below = plan(&["--tolerance", &format!("{:.4}", 0.9 * least)]);
    assert_eq!((below.status.code(), codes(&below).contains(&"W1914".to_owned())), (Some(3), true));
    let bare = dbbd(at, &["plan", "--check", "job.toml", "--robot", "bare.toml", "--out", "p"]);
    assert_eq!((bare.status.code(), codes(&bare).contains(&"E1910".to_owned())), (Some(1), true));
    fs::write(at.join("change.toml"), JOB.replace("points = 60", "points = 60, criterion = \"change\""))
        .unwrap();
    let without = dbbd(at, &["plan", "change.toml", "--out", "p"]);
    assert_eq!((without.status.code(), codes(&without).contains(&"E0740".to_owned())), (Some(1), true));
    for wrong in [&["--poses", "11"][..], &["--stage", "20"]] {
        assert_eq!(plan(wrong).status.code(), Some(2));
    }
}

/// check.json and compare.json have their sources, and `info` shows them.
#[test]
fn a_check_and_a_comparison_record_their_sources() {
    let dir = cell();
    let at = dir.path();
    let circles = three_planes(1, CENTRE);
    fs::write(at.join("C.csv"), centres_csv(&circles)).unwrap();
    // Each pose twice: the repeatability comes from them.
    let text = lengths(&with_errors(DESIGNED), &circles, 8, 1);
    let again = lengths(&with_errors(DESIGNED), &circles, 8, 5);
    let repeated = (25..)
        .zip(again.lines().skip(1))
        .map(|(index, line)| format!("{index},{}\n", line.split_once(',').unwrap().1));
    fs::write(at.join("same.csv"), text + &repeated.collect::<String>()).unwrap();
    let checked =
        dbbd(at, &["check", "same.csv", "--robot", "robot.toml", "--centres", "C.csv", "--out", "check"]);
    assert_eq!(checked.status.code(), Some(0), "{}", stderr(&checked));
    let check = read(at, "check/check.json");
    // 24 degrees of freedom: 3 sigma within the factors of chi-square at 0.001.
    let repeatability = check["distance"]["repeatability"]["value"].as_f64().unwrap();
    assert!((0.55..1.5).contains(&(repeatability / (3.0 * SIGMA))), "{repeatability}");
    let info = dbbd(at, &["info", "check/check.json", "--json"]);
    let info: Value = serde_json::from_slice(&info.stdout).unwrap();
    let roles: Vec<&Value> =
        info["provenance"]["from"].as_array().unwrap().iter().map(|source| &source["role"]).collect();
    assert_eq!(info["role"], "check");
    assert!(roles.contains(&&json!("measurements")) && roles.contains(&&json!("base_balls")), "{info}");
}
