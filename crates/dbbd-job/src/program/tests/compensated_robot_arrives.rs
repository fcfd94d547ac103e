//! With a compensated program the identified robot reaches the nominal positions.

use std::fs;
use std::path::{Path, PathBuf};

use dbbd_job::program::Correction;
use dbbd_job::program::krl::{Compensated, Files, Given, PointProgram, Text, compensate, read};
use dbbd_job::program::{Frames, Target};
use dbbd_job::sim::truth;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::{Geometry, Pose, Robot, inverse};
use nalgebra::Vector3;

use crate::test_support::cell::kr60;

fn fixture(name: &str) -> String {
    let path: PathBuf = [env!("CARGO_MANIFEST_DIR"), "../../fixtures/krl", name].iter().collect();
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
    let done = compensate(files, &program, Correction::of(robot, 20.0)).unwrap();
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
    ("$TOOL=F1\n$BASE=F1\nSUB()\nPTP XP1\nEND\nDEF SUB()\n$TOOL=F1:F1\n", "E0901", 5, 1),
    ("$TOOL=F1\n$BASE=F1\nXP1.X=10.0\nPTP XP1\n", "E0903", 5, 5),
    ("$TOOL=F1\n$BASE=F1\nLIN XP1:F1\n", "E0903", 4, 1),
    ("$TOOL=F1\n$BASE=F1\nLIN {X 10,Y 5,Z 1}\n", "E0903", 4, 5),
    ("$TOOL=F1\n$BASE=F1\nLIN {X 10,Y 5,Z N,A 0,B 0,C 0}\n", "E0903", 4, 5),
    ("$TOOL=F1\n$BASE=F1\nLIN {X 10,Y 5\n", "E0803", 4, 14),
    ("$TOOL=F1\n$BASE=F1\nPTP XP1\n$BASE={X 1,Y 0,Z 0,A 0,B 0,C 0}\nPTP XP1\n", "E0904", 6, 5),
    // The nominal robot does not reach it.
    ("$TOOL=F1\n$BASE=F1\nPTP XP1\nLIN {X 9000,Y 0,Z 0,A 0,B 0,C 0}\n", "E0906", 5, 5),
    // Nothing selects the branch.
    ("$TOOL=F1\n$BASE=F1\nLIN {X 1300,Y 0,Z 900,A 0,B 90,C 0}\n", "E0923", 4, 5),
    ("$TOOL=F1\n$BASE=F1\nPTP {X 1300,Y 0,Z 900,A 0,B 90,C 0}\n", "E0923", 4, 5),
];

/// The first finding about a program.
fn refusal(source: &str, given: Given) -> Option<Diagnostic> {
    let point = "{X 1363.778,Y -282.219,Z 1360.625,A 152.596,B 29.472,C -174.261,S 2,T 34}";
    let data =
        format!("DEFDAT P\nDECL E6POS XP1={point}\nDECL FRAME F1={{X 0,Y 0,Z 0,A 0,B 0,C 0}}\nENDDAT\n");
    let files = files(source, &data, None);
    match read(files, given) {
        Err(diagnostic) => Some(diagnostic),
        Ok(program) => {
            compensate(files, &program, Correction::of(&identified(1), 5.0)).err()?.into_iter().next()
        }
    }
}

#[test]
fn points_and_frames_unknown_before_the_run_are_refused() {
    let frames = "$TOOL=F1\n$BASE=$NULLFRAME\n";
    let code = |body: &str, given| {
        refusal(&format!("DEF P()\n{body}END\n"), given).map(|wrong| wrong.code().as_str())
    };
    assert_eq!(code(&format!("{frames}PTP XP1\n"), Given::default()), None);
    // A line that begins the program has the branch in which its point was taught.
    assert_eq!(code(&format!("{frames}LIN XP1\n"), Given::default()), None);
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
    let files_of = crate::test_support::circle_plan::plan(1, 6);
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
    compensate(given, &program, Correction::of(&robot, 20.0)).unwrap();
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
        compensate(files, &program, Correction::of(&identified(1), 20.0))
            .map_err(|refused| refused[0].code().as_str())
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
        let corrected = compensate(files, &program, Correction::of(&robot, 20.0)).unwrap();
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
