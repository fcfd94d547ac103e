//! From the plan to the corrected program for an arm of each make with a supported language and of each geometry, through the files
//! and the simulated controller: the true 3-D error before and after.

use std::fs;
use std::path::Path;

use dbbd_job::program::Correction;
use dbbd_job::program::fanuc::{self, GivenFrames};
use dbbd_job::program::{Language, Program, Text, krl, rapid, urscript};
use dbbd_job::robot_description;
use dbbd_job::sim::truth;
use dbbd_model::math::aligned_distances;
use dbbd_model::robot::inverse::FanucConfiguration;
use dbbd_model::robot::pose::rotation_vector;
use dbbd_model::robot::{ControllerModel, Geometry, Robot, inverse, max_axis_difference};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use tempfile::tempdir;

use crate::cell::named;
use crate::cell::{codes, dbbd, kr60, stderr};
use crate::process::Simulator;
use crate::support::makes::{job, run};

/// An arm with its language.
struct Arm {
    language: Language,
    /// A built-in robot, or that of [`offset_wrist`].
    name: &'static str,
    /// Position of the base ball, mm.
    centre: [f64; 3],
    /// Largest remaining mean 3-D error, mm: more for an arm of 2 m.
    max_mm: f64,
    /// Axis angles of its production program, degrees.
    range_deg: [[f64; 2]; 6],
}

const OFFSET_WRIST: &str = "offset wrist";
const KUKA_DEG: [[f64; 2]; 6] =
    [[-40.0, 40.0], [-100.0, -50.0], [60.0, 120.0], [-60.0, 60.0], [20.0, 80.0], [-60.0, 60.0]];
const KUKA: Arm = Arm {
    language: Language::Krl,
    name: "kr16r2010-2",
    centre: [1300.0, 0.0, 800.0],
    max_mm: 0.1,
    range_deg: KUKA_DEG,
};
const OFFSET: Arm = Arm { name: OFFSET_WRIST, centre: [1400.0, -300.0, 700.0], ..KUKA };
const FANUC: Arm = Arm {
    language: Language::Fanuc,
    name: "m10id12",
    centre: [900.0, 0.0, 300.0],
    max_mm: 0.05,
    range_deg: [[-40.0, 40.0], [-20.0, 40.0], [-40.0, 20.0], [-60.0, 60.0], [-100.0, -40.0], [-60.0, 60.0]],
};
const CRX: Arm = Arm { name: "crx10ia", centre: [650.0, -150.0, 200.0], ..FANUC };
const ABB: Arm = Arm {
    language: Language::Rapid,
    name: "irb1600-10-145",
    centre: [900.0, 0.0, 850.0],
    max_mm: 0.05,
    range_deg: [[-40.0, 40.0], [-20.0, 40.0], [-20.0, 30.0], [-60.0, 60.0], [20.0, 80.0], [-60.0, 60.0]],
};
const UR: Arm = Arm {
    language: Language::Urscript,
    name: "ur10",
    centre: [700.0, 0.0, 300.0],
    max_mm: 0.05,
    range_deg: [
        [-40.0, 40.0],
        [-110.0, -60.0],
        [60.0, 120.0],
        [-120.0, -60.0],
        [-120.0, -60.0],
        [-60.0, 60.0],
    ],
};

/// The table of a UR10 in a controller: differences of some tenths of a millimetre and degrees, and parallel axes whose offsets cancel
/// each other.
const FACTORY_TABLE: &str = "[mounting]\n\
    delta_theta = [0.0004, -0.31, 0.33, -0.02, 0.0007, 0.0]\n\
    delta_a = [0.00004, -0.0009, 0.0007, 0.00004, -0.00002, 0]\n\
    delta_d = [0.0001, 121.7, -128.2, 6.5, 0.0002, -0.0001]\n\
    delta_alpha = [-0.0006, 0.0002, -0.0021, 0.0006, -0.0007, 0]\n";
const FACTORY: Arm = Arm { name: "ur10 with its factory table", ..UR };

fn with_factory_table() -> Robot {
    let like = named(UR.name);
    let known = robot_description::KnownOfRobot { like: Some(&like), ..Default::default() };
    let found = robot_description::import("calibration.conf", FACTORY_TABLE, known);
    Robot { name: FACTORY.name.into(), ..found.unwrap().robot }
}

