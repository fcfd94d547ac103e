//! Three years of a robot whose zeros wear, in a hall with seasons: every three months a check, and 20 lengths that renew the
//! calibration. What was crashed in between is found with its axis.

use dbbd_model::base::date::after_months;
use dbbd_model::conformity::expected::{Expected, Mounting};
use dbbd_model::conformity::{CheckInput, DecisionRule, InterimCheck};
use dbbd_model::design::Criterion;
use dbbd_model::estimation::{ErrorModel, Options, Posterior, Prior, Workspace};
use dbbd_model::measurement::{BaseBall, Datum, LengthModel, Measurement, Measurements, PreparedMeasurement};
use dbbd_model::robot::{
    Approach, AxisAngles, BarId, Joint, MeasurementConditions, ParamId, Payload, PayloadId, Robot, TargetId,
};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use crate::plan::{Job, Plan, PlanningPrior, PoseKind};
use crate::test_support::cell::{calibrated, kr60};
use crate::test_support::drawn_robots::{BALLS, LENGTH_MM, POSE_MM, Senses, drawn, judged, lengths};

const FIRST_DAY: &str = "2023-11-27";
/// Months between two runs, and runs of three years.
const INTERVAL: f64 = 3.0;
const RUNS: usize = 12;
const LENGTHS: u32 = 20;
const CHECKED: u32 = 24;
/// Standard uncertainty of the bar, mm.
const BAR_U_MM: f64 = 0.002;

/// So many months after the first day, at a temperature that was measured.
fn day(months: f64, temperature_c: f64) -> MeasurementConditions {
    MeasurementConditions { date: after_months(FIRST_DAY, months), temperature_c: Some(temperature_c) }
}

/// A robot that wears: its zeros settle at a rate of their own and wander, and its links expand with the season.
struct WearingRobot {
    truth: Robot,
    wear_rad: f64,
    months: f64,
    /// rad in a month.
    settling: [f64; 6],
    summer: f64,
    random: Pcg64,
}

/// In a year a zero settles by this, and wanders by as much, rad: of a sound, a usual and a worn robot, a factor of e apart as
/// robots are taken to be. The seasons span 15 K.
const WEAR_RAD: [f64; 3] = [7.4e-6, 20e-6, 54e-6];
const SUMMER_K: f64 = 7.5;
const EXPANSION_PER_K: f64 = 11.5e-6;

impl WearingRobot {
    fn new(seed: u64) -> Self {
        let mut random = Pcg64::seed_from_u64(seed ^ 0x3e45);
        let mut normal = || -> f64 { random.sample(StandardNormal) };
        let wear_rad = WEAR_RAD[seed as usize % WEAR_RAD.len()];
        let settling = [(); 6].map(|()| wear_rad / 12.0 * normal());
        let summer = random.random_range(0.0..12.0);
        Self { truth: drawn(seed), wear_rad, months: 0.0, settling, summer, random }
    }

    fn zero(&mut self, joint: Joint, rad: f64) {
        *self.truth.geometry.value_mut(ParamId::Theta(joint)).unwrap() += rad;
    }

    fn later(&mut self, months: f64) {
        for (at, joint) in Joint::ALL.into_iter().enumerate() {
            let step: f64 = self.random.sample(StandardNormal);
            self.zero(joint, self.settling[at] * months + self.wear_rad * (months / 12.0).sqrt() * step);
        }
        let before_c = self.celsius();
        self.months += months;
        let kelvin = self.celsius() - before_c;
        for row in &mut self.truth.geometry.rows {
            row.a *= 1.0 + EXPANSION_PER_K * kelvin;
            row.d *= 1.0 + EXPANSION_PER_K * kelvin;
        }
    }

    fn celsius(&self) -> f64 {
        20.0 + SUMMER_K * (std::f64::consts::TAU * (self.months - self.summer) / 12.0).cos()
    }

