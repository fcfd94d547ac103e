//! Every kind of plan is executed on robots that are drawn, with the base balls where the documents put them: where the true
//! tool ball is at the taught angles. The bar stays in its stroke at the rate that the plans state.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use dbbd_job::plan::{CheckQuantity, Plan};
use dbbd_job::recording::run::read_plan;
use dbbd_job::sim::truth;
use dbbd_model::estimation::with_drawn_joint_errors;
use dbbd_model::measurement::PreparedMeasurement;
use dbbd_model::robot::Robot;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use tempfile::tempdir;

use crate::cell::{codes, dbbd, kr60, stderr};
use crate::process::Simulator;
use crate::stages_allow_every_pose::{Cell, execute};
use crate::support::drawn_robots::drawn_at;

/// The taught angles of both balls of the jobs, degrees.
const TAUGHT_DEG: [[f64; 6]; 2] = [
    [-2.8178, -61.2356, 116.7537, 13.6265, 57.4349, -206.6011],
    [-39.3926, -80.8698, 118.5950, 9.0813, 68.0267, -235.7499],
];
const XYZ_MM: [[f64; 3]; 2] = [[1300.0, 0.0, 800.0], [950.0, 700.0, 1100.0]];
const CIRCLE: &str = "[[circle]]\nplane = \"XY\"\npoints = 24\namplitude_deg = 25.0\ntilt_deg = 30.0\n";
const CHOSEN: &str = "[optimise]\npoints = 40\nstage_points = 16\ncandidates = 600\n";
/// Standard deviation of each coordinate of the tool ball at a stop, and of a ball that is mounted again, mm.
const POSE_MM: f64 = 0.014;
const SEAT_MM: f64 = 0.01;

/// A job with the first balls, taught or not, and its poses.
fn job(stroke_mm: f64, balls: usize, taught: bool, poses: &str) -> String {
    let centre = |at: usize| {
        let angles = if taught { format!("taught_deg = {:?}\n", TAUGHT_DEG[at]) } else { String::new() };
        format!("[[centre]]\nid = {}\nxyz_mm = {:?}\n{angles}", at + 1, XYZ_MM[at])
    };
    format!(
        "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nlength_u_mm = 0.002\nstroke_mm = [-{stroke_mm}, {stroke_mm}]\n\
         margin_mm = 0.1\n{}{poses}",
        (0..balls).map(centre).collect::<String>()
    )
}

/// What became of the plans of one kind.
#[derive(Clone, Copy, Default, Debug)]
struct Executed {
    refused: usize,
    runs: usize,
    left: usize,
    /// The sum of the stated risks.
    risk: f64,
    /// The greatest |reading|, mm.
    worst_mm: f64,
}

/// One robot in its cell, in a directory of its own.
struct DrawnCell<'a> {
    at: &'a Path,
    stroke_mm: f64,
    true_robot: Robot,
    random: Pcg64,
    found: BTreeMap<String, Executed>,
}