/// A KR 60 HA with the wrist of a CRX-10iA/L, which has no closed form: axes 4 and 6 have a distance of 150 mm.
fn offset_wrist() -> Robot {
    let mut robot = Robot { name: OFFSET_WRIST.into(), language: Some("krl".into()), ..kr60() };
    robot.geometry.rows[4].d = 150.0;
    robot
}

impl Arm {
    fn robot(&self) -> Robot {
        let robot = match self.name {
            OFFSET_WRIST => offset_wrist(),
            name if name == FACTORY.name => with_factory_table(),
            // The simulated controller computes with the table of the file.
            name => Robot { controller_model: ControllerModel::Nominal, ..named(name) },
        };
        Robot { language: Some(self.language.name().into()), ..robot }
    }
}

fn numbers(list: &[f64], decimals: usize) -> String {
    list.iter().map(|number| format!("{number:.decimals$}")).collect::<Vec<_>>().join(",")
}

/// A program in the language of an arm with random targets, and the targets.
fn production(arm: &Arm, robot: &Robot, count: usize) -> (String, Vec<Vector3<f64>>) {
    let mut random = Pcg64::seed_from_u64(7);
    let tool: [f64; 3] = robot.geometry.tool.into();
    let (mut data, mut moves, mut wanted) = (String::new(), String::new(), Vec::new());
    for number in 1..=count {
        let axes = arm.range_deg.map(|[low, high]| random.random_range(low..high).to_radians());
        let ball = robot.geometry.ball(&axes);
        let place: [f64; 3] = ball.position.into();
        wanted.push(ball.position);
        match arm.language {
            Language::Krl => {
                let ([x, y, z], [a, b, c]) = (place, ball.abc_deg());
                let (s, t) = (inverse::status(&robot.geometry, &axes), inverse::turn(&axes));
                moves += &format!(
                    "PTP {{X {x:.3},Y {y:.3},Z {z:.3},A {a:.4},B {b:.4},C {c:.4},S {s},T {t}}}\nWAIT SEC 1\n"
                );
            }
            Language::Rapid => {
                let [a, b, c, d] = inverse::quadrants(&robot.geometry, &axes);
                data += &format!(
                    "  CONST robtarget p{number}:=[[{}],[{}],[{a},{b},{c},{d}],[9E9,9E9,9E9,9E9,9E9,9E9]];\n",
                    numbers(&place, 3),
                    numbers(&ball.quaternion(), 8)
                );
                moves += &format!("    MoveJ p{number},v200,fine,tBall;\n    WaitTime 1;\n");
            }
            Language::Fanuc => {
                let frames = format!("P[{number}]{{\n   GP1:\n\tUF : 0, UT : 1,");
                let listed = |names: [&str; 6], numbers: [f64; 6]| -> String {
                    let unit = |at: usize| if names[0] == "X" && at < 3 { "mm" } else { "deg" };
                    let pairs = (0..6).map(|at| format!("\t{} = {:.3} {}", names[at], numbers[at], unit(at)));
                    pairs.collect::<Vec<_>>().join(",\n")
                };
                let ([x, y, z], [a, b, c]) = (place, ball.abc_deg());
                let numbers = match FanucConfiguration::certain(&robot.geometry, &axes) {
                    Some(config) => {
                        let pose = listed(["X", "Y", "Z", "W", "P", "R"], [x, y, z, c, b, a]);
                        format!("\t\tCONFIG : '{config}',\n{pose}")
                    }
                    None => {
                        let angles = axes.map(f64::to_degrees);
                        format!("\t\n{}", listed(["J1", "J2", "J3", "J4", "J5", "J6"], angles))
                    }
                };
                data += &format!("{frames}{numbers}\n}};\n");
                moves += &format!("   1:J P[{number}] 50% FINE    ;\n   1:  WAIT   1.00(sec) ;\n");
            }
            Language::Urscript => {
                let turn: [f64; 3] = rotation_vector(&ball.rotation).into();
                let pose = format!("p[{},{}]", numbers(&place.map(|x| x * 1e-3), 7), numbers(&turn, 7));
                let near = numbers(&axes.map(|angle| angle + 0.02), 3);
                moves += &format!("  movej([{near}])\n  movej({pose}, a=1.0, v=0.5)\n  sleep(1.0)\n");
            }
        }
    }
    let text = match arm.language {
        Language::Krl => {
            let frame = |[x, y, z]: [f64; 3]| format!("{{X {x:.3},Y {y:.3},Z {z:.3},A 0.0,B 0.0,C 0.0}}");
            format!("DEF P ( )\n$TOOL={}\n$BASE={}\n{moves}END\n", frame(tool), frame([0.0; 3]))
        }
        Language::Rapid => format!(
            "MODULE Prod\n  PERS tooldata tBall:=[TRUE,[[{}],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n{data}  PROC main()\n\
             {moves}  ENDPROC\nENDMODULE\n",
            numbers(&tool, 3)
        ),
        Language::Fanuc => {
            let [x, y, z] = tool;
            let frame = format!(
                "P[{}]{{\n   GP1:\n\tUF : 0, UT : 0,\t\tCONFIG : 'N U T, 0, 0, 0',\n\tX = {x:.3} mm,\tY = {y:.3} mm,\tZ = {z:.3} mm,\n\tW = 0.000 deg,\tP = 0.000 deg,\tR = 0.000 deg\n}};\n",
                count + 1
            );
            let set = format!(
                "   1:  PR[1]=P[{}] ;\n   2:  UTOOL[1]=PR[1] ;\n   3:  UTOOL_NUM=1 ;\n   4:  UFRAME_NUM=0 ;\n",
                count + 1
            );
            format!("/PROG  PROD\n/ATTR\n/MN\n{set}{moves}/POS\n{data}{frame}/END\n")
        }
        Language::Urscript => {
            format!("def prod():\n  set_tcp(p[{},0,0,0])\n{moves}end\n", numbers(&tool.map(|x| x * 1e-3), 6))
        }
    };
    (text, wanted)
}