    /// The day, with a temperature that is measured to half a kelvin.
    fn day(&mut self) -> MeasurementConditions {
        let off: f64 = self.random.sample(StandardNormal);
        day(self.months, self.celsius() + 0.5 * off)
    }

    /// Lengths at the dwells of a plan, the tool ball and the base balls mounted again.
    fn measured(&mut self, plan: &Plan) -> Measurements {
        let random = &mut self.random;
        let mut normal = |sd: f64| sd * random.sample::<f64, _>(StandardNormal);
        let mut mounted = self.truth.geometry.clone();
        mounted.tool += Vector3::from_fn(|_, _| normal(Mounting::SEAT_REPEAT_MM));
        let balls: Vec<Vector3<f64>> = plan
            .header
            .job
            .centres
            .iter()
            .map(|ball| Vector3::from(ball.xyz_mm) + Vector3::from_fn(|_, _| normal(1.0)))
            .collect();
        let dwells: Vec<_> = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit).collect();
        let axes: Vec<[f64; 6]> = dwells.iter().map(|row| row.axes_deg.map(f64::to_radians)).collect();
        let approaches = Approach::along(axes.iter().copied());
        let rows = dwells.into_iter().zip(approaches).map(|(row, approach)| {
            let there = mounted.approached(approach).ball(&row.axes_deg.map(f64::to_radians)).position;
            let there = there + Vector3::from_fn(|_, _| normal(POSE_MM));
            Measurement {
                index: row.index,
                datum: Datum::Ball(row.centre, BarId::FIRST),
                target: TargetId::FIRST,
                axes: AxisAngles::from_degrees(row.axes_deg),
                approach,
                length_mm: (there - balls[row.centre.index()]).norm() + normal(LENGTH_MM),
                sigma_mm: Some(LENGTH_MM),
                payload: PayloadId::FIRST,
                context: None,
            }
        });
        Measurements { rows: rows.collect(), ..Measurements::default() }
    }
}

fn balls_of(plan: &Plan) -> Vec<BaseBall> {
    plan.header.job.balls()
}

fn options(prior: Prior, measured: MeasurementConditions) -> Options {
    Options {
        prior,
        bar_u_mm: Some(BAR_U_MM),
        folds: Some(0),
        workspace: Some(Workspace::uniform(&kr60(), 50, 1)),
        measured,
        model: ErrorModel::Joints,
        ..Options::default()
    }
}

/// The calibration of the first day: 70 poses to each of three balls.
fn calibration(truth: &Robot, seed: u64, measured: MeasurementConditions) -> Robot {
    let data = lengths(truth, 70, 3, seed);
    let balls: Vec<BaseBall> = (1..)
        .zip(BALLS)
        .map(|(id, place)| BaseBall {
            id: dbbd_model::robot::BallId::new(id).unwrap(),
            position: place.into(),
        })
        .collect();
    calibrated(&kr60(), &data, &balls, &options(Prior::Datasheet, measured)).unwrap().robot
}

/// The plan of a check (24 poses), or of the lengths that renew a calibration.
fn planned(robot: &Robot, then: &MeasurementConditions, criterion: Criterion) -> Plan {
    let mut text = String::from(
        "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-15.0, 15.0]\nmargin_mm = 0.5\nsigma_um = 15.0\n",
    );
    // One on either side: what turns about axis 2 is then no tilt of the base.
    for (id, place) in (1..).zip([BALLS[1], BALLS[2]]) {
        text += &format!("[[centre]]\nid = {id}\nxyz_mm = {place:?}\n");
    }
    text += "[optimise]\npoints = 50\n";
    let job = Job::from_toml("job.toml", &text).unwrap();
    let robot = robot.under(then);
    let start = LengthModel::new(robot.geometry.clone(), &job.balls());
    let known = Posterior::of_robot(start, robot.posterior.as_ref().unwrap(), robot.uncertainty.as_deref());
    let expected = Expected::new(&known, 1, Mounting::again(&robot, Some(BAR_U_MM)));
    let prior = PlanningPrior::of_check(&job, &robot, expected);
    let points = if criterion == Criterion::Change { CHECKED } else { LENGTHS };
    Plan::build_with(&job.as_check(points, criterion), &robot, &prior).unwrap()
}

