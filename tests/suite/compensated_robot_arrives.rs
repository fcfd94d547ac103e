//! With a compensated program the identified robot reaches the nominal positions, and only the numbers of points differ from the
//! original program.

use std::fs;
use std::path::{Path, PathBuf};

use dbbd_job::program::krl::{Compensated, Files, Given, PointProgram, Text, compensate, read};
use dbbd_job::program::{Frames, Target};
use dbbd_job::sim::truth;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::{Geometry, Pose, Robot, inverse};
use nalgebra::Vector3;

use crate::cell::{codes, dbbd, kr60, stderr};

fn fixture(name: &str) -> String {
    let path: PathBuf = [env!("CARGO_MANIFEST_DIR"), "fixtures/krl", name].iter().collect();
    fs::read_to_string(path).unwrap()
}

/// A robot drawn from the tolerance as an identified one. Its ball is not a tool of the program.
fn identified(seed: u64) -> Robot {
    let mut robot = truth::draw_true_robot(&kr60(), seed, 1.0);
    robot.nominal = Some(Box::new(kr60()));
    robot
}

fn text<'a>(file: &'a str, text: &'a str) -> Text<'a> {
    Text { file, text }
}

fn files<'a>(source: &'a str, data: &'a str, config: Option<&'a str>) -> Files<'a> {
    Files {
        source: text("P.src", source),
        data: Some(text("P.dat", data)),
        config: config.map(|config| text("config.dat", config)),
    }
}

/// The pose of the tool in the robot base at each point: of the nominal robot, and of the other robot under the nominal
/// controller.
fn reached(program: &PointProgram, robot: &Robot) -> Vec<(Pose, Pose)> {
    let flange = |mut robot: Robot| {
        robot.geometry.tool = Vector3::zeros();
        robot
    };
    let (nominal, truth) = (flange(kr60()), flange(robot.clone()));
    let mut last = [0.0, -80.0, 100.0, 0.0, 60.0, 0.0].map(f64::to_radians);
    let mut found = Vec::new();
    for point in &program.points {
        let null = Frames { tool: Pose::identity(), base: Pose::identity() };
        let frames = point.frames.unwrap_or(null);
        let (axes, commanded) = match point.target {
            Target::Axes(axes_deg) => {
                let axes = axes_deg.map(f64::to_radians);
                (axes, nominal.geometry.ball(&axes))
            }
            Target::Pose { xyz_mm, abc_deg, status, turn } => {
                let commanded = frames.flange(&Pose::from_kuka(xyz_mm, abc_deg));
                let axes = if point.by_ptp {
                    let (s, t) = (status.unwrap() as u8, turn.unwrap() as u8);
                    inverse::from_status_turn(&nominal, &commanded, s, t).unwrap()
                } else {
                    inverse::nearest(&nominal.geometry, &commanded, &last).unwrap()
                };
                (axes, commanded)
            }
        };
        last = axes;
        found.push((commanded.then(&frames.tool), truth.geometry.ball(&axes).then(&frames.tool)));
    }
    found
}

fn compensated(files: Files<'_>, given: Given, robot: &Robot) -> (PointProgram, Compensated) {
    let program = read(files, given).unwrap();
    let done = compensate(files, &program, robot, 20.0).unwrap();
    (program, done)
}

