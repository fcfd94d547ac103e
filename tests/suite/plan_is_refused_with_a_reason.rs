//! What cannot be planned is refused with the line, or with row, quantity, value and limit.

use dbbd::model::Robot;
use dbbd::plan::{Finding, Job, Plan, Quantity};

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
"#;

fn robot() -> Robot {
    Robot::by_name("kr60ha").unwrap().unwrap()
}

fn findings(text: &str) -> Vec<Finding> {
    Plan::build(&Job::from_toml("job.toml", text).unwrap(), &robot()).unwrap_err().findings
}

fn beyond(text: &str) -> Vec<Quantity> {
    let of = |finding: &Finding| match finding {
        Finding::Beyond(check) => Some(check.quantity),
        _ => None,
    };
    findings(text).iter().filter_map(of).collect()
}

#[test]
fn the_job_itself_is_fine() {
    Plan::build(&Job::from_toml("job.toml", JOB).unwrap(), &robot()).unwrap();
}

#[test]
fn a_bar_that_would_be_torn_out() {
    let far = JOB.replace("points = 12", "points = 12\nradius_mm = 304.8");
    assert!(beyond(&far).contains(&Quantity::ReadingHighMm));
    let near = JOB.replace("points = 12", "points = 12\nradius_mm = 295.4");
    assert!(beyond(&near).contains(&Quantity::ReadingLowMm));
    // A stroke of +-0.7 mm is too little for a robot of 0.5 mm and 0.05 degrees (a full circle does not fit).
    let short = JOB.replace("[-5.0, 5.0]", "[-0.7, 0.7]").replace("margin_mm = 0.5", "margin_mm = 0.2");
    assert!(beyond(&short).contains(&Quantity::StrokeRisk));
    let told = Plan::build(&Job::from_toml("job.toml", &short).unwrap(), &robot()).unwrap_err().to_string();
    assert!(told.contains("--stage 20"), "{told}");
    let message = Plan::build(&Job::from_toml("job.toml", &far).unwrap(), &robot()).unwrap_err().to_string();
    assert!(message.contains("row 1: highest reading of the bar: 4.8"), "{message}");
    assert!(message.contains("must be at most 4.500 mm"), "{message}");
}

#[test]
fn limits_singularities_and_reach() {
    let behind = JOB.replace("[1300.0, 0.0, 800.0]", "[700.0, 0.0, 1400.0]");
    assert!(beyond(&behind).iter().any(|q| matches!(q, Quantity::AxisMarginDeg | Quantity::WristDeg)));
    let strict = format!("{JOB}[limits]\nmin_a5_deg = 80.0\n");
    assert!(beyond(&strict).contains(&Quantity::WristDeg));
    let wide = format!("{JOB}[limits]\nmin_overhead_mm = 2000.0\n");
    assert!(beyond(&wide).contains(&Quantity::OverheadMm));
    let far = JOB.replace("1300.0, 0.0", "3300.0, 0.0");
    assert!(matches!(findings(&far)[0], Finding::Unsolved { row: 1, .. }));
    let cup = JOB.replace("800.0]", "800.0]\ncup_axis = [0.0, 0.0, 1.0]\ncup_limit_deg = 60.0");
    assert!(beyond(&cup).contains(&Quantity::CupDeg));
}

#[test]
fn obstacles_cups_and_the_whole_run() {
    let with = |table: &str| beyond(&format!("{JOB}{table}"));
    let shelf =
        "[[obstacle]]\nshape = \"box\"\nlow_mm = [1500.0, -100.0, 700.0]\nhigh_mm = [1700.0, 100.0, 805.0]\n";
    assert!(with(shelf).contains(&Quantity::ClearanceMm));
    let column = "[[obstacle]]\nshape = \"cylinder\"\nfrom_mm = [1300.0, 250.0, 0.0]\nto_mm = [1300.0, 250.0, 900.0]\nradius_mm = 20.0\n";
    assert!(with(column).contains(&Quantity::ClearanceMm));
    let floor = "[[obstacle]]\nshape = \"floor\"\nz_mm = 795.0\n";
    assert!(with(floor).contains(&Quantity::ClearanceMm));
    assert!(
        Plan::build(
            &Job::from_toml("job", &format!("{JOB}{}", floor.replace("795.0", "0.0"))).unwrap(),
            &robot()
        )
        .is_ok()
    );
    // The tool points down, the bar goes sideways from its ball.
    assert!(
        with("[tool]\ncup_axis = [0.0, 0.0, 1.0]\ncup_limit_deg = 60.0\n").contains(&Quantity::ToolCupDeg)
    );
    // No pose has this risk, the whole run has.
    let short = JOB.replace("[-5.0, 5.0]", "[-1.0, 1.0]").replace("margin_mm = 0.5", "margin_mm = 0.0");
    let worst = |risk: f64| beyond(&format!("{short}[limits]\nmax_stroke_risk = {risk}\n"));
    assert!(worst(1e-6).contains(&Quantity::StrokeRisk) && worst(1e-6).contains(&Quantity::RunRisk));
    let slow = robot_with(|robot| robot.max_acceleration_deg_s2 = [Some(0.5); 6]);
    let refused = Plan::build(&Job::from_toml("job.toml", JOB).unwrap(), &slow).unwrap_err().to_string();
    assert!(refused.contains("axis acceleration"), "{refused}");
}

