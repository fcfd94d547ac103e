//! Poses chosen for a robot, the robot identified from lengths at these poses, and a production program that is
//! corrected with it.

use dbbd_job::plan::{Job, Plan, PoseKind};
use dbbd_job::program::Target;
use dbbd_job::program::krl::{Files, Given, Text, read};
use dbbd_model::estimation::{CompletedCalibration, Options};
use dbbd_model::measurement::{BaseBall, Datum, Measurement, Measurements, TargetId};
use dbbd_model::robot::{
    Approach, AxisAngles, BallId, BarId, Geometry, Joint, Mass, ParamId, PayloadId, Pose, Robot, inverse,
};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::cell::{CENTRE, RADIUS, calibrated, kr60};

/// Standard deviation of a length, mm.
const SIGMA_MM: f64 = 0.02;
/// Base balls: the second and third at other radii and heights.
pub(crate) const BALLS: [[f64; 3]; 3] = [CENTRE, [1000.0, 500.0, 1300.0], [1500.0, -300.0, 400.0]];
/// Difference between the true position of each ball and its position in the job, mm.
pub(crate) const OFF_MM: [f64; 3] = [0.8, -0.5, 0.3];

/// A job of poses chosen for the smallest error in a cube, or in the whole workspace.
pub(crate) fn job(bar_mm: f64, balls: usize, points: usize, cube: bool) -> String {
    let mut text = format!(
        "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = {bar_mm:?}\nstroke_mm = [-15.0, 15.0]\nmargin_mm = 0.5\nsigma_um = 20.0\n\
         length_u_mm = 0.002\n"
    );
    for (at, xyz_mm) in BALLS.iter().enumerate().take(balls) {
        text.push_str(&format!("[[centre]]\nid = {}\nxyz_mm = {xyz_mm:?}\n", at + 1));
    }
    text.push_str(&format!("[optimise]\npoints = {points}\n"));
    if cube {
        let corner = |side: f64| CENTRE.map(|middle| middle + side);
        text.push_str(&format!("workspace_mm = [{:?}, {:?}]\n", corner(-500.0), corner(500.0)));
    }
    text
}

pub(crate) fn chosen(balls: usize, points: usize, cube: bool) -> Plan {
    Plan::build(&Job::from_toml("job.toml", &job(RADIUS, balls, points, cube)).unwrap(), &kr60()).unwrap()
}

/// Lengths at the dwells of a plan, with noise; the axis angles are those of the printed poses.
fn measured(plan: &Plan, true_robot: &Robot, seed: u64) -> Measurements {
    let mut random = Pcg64::seed_from_u64(seed);
    let dwells = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit);
    let rows = dwells.map(|row| {
        let ball = Vector3::from(BALLS[row.centre.index()]) + Vector3::from(OFF_MM);
        let length = true_robot.geometry.length(&row.axes_deg.map(f64::to_radians), &ball, 0.0);
        Measurement {
            index: row.index,
            datum: Datum::Ball(row.centre, BarId::FIRST),
            target: TargetId::FIRST,
            axes: AxisAngles::from_degrees(row.axes_deg),
            approach: Approach::default(),
            length_mm: length + SIGMA_MM * random.sample::<f64, _>(StandardNormal),
            sigma_mm: None,
            payload: PayloadId::FIRST,
            context: None,
        }
    });
    Measurements { rows: rows.collect(), ..Measurements::default() }
}

/// `true_robot` identified from lengths at the poses of a plan, without a prior.
pub(crate) fn identified(true_robot: &Robot, plan: &Plan, seed: u64) -> CompletedCalibration {
    let balls = plan.header.job.centres.iter();
    let centres: Vec<BaseBall> = balls
        .map(|ball| BaseBall { id: BallId::new(ball.id).unwrap(), position: ball.xyz_mm.into() })
        .collect();
    // The length of the bar is held: lengths about one value determine it only together with the size of the robot.
    let hold = vec![ParamId::BarOffset(BarId::FIRST)];
    let options = Options { sigma_mm: Some(SIGMA_MM), folds: Some(0), hold, ..Options::default() };
    calibrated(&kr60(), &measured(plan, true_robot, seed), &centres, &options).unwrap()
}