fn check(robot: &Robot, plan: &Plan, data: &Measurements) -> InterimCheck {
    let readings: Vec<PreparedMeasurement> = data.rows.iter().map(PreparedMeasurement::from).collect();
    let input = CheckInput {
        robot,
        start: &LengthModel::new(robot.geometry.clone(), &balls_of(plan)),
        readings: &readings,
        bars: 1,
        sigma_mm: POSE_MM.hypot(LENGTH_MM),
        mounting: Mounting::again(robot, Some(BAR_U_MM)),
        tolerance_mm: None,
        rule: DecisionRule::GuardBand { risk: 0.05 },
        workspace: &Workspace::uniform(&kr60(), 50, 1),
    };
    input.check().unwrap()
}

#[derive(Default, Debug)]
struct Years {
    /// Mean true error, that of the calibration's day, and predicted, over dates; coverage.
    errors: Vec<f64>,
    full: Vec<f64>,
    predicted: Vec<f64>,
    covered: Vec<f64>,
    checks: usize,
    alarms: usize,
    crashes: usize,
    found: usize,
    named: usize,
}

impl Years {
    fn judge(&mut self, wearing: &mut WearingRobot, robot: &Robot, seed: u64) {
        let known = robot.under(&wearing.day());
        let found = judged(&wearing.truth, &known, Senses::Known, seed);
        self.errors.push(found.mean);
        self.predicted.push(found.predicted);
        self.covered.push(found.covered);
    }
}

