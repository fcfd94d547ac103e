//! Every key of a job is documented in the examples, every documented example plans, and bad values name their line.

use dbbd::model::Robot;
use dbbd::plan::{Job, Plan};

const EXAMPLES: [(&str, &str); 5] = [
    ("demo.toml", include_str!("../../examples/demo.toml")),
    ("optimal.toml", include_str!("../../examples/optimal.toml")),
    ("seed-experiment.toml", include_str!("../../examples/seed-experiment.toml")),
    ("stages.toml", include_str!("../../examples/stages.toml")),
    ("continuous.toml", include_str!("../../examples/continuous.toml")),
];

/// The key and the value of a line, also where both are a comment that shows a default.
fn entry(line: &str) -> Option<(&str, &str)> {
    let (key, value) = line.trim_start_matches("# ").split_once(" = ")?;
    let word =
        !key.is_empty() && key.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    word.then(|| (key, value.split('#').next().unwrap_or("").trim()))
}

#[test]
fn every_example_plans() {
    let robot = Robot::by_name("kr60ha").unwrap().unwrap();
    for (name, text) in EXAMPLES {
        let job = Job::from_toml(name, text).unwrap_or_else(|error| panic!("{error}"));
        job.check_against(&robot).unwrap();
        Plan::build(&job, &robot).unwrap_or_else(|refused| panic!("{name}: {refused}"));
    }
}

/// The public fields of the job's tables, by their names in the file.
#[test]
fn every_key_is_documented() {
    let shown: Vec<&str> =
        EXAMPLES.iter().flat_map(|(_, text)| text.lines().filter_map(entry)).map(|e| e.0).collect();
    let fields =
        concat!(include_str!("../../src/plan/job/mod.rs"), include_str!("../../src/plan/job/obstacle.rs"));
    let fields = fields.lines().filter_map(|line| {
        let field = line.trim().strip_prefix("pub ").unwrap_or(line.trim()).split_once(": ")?;
        let own = line.starts_with("    pub ") || line.starts_with("        ") && field.0.ends_with("_mm");
        own.then_some(field.0)
    });
    let tables =
        ["bar", "centres", "circles", "optimise", "obstacles", "tool", "motion", "limits", "outputs"];
    let mut count = 0;
    for field in fields.filter(|field| !tables.contains(field)) {
        count += 1;
        assert!(shown.contains(&field), "`{field}` is in no example");
    }
    assert!(count > 40, "{count} fields found");
}

/// Each documented line with a value that cannot be: a wrong type, no number, an absurd size.
#[test]
fn a_bad_value_of_every_key_names_its_line() {
    let mut tried = 0;
    for (name, text) in EXAMPLES {
        // Keys of a table that is a comment belong to no other.
        let (head, commented) = text.split_once("# [[obstacle]]\n").unwrap_or((text, ""));
        let text = format!(
            "{head}\n{}",
            commented
                .replacen("# shape", "[[obstacle]]\nshape", 1)
                .replace("# low_mm", "low_mm")
                .replace("# high_mm", "high_mm")
        );
        let lines: Vec<&str> = text.lines().collect();
        for (at, line) in lines.iter().enumerate() {
            let Some((key, value)) = entry(line) else { continue };
            let with = |bad: String| {
                let mut changed = lines.clone();
                let text = format!("{key} = {bad}");
                changed[at] = &text;
                Job::from_toml(name, &changed.join("\n"))
            };
            let first = value.split([',', ']']).next().unwrap().trim_start_matches(['[', ' ']);
            let in_place = |bad: &str| value.replacen(first, bad, 1);
            let mut bad = vec![if value.starts_with('"') { "7".into() } else { "\"word\"".to_owned() }];
            if value.starts_with('"') {
                // Names of robots and protocols are looked up later, lists of parameters with the robot.
                if !["robot", "protocol", "parameters"].contains(&key) {
                    bad.push("\"no such word\"".into());
                }
            } else {
                bad.extend([in_place("nan"), in_place("1e300"), in_place("-1e300"), "{}".into()]);
            }
            for bad in bad {
                tried += 1;
                let error =
                    with(bad.clone()).err().unwrap_or_else(|| panic!("{name}: {key} = {bad} is taken"));
                assert_eq!(error.line, at + 1, "{key} = {bad}: {error}");
                assert!(error.to_string().starts_with(&format!("{name}:{}:", at + 1)), "{error}");
            }
            let error = with(format!("{value}\nno_such_key = 1")).unwrap_err();
            assert!(error.line == at + 2 || line.starts_with('#'), "{error}");
        }
    }
    assert!(tried > 300, "{tried} tried");
}

/// What only the robot shows to be wrong.
#[test]
fn a_taught_ball_that_is_not_there_is_told() {
    let robot = Robot::by_name("kr60ha").unwrap().unwrap();
    let text = EXAMPLES[3].1.replace("-62.5511", "-62.1511");
    let error = Job::from_toml("stages.toml", &text).unwrap().check_against(&robot).unwrap_err();
    assert!(error.contains("[[centre]] 1: taught_deg brings the tool ball to (1"), "{error}");
    let text = format!("{}tool = [30.0, 20.0, 11.0, 0.0, 0.0, 0.0]\n", EXAMPLES[3].1);
    let error = Job::from_toml("stages.toml", &text).unwrap().check_against(&robot).unwrap_err();
    assert!(error.contains("is not the robot file's tool ball (30, 20, 10)"), "{error}");
}