/// A program of PTP motions to `count` random poses: in the cube with the tool within 30 degrees of straight down, else in the whole
/// workspace with any orientation.
pub(crate) fn production(count: usize, cube: bool, seed: u64) -> String {
    let robot = kr60();
    let mut random = Pcg64::seed_from_u64(seed);
    let [x, y, z] = <[f64; 3]>::from(robot.geometry.tool);
    let frame = |[x, y, z]: [f64; 3]| format!("{{X {x:.3},Y {y:.3},Z {z:.3},A 0.0,B 0.0,C 0.0}}");
    let mut program = format!("DEF P ( )\n$TOOL={}\n$BASE={}\n", frame([x, y, z]), frame([0.0; 3]));
    let mut written = 0;
    while written < count {
        let axes = if cube {
            let xyz_mm = CENTRE.map(|middle| middle + random.random_range(-500.0..500.0));
            let [a, b, c] = [180.0, 30.0, 30.0].map(|range| random.random_range(-range..range));
            let ball = Pose::from_kuka(xyz_mm, [a, b, 180.0 + c]);
            let Ok(all) = inverse::branches(&robot.geometry, &ball) else { continue };
            // The branch in front of axis 1 with the elbow up (S 2), as on the circles.
            let front = all.into_iter().find(|axes| inverse::status(&robot.geometry, axes) == 2);
            let Some(axes) = front else { continue };
            axes
        } else {
            std::array::from_fn(|i| {
                let [low, high] = robot.limits_deg[i];
                random.random_range(low..high).to_radians()
            })
        };
        // Away from limits and singularities; an axis may be near zero.
        let inside = (0..6).all(|i| {
            let ([low, high], deg) = (robot.limits_deg[i], axes[i].to_degrees());
            (low + 1.0..high - 1.0).contains(&deg)
        });
        let clear = inverse::clearance(&robot.geometry, &axes).unwrap();
        if !inside
            || clear.wrist.to_degrees() < 10.0
            || clear.elbow.to_degrees() < 10.0
            || clear.overhead < 200.0
        {
            continue;
        }
        let ball = robot.geometry.ball(&axes);
        let ([x, y, z], [a, b, c]) = (<[f64; 3]>::from(ball.position), ball.abc_deg());
        let (s, t) = (inverse::status(&robot.geometry, &axes), inverse::turn(&axes));
        program.push_str(&format!(
            "PTP {{X {x:.3},Y {y:.3},Z {z:.3},A {a:.4},B {b:.4},C {c:.4},S {s},T {t}}}\n"
        ));
        written += 1;
    }
    program + "END\n"
}

/// The taught poses as printed, with the axis angles of the controller by S and T, rad.
pub(crate) fn taught(program: &str) -> Vec<(Pose, [f64; 6])> {
    let nominal = kr60();
    let files = Files { source: Text { file: "P.src", text: program }, data: None, config: None };
    let points = read(files, Given::default()).unwrap().points;
    let targets = points.iter().map(|point| {
        let Target::Pose { xyz_mm, abc_deg, status, turn } = point.target else { panic!("no pose") };
        let ball = Pose::from_kuka(xyz_mm, abc_deg);
        let (s, t) = (status.unwrap() as u8, turn.unwrap() as u8);
        (ball, inverse::from_status_turn(&nominal, &ball, s, t).unwrap())
    });
    targets.collect()
}

/// A robot whose joints 2 and 3 deflect under its own weight, by at most 0.2 and 0.14 mrad.
pub(crate) fn sagging(mut robot: Robot) -> Robot {
    let mass = |joint, kg, [x, y, z]: [f64; 3]| Mass { joint, kg, centre: Vector3::new(x, y, z) };
    robot.geometry.load.masses = vec![
        mass(Joint::J2, 150.0, [425.0, 0.0, 0.0]),
        mass(Joint::J3, 120.0, [145.0, -300.0, 0.0]),
        mass(Joint::J6, 60.0, [0.0; 3]),
    ];
    let rigid = Geometry { compliance: [0.0; 6], ..robot.geometry.clone() };
    let poses = dbbd_model::estimation::Workspace::uniform(&robot, 500, 1);
    for (joint, most_rad) in [(1, 0.2e-3), (2, 0.14e-3)] {
        let mut probe = robot.geometry.clone();
        probe.compliance = [0.0; 6];
        probe.compliance[joint] = 1e-9;
        let turned = |axes: &[f64; 6]| {
            let (a, b) = (probe.ball(axes), rigid.ball(axes));
            a.angle_to(&b)
        };
        let greatest = poses.iter().map(turned).fold(0.0, f64::max);
        robot.geometry.compliance[joint] = 1e-9 * most_rad / greatest;
    }
    robot
}