impl DrawnCell<'_> {
    fn normal(&mut self, sd: f64) -> f64 {
        sd * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut self.random)
    }

    fn scattered(&mut self, sd: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.normal(sd))
    }

    /// Runs a command that ends with a result; `None` if it is refused.
    fn done(&self, command: &str) -> Option<()> {
        let output = dbbd(self.at, &command.split_whitespace().collect::<Vec<_>>());
        match output.status.code() {
            Some(0 | 3) => Some(()),
            Some(1) => None,
            _ => panic!("{command}: {}", stderr(&output)),
        }
    }

    /// Plans, mounts tool ball and base balls, and executes the plan. `None` if the plan is refused.
    fn run(&mut self, kind: &str, plan: &str, out: &str) -> Option<(Plan, Vec<PreparedMeasurement>)> {
        let kind = format!("{kind}, {} mm", self.stroke_mm);
        let planned = self.done(&format!("plan {plan} --out {out} --quiet"));
        if planned.is_none() {
            self.found.entry(kind).or_default().refused += 1;
            return None;
        }
        let plan = read_plan(&self.at.join(out).join("plan.csv")).unwrap();
        let mut true_robot = self.true_robot.clone();
        true_robot.geometry.tool += self.scattered(SEAT_MM);
        let mut world = format!("repeatability_um = {}\n[bar]\nnoise_um = 2.0\n", 1e3 * POSE_MM);
        for ball in plan.taught() {
            let tool_ball = true_robot.geometry.ball(&ball.axes_deg.map(f64::to_radians)).position;
            let place: [f64; 3] = (tool_ball + self.scattered(POSE_MM)).into();
            world += &format!("[[centre]]\nid = {}\nxyz_mm = {place:?}\n", ball.centre);
        }
        let cell = Cell { nominal: kr60(), true_robot, world };
        let seed = self.found.values().map(|kind| kind.runs as u64).sum();
        let (worst_mm, lengths) = execute(&plan, &cell, seed);
        let risks = plan.header.checks.iter().filter(|check| check.quantity == CheckQuantity::RunRisk);
        let entry = self.found.entry(kind).or_default();
        entry.runs += 1;
        entry.left += usize::from(worst_mm > self.stroke_mm);
        entry.risk += risks.map(|check| check.worst).fold(0.0, f64::max);
        entry.worst_mm = entry.worst_mm.max(worst_mm);
        Some((plan, lengths))
    }

    /// Writes the lengths as a table.
    fn table(&self, name: &str, plan: &Plan, lengths: &[PreparedMeasurement]) {
        let mut table = "index,centre,a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,length_mm\n".to_owned();
        let dwells = plan.rows.iter().filter(|row| row.kind != dbbd_job::plan::PoseKind::Transit);
        for (row, length) in dwells.zip(lengths) {
            let axes: Vec<String> = row.axes_deg.iter().map(f64::to_string).collect();
            table += &format!(
                "{},{},{},{:.5}\n",
                row.index,
                row.centre.number(),
                axes.join(","),
                length.length_mm
            );
        }
        fs::write(self.at.join(name), table).unwrap();
    }

    /// Stages until every pose is allowed; the tables of their lengths. `None` if one is refused.
    fn stages(&mut self) -> Option<String> {
        let (mut measured, mut tables) = (String::new(), String::new());
        for stage in 1..=6 {
            let plan = format!("chosen.toml {measured}");
            let kind = if stage == 1 { "first stage" } else { "later stage" };
            let (plan, lengths) = self.run(kind, &plan, &format!("stage{stage}"))?;
            let name = format!("lengths{stage}.csv");
            self.table(&name, &plan, &lengths);
            measured += &format!(" --measured {name}");
            tables += &format!(" {name}");
            if plan.header.stage.is_none() {
                return Some(tables);
            }
        }
        Some(tables)
    }

    fn all_kinds(&mut self) {
        let stroke_mm = self.stroke_mm;
        let jobs = [
            ("circle", 1, true, CIRCLE),
            ("chosen", 1, true, CHOSEN),
            ("two", 2, true, CHOSEN),
            ("untaught", 1, false, CHOSEN),
            ("second", 2, false, CIRCLE),
        ];
        for (name, balls, taught, poses) in jobs {
            let poses = poses.replace(
                "[[circle]]\n",
                if name == "second" { "[[circle]]\ncentre = 2\n" } else { "[[circle]]\n" },
            );
            fs::write(self.at.join(format!("{name}.toml")), job(stroke_mm, balls, taught, &poses)).unwrap();
        }
        self.run("circle", "circle.toml", "circle");
        let Some(tables) = self.stages() else { return };
        self.done(&format!("identify {tables} --same-setup --robot kr60ha --tool 30,20,10 --centres stage1/centres.csv --prior datasheet --folds 0 --quiet --out result")).unwrap();
        let identified = "--robot result/robot-identified.toml";
        for (kind, plan) in [
            ("check", "--check chosen.toml"),
            ("check of a ball that is taught by the plan", "--check untaught.toml"),
            ("check with two balls", "--check two.toml"),
            ("renewal", "--renew chosen.toml"),
            ("identified circle", "circle.toml"),
            ("identified chosen", "chosen.toml"),
            ("further ball", "second.toml"),
        ] {
            self.run(kind, &format!("{plan} {identified}"), &kind.replace(' ', "-"));
        }
        // Some poses of the first run, as another robot left them: which poses remain is all that counts.
        if self.done("acquire --port sim --plan stage1/plan.csv --out run.dbbd --quiet").is_some() {
            let bytes = fs::read(self.at.join("run.dbbd")).unwrap();
            fs::write(self.at.join("part.dbbd"), &bytes[..bytes.len() / 2]).unwrap();
            self.run("remaining", "chosen.toml --remaining part.dbbd", "remaining");
            self.run(
                "remaining, identified",
                &format!("chosen.toml --remaining part.dbbd {identified}"),
                "remaining-identified",
            );
            self.run("repeat", "chosen.toml --repeat run.dbbd", "repeat");
        }
    }
}