#[test]
fn all_forms_of_points_are_read_with_their_frames() {
    let (source, data, config) = (fixture("GLUE01.src"), fixture("GLUE01.dat"), fixture("config.dat"));
    let program = read(files(&source, &data, Some(&config)), Given::default()).unwrap();
    let names: Vec<_> = program.points.iter().map(|point| point.name.as_str()).collect();
    assert_eq!(names, ["XP1", "XP2", "XP3", "XP4", "XP5", "XSP[1]", "XSP[2]", "inline", "XVIA"]);
    assert_eq!(
        program.not_corrected.iter().map(|finding| finding.code().as_str()).collect::<Vec<_>>(),
        ["W0905"]
    );
    // The axis angles from which another program computed the fixture.
    let taught = [[12.0, -70.0, 95.0, 15.0, 50.0, -20.0], [20.0, -75.0, 104.0, 30.0, 45.0, -40.0]];
    let reached = reached(&program, &kr60());
    for (at, axes_deg) in [(0, taught[0]), (6, taught[1])] {
        let tool = program.points[at].frames.unwrap().tool;
        let flange = Geometry { tool: Vector3::zeros(), ..kr60().geometry };
        let expected = flange.ball(&axes_deg.map(f64::to_radians)).then(&tool);
        assert!((reached[at].0.position - expected.position).norm() < 1e-4);
        assert!(reached[at].0.angle_to(&expected) < 1e-5);
    }
}

#[test]
fn identified_robot_reaches_the_nominal_positions() {
    let (source, data, config) = (fixture("GLUE01.src"), fixture("GLUE01.dat"), fixture("config.dat"));
    let given = files(&source, &data, Some(&config));
    for seed in 0..5 {
        let robot = identified(seed);
        let (before, done) = compensated(given, Given::default(), &robot);
        let new_data = done.data.unwrap();
        let after = read(files(&done.source, &new_data, Some(&config)), Given::default()).unwrap();
        let (wanted, came) = (reached(&before, &robot), reached(&after, &robot));
        assert_eq!(wanted.len(), 9);
        for ((nominal, off), (_, now)) in wanted.iter().zip(&came) {
            assert!((nominal.position - off.position).norm() > 0.05);
            // The rounding of lengths to three and of angles to four decimals, with a tool of 220 mm.
            assert!((nominal.position - now.position).norm() < 2e-3, "{}", nominal.position - now.position);
            assert!(nominal.angle_to(now).to_degrees() < 3e-4);
        }
    }
}

/// A line with the numbers of X, Y, Z, A..C and A1..A6 replaced by a mark.
fn masked(line: &[u8]) -> String {
    let line: String = line.iter().copied().map(char::from).collect();
    let mut out = String::new();
    let mut rest = line.as_str();
    while let Some(at) = rest.find(|c: char| "{,".contains(c)) {
        let (head, tail) = rest.split_at(at + 1);
        out.push_str(head);
        let tail_of_type = tail.strip_prefix("E6POS:").map_or(tail, |rest| {
            out.push_str("E6POS:");
            rest
        });
        let name = tail_of_type.trim_start().split(' ').next().unwrap();
        let value = tail_of_type.find(name).unwrap() + name.len();
        let point = ["X", "Y", "Z", "A", "B", "C", "A1", "A2", "A3", "A4", "A5", "A6"].contains(&name);
        if point && !name.is_empty() {
            out.push_str(&tail_of_type[..value]);
            let end = tail_of_type[value..].find([',', '}']).map_or(tail_of_type.len(), |end| value + end);
            out.push('#');
            rest = &tail_of_type[end..];
        } else {
            rest = tail_of_type;
        }
    }
    out + rest
}