/// Three years of one robot, with a crash before each of the runs in `crashes`.
fn three_years(seed: u64, crashes: &[usize], years: &mut Years) {
    let mut wearing = WearingRobot::new(seed);
    let first = wearing.day();
    let mut robot = calibration(&wearing.truth, 1000 + seed, first);
    let full = judged(&wearing.truth, &robot, Senses::Known, 50 + seed).mean;
    years.full.push(full);
    let [plan, to_check] =
        [Criterion::I, Criterion::Change].map(|criterion| planned(&robot, &day(INTERVAL, 20.0), criterion));
    for run in 1..=RUNS {
        wearing.later(INTERVAL / 2.0);
        years.judge(&mut wearing, &robot, 100 * seed + run as u64);
        let crashed = crashes.contains(&run).then(|| {
            let joint = Joint::ALL[1 + (seed as usize + run) % 4];
            let size = wearing.random.random_range(0.05f64..0.2).to_radians();
            wearing.zero(joint, size);
            ParamId::Theta(joint)
        });
        wearing.later(INTERVAL / 2.0);
        if crashed.is_none() {
            years.judge(&mut wearing, &robot, 200 * seed + run as u64);
        }
        let data = wearing.measured(&plan);
        let today = wearing.day();
        let known = robot.under(&today);
        let checked = check(&known, &to_check, &wearing.measured(&to_check));
        eprintln!(
            "robot {seed} run {run}: p {:.4}, {crashed:?}, {:?}",
            checked.test.p,
            checked.changes.first().map(|c| (&c.parameters, c.probability))
        );
        robot = match crashed {
            Some(axis) => {
                years.crashes += 1;
                years.found += usize::from(checked.test.changed);
                let likeliest = checked.changes.first();
                years.named += usize::from(
                    likeliest.is_some_and(|one| one.parameters.contains(&axis) || one.alike.contains(&axis)),
                );
                // After a crash the robot is calibrated again.
                calibration(&wearing.truth, 2000 + seed + run as u64, today)
            }
            None => {
                years.checks += 1;
                years.alarms += usize::from(checked.test.changed);
                calibrated(&known, &data, &balls_of(&plan), &options(Prior::Posterior, today)).unwrap().robot
            }
        };
        years.judge(&mut wearing, &robot, 300 * seed + run as u64);
        eprintln!(
            "   full {full:.4}, error {:.4}, predicted {:.4}, covered {:.2}",
            years.errors.last().unwrap(),
            years.predicted.last().unwrap(),
            years.covered.last().unwrap()
        );
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn rms(values: &[f64]) -> f64 {
    mean(&values.iter().map(|value| value * value).collect::<Vec<_>>()).sqrt()
}

#[test]
#[ignore = "a campaign: three years of eight robots"]
fn robots_are_renewed_for_three_years() {
    let mut years = Years::default();
    for seed in 1..=8 {
        three_years(seed, &[4, 9], &mut years);
    }
    let (error, full, predicted, covered) =
        (rms(&years.errors), rms(&years.full), rms(&years.predicted), mean(&years.covered));
    eprintln!("error {error:.4} mm, full {full:.4}, predicted {predicted:.4}, coverage {covered:.3}");
    eprintln!(
        "{} alarms of {} checks; of {} crashes {} found, {} named",
        years.alarms, years.checks, years.crashes, years.found, years.named
    );
    assert!(error < 1.5 * full, "{error} {full}");
    assert!((0.90..=0.98).contains(&covered), "{covered}");
    assert!(years.alarms <= 4, "{} of {}", years.alarms, years.checks);
    assert_eq!((years.found, years.named), (years.crashes, years.crashes));
}

/// Poses are chosen at the ends of what a robot can reach: the plan's own check must not refuse them.
#[test]
#[ignore = "a campaign: plans of the checks and renewals of 24 robots"]
fn every_check_and_renewal_has_a_plan() {
    for seed in 1..=24 {
        let mut wearing = WearingRobot::new(seed);
        let first = wearing.day();
        let robot = calibration(&wearing.truth, 1000 + seed, first);
        for criterion in [Criterion::I, Criterion::Change] {
            planned(&robot, &day(INTERVAL, 20.0), criterion);
        }
    }
}

/// A robot that carries 50 kg in its check and carried nothing in its calibration: what the load does is not a change of an axis.
#[test]
#[ignore = "a campaign: checks of 20 robots with another payload"]
fn a_payload_in_a_check_is_no_change() {
    let payload = |name: &str, kg| Payload {
        name: name.into(),
        kg,
        centre: Vector3::new(0.0, 0.0, 150.0),
        ..Payload::default()
    };
    let (mut checks, mut changed, mut blamed) = (0, 0, 0);
    let plan = planned(&calibration(&drawn(1), 1, day(0.0, 20.0)), &day(INTERVAL, 20.0), Criterion::Change);
    for seed in 1..=20 {
        let mut wearing = WearingRobot::new(seed);
        wearing.truth.geometry.load.payloads = vec![payload("bar", 0.0), payload("gripper", 50.0)];
        for (joint, compliance) in [(1, 2e-7), (2, 4e-7), (3, 6e-7), (4, 6e-7)] {
            wearing.truth.geometry.compliance[joint] = compliance;
        }
        let mut robot = calibration(&wearing.truth, seed, day(0.0, 20.0));
        robot.geometry.load.payloads = wearing.truth.geometry.load.payloads.clone();
        wearing.truth.geometry.load.payloads.swap(0, 1);
        let mut data = wearing.measured(&plan);
        data.rows.iter_mut().for_each(|row| row.payload = PayloadId::at(1));
        let checked = check(&robot, &plan, &data);
        let blames = checked
            .changes
            .first()
            .is_some_and(|one| one.parameters.iter().any(|id| matches!(id, ParamId::Theta(_))));
        eprintln!(
            "robot {seed}: p {:.4}, {:?}",
            checked.test.p,
            checked.changes.first().map(|c| (&c.parameters, c.probability))
        );
        (checks, changed, blamed) =
            (checks + 1, changed + usize::from(checked.test.changed), blamed + usize::from(blames));
    }
    eprintln!("of {checks} checks with 50 kg {changed} report a change, {blamed} blame an axis");
    assert!(changed <= 2, "{changed}");
}