fn campaign(seeds: std::ops::Range<u64>) -> BTreeMap<String, Executed> {
    let mut all = BTreeMap::<String, Executed>::new();
    for seed in seeds {
        for stroke_mm in [1.0, 5.0] {
            let dir = tempdir().unwrap();
            let mut true_robot = with_drawn_joint_errors(&truth::draw_true_robot(&kr60(), seed, 1.0), seed);
            let mut random = Pcg64::seed_from_u64(seed);
            let off = Vector3::from_fn(|_, _| {
                kr60().ball_u_mm * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut random)
            });
            true_robot.geometry.tool += off;
            let mut cell =
                DrawnCell { at: dir.path(), stroke_mm, true_robot, random, found: BTreeMap::new() };
            cell.all_kinds();
            for (kind, one) in cell.found {
                if one.left > 0 {
                    eprintln!("seed {seed}: {kind}: {one:?}");
                }
                let entry = all.entry(kind).or_default();
                entry.refused += one.refused;
                entry.runs += one.runs;
                entry.left += one.left;
                entry.risk += one.risk;
                entry.worst_mm = entry.worst_mm.max(one.worst_mm);
            }
        }
    }
    for (kind, one) in &all {
        eprintln!("{kind}: {one:.3?}");
    }
    all
}

/// The smallest number of runs that leave the stroke with a probability below 1 % where `expected` are stated (Poisson).
fn most(expected: f64) -> usize {
    let (mut term, mut sum, mut count) = ((-expected).exp(), (-expected).exp(), 0);
    while sum < 0.99 {
        count += 1;
        term *= expected / count as f64;
        sum += term;
    }
    count
}

fn assert_stated(found: &BTreeMap<String, Executed>) {
    let left: usize = found.values().map(|one| one.left).sum();
    let risk: f64 = found.values().map(|one| one.risk).sum();
    assert!(left <= most(risk), "{left} left the stroke, {risk:.4} were stated");
}

/// The joints of this robot are so wrong that plans by the tolerance of its geometry alone leave a stroke of 1 mm three times, by up to
/// 0.81 mm.
#[test]
fn every_kind_of_plan_keeps_the_stroke() {
    let found = campaign(106..107);
    assert_stated(&found);
    let runs: usize = found.values().map(|one| one.runs).sum();
    assert!(found.len() >= 20 && runs >= 20, "{found:?}");
}

/// `cargo test --release --test suite sixty_robots_keep_the_stroke -- --ignored --nocapture`
#[test]
#[ignore = "takes half an hour"]
fn sixty_robots_keep_the_stroke() {
    let first: u64 = std::env::var("STROKE_FROM").ok().and_then(|from| from.parse().ok()).unwrap_or(100);
    let robots: u64 = std::env::var("STROKE_ROBOTS").ok().and_then(|count| count.parse().ok()).unwrap_or(60);
    assert_stated(&campaign(first..first + robots));
}

/// The ball is 5 mm from where it was taught: the bar leaves its stroke at some dwells. That is said, and no fault of the
/// mounting.
#[test]
fn a_bar_out_of_its_stroke_is_named() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let done = |args: &str| {
        let output = dbbd(at, &args.split_whitespace().collect::<Vec<_>>());
        assert!(matches!(output.status.code(), Some(0 | 3)), "{args}: {}", stderr(&output));
        codes(&output)
    };
    fs::write(at.join("job.toml"), job(3.0, 1, true, CIRCLE)).unwrap();
    let [x, y, z] = XYZ_MM[0];
    fs::write(at.join("world.toml"), format!("[[centre]]\nid = 1\nxyz_mm = [{}, {y}, {z}]\n", x + 5.0))
        .unwrap();
    done("plan job.toml --out plan --quiet");
    done("krl plan/plan.csv --out krl --quiet");
    let world = ["--program", "krl/DBB_MAIN.src", "--world", "world.toml", "--speed", "0", "--link", "link"];
    let simulator = Simulator::start(at, &world);
    done("acquire --port link --plan plan/plan.csv --out run.dbbd --quiet");
    // It warns of the readings that are out of its stroke.
    assert_eq!(simulator.finished().status.code(), Some(3));
    let output = dbbd(at, &["sync", "run.dbbd", "--out", "lengths.csv"]);
    let (said, text) = (codes(&output), stderr(&output));
    assert!(said.contains(&"W0285".to_owned()), "{said:?}");
    assert!(!said.iter().any(|code| ("W0280".."W0285").contains(&code.as_str())), "{said:?}");
    // Each dwell counts: of 26 with a ball that is 5 mm off in one direction about a third is beyond 3 mm on either side.
    let dwells =
        text.split("or off, when ").nth(1).and_then(|rest| rest.split(' ').next()?.parse::<u32>().ok());
    assert!(dwells.is_some_and(|dwells| (4..=22).contains(&dwells)), "{text}");
}