fn robot_with(change: impl FnOnce(&mut Robot)) -> Robot {
    let mut changed = robot();
    change(&mut changed);
    changed
}

/// The refusal says how the tool could be held, and so held the circle passes.
#[test]
fn another_hold_is_offered() {
    let bad = JOB
        .replace("orientation = \"fixed\"", "orientation = \"seed\"\namplitude_deg = 25.0\nspin_deg = 120.0");
    let refused = Plan::build(&Job::from_toml("job.toml", &bad).unwrap(), &robot()).unwrap_err().to_string();
    let (_, told) = refused.split_once("circle 1: tilt_deg = ").expect("an offer");
    let (tilt, rest) = told.split_once(", spin_deg = ").unwrap();
    let spin = rest.split_whitespace().next().unwrap();
    let better = bad.replace("spin_deg = 120.0", &format!("spin_deg = {spin}\ntilt_deg = {tilt}"));
    Plan::build(&Job::from_toml("job.toml", &better).unwrap(), &robot())
        .unwrap_or_else(|refused| panic!("{refused}"));
}

#[test]
fn what_cannot_be_chosen_is_said() {
    let (head, _) = JOB.split_once("[[circle]]").unwrap();
    let job =
        format!("{head}[optimise]\npoints = 20\ncandidates = 200\n[limits]\nmin_overhead_mm = 3000.0\n");
    let refused = Plan::build(&Job::from_toml("job.toml", &job).unwrap(), &robot()).unwrap_err().to_string();
    assert!(refused.contains("no pose about base ball 1 can be reached"), "{refused}");
}

#[test]
fn a_mistake_in_the_job_names_its_line() {
    for (from, to, line, words) in [
        ("margin_mm", "margn_mm", 6, "did you mean `margin_mm`"),
        ("\"XY\"", "\"XQ\"", 11, "unknown variant"),
        ("plane = \"XY\"", "normal = [0.0, 0.0, 0.0]", 11, "no direction"),
        ("plane = \"XY\"", "", 10, "neither `plane` nor `normal`"),
        ("300.0", "nan", 4, "length_mm = NaN"),
        ("[1300.0, 0.0, 800.0]", "[1300.0, inf, 800.0]", 9, "xyz_mm = inf"),
        ("[-5.0, 5.0]", "[5.0, -5.0]", 5, "must be [low, high]"),
        ("margin_mm = 0.5", "margin_mm = 5.0", 6, "leave some of the stroke"),
        ("points = 12", "points = 250", 12, "255 dwells"),
        ("points = 12", "points = 12\namplitude_deg = 10.0", 13, "no amplitude_deg"),
        ("id = 1", "id = 2", 8, "id = 2 must be 1"),
        ("plane", "centre = 2\nplane", 11, "there are 1"),
        ("feed_mm_s = 40.0", "feed_mm_s = 251.0", 15, "above 250"),
        ("margin_mm = 0.5", "length_u_mm = -0.1", 6, "must be a positive number"),
        ("margin_mm = 0.5", "expansion_per_k = nan", 6, "is not a number"),
        ("[motion]", "[optimise]\npoints = 3\n[motion]", 15, "points = 3 must be in 6..1000"),
        ("[motion]", "[optimise]\npoints = 20\ncandidates = 30\n[motion]", 16, "candidates = 30"),
        (
            "[motion]",
            "[[obstacle]]\nshape = \"box\"\nlow_mm = [1, 0, 0]\nhigh_mm = [0, 1, 1]\n[motion]",
            16,
            "lowest corner",
        ),
        ("[motion]", "[[obstacle]]\nshape = \"ball\"\n[motion]", 15, "unknown variant"),
        ("[motion]", "[tool]\ncup_limit_deg = 10.0\n[motion]", 15, "cup_axis beside it"),
        ("feed_mm_s = 40.0", "feed_mm_s = 0.0", 15, "must be a positive number"),
        ("feed_mm_s = 40.0", "outputs = { strobe = 10 }", 15, "one of the index's"),
    ] {
        let error = Job::from_toml("job.toml", &JOB.replacen(from, to, 1)).unwrap_err();
        let message = error.to_string();
        assert!(message.contains(words), "{message}");
        assert_eq!(error.line, line, "{message}");
    }
}
