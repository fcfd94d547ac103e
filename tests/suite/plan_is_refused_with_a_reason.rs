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
    // A stroke of +-1 mm is too little for a robot of 0.5 mm and 0.05 degrees (a full circle does not fit).
    let short = JOB.replace("[-5.0, 5.0]", "[-1.0, 1.0]");
    assert!(beyond(&short).contains(&Quantity::StrokeRisk));
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
        ("feed_mm_s = 40.0", "feed_mm_s = 0.0", 15, "must be a positive number"),
        ("feed_mm_s = 40.0", "outputs = { strobe = 10 }", 15, "one of the index's"),
    ] {
        let error = Job::from_toml("job.toml", &JOB.replacen(from, to, 1)).unwrap_err();
        let message = error.to_string();
        assert!(message.contains(words), "{message}");
        assert_eq!(error.line, line, "{message}");
    }
}