/// The position of a robot at the end of each wait of a program.
fn stops(language: Language, text: &str, nominal: &Robot, robot: &Robot) -> Vec<Vector3<f64>> {
    let file = ("P".to_owned(), text.to_owned());
    let program: Program = match language {
        Language::Krl => {
            let source = |name: &str| Ok((name == "P.src").then(|| (name.to_owned(), text.to_owned())));
            krl::Program::open("P", source).unwrap().into()
        }
        Language::Rapid => rapid::open(file, vec![]).unwrap().into(),
        Language::Urscript => urscript::open(file).unwrap().into(),
        Language::Fanuc => fanuc::open(file, vec![]).unwrap().into(),
    };
    let there = Geometry { tool: nominal.geometry.tool, ..robot.geometry.clone() };
    let mut stops: Vec<Vector3<f64>> = Vec::new();
    for moment in run(program, nominal) {
        stops.resize(moment.motions as usize, Vector3::zeros());
        if let Some(stop) = stops.last_mut() {
            *stop = there.ball(&moment.axes).position;
        }
    }
    // In a script every second motion is only an approach.
    let step = if language == Language::Urscript { 2 } else { 1 };
    stops.into_iter().skip(step - 1).step_by(step).collect()
}

/// A tool ball off the flange axis.
fn with_ball(name: &str) -> Robot {
    let mut robot = named(name);
    robot.geometry.tool = Vector3::new(30.0, 20.0, 60.0);
    robot
}