#[test]
fn other_bytes_are_unchanged() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    // A comment in an old code page, another line end, no line end at the end of the file.
    let mut source = fixture("GLUE01.src").into_bytes();
    source.extend(b"; M\xfcller\t \n;\r\n; last");
    let data = fixture("GLUE01.dat").into_bytes();
    fs::write(path("GLUE01.src"), &source).unwrap();
    fs::write(path("glue01.DAT"), &data).unwrap();
    fs::write(path("config.dat"), fixture("config.dat")).unwrap();
    fs::write(path("id.toml"), identified(3).to_toml().unwrap()).unwrap();
    let run_to = |out: &str, extra: &[&str]| {
        let args = ["compensate", "GLUE01.src", "--robot", "id.toml", "--out", out];
        dbbd(dir.path(), &[&args, extra].concat())
    };
    let run = |extra: &[&str]| run_to("new", extra);
    let output = run(&["--config", "config.dat"]);
    // 3: a relative motion was not corrected, which the user must see.
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    assert!(codes(&output).contains(&"W0905".into()), "{}", stderr(&output));
    let mut changed = 0;
    for (name, old) in [("GLUE01.src", &source), ("glue01.DAT", &data)] {
        let new = fs::read(dir.path().join("new").join(name)).unwrap();
        // The comments with the provenance are new.
        let made = |line: &&[u8]| line.starts_with(b"; made ");
        let lines = |bytes: &[u8]| {
            bytes.split(|b| *b == b'\n').filter(|line| !made(line)).map(<[u8]>::to_vec).collect::<Vec<_>>()
        };
        let (old, new) = (lines(old), lines(&new));
        assert_eq!(old.len(), new.len());
        for (old, new) in old.iter().zip(&new) {
            assert_eq!(masked(old), masked(new));
            changed += u32::from(old != new);
        }
    }
    assert_eq!(changed, 9);
    let points = fs::read_to_string(dir.path().join("new/glue01.DAT")).unwrap();
    let digits = |line: &str| line.split(',').next().unwrap().rsplit('.').next().unwrap().len();
    assert!(points.lines().filter(|line| line.contains("XP1=")).all(|line| digits(line) == 5));

    let refused = |output: std::process::Output, code: &str| {
        assert_eq!(output.status.code(), Some(1), "{code}");
        assert_eq!(codes(&output).last().map(String::as_str), Some(code), "{}", stderr(&output));
    };
    refused(run(&[]), COMMAND[0]);
    let one = ["--tool", "52.5,-3.25,210,12,25,-8", "--base", "900,-400,450,15,0,0"];
    refused(run(&one), COMMAND[1]);
    let limited = run(&["--config", "config.dat", "--limit", "0.01"]);
    assert!(codes(&limited).contains(&COMMAND[2].into()));
    refused(limited, COMMAND[3]);
    refused(run_to(".", &["--config", "config.dat"]), COMMAND[4]);
    refused(run(&["--limit", "0"]), COMMAND[4]);
    // A `.dat` alone is not a program.
    let args = ["compensate", "glue01.DAT", "--robot", "id.toml", "--out", "new"];
    refused(dbbd(dir.path(), &args), COMMAND[4]);
    fs::write(path("id.toml"), kr60().to_toml().unwrap()).unwrap();
    refused(run(&["--config", "config.dat"]), COMMAND[5]);
}

/// What the command refuses in `other_bytes_are_unchanged`.
const COMMAND: [&str; 6] = ["E0901", "E0902", "E0908", "E0912", "E0910", "E0909"];

/// Statements of a program with the code, line and column of the finding. If the frames do not matter, they are `$TOOL=F1` and
/// `$BASE=F1` in lines 2 and 3.
const REFUSED: &[(&str, &str, usize, usize)] = &[
    ("PTP XP1\n", "E0901", 2, 1),
    ("$TOOL=F2\n$BASE=F1\nPTP XP1\n", "E0901", 4, 1),
    ("$TOOL=F1\n$BASE=F1:F1\nPTP XP1\n", "E0901", 4, 1),
    ("$TOOL=F1\n$BASE=F1\n$BASE.X=10\nPTP XP1\n", "E0901", 5, 1),
    ("$TOOL=F1\n$BASE=F1\nBAS(#TOOL,1)\nPTP XP1\n", "E0901", 5, 1),
    ("$TOOL=F1\n$BASE=F1\nBAS(#BASE,N)\nPTP XP1\n", "E0901", 5, 1),
    ("$TOOL=F1\n$BASE=F1\nIF $IN[1] THEN\n$BASE={X 1,Y 0,Z 0,A 0,B 0,C 0}\nENDIF\nPTP XP1\n", "E0901", 7, 1),
    ("$TOOL=F1\n$BASE=F1\nLOOP\nPTP XP1\n$BASE={X 1,Y 0,Z 0,A 0,B 0,C 0}\nENDLOOP\n", "E0901", 5, 1),
    ("$TOOL=F1\n$BASE=F1\nSUB()\nPTP XP1\nEND\nDEF SUB()\n$TOOL=$NULLFRAME\n", "E0901", 5, 1),
    ("$TOOL=F1\n$BASE=F1\nXP1.X=10.0\nPTP XP1\n", "E0903", 5, 5),
    ("$TOOL=F1\n$BASE=F1\nLIN XP1:F1\n", "E0903", 4, 1),
    ("$TOOL=F1\n$BASE=F1\nLIN {X 10,Y 5,Z 1}\n", "E0903", 4, 5),
    ("$TOOL=F1\n$BASE=F1\nLIN {X 10,Y 5,Z N,A 0,B 0,C 0}\n", "E0903", 4, 5),
    ("$TOOL=F1\n$BASE=F1\nLIN {X 10,Y 5\n", "E0803", 4, 14),
    ("$TOOL=F1\n$BASE=F1\nPTP XP1\n$BASE={X 1,Y 0,Z 0,A 0,B 0,C 0}\nPTP XP1\n", "E0904", 6, 5),
    // The nominal robot does not reach it.
    ("$TOOL=F1\n$BASE=F1\nLIN {X 9000,Y 0,Z 0,A 0,B 0,C 0}\n", "E0906", 4, 5),
];

