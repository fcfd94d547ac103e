//! What cannot be planned is refused with a code: of the job with its line, of the plan with row, value and limit.

use dbbd_job::plan::{Job, Plan, Refusal};
use dbbd_model::robot::Robot;

use crate::cell::{codes, dbbd, stderr};

const JOB: &str = r#"
robot = "kr60ha"
[bar]
length_mm = 300.0
stroke_mm = [-5.0, 5.0]
margin_mm = 0.5
[[centre]]
id = 1
xyz_mm = [1300.0, 0.0, 800.0]
[[circle]]
plane = "XY"
points = 12
orientation = "fixed"
[motion]
feed_mm_s = 40.0
[tool]
ball_mm = [30.0, 20.0, 10.0]
"#;

/// Jobs that are refused: what is replaced, the line that is named, the code.
const JOBS: &[(&str, &str, usize, &str)] = &[
    ("margin_mm", "margn_mm", 6, "E0120"),
    ("\"XY\"", "\"XQ\"", 11, "E0120"),
    ("[motion]", "[[obstacle]]\nshape = \"ball\"\n[motion]", 15, "E0120"),
    ("300.0", "nan", 4, "E0130"),
    ("[1300.0, 0.0, 800.0]", "[1300.0, inf, 800.0]", 9, "E0130"),
    ("plane = \"XY\"", "normal = [0.0, 0.0, 0.0]", 11, "E0130"),
    ("feed_mm_s = 40.0", "feed_mm_s = 251.0", 15, "E0130"),
    ("feed_mm_s = 40.0", "feed_mm_s = 0.0", 15, "E0130"),
    ("margin_mm = 0.5", "length_u_mm = -0.1", 6, "E0130"),
    ("margin_mm = 0.5", "expansion_per_k = nan", 6, "E0130"),
    ("[motion]", "[optimise]\npoints = 3\n[motion]", 15, "E0130"),
    ("[motion]", "[optimise]\npoints = 20\ncandidates = 30\n[motion]", 16, "E0130"),
    (
        "[motion]",
        "[optimise]\npoints = 20\nworkspace_mm = [[0.5, -0.5, 0.2], [1.5, 0.5, 1.2]]\n[motion]",
        16,
        "E0130",
    ),
    ("[-5.0, 5.0]", "[5.0, -5.0]", 5, "E0602"),
    ("margin_mm = 0.5", "margin_mm = 5.0", 6, "E0602"),
    (
        "[motion]",
        "[[obstacle]]\nshape = \"box\"\nlow_mm = [1, 0, 0]\nhigh_mm = [0, 1, 1]\n[motion]",
        16,
        "E0602",
    ),
    ("plane = \"XY\"", "", 10, "E0603"),
    ("points = 12", "points = 12\namplitude_deg = 10.0", 13, "E0603"),
    ("[tool]", "[tool]\ncup_limit_deg = 10.0", 17, "E0603"),
    ("[tool]", "[[joint]]\n[tool]", 16, "E0603"),
    ("[30.0, 20.0, 10.0]", "[0.03, 0.02, 0.01]", 17, "E0130"),
    ("id = 1", "id = 2", 8, "E0604"),
    ("plane", "centre = 2\nplane", 11, "E0604"),
    ("points = 12", "points = 250", 12, "E0605"),
    ("feed_mm_s = 40.0", "outputs = { strobe = 10 }", 15, "E0606"),
];