#[test]
fn corrected_programs_reach_the_nominal_positions() {
    for arm in [ABB, UR, FANUC] {
        let (language, nominal) = (arm.language, with_ball(arm.name));
        // The identified robot is the true one: only the rounding of numbers remains, at most half a micrometre.
        let found =
            Robot { nominal: Some(Box::new(nominal.clone())), ..truth::draw_true_robot(&nominal, 3, 1.0) };
        let (text, wanted) = production(&arm, &nominal, 20);
        let file = Text { file: "P", text: &text };
        let (corrected, moved) = match language {
            Language::Rapid => {
                rapid::read(file, None).unwrap().compensate(file, Correction::of(&found, 50.0))
            }
            Language::Fanuc => fanuc::read(file, GivenFrames::default())
                .unwrap()
                .compensate(file, Correction::of(&found, 50.0)),
            _ => urscript::read(file, None).unwrap().compensate(file, Correction::of(&found, 50.0)),
        }
        .unwrap();
        assert_eq!(moved.len(), if language == Language::Urscript { 40 } else { 20 });
        let [before, after] = [&text, &corrected].map(|text| {
            let off = aligned_distances(&stops(language, text, &nominal, &found), &wanted);
            off.iter().sum::<f64>() / off.len() as f64
        });
        eprintln!("{language:?}: {before:.4} mm before, {after:.5} mm after");
        assert!(before > 0.2 && after < 0.002, "{language:?}: {before} {after}");
        // Only numbers change.
        let shape = |text: &str| text.replace(|c: char| c.is_ascii_digit() || "-.".contains(c), "");
        assert_eq!(shape(&text), shape(&corrected));
    }
}

/// Error of each coordinate of the tool ball at each stop.
const WORLD: &str = "repeatability_um = 20.0\n[bar]\nstroke_mm = [-15.0, 15.0]\nnoise_um = 1.0\n";

/// Runs a step; exit code 3 (a warning) is a result as well.
fn step(dir: &Path, args: &str) -> Vec<String> {
    let args: Vec<&str> = args.split_whitespace().collect();
    let output = dbbd(dir, &args);
    assert!(matches!(output.status.code(), Some(0 | 3)), "dbbd {}: {}", args.join(" "), stderr(&output));
    codes(&output)
}

/// The closed loop through the files of a language: plan, program, simulate, acquire, sync, identify, compensate. Returns the number
/// of dwells with a length and of all, and the mean 3-D error of a production program before and after, mm.
fn closed_loop(arm: &Arm, job: &str, seed: u64) -> ([usize; 2], [f64; 2]) {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let (language, nominal) = (arm.language, arm.robot());
    let robot = truth::draw_true_robot(&nominal, seed, 1.0);
    let write = |file: &str, text: String| fs::write(at.join(file), text).unwrap();
    write("nominal.toml", nominal.to_toml().unwrap());
    write("truth.toml", robot.to_toml().unwrap());
    write("job.toml", job.into());
    write("world.toml", WORLD.into());
    step(at, "plan job.toml --out plan --quiet");
    step(at, "program plan/plan.csv --out program --sync output --quiet");
    let (main, production_file) = match language {
        Language::Krl => ("DBB_MAIN.src", "P.src"),
        Language::Rapid => ("DBB_MAIN.mod", "P.mod"),
        Language::Urscript => ("DBB_MAIN.script", "P.script"),
        Language::Fanuc => ("DBB_MAIN.ls", "P.ls"),
    };
    let program = ["--program", &format!("program/{main}"), "--nominal", "nominal.toml", "--speed", "0"];
    let truth = ["--robot", "truth.toml", "--world", "world.toml", "--seed", &seed.to_string()];
    let bar = ["--link", "link", "--quiet"];
    let simulator = Simulator::start(at, &[&program[..], &truth, &bar].concat());
    step(at, "acquire --port link --plan plan/plan.csv --out run.dbbd --quiet");
    let simulated = simulator.finished();
    assert!(simulated.status.success(), "{}", stderr(&simulated));
    step(at, "sync run.dbbd --out obs.csv --quiet");
    step(
        at,
        "identify obs.csv --robot nominal.toml --centres plan/centres.csv --sigma 0.02 --hold bar --prior datasheet --folds 0 \
         --out result --quiet",
    );
    let lines = |file: &str| fs::read_to_string(at.join(file)).unwrap();
    let dwells = lines("plan/plan.csv")
        .lines()
        .filter(|line| line.contains(",measure,") || line.contains(",reference,"))
        .count();
    let lengths = lines("obs.csv").lines().count() - 1;
    let (text, wanted) = production(arm, &nominal, 100);
    write(production_file, text.clone());
    let args = format!(
        "compensate {production_file} --robot result/robot-identified.toml --limit 50 --out new --replace --quiet"
    );
    step(at, &args);
    let corrected = lines(&format!("new/{production_file}"));
    let errors = [&text, &corrected].map(|text| {
        let off = aligned_distances(&stops(language, text, &nominal, &robot), &wanted);
        off.iter().sum::<f64>() / off.len() as f64
    });
    ([lengths, dwells], errors)
}