pub(crate) fn provoked() -> Vec<&'static str> {
    let others = ["W0905", "E0907", "I0911"];
    REFUSED.iter().map(|case| case.1).chain(COMMAND).chain(others).collect()
}

/// The first finding about a program.
fn refusal(source: &str, given: Given) -> Option<Diagnostic> {
    let point = "{X 1363.778,Y -282.219,Z 1360.625,A 152.596,B 29.472,C -174.261,S 2,T 34}";
    let data =
        format!("DEFDAT P\nDECL E6POS XP1={point}\nDECL FRAME F1={{X 0,Y 0,Z 0,A 0,B 0,C 0}}\nENDDAT\n");
    let files = files(source, &data, None);
    match read(files, given) {
        Err(diagnostic) => Some(diagnostic),
        Ok(program) => compensate(files, &program, &identified(1), 5.0).err()?.into_iter().next(),
    }
}

#[test]
fn points_and_frames_unknown_before_the_run_are_refused() {
    let frames = "$TOOL=F1\n$BASE=$NULLFRAME\n";
    let code = |body: &str, given| {
        refusal(&format!("DEF P()\n{body}END\n"), given).map(|wrong| wrong.code().as_str())
    };
    assert_eq!(code(&format!("{frames}PTP XP1\n"), Given::default()), None);
    let zero = Given { tool: Some(Pose::identity()), base: Some(Pose::identity()) };
    assert_eq!(code("PTP XP1\n", zero), None);
    for (body, code, line, column) in REFUSED {
        let wrong = refusal(&format!("DEF P()\n{body}END\n"), Given::default()).unwrap();
        assert_eq!(
            (wrong.code().as_str(), wrong.line_number(), wrong.column_number()),
            (*code, *line, *column),
            "{body}: {wrong}"
        );
    }
    // A nearly straight wrist on either side: the correction would move one of the two through zero.
    let straight = [
        "{X 1340,Y 0,Z 1809.985,A 0,B 90.005,C 0,S 2,T 2}",
        "{X 1340,Y 0,Z 1810.015,A 0,B 89.995,C 0,S 6,T 18}",
    ];
    let refused = straight.map(|point| code(&format!("{frames}PTP {point}\n"), Given::default()));
    assert!(refused.contains(&Some("E0907")), "{refused:?}");
    let other = Given { tool: Some(Pose::from_kuka([1.0, 0.0, 0.0], [0.0; 3])), base: None };
    assert_eq!(code(&format!("{frames}PTP XP1\n"), other), Some("E0902"));
}