/// A program of a plan is corrected about the ball as it is mounted: with a bar of ±1 mm every pose of the corrected circle has its
/// length, which the circle about the ball where the nominal robot has it would leave by millimetres.
#[test]
fn a_corrected_circle_keeps_the_stroke() {
    for seed in [1, 2, 3] {
        let dir = tempdir().unwrap();
        let at = dir.path();
        let run = |args: &str| {
            let output = dbbd(at, &args.split_whitespace().collect::<Vec<_>>());
            (output.status.code(), codes(&output), stderr(&output))
        };
        let done = |args: &str| {
            let (code, said, text) = run(args);
            assert!(matches!(code, Some(0 | 3)), "{args}: {text}");
            said
        };
        // What is identified is the truth: what is left is the correction.
        let truth = drawn_at(seed, 1.0);
        let nominal = Some(Box::new(kr60()));
        let identified = Robot { name: kr60().name, nominal, ..truth.clone() };
        let off_mm = {
            let taught = TAUGHT_DEG[0].map(f64::to_radians);
            (truth.geometry.ball(&taught).position - kr60().geometry.ball(&taught).position).norm()
        };
        assert!(off_mm > 0.5, "{off_mm}");
        fs::write(at.join("identified.toml"), identified.to_toml().unwrap()).unwrap();
        fs::write(at.join("truth.toml"), truth.to_toml().unwrap()).unwrap();
        let taught = TAUGHT_DEG[0];
        fs::write(at.join("world.toml"), format!("[[centre]]\nid = 1\ntaught_deg = {taught:?}\n")).unwrap();
        // Planned with a long bar: nothing is known of the robot. The corrected program is for a short one.
        fs::write(at.join("job.toml"), job(9.0, 1, true, CIRCLE)).unwrap();
        done("plan job.toml --out plan --quiet");
        done("krl plan/plan.csv --out krl --quiet");
        done("compensate krl/DBB_C001.src --robot identified.toml --out corrected --quiet");
        for name in ["DBB_MAIN.src", "DBB_MAIN.dat"] {
            fs::copy(at.join("krl").join(name), at.join("corrected").join(name)).unwrap();
        }
        let program =
            ["--program", "corrected/DBB_MAIN.src", "--robot", "truth.toml", "--world", "world.toml"];
        let simulator = Simulator::start(at, &[&program[..], &["--speed", "0", "--link", "link"]].concat());
        done("acquire --port link --plan plan/plan.csv --out run.dbbd --quiet");
        simulator.finished();
        done("sync run.dbbd --out lengths.csv");
        let lengths = fs::read_to_string(at.join("lengths.csv")).unwrap();
        let mut table = csv::Reader::from_reader(lengths.as_bytes());
        let column = table.headers().unwrap().iter().position(|name| name == "length_mm").unwrap();
        let readings: Vec<f64> =
            table.records().map(|row| row.unwrap()[column].parse::<f64>().unwrap() - 300.0).collect();
        let worst_mm = readings.iter().fold(0.0, |worst: f64, reading| worst.max(reading.abs()));
        // Backlash is corrected for the way to a target as it was planned.
        assert!(readings.len() >= 24 && worst_mm < 0.5, "seed {seed}: {off_mm} mm off, {readings:.3?}");
        // With a tool ball that is 12 mm away the bar would leave its stroke.
        let mut away = identified.clone();
        away.geometry.tool.x += 12.0;
        fs::write(at.join("away.toml"), away.to_toml().unwrap()).unwrap();
        let (code, said, text) =
            run("compensate krl/DBB_C001.src --robot away.toml --limit 50 --out away --quiet");
        assert!(code == Some(1) && said.contains(&"E0925".to_owned()), "{text}");
        // Without its plan the program is refused.
        fs::create_dir_all(at.join("alone/krl")).unwrap();
        for name in ["DBB_C001.src", "DBB_C001.dat"] {
            fs::copy(at.join("krl").join(name), at.join("alone/krl").join(name)).unwrap();
        }
        let alone = "compensate alone/krl/DBB_C001.src --robot identified.toml --out new --quiet";
        let (code, said, text) = run(alone);
        assert_eq!((code, said), (Some(1), vec!["E0924".to_owned()]), "{text}");
        done(&format!("{alone} --plan plan/plan.csv"));
    }
}
