//! Every key of a job is documented in the examples, every documented example plans, and bad values name their line.

use dbbd_job::plan::goal::plan_for_goal;
use dbbd_job::plan::{Job, KnownCell, Plan, PlanningPrior, job};
use dbbd_model::provenance::{Identity, MeasuredTemperature};
use dbbd_model::robot::Robot;
use serde::de::{self, DeserializeOwned, Visitor, value};
use serde::{Deserializer, forward_to_deserialize_any};

const EXAMPLES: [(&str, &str); 6] = [
    ("circles.toml", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/circles.toml"))),
    ("optimal.toml", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/optimal.toml"))),
    (
        "seed-experiment.toml",
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/seed-experiment.toml")),
    ),
    ("stages.toml", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/stages.toml"))),
    ("goal.toml", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/goal.toml"))),
    ("continuous.toml", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/continuous.toml"))),
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
    let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
    for (name, text) in EXAMPLES {
        let job = Job::from_toml(name, text).unwrap_or_else(|error| panic!("{error}"));
        job.check_against(&robot).unwrap();
        let cell = |job: Job| {
            let prior = PlanningPrior::datasheet(&job, &robot);
            Ok(KnownCell { job, robot: robot.clone(), prior })
        };
        let planned = match &job.goal {
            Some(goal) => plan_for_goal(goal, &cell(job.clone()).unwrap(), &cell).map(|(plan, _)| plan),
            None => Plan::build(&job, &robot),
        };
        planned.unwrap_or_else(|refused| panic!("{name}: {refused}"));
    }
}

/// Collects the keys of a table, which its deserialisation names, and reads nothing.
struct Keys<'a>(&'a mut Vec<&'static str>);

impl<'de> Deserializer<'de> for Keys<'_> {
    type Error = value::Error;

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Self::Error> {
        Err(de::Error::custom("no table"))
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        _: V,
    ) -> Result<V::Value, Self::Error> {
        self.0.extend(fields);
        Err(de::Error::custom("only the keys are wanted"))
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map enum identifier ignored_any
    }
}

fn keys_of<T: DeserializeOwned>() -> Vec<&'static str> {
    let mut keys = Vec::new();
    assert!(T::deserialize(Keys(&mut keys)).is_err());
    assert!(!keys.is_empty());
    keys
}

#[test]
fn every_key_is_documented() {
    let shown: Vec<&str> =
        EXAMPLES.iter().flat_map(|(_, text)| text.lines().filter_map(entry)).map(|e| e.0).collect();
    let tables = ["bar", "centre", "circle", "optimise", "obstacle", "tool", "motion", "limits", "outputs"];
    let tables =
        [&tables[..], &["goal", "place", "bar_choice", "identity", "temperature", "balls", "robot"]].concat();
    let keys = [
        keys_of::<Job>(),
        keys_of::<job::JobBar>(),
        keys_of::<job::BaseBallTable>(),
        keys_of::<job::CircleTable>(),
        keys_of::<job::OptimiseTable>(),
        keys_of::<job::GoalTable>(),
        keys_of::<job::GoalTool>(),
        keys_of::<job::PlaceTable>(),
        keys_of::<job::BarChoiceTable>(),
        keys_of::<job::ObstacleTable>(),
        keys_of::<job::JobToolTable>(),
        keys_of::<job::MotionTable>(),
        keys_of::<job::MarkerOutputs>(),
        keys_of::<job::JobLimits>(),
        keys_of::<Identity>(),
        keys_of::<MeasuredTemperature>(),
    ]
    .concat();
    for key in keys.iter().filter(|key| !tables.contains(key)) {
        assert!(shown.contains(key), "`{key}` is in no example");
    }
    assert!(keys.len() > 50, "{keys:?}");
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
                // Names of robots, payloads and protocols are looked up later, lists of parameters with the robot; texts are free.
                let later = ["robot", "payload", "protocol", "parameters", "program"];
                let texts = ["serial", "certificate", "certified_by", "laboratory", "cell", "operator"];
                let more = ["customer", "controller", "of", "device"];
                if ![&later[..], &texts, &more].concat().contains(&key) {
                    bad.push("\"no such word\"".into());
                }
            } else {
                bad.extend([in_place("nan"), in_place("1e300"), in_place("-1e300"), "{}".into()]);
            }
            for bad in bad {
                tried += 1;
                let error =
                    with(bad.clone()).err().unwrap_or_else(|| panic!("{name}: {key} = {bad} is taken"));
                assert_eq!(error.line_number(), at + 1, "{key} = {bad}: {error}");
                assert!(error.to_string().starts_with(&format!("{name}:{}:", at + 1)), "{error}");
            }
            let error = with(format!("{value}\nno_such_key = 1")).unwrap_err();
            assert!(error.line_number() == at + 2 || line.starts_with('#'), "{error}");
        }
    }
    assert!(tried > 300, "{tried} tried");
}

/// What only the robot shows to be wrong: what is replaced in the example of stages.
const ELSEWHERE: &[(&str, &str, &str)] = &[
    ("-62.5511", "-62.1511", "E0607"),
    ("[motion]", "[motion]\ntool = [30.0, 20.0, 11.0, 0.0, 0.0, 0.0]", "E0607"),
];

#[test]
fn a_taught_ball_or_tool_at_another_place_is_refused() {
    let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
    for (from, to, code) in ELSEWHERE {
        assert!(EXAMPLES[3].1.contains(from));
        let text = EXAMPLES[3].1.replace(from, to);
        let job = Job::from_toml("stages.toml", &text).unwrap();
        let error = job.check_against(&robot).unwrap_err().in_text("stages.toml", &text);
        let key = if to.starts_with('[') { "tool = " } else { "taught_deg = " };
        assert!(text.lines().nth(error.line_number() - 1).unwrap().starts_with(key), "{error}");
        assert_eq!(error.code().as_str(), *code);
    }
}