/// Plans that are refused: what is replaced, the code, and the quantity beyond its limit where it is about one.
type PlanCase = (&'static [(&'static str, &'static str)], &'static str, &'static str);
const PLANS: &[PlanCase] = &[
    (&[("1300.0, 0.0", "3300.0, 0.0")], "E0702", ""),
    (&[("[1300.0, 0.0, 800.0]", "[700.0, 0.0, 1400.0]")], "E0703", ""),
    (&[("[motion]", "[limits]\nmin_a5_deg = 80.0\n[motion]")], "E0703", "wrist_deg"),
    (&[("[motion]", "[limits]\nmin_axis_margin_deg = 80.0\n[motion]")], "E0703", "axis_margin_deg"),
    (&[("[motion]", "[limits]\nmin_overhead_mm = 2000.0\n[motion]")], "E0703", "overhead_mm"),
    (&[("points = 12", "points = 12\nradius_mm = 304.8")], "E0705", "reading_high_mm"),
    (&[("points = 12", "points = 12\nradius_mm = 295.4")], "E0705", "reading_low_mm"),
    // A stroke of +-0.7 mm is too little for a robot of 0.5 mm and 0.05 degrees (a full circle does not fit).
    (&[("[-5.0, 5.0]", "[-0.7, 0.7]"), ("margin_mm = 0.5", "margin_mm = 0.2")], "E0706", "stroke_risk"),
    (
        &[
            ("[-5.0, 5.0]", "[-1.0, 1.0]"),
            ("margin_mm = 0.5", "margin_mm = 0.0"),
            ("[motion]", "[limits]\nmax_stroke_risk = 1e-6\n[motion]"),
        ],
        "E0706",
        "run_risk",
    ),
    (&[("800.0]", "800.0]\ncup_axis = [0.0, 0.0, 1.0]\ncup_limit_deg = 60.0")], "E0707", "cup_deg"),
    // The tool points down, the bar goes sideways from its ball.
    (&[("[tool]", "[tool]\ncup_axis = [0.0, 0.0, 1.0]\ncup_limit_deg = 60.0")], "E0707", "tool_cup_deg"),
    (
        &[(
            "[motion]",
            "[[obstacle]]\nshape = \"box\"\nlow_mm = [1500.0, -100.0, 700.0]\nhigh_mm = [1700.0, 100.0, 805.0]\n[motion]",
        )],
        "E0708",
        "clearance_mm",
    ),
    (
        &[(
            "[motion]",
            "[[obstacle]]\nshape = \"cylinder\"\nfrom_mm = [1300.0, 250.0, 0.0]\nto_mm = [1300.0, 250.0, 900.0]\n\
             radius_mm = 20.0\n[motion]",
        )],
        "E0708",
        "clearance_mm",
    ),
    (&[("[motion]", "[[obstacle]]\nshape = \"floor\"\nz_mm = 795.0\n[motion]")], "E0708", "clearance_mm"),
    (
        &[(CIRCLE, "[optimise]\npoints = 20\ncandidates = 200\n[limits]\nmin_overhead_mm = 3000.0\n")],
        "E0710",
        "",
    ),
    (&[(CIRCLE, "[optimise]\npoints = 20\nparameters = \"alpha9\"\n")], "E0608", ""),
    (&[(CIRCLE, "[optimise]\npoints = 20\nparameters = \"gear\"\n")], "E0608", ""),
];
const CIRCLE: &str = "[[circle]]\nplane = \"XY\"\npoints = 12\norientation = \"fixed\"\n";

/// What `dbbd plan` reports: the text of the job, further arguments, exit code, codes.
type Command = (fn() -> String, &'static [&'static str], i32, &'static [&'static str]);
const COMMANDS: &[Command] = &[
    (twisted, &[], 1, &["E0703", "I0713", "E0701"]),
    (risky, &[], 1, &["E0706", "I0713", "E0701"]),
    (few, &["--robot", "loose.toml"], 0, &["I0711", "I0712", "I0714", "I0715", "I0716"]),
    (|| JOB.into(), &["--robot", "identified.toml"], 3, &["W0720", "I0714", "I0715"]),
    (|| JOB.into(), &["--measured", "elsewhere.csv"], 1, &["E1203"]),
    (|| replaced(&[("[1300.0, 0.0, 800.0]", "[1.3, 0.0, 0.8]")]), &[], 1, &["E0130"]),
    (|| replaced(&[("[1300.0, 0.0, 800.0]", "[4100.0, 0.0, 800.0]")]), &[], 1, &["E0130"]),
];
const SLOW_ROBOT: &str = "E0704";

fn twisted() -> String {
    JOB.replace("orientation = \"fixed\"", "orientation = \"seed\"\namplitude_deg = 25.0\nspin_deg = 120.0")
}

fn risky() -> String {
    replaced(PLANS.iter().find(|case| case.2 == "stroke_risk").unwrap().0)
}

/// About a ball near the base of the robot, which few poses reach.
fn few() -> String {
    replaced(&[
        ("[1300.0, 0.0, 800.0]", "[420.0, 0.0, 250.0]"),
        (CIRCLE, "[optimise]\npoints = 16\ncandidates = 200\n[limits]\nmin_a5_deg = 83.0\n"),
    ])
}

fn replaced(changes: &[(&str, &str)]) -> String {
    changes.iter().fold(JOB.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1)
    })
}