#[test]
fn emitted_programs_are_compensated() {
    let files_of = crate::circle_plan::plan(1, 6);
    let options = dbbd_job::program::krl::Options {
        sync: dbbd_job::program::krl::Sync::Marker,
        controller: dbbd_job::program::krl::Controller::Krc4,
    };
    let modules = dbbd_job::program::krl::emit(&files_of, options).unwrap();
    let find =
        |name: &str| modules.iter().find(|(file, _)| Path::new(file) == Path::new(name)).unwrap().1.clone();
    let (source, data) = (find("DBB_C001.src"), find("DBB_C001.dat"));
    let given = files(&source, &data, None);
    let program = read(given, Given::default()).unwrap();
    assert!(program.not_corrected.is_empty() && program.points.len() > 6);
    let robot = identified(2);
    compensate(given, &program, &robot, 20.0).unwrap();
}

/// A point that was taught with axes at zero has the turn bits of zero, although rounding moves the axes off zero. A degree off
/// zero, the same turn bits mean a full turn.
#[test]
fn rounding_about_zero_does_not_change_the_turn() {
    let corrected = |y: f64| {
        let text = format!(
            "DEF P()\n$TOOL=$NULLFRAME\n$BASE=$NULLFRAME\nPTP {{X 1170,Y {y},Z 1640,A 0,B 180,C 0,S 2,T 2}}\nEND\n"
        );
        let files = Files { source: Text { file: "P.src", text: &text }, data: None, config: None };
        let program = read(files, Given::default()).unwrap();
        compensate(files, &program, &identified(1), 20.0).map_err(|refused| refused[0].code().as_str())
    };
    assert!(corrected(0.0).is_ok());
    assert!(corrected(0.001).is_ok(), "{:?}", corrected(0.001));
    assert_eq!(corrected(20.0).unwrap_err(), "E0906");
}

/// If a correction moves an axis through zero, its turn bit changes, in the form in which it was written; other bits stay. With the
/// old bit the axis would be a full turn away, or the pose out of reach.
#[test]
fn turn_bit_follows_an_axis_through_zero() {
    let point = |turn: &str| format!("{{X 1170,Y 0,Z 1640,A 0,B 180,C 0,S 2,T {turn}}}");
    let nominal = kr60();
    for (seed, before) in [(1, "2"), (2, "'B000010'"), (3, "'H02'")] {
        let text = format!("DEF P()\n$TOOL=$NULLFRAME\n$BASE=$NULLFRAME\nPTP {}\nEND\n", point(before));
        let files = Files { source: Text { file: "P.src", text: &text }, data: None, config: None };
        let program = read(files, Given::default()).unwrap();
        let robot = identified(seed);
        let corrected = compensate(files, &program, &robot, 20.0).unwrap();
        let again = Files { source: Text { file: "P.src", text: &corrected.source }, ..files };
        let points = read(again, Given::default()).unwrap().points;
        let Target::Pose { xyz_mm, abc_deg, status, turn } = points[0].target else { panic!("no pose") };
        let there = Pose::from_kuka(xyz_mm, abc_deg);
        let flange = Robot {
            geometry: Geometry { tool: Vector3::zeros(), ..nominal.geometry.clone() },
            ..nominal.clone()
        };
        let new = turn.unwrap() as u8;
        let axes = inverse::from_status_turn(&flange, &there, status.unwrap() as u8, new).unwrap();
        // Taught at 0, -90, 90, 0, 90, 0: far from a full turn.
        for (axis, taught) in axes.iter().zip([0.0, -90.0, 90.0, 0.0, 90.0, 0.0]) {
            assert!((axis.to_degrees() - taught).abs() < 1.0, "seed {seed}: {axes:?}");
        }
        assert_eq!(corrected.moved[0].turn_bits, (new != 2).then_some([2, new]));
        let form = before.len();
        let written =
            corrected.source.split(",T ").nth(1).map(|rest| rest.split('}').next().unwrap().to_owned());
        let written = written.unwrap_or_default();
        assert!(
            new == 2 || form == 1 || written.len() == form,
            "{written} for {before}: {}",
            corrected.source
        );
        assert_eq!(inverse::turn(&axes), new);
    }
}
