//! The findings of an identification of difficult data, by codes.

use std::fs;
use std::sync::Arc;

use dbbd_model::measurement::{CircleId, ContextColumn, Datum, MeasurementContext, Measurements, PoseKind};
use dbbd_model::robot::Tolerance;
use dbbd_model::robot::pose::rot_x;
use dbbd_model::robot::{BarId, Robot};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use tempfile::tempdir;

use crate::cell::{
    CENTRE, Circle, DESIGNED, centres_csv, codes, dbbd, horizontal, kr60, measure, three_planes, with_errors,
};

/// One run: measurements, arguments, and output.
struct Scene {
    robot: String,
    circles: Vec<Circle>,
    data: Measurements,
    args: Vec<&'static str>,
}

impl Scene {
    fn new(truth: &Robot, circles: &[Circle], points: usize, sigma_mm: f64, args: &[&'static str]) -> Self {
        let mut random = Pcg64::seed_from_u64(1);
        let mut data = measure(truth, circles, points, 25.0);
        for row in &mut data.rows {
            let z: f64 = StandardNormal.sample(&mut random);
            row.length_mm += sigma_mm * z;
        }
        Self { robot: kr60().to_toml().unwrap(), circles: circles.to_vec(), data, args: args.to_vec() }
    }

    fn spoilt(mut self, every: usize, mm: f64) -> Self {
        self.data.rows.iter_mut().step_by(every).for_each(|row| row.length_mm += mm);
        self
    }

    /// The codes that are reported.
    fn codes(&self) -> Vec<String> {
        let dir = tempdir().unwrap();
        let write = |name: &str, text: &str| fs::write(dir.path().join(name), text).unwrap();
        write("robot.toml", &self.robot);
        write("obs.csv", &self.data.to_csv());
        write("centres.csv", &centres_csv(&self.circles));
        write("headless.csv", "name,sd\na2,0.1\n");
        write("unit.csv", "name,unit,sd\na2,m,0.1\n");
        write("tight.csv", "name,unit,sd\na2,mm,0.1\n");
        write("negative.csv", "name,unit,sd\na2,mm,-0.1\n");
        write("plan.csv", "move,dwell_s\nptp,0.5\n");
        let args =
            ["identify", "obs.csv", "--robot", "robot.toml", "--centres", "centres.csv", "--out", "out"];
        let output = dbbd(dir.path(), &[&args[..], &self.args[..]].concat());
        codes(&output)
    }
}

/// The codes that the scenes provoke together.
const REPORTED: [&str; 18] = [
    "E1301", "E1304", "W1311", "W1312", "W1313", "I1314", "W1315", "W1316", "I1317", "W1319", "I1321",
    "W1324", "I1325", "E1305", "W1310", "I1320", "W1322", "I1323",
];

/// The data that provoke the codes.
fn scenes() -> Vec<Scene> {
    let truth = with_errors(DESIGNED);
    let flat = [horizontal(1, CENTRE)];
    let planes = three_planes(1, CENTRE);
    let thirteen = ["--estimate", "alpha1-5,a1-5,d4-6", "--folds", "0"];
    let mut scenes = vec![
        // Dependent parameters of a horizontal circle; predicted worse than the nominal robot.
        Scene::new(&truth, &flat, 80, 0.0, &["--estimate", "alpha1-5,a1-5,d2-6"]),
        Scene::new(&truth, &flat, 80, 0.002, &["--sigma", "0.002"]),
        Scene::new(&truth, &flat, 80, 0.01, &["--prior", "datasheet"]),
        // Poorly observable; fixed by the user; a validation file.
        Scene::new(&truth, &planes, 27, 0.02, &["--hold", "theta2", "--validate", "obs.csv"]),
        // Sigma given too small, too large, and too small in the file.
        Scene::new(&truth, &planes, 27, 0.05, &["--sigma", "0.005"]),
        Scene::new(&truth, &planes, 27, 0.005, &["--sigma", "0.05"]),
        Scene::new(&truth, &planes, 27, 0.01, &[]).spoilt(40, 5.0),
        // More outliers than one in ten; as many parameters as lengths.
        Scene::new(&truth, &planes, 27, 0.005, &["--estimate", "all", "--prior", "datasheet"])
            .spoilt(8, 10.0),
        Scene::new(&truth, &flat, 13, 0.0, &thirteen),
        // No length changes by the parameters asked for; only the ball's place, which is fitted before as well.
        Scene::new(&truth, &planes, 27, 0.0, &["--estimate", "theta6", "--tool", "0,0,100"]),
        Scene::new(&truth, &planes, 27, 0.01, &["--estimate", "centres", "--folds", "0"]),
        // A tool ball on axis 6, fixed there; one fixed at a wrong place.
        Scene::new(&truth, &planes, 27, 0.01, &["--tool", "0,0,100", "--hold", "tool", "--folds", "0"]),
        Scene::new(&truth, &planes, 27, 0.01, &["--tool", "30,20,60", "--hold", "tool", "--folds", "0"]),
        // Impossible arguments and priors.
        Scene::new(&truth, &flat, 20, 0.0, &["--tool", "30,20"]),
        Scene::new(&truth, &flat, 20, 0.0, &["--sigma", "-1"]),
        Scene::new(&truth, &flat, 20, 0.0, &["--prior", "headless.csv"]),
        Scene::new(&truth, &flat, 20, 0.0, &["--prior", "unit.csv"]),
        Scene::new(&truth, &flat, 20, 0.0, &["--prior", "negative.csv"]),
        // A plan in place of measured lengths.
        Scene::new(&truth, &flat, 20, 0.0, &["--validate", "plan.csv"]),
        // One parameter, hardly determined because of noise.
        Scene::new(&truth, &flat, 80, 10.0, &["--estimate", "alpha5", "--folds", "0"]),
        Scene::new(&truth, &flat, 80, 10.0, &["--estimate", "a2", "--folds", "0"]),
        // A length that is not a number.
        Scene::new(&truth, &flat, 80, 0.0, &thirteen).spoilt(1, 1e200),
    ];
    // Corrections slightly and far beyond the tolerance of the robot file.
    for (length_mm, angle_deg) in [(0.2, 0.02), (0.1, 0.01)] {
        let args = ["--prior", "tight.csv", "--model", "geometric", "--folds", "0"];
        let mut tight = Scene::new(&truth, &flat, 80, 0.0, &args);
        tight.robot = Robot { tolerance: Tolerance::of(length_mm, angle_deg), ..kr60() }.to_toml().unwrap();
        scenes.push(tight);
    }
    // Lengths that are unrelated to their poses.
    let mut drawn = Scene::new(&truth, &flat, 80, 0.0, &["--estimate", "all", "--folds", "0"]);
    let mut random = Pcg64::seed_from_u64(2);
    drawn.data.rows.iter_mut().for_each(|row| row.length_mm *= random.random_range(0.2..1.8));
    scenes.push(drawn);
    // Two bars with an offset each; lengths drawn again.
    let mut two = Scene::new(&kr60(), &planes, 27, 0.0, &["--estimate", "all", "--folds", "0"]);
    two.data
        .rows
        .iter_mut()
        .step_by(2)
        .for_each(|row| row.datum = Datum::Ball(row.datum.ball().unwrap(), BarId::at(1)));
    scenes.push(two);
    let choices = ["--prior", "datasheet", "--monte-carlo", "100"];
    scenes.push(Scene::new(&truth, &planes, 20, 0.01, &choices));
    // As `dbbd sync` writes them: circles with angles, and a reference pose.
    let mut synced = Scene::new(&truth, &planes, 27, 0.01, &["--prior", "datasheet", "--hold", "centres"]);
    synced.data.columns = vec![ContextColumn::Kind, ContextColumn::Circle, ContextColumn::AngleDeg];
    for (at, row) in synced.data.rows.iter_mut().enumerate() {
        row.context = Some(Arc::new(MeasurementContext {
            kind: Some(if at % 20 == 0 { PoseKind::Reference } else { PoseKind::Measure }),
            circle: Some(CircleId::at(at / 27)),
            angle_deg: Some(360.0 / 27.0 * (at % 27) as f64),
            ..MeasurementContext::default()
        }));
    }
    scenes.push(synced);
    let mut given = Scene::new(&truth, &planes, 27, 0.05, &[]);
    given.data.rows.iter_mut().for_each(|row| row.sigma_mm = Some(0.005));
    scenes.push(given);
    // One degree of freedom does not show that sigma is too small.
    let mut few = Scene::new(&truth, &planes, 9, 0.05, &["--prior", "datasheet"]);
    few.data.rows.truncate(25);
    few.data.rows.iter_mut().for_each(|row| row.sigma_mm = Some(0.015));
    scenes.push(few);
    // Balls and lengths that do not belong together.
    let mut lost = Scene::new(&truth, &flat, 80, 0.0, &thirteen);
    lost.circles = vec![horizontal(1, [0.0, 9000.0, 0.0])];
    scenes.push(lost);
    // A ball at another place than given.
    let mut astray = Scene::new(&truth, &planes, 27, 0.01, &["--estimate", "centres", "--folds", "0"]);
    astray.circles = vec![horizontal(1, [2500.0, 0.0, 800.0])];
    scenes.push(astray);
    // An arm with limits so narrow that no other pose is possible.
    let mut narrow = Scene::new(&truth, &flat, 80, 0.02, &["--prior", "datasheet"]);
    let mut robot = kr60();
    for axis in 0..6 {
        let angles = || narrow.data.rows.iter().map(move |row| row.axes.degrees()[axis]);
        let (low, high) =
            (angles().fold(f64::INFINITY, f64::min), angles().fold(f64::NEG_INFINITY, f64::max));
        let middle = 0.5 * (low + high);
        robot.limits_deg[axis] = if axis < 3 { [middle - 0.01, middle + 0.01] } else { [low, high] };
    }
    narrow.robot = robot.to_toml().unwrap();
    scenes.push(narrow);
    // Backlash at axis 3, and transmission error at axis 2.
    let mut random = Pcg64::seed_from_u64(3);
    let mut worn = Scene::new(&truth, &planes, 60, 0.005, &["--hold", "bar_offset"]);
    for at in (1..worn.data.rows.len()).rev() {
        worn.data.rows.swap(at, random.random_range(0..=at));
    }
    let mut last = worn.data.rows[0].axes.radians();
    for row in &mut worn.data.rows {
        let axes = row.axes.radians();
        let (mut stands, before) = (axes, truth.geometry.length(&axes, &Vector3::from(CENTRE), 0.0));
        stands[1] += 0.5e-3 * (4.0 * axes[1]).sin() + 0.5e-3 * (2.0 * axes[1]).sin();
        stands[2] -= 0.2e-3 * (axes[2] - last[2]).signum();
        row.length_mm += truth.geometry.length(&stands, &Vector3::from(CENTRE), 0.0) - before;
        last = axes;
    }
    scenes.push(worn);
    // A robot far beyond its tolerance.
    let worse = with_errors([("a1", 6.0), ("a2", 5.0), ("a3", -4.0), ("d4", 4.0), ("theta3", 0.02)]);
    scenes.push(Scene::new(&worse, &planes, 27, 0.01, &["--prior", "datasheet"]));
    // Noise of a fifth of the bar, and of ten bars: the model is nonlinear, and draws do not converge.
    for sigma in ["60", "100", "3000"] {
        let args = ["--estimate", "centres,tool", "--sigma", sigma, "--monte-carlo", "1000", "--folds", "0"];
        scenes.push(Scene::new(&truth, &planes, 5, 0.01, &args));
    }
    // A tool that never rotates, with tiny errors of the start angles; the same with a list of parameters.
    for args in [&[][..], &["--estimate", "tool,centres"][..]] {
        let mut still = Scene::new(&truth, &flat, 80, 0.0, args);
        still.data = measure(&truth, &flat, 80, 0.0);
        for (at, row) in still.data.rows.iter_mut().enumerate() {
            row.axes
                .degrees_mut()
                .iter_mut()
                .enumerate()
                .for_each(|(k, a)| *a += 5e-7 * ((6 * at + k) as f64 * 78.233).sin());
        }
        scenes.push(still);
    }
    // One tilted circle, on which the wrist does not turn with the tool's own axis told.
    let tilted = [Circle { plane: rot_x(0.5), ..horizontal(1, CENTRE) }];
    scenes.push(Scene::new(&truth, &tilted, 40, 0.02, &["--prior", "datasheet", "--tool", "0,0,100"]));
    scenes
}

#[test]
fn every_code_is_reported_in_a_scene() {
    let mut found: Vec<String> = scenes().iter().flat_map(Scene::codes).collect();
    found.sort();
    found.dedup();
    let silent: Vec<&str> =
        REPORTED.into_iter().filter(|code| !found.iter().any(|found| found == code)).collect();
    assert!(silent.is_empty(), "no scene reports {silent:?}, they report {found:?}");
}

/// With a tool ball fixed 50 mm off, the lengths fit as well, but with implausible corrections.
#[test]
fn wrong_fixed_values_have_warnings() {
    let truth = with_errors([("a1", 0.4), ("alpha2", 6e-4), ("d4", -0.5), ("theta3", 9e-4)]);
    let warned = |args: &[&'static str]| {
        let scene = Scene::new(&truth, &three_planes(1, CENTRE), 27, 0.01, args);
        scene.codes().iter().any(|code| code == "W1312")
    };
    for prior in ["none", "datasheet"] {
        assert!(warned(&["--hold", "tool", "--tool", "30,20,60", "--prior", prior]));
        assert!(!warned(&["--hold", "tool", "--prior", prior]));
    }
}

/// With a list the user knows that the other parameters are fixed; a result that is predicted worse than the nominal robot is
/// still warned of.
#[test]
fn a_list_that_worsens_the_robot_has_a_warning() {
    let truth = with_errors(DESIGNED);
    let codes = |list: &'static str| {
        let args = ["--estimate", list, "--folds", "0"];
        let found = Scene::new(&truth, &[horizontal(1, CENTRE)], 80, 0.02, &args).codes();
        ["W1319", "I1320"].map(|code| found.iter().any(|found| found == code))
    };
    assert_eq!(codes("alpha1-5,a1-5,d2-6"), [true, false]);
    assert_eq!(codes("alpha2"), [false, false]);
}