fn robot() -> Robot {
    Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap()
}

fn refusal(text: &str, robot: &Robot) -> Refusal {
    Plan::build(&Job::from_toml("job.toml", text).unwrap(), robot).unwrap_err()
}

#[test]
fn the_job_itself_is_fine() {
    Plan::build(&Job::from_toml("job.toml", JOB).unwrap(), &robot()).unwrap();
    let floor = replaced(&[("[motion]", "[[obstacle]]\nshape = \"floor\"\nz_mm = 0.0\n[motion]")]);
    Plan::build(&Job::from_toml("job.toml", &floor).unwrap(), &robot()).unwrap();
}

#[test]
fn a_mistake_in_the_job_has_its_code_and_its_line() {
    for (from, to, line, code) in JOBS {
        let error = Job::from_toml("job.toml", &replaced(&[(*from, *to)])).unwrap_err();
        assert_eq!((error.code().as_str(), error.line_number()), (*code, *line), "{error}");
    }
}

#[test]
fn an_unsafe_plan_has_the_code_of_what_it_breaks() {
    for (changes, code, quantity) in PLANS {
        let refusal = refusal(&replaced(changes), &robot());
        let named = refusal.findings.iter().any(|finding| {
            finding.code().as_str() == *code
                && (quantity.is_empty() || finding.values()["quantity"] == *quantity)
        });
        assert!(named, "{code} {quantity}: {refusal}");
    }
    let mut slow = robot();
    slow.max_acceleration_deg_s2 = [Some(0.5); 6];
    let refusal = refusal(JOB, &slow);
    assert!(refusal.findings.iter().all(|finding| finding.code().as_str() == SLOW_ROBOT), "{refusal}");
}

#[test]
fn a_finding_has_row_value_and_limit() {
    let refusal = refusal(&replaced(&[("points = 12", "points = 12\nradius_mm = 304.8")]), &robot());
    let values =
        &refusal.findings.iter().find(|finding| finding.code().as_str() == "E0705").unwrap().values();
    assert_eq!((&values["row"], &values["limit"]), (&1.into(), &4.5.into()));
    assert!((values["worst"].as_f64().unwrap() - 4.8).abs() < 0.01, "{values}");
}

/// The refusal names an orientation of the tool, and with it the circle passes.
#[test]
fn another_orientation_is_recommended() {
    let bad = twisted();
    let refusal = refusal(&bad, &robot());
    let values = &refusal.recommendations[0].values();
    assert_eq!(values["circle"], 1);
    let [tilt, spin] = ["tilt_deg", "spin_deg"].map(|key| values[key].as_f64().unwrap());
    let better = bad.replace("spin_deg = 120.0", &format!("spin_deg = {spin:?}\ntilt_deg = {tilt:?}"));
    Plan::build(&Job::from_toml("job.toml", &better).unwrap(), &robot())
        .unwrap_or_else(|refused| panic!("{refused}"));
}

#[test]
fn the_command_reports_every_finding() {
    for (job, more, exit, expected) in COMMANDS {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("job.toml"), job()).unwrap();
        let identified = Robot { nominal: Some(Box::new(robot())), ..robot() };
        std::fs::write(dir.path().join("identified.toml"), identified.to_toml().unwrap()).unwrap();
        // A flange that is no better than the arm.
        let mut loose = robot();
        (loose.tolerance.flange_mm, loose.tolerance.flange_deg) = (Some(0.5), Some(0.05));
        std::fs::write(dir.path().join("loose.toml"), loose.to_toml().unwrap()).unwrap();
        let elsewhere =
            "index,centre,a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,length_mm\n1,2,0,-60,90,0,60,0,300\n";
        std::fs::write(dir.path().join("elsewhere.csv"), elsewhere).unwrap();
        let output = dbbd(dir.path(), &[&["plan", "job.toml", "--out", "plan", "--json"], *more].concat());
        let found = codes(&output);
        assert_eq!(output.status.code(), Some(*exit), "{}", stderr(&output));
        for code in *expected {
            assert!(found.iter().any(|found| found == code), "{code}: {}", stderr(&output));
        }
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(json["error"]["code"].as_str(), (*exit == 1).then(|| *expected.last().unwrap()));
        assert_eq!(dir.path().join("plan/plan.csv").is_file(), *exit != 1);
    }
}