/// A controller with a factory table is elsewhere than planned at a Cartesian target, but for a robot whose controller is unknown
/// every dwell is at the planned axis angles.
#[test]
fn dwells_of_an_unknown_controller_are_at_the_planned_axes() {
    let largest_deg = |robot: &Robot| {
        let dir = tempdir().unwrap();
        let at = dir.path();
        fs::write(at.join("robot.toml"), robot.to_toml().unwrap()).unwrap();
        fs::write(at.join("job.toml"), job("robot.toml", UR.centre, 8)).unwrap();
        step(at, "plan job.toml --out plan --quiet");
        step(at, "program plan/plan.csv --out program --sync output --quiet");
        let text = fs::read_to_string(at.join("program/DBB_MAIN.script")).unwrap();
        let mut dwells: Vec<[f64; 6]> = Vec::new();
        let mut was_high = false;
        for moment in run(urscript::open(("P".to_owned(), text)).unwrap(), &with_factory_table()) {
            // Pulses that mark the start and the end are short; a dwell lasts.
            if moment.strobe && was_high && dwells.last() != Some(&moment.axes) {
                dwells.push(moment.axes);
            }
            was_high = moment.strobe;
        }
        let plan = fs::read_to_string(at.join("plan/plan.csv")).unwrap();
        let mut rows = csv::Reader::from_reader(plan.as_bytes());
        let first = rows.headers().unwrap().iter().position(|name| name == "a1_deg").unwrap();
        let kind = rows.headers().unwrap().iter().position(|name| name == "kind").unwrap();
        let planned = rows.records().map(Result::unwrap).filter(|row| &row[kind] != "transit").map(|row| {
            std::array::from_fn::<f64, 6, _>(|axis| row[first + axis].parse::<f64>().unwrap().to_radians())
        });
        let nearest = |axes: [f64; 6]| {
            dwells.iter().map(|dwell| max_axis_difference(dwell, &axes)).fold(f64::INFINITY, f64::min)
        };
        planned.map(nearest).fold(0.0, f64::max).to_degrees()
    };
    let unknown = named(UR.name);
    assert_eq!(unknown.controller_model, ControllerModel::Unknown);
    let [by_joints, by_poses] = [unknown, UR.robot()].map(|robot| largest_deg(&robot));
    assert!(by_joints < 1e-6 && by_poses > 0.02, "{by_joints} {by_poses}");
}

/// The lengths are too few to determine a robot, but they pass through every step.
#[test]
#[cfg(unix)]
fn every_dwell_of_each_make_is_matched() {
    for arm in [KUKA, OFFSET, FANUC, CRX, ABB, UR, FACTORY] {
        let ([lengths, dwells], _) = closed_loop(&arm, &job("nominal.toml", arm.centre, 8), 1);
        assert_eq!((lengths, dwells > 0), (dwells, true), "{}", arm.name);
    }
}

/// `cargo test --release --test suite chosen_poses_of_each_make -- --ignored --nocapture`: docs/evidence/README.md.
#[test]
#[cfg(unix)]
#[ignore = "takes minutes"]
fn chosen_poses_of_each_make() {
    let mut wrong: Vec<String> = Vec::new();
    for arm in [KUKA, OFFSET, FANUC, CRX, ABB, UR, FACTORY] {
        let [low, high] = [-250.0, 250.0].map(|side| arm.centre.map(|middle| middle + side));
        let text = job("nominal.toml", arm.centre, 8);
        let text = text.split("[[circle]]").next().unwrap_or_default();
        let text = format!("{text}[optimise]\npoints = 60\nworkspace_mm = [{low:?}, {high:?}]\n");
        for seed in 1..=3 {
            let ([lengths, dwells], [before, after]) = closed_loop(&arm, &text, seed);
            let line = format!(
                "{}, robot {seed}: {lengths} of {dwells} dwells; {before:.3} mm before, {after:.4} mm after",
                arm.name
            );
            eprintln!("{line}");
            if lengths != dwells || after >= arm.max_mm {
                wrong.push(line);
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
