//! Simulated checks: rates of false alarms, detection, right hypotheses, repair and wrong decisions.

use dbbd_model::conformity::change::Innovation;
use dbbd_model::conformity::expected::{BallMounting, Mounting};
use dbbd_model::conformity::{
    CheckInput, CheckUncertainty, ConformityOutcome, DecisionRule, InterimCheck, decide,
};
use dbbd_model::diagnostic::Finding;
use dbbd_model::estimation::{ErrorSummary, Posterior, Workspace, displacement, tool_balls};
use dbbd_model::measurement::{ApproachedPose, BaseBall, LengthModel, Measurements, PreparedMeasurement};
use dbbd_model::robot::{BallId, Coordinate, ParamId, Robot};
use nalgebra::{DMatrix, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::test_support::cell::{CENTRE, kr60, measure, three_planes};
use crate::test_support::checked_robot::{SIGMA, calibration, normal};

const MOUNTING: Mounting = Mounting { tool_mm: 0.01, balls: BallMounting::Anywhere, bar_mm: 0.005 };

/// The base ball stays where it was in the calibration.
const KEPT: Mounting = Mounting { balls: BallMounting::Kept(0.01), ..MOUNTING };

/// What all checks of a campaign share.
struct Bench {
    mounting: Mounting,
    robot: Robot,
    start: LengthModel,
    /// 8 in each of three planes about one ball.
    poses: Measurements,
    workspace: Vec<[f64; 6]>,
}

impl Bench {
    fn new(mounting: Mounting) -> Self {
        let robot = calibration();
        let place = if mounting == KEPT {
            robot.posterior.as_ref().unwrap().ball(BallId::FIRST).unwrap()
        } else {
            Vector3::from(CENTRE)
        };
        let ball = BaseBall { id: BallId::FIRST, position: place };
        Self {
            mounting,
            start: LengthModel::new(robot.geometry.clone(), &[ball]),
            poses: measure(&kr60(), &three_planes(1, CENTRE), 8, 40.0),
            workspace: Workspace::uniform(&robot, 200, 2),
            robot,
        }
    }

    fn known(&self) -> Posterior {
        let (posterior, unknown) =
            (self.robot.posterior.as_ref().unwrap(), self.robot.uncertainty.as_deref());
        if self.mounting == KEPT {
            Posterior::of_robot_with_balls(self.start.clone(), posterior, unknown)
        } else {
            Posterior::of_robot(self.start.clone(), posterior, unknown)
        }
    }

    fn readings(&self) -> Vec<PreparedMeasurement> {
        self.poses.rows.iter().map(PreparedMeasurement::from).collect()
    }

    fn input<'a>(&'a self, readings: &'a [PreparedMeasurement]) -> CheckInput<'a> {
        CheckInput {
            robot: &self.robot,
            start: &self.start,
            readings,
            bars: 1,
            sigma_mm: SIGMA,
            mounting: self.mounting,
            tolerance_mm: None,
            rule: DecisionRule::GuardBand { risk: 0.05 },
            workspace: &self.workspace,
        }
    }

    /// 3-D errors over the workspace of a robot file: mean, and not exceeded by 95 % of the poses, mm.
    fn errors_mm(&self, file: &Robot, truth: &LengthModel) -> [f64; 2] {
        let poses: Vec<ApproachedPose> = self.workspace.iter().map(ApproachedPose::unapproached).collect();
        let [file, truth] = [&file.geometry, &truth.geometry].map(|geometry| tool_balls(geometry, &poses));
        let moved = displacement(&file, &truth);
        let found = ErrorSummary::of(&DMatrix::from_columns(&[moved]));
        [found.mean, found.p95]
    }
}

/// One robot drawn from the posterior of a calibration, mounted again, with the lengths of its check.
struct Drawn {
    /// Before the change, and after it.
    calibrated: LengthModel,
    truth: LengthModel,
    readings: Vec<PreparedMeasurement>,
}

impl Drawn {
    fn new(bench: &Bench, change: &[(ParamId, f64)], random: &mut Pcg64) -> Self {
        let calibrated = bench.known().drawn(|| normal(random));
        let mut truth = calibrated.clone();
        let ball_mm = if let BallMounting::Kept(mm) = bench.mounting.balls { mm } else { 2.0 };
        for axis in 0..3 {
            truth.geometry.tool[axis] += MOUNTING.tool_mm * normal(random);
            truth.balls[0][axis] += ball_mm * normal(random);
        }
        truth.bar_offsets = vec![MOUNTING.bar_mm * normal(random)];
        change.iter().for_each(|(id, size)| truth.shift(*id, *size));
        let mut readings = bench.readings();
        for reading in &mut readings {
            reading.length_mm = truth.prepare().length(reading) + SIGMA * normal(random);
        }
        Self { calibrated, truth, readings }
    }
}

/// 24 visits of one length with 8 degrees of freedom are together as t with 4 + 4 (24 26) / (24 3), 38.7: at 0.1 % the limit of one deviate is
/// 5 % larger, and a change of 95 % power, 1.6 standard deviations beyond it, 4 %.
#[test]
fn tails_of_visits_make_the_smallest_change_larger() {
    let smallest = |visit_degrees_of_freedom| {
        let mut bench = Bench::new(MOUNTING);
        bench.robot.uncertainty.as_mut().unwrap().visit_degrees_of_freedom = visit_degrees_of_freedom;
        let power = bench.input(&bench.readings()).power().unwrap();
        let found: Vec<f64> = power.detectable.iter().filter_map(|found| found.smallest).collect();
        found.iter().map(|size| size.ln()).sum::<f64>() / found.len() as f64
    };
    let times = (smallest(Some(8.0)) - smallest(None)).exp();
    assert!((1.02..1.08).contains(&times), "{times}");
}

/// A size between two, all scales alike, of either sign.
fn size(random: &mut Pcg64, low: f64, high: f64) -> f64 {
    let share: f64 = random.random();
    let sign = if random.random::<bool>() { 1.0 } else { -1.0 };
    sign * low * (high / low).powf(share)
}

/// A change of a joint offset by 0.005 to 0.1 degrees, of a link by 0.1 to 1 mm, another tool, or, where the base ball
/// should have stayed, its place.
fn drawn_change(mounting: Mounting, kind: usize, random: &mut Pcg64) -> Vec<(ParamId, f64)> {
    let of = |random: &mut Pcg64, names: &[&str], low: f64, high: f64| {
        let id: ParamId = names[random.random_range(0..names.len())].parse().unwrap();
        vec![(id, size(random, low, high))]
    };
    let ball = |axis| ParamId::Ball(BallId::FIRST, axis);
    match kind % 7 {
        1 if mounting == KEPT => Coordinate::ALL.map(|axis| (ball(axis), size(random, 0.1, 1.0))).to_vec(),
        0 => Coordinate::ALL.map(|axis| (ParamId::Tool(axis), size(random, 0.1, 1.0))).to_vec(),
        1..=3 => of(random, &["a1", "a2", "a3", "d3", "d4"], 0.1, 1.0),
        _ => {
            of(random, &["theta2", "theta3", "theta4", "theta5"], 0.005f64.to_radians(), 0.1f64.to_radians())
        }
    }
}

/// Counts of a campaign.
#[derive(Debug, Default)]
struct Counts {
    unchanged: usize,
    alarms: usize,
    changed: usize,
    found: usize,
    named: usize,
    /// Detections that the stated powers add up to.
    stated: f64,
    /// Changes of at least the size that is found with 95 % probability.
    detectable: usize,
    detectable_found: usize,
    /// Found changes that a hypothesis explains.
    repaired: usize,
    /// Mean 3-D error of the robots that were repaired, and of the same ones as the calibration left them, mm.
    repaired_mm: f64,
    calibrated_mm: f64,
    /// Changed and found by the decade of the stated power.
    curve: [[usize; 2]; 5],
}

impl Counts {
    /// `stated`: the probability of finding the change.
    fn add(&mut self, stated: f64, found: bool) {
        self.changed += 1;
        self.found += usize::from(found);
        self.stated += stated;
        self.detectable += usize::from(stated >= 0.95);
        self.detectable_found += usize::from(stated >= 0.95 && found);
        let place = [0.2, 0.5, 0.8, 0.95].iter().filter(|limit| stated >= **limit).count();
        self.curve[place][0] += 1;
        self.curve[place][1] += usize::from(found);
    }
}

fn campaign(mounting: Mounting, robots: usize, seed: u64) -> Counts {
    let bench = Bench::new(mounting);
    let mut random = Pcg64::seed_from_u64(seed);
    let mut counts = Counts::default();
    for number in 0..robots {
        let changed = number % 2 == 1;
        let change = if changed { drawn_change(mounting, number / 2, &mut random) } else { Vec::new() };
        let drawn = Drawn::new(&bench, &change, &mut random);
        let input = bench.input(&drawn.readings);
        let innovation = Innovation::of(&input.expected().unwrap(), &drawn.readings, input.noise()).unwrap();
        let found = innovation.test().changed;
        if !changed {
            counts.unchanged += 1;
            counts.alarms += usize::from(found);
            continue;
        }
        counts.add(innovation.power(&change).unwrap_or(0.0), found);
        if found {
            let likeliest = innovation.hypotheses().into_iter().find(|h| !h.parameters.is_empty()).unwrap();
            let names = [likeliest.parameters, likeliest.alike].concat();
            counts.named += usize::from(change.iter().any(|(id, _)| names.contains(id)));
            if let Some(update) = input.check().unwrap().update() {
                counts.repaired += 1;
                counts.repaired_mm += bench.errors_mm(update, &drawn.truth)[0];
                counts.calibrated_mm += bench.errors_mm(&bench.robot, &drawn.calibrated)[0];
            }
        }
    }
    counts.repaired_mm /= counts.repaired.max(1) as f64;
    counts.calibrated_mm /= counts.repaired.max(1) as f64;
    counts
}

#[test]
fn robots_that_changed_are_separated_from_those_that_did_not() {
    let counts = campaign(MOUNTING, 32, 3);
    eprintln!("{counts:?}");
    assert!(counts.alarms <= 1 && counts.found >= counts.detectable_found, "{counts:?}");
    assert!(counts.detectable_found * 10 >= counts.detectable * 8, "{counts:?}");
    assert!(counts.named * 10 >= counts.found * 8, "{counts:?}");
    assert!(counts.repaired_mm < 1.5 * counts.calibrated_mm, "{counts:?}");
}

#[test]
#[ignore = "a campaign"]
fn false_alarms_and_detection_are_as_stated() {
    as_stated(MOUNTING);
}

#[test]
#[ignore = "a campaign"]
fn false_alarms_and_detection_with_kept_balls_are_as_stated() {
    as_stated(KEPT);
}

fn as_stated(mounting: Mounting) {
    let counts = campaign(mounting, 1000, 1);
    eprintln!("{counts:#?}");
    let share = |part: usize, whole: usize| part as f64 / whole as f64;
    // 500 robots at 1 %: 1 to 11 alarms with 99.5 % probability.
    assert!((1..=11).contains(&counts.alarms), "{counts:?}");
    assert!(share(counts.found, counts.changed) > counts.stated / counts.changed as f64 - 0.03, "{counts:?}");
    assert!(share(counts.detectable_found, counts.detectable) > 0.95, "{counts:?}");
    assert!(share(counts.named, counts.found) >= 0.95, "{counts:?}");
    assert!(counts.repaired_mm < 1.5 * counts.calibrated_mm, "{counts:?}");
}

/// The lengths of a corrected program are those of the nominal robot: they are no change of the robot. A changed robot is not taken
/// for one that ran a corrected program.
#[test]
fn lengths_of_a_corrected_program_are_no_change() {
    let bench = Bench::new(MOUNTING);
    let nominal = bench.robot.nominal.as_deref().unwrap();
    let truth = LengthModel { geometry: nominal.geometry.clone(), ..bench.start.clone() };
    let mut random = Pcg64::seed_from_u64(7);
    let of_nominal = |sds: f64, random: &mut Pcg64| {
        let mut readings = bench.readings();
        for reading in &mut readings {
            reading.length_mm = truth.prepare().length(reading) + sds * SIGMA * normal(random);
        }
        readings
    };
    let corrected = of_nominal(1.0, &mut random);
    let too_far_off = of_nominal(3.0, &mut random);
    let changed = Drawn::new(&bench, &[("theta2".parse().unwrap(), 4e-3)], &mut random).readings;
    // Lengths that scatter about the nominal robot do not show how far off a changed one is.
    let [undecided, fail] = [ConformityOutcome::Undecided, ConformityOutcome::Fail];
    let cases = [
        (corrected, true, &[undecided][..]),
        (too_far_off, false, &[undecided, fail]),
        (changed, false, &[fail]),
    ];
    for (readings, was_corrected, outcomes) in cases {
        let input = CheckInput { tolerance_mm: Some(1.0), ..bench.input(&readings) };
        let found = input.check().unwrap();
        assert!(found.test.changed, "{:?}", found.test);
        let is_named = found.findings.iter().any(|finding| finding.code().as_str() == "W1925");
        assert_eq!(is_named, was_corrected, "{:?}", found.findings);
        assert!(outcomes.contains(&found.decision.decision), "{:?}", found.decision);
        assert!(!was_corrected || found.changes.is_empty() && found.update().is_none());
    }
}

/// A base ball that moved by three tenths of a millimetre is named, where it should have stayed; else it is no change.
#[test]
fn a_moved_ball_is_found_if_it_was_kept() {
    let ids = Coordinate::ALL.map(|axis| ParamId::Ball(BallId::FIRST, axis));
    let change: Vec<(ParamId, f64)> = ids.into_iter().zip([0.2, 0.15, -0.2]).collect();
    let (mut now_mm, mut before_mm) = (0.0, 0.0);
    for (mounting, seen, seed) in [(KEPT, true, 4), (KEPT, true, 5), (KEPT, true, 6), (MOUNTING, false, 4)] {
        let bench = Bench::new(mounting);
        let drawn = Drawn::new(&bench, &change, &mut Pcg64::seed_from_u64(seed));
        let found = bench.input(&drawn.readings).check().unwrap();
        assert_eq!(found.test.changed, seen, "{:?}", found.test);
        let untested = found.findings.iter().any(|finding| finding.code().as_str() == "I1924");
        assert_eq!(untested, !seen);
        let Some(likeliest) = found.changes.first() else { continue };
        assert_eq!(likeliest.parameters, ids);
        for ((size, sd), (_, truth)) in likeliest.change.iter().zip(&likeliest.sd).zip(&change) {
            assert!((size - truth).abs() < 4.0 * sd, "{size} +- {sd} for {truth}");
        }
        // The file of the robot has the new place of the ball.
        let updated = found.update().unwrap();
        now_mm += bench.errors_mm(updated, &drawn.truth)[0];
        before_mm += bench.errors_mm(&bench.robot, &drawn.truth)[0];
        let posterior = updated.posterior.as_ref().unwrap();
        let off = posterior.ball(BallId::FIRST).unwrap() - drawn.truth.balls[0];
        for (off, id) in off.iter().zip(ids) {
            let sd = posterior.sd(id).unwrap();
            assert!(off.abs() < 4.0 * sd && sd < 0.2, "{off} +- {sd}");
        }
    }
    // The robot is what it was.
    assert!(now_mm < 1.2 * before_mm, "{now_mm} {before_mm}");
}

/// Another tool ball, 0.7 mm from where it is stated: the lengths place it, and the position of the robot is known as before. Of twelve
/// checks with 1 % of false alarms two would have one with a probability of 0.6 %.
#[test]
fn the_place_of_another_tool_ball_is_no_error_of_the_robot() {
    let other = [80.0, -30.0, 60.0];
    let mut bench = Bench::new(Mounting { tool_mm: 0.5, ..MOUNTING });
    bench.robot.set_tool(other);
    bench.start.geometry.tool = other.into();
    let ids = Coordinate::ALL.map(ParamId::Tool);
    let change: Vec<(ParamId, f64)> = ids.into_iter().zip([0.4, -0.4, 0.4]).collect();
    let (mut false_alarms, mut now_mm, mut calibrated_mm) = (0, 0.0, 0.0);
    for seed in 1..=12 {
        let drawn = Drawn::new(&bench, &change, &mut Pcg64::seed_from_u64(seed));
        let found = bench.input(&drawn.readings).check().unwrap();
        if found.test.changed {
            false_alarms += 1;
        }
        let CheckUncertainty { calibrated, now, .. } = found.predicted_position_uncertainty_mm;
        now_mm += now.p95;
        calibrated_mm += calibrated.p95;
    }
    assert!(false_alarms <= 1, "{false_alarms}");
    assert!(now_mm < 1.2 * calibrated_mm, "{now_mm} {calibrated_mm}");
}

/// A change as the hypotheses of a check have them before the lengths: none, one, or two.
fn supposed(candidates: &[Vec<ParamId>], random: &mut Pcg64) -> Vec<(ParamId, f64)> {
    let (offsets, others): (Vec<_>, Vec<_>) =
        candidates.iter().partition(|ids| matches!(ids[..], [ParamId::Theta(_)]));
    let one = |random: &mut Pcg64| {
        let among = if random.random::<bool>() { &offsets } else { &others };
        let ids = among[random.random_range(0..among.len())];
        let sd = |id: &ParamId| if id.unit().name() == "mm" { 0.5 } else { 0.05f64.to_radians() };
        ids.iter().map(|id| (*id, sd(id) * normal(random))).collect::<Vec<_>>()
    };
    match random.random_range(0.0..1.0) {
        share if share < 0.5 => Vec::new(),
        share if share < 0.95 => one(random),
        _ => [one(random), one(random)].concat(),
    }
}

/// Decisions at one tolerance.
#[derive(Clone, Copy, Debug, Default)]
struct Decisions {
    pass: usize,
    wrong_pass: usize,
    fail: usize,
    wrong_fail: usize,
    undecided: usize,
}

/// Decisions of so many robots at each of the tolerances, in units of the error that the calibration left.
fn decisions(robots: usize, seed: u64) -> [(f64, Decisions); 5] {
    let bench = Bench::new(MOUNTING);
    let nominal = bench.readings();
    let foreseen = bench.input(&nominal);
    let mut candidates: Vec<Vec<ParamId>> = Vec::new();
    for found in foreseen.power().unwrap().detectable.into_iter().filter(|found| found.smallest.is_some()) {
        match candidates
            .iter_mut()
            .find(|ids| matches!((ids[0], found.name), (ParamId::Tool(_), ParamId::Tool(_))))
        {
            Some(tool) => tool.push(found.name),
            None => candidates.push(vec![found.name]),
        }
    }
    let mut random = Pcg64::seed_from_u64(seed);
    let mut table = [1.0, 1.2, 1.5, 2.0, 4.0].map(|factor| (factor, Decisions::default()));
    for _ in 0..robots {
        let change = supposed(&candidates, &mut random);
        let drawn = Drawn::new(&bench, &change, &mut random);
        let input = bench.input(&drawn.readings);
        let check: InterimCheck = input.check().unwrap();
        let truth_mm = bench.errors_mm(&bench.robot, &drawn.truth)[1];
        for (factor, counts) in &mut table {
            let tolerance = *factor * check.predicted_position_uncertainty_mm.calibrated.p95;
            match decide(&check.position_errors_mm, Some(tolerance), input.rule, false).decision {
                ConformityOutcome::Pass => {
                    counts.pass += 1;
                    counts.wrong_pass += usize::from(truth_mm > tolerance);
                }
                ConformityOutcome::Fail => {
                    counts.fail += 1;
                    counts.wrong_fail += usize::from(truth_mm <= tolerance);
                }
                ConformityOutcome::Undecided => counts.undecided += 1,
                ConformityOutcome::Unchanged | ConformityOutcome::Changed => panic!("a tolerance is given"),
            }
        }
    }
    table
}

#[test]
fn few_decisions_are_wrong() {
    let table = decisions(20, 2);
    eprintln!("{table:?}");
    let wrong: usize = table.iter().map(|(_, counts)| counts.wrong_pass + counts.wrong_fail).sum();
    let made: usize = table.iter().map(|(_, counts)| counts.pass + counts.fail).sum();
    assert!(made > 30 && wrong * 10 <= made, "{wrong} of {made}: {table:?}");
}

#[test]
#[ignore = "a campaign"]
fn wrong_decisions_are_as_rare_as_stated() {
    let table = decisions(2000, 1);
    eprintln!("{table:#?}");
    for (factor, counts) in table {
        let share = |part: usize, whole: usize| part as f64 / whole.max(1) as f64;
        assert!(share(counts.wrong_pass, counts.pass) <= 0.05, "{factor}: {counts:?}");
        assert!(share(counts.wrong_fail, counts.fail) <= 0.05, "{factor}: {counts:?}");
    }
}

/// A robot whose change is identified again predicts the true position again.
#[test]
fn a_change_is_repaired() {
    let bench = Bench::new(MOUNTING);
    let mut random = Pcg64::seed_from_u64(11);
    let id: ParamId = "theta3".parse().unwrap();
    let drawn = Drawn::new(&bench, &[(id, 0.06f64.to_radians())], &mut random);
    let input = CheckInput { tolerance_mm: Some(0.3), ..bench.input(&drawn.readings) };
    let mut spoilt = drawn.readings.clone();
    spoilt[3].length_mm = f64::NAN;
    let refused =
        CheckInput { readings: &spoilt, ..input }.check().err().map(|finding| finding.code().as_str());
    assert_eq!(refused, Some("E1913"));
    let found = input.check().unwrap();
    assert!(found.test.changed);
    assert_eq!(found.changes[0].parameters, [id]);
    assert!(
        (found.changes[0].change[0].to_degrees() - 0.06).abs() < 4.0 * found.changes[0].sd[0].to_degrees()
    );
    let position = &found.predicted_position_uncertainty_mm;
    let updated = found.update().unwrap();
    assert!(position.updated.unwrap().p95 < 0.5 * position.now.p95);
    let [repaired, before] = [updated, &bench.robot].map(|robot| bench.errors_mm(robot, &drawn.truth)[0]);
    assert!(repaired < 0.4 * before, "{repaired} {before}");
}
