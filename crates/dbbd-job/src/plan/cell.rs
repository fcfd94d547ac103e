//! The checked quantities at one pose of the arm: limits, singularities, cups, obstacles, stroke.

use nalgebra::{DVector, Vector3};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::clearance::LineSegment;
use super::job::BaseBallTable;
use super::prior::length_sigma_mm;
use super::quantity::CheckQuantity;
use super::workspace::goal_poses;
use super::{BarPresence, CandidateConditions, PlanKinematics, PlanningCell, PlanningPrior, StrokeMargin};
use dbbd_model::design::placement::ordered_branches;
use dbbd_model::design::{Candidate, Sphere, tool_rows};
use dbbd_model::estimation::Posterior;
use dbbd_model::robot::inverse::{clearance, status};
use dbbd_model::robot::{AXES, BallId};

/// Length of the bar at the base ball that is not checked, mm: there the bar is in the cup, whose limit guards it.
const IN_CUP_MM: f64 = 50.0;
/// Poses about a ball in each branch of the arm by which branches are compared, and poses of each tool over which they are.
const BRANCH_CANDIDATES: usize = 150;
const BRANCH_WORKSPACE_POSES: usize = 100;
/// Number of robots drawn: at a risk of 1e-3 the share has a relative standard deviation of a fifth.
const ROBOTS: usize = 20_000;
/// Poses with less than this share of the greatest risk are neglected.
const NEGLIGIBLE: f64 = 1e-4;

impl<'a> PlanningCell<'a> {
    /// The cell for a run about base ball `centre` (from 1) that starts at axis angles in rad.
    pub(super) fn new(
        rig: PlanKinematics<'a>,
        prior: &PlanningPrior,
        centre: u32,
        start: &[f64; AXES],
    ) -> Self {
        Self { rig, posterior: prior.at_start(&rig, centre, start).posterior }
    }

    /// Computes all quantities at axis angles in rad, the cheap ones first, until `note` returns `None`.
    pub(super) fn evaluate(
        &self,
        axes: &[f64; AXES],
        centre: u32,
        mounted: BarPresence,
        note: &mut impl FnMut(CheckQuantity, f64) -> Option<()>,
    ) -> Option<StrokeMargin> {
        note(CheckQuantity::AxisMarginDeg, self.rig.controller.limit_margin_deg(axes))?;
        let job = self.rig.job;
        let table = job.ball(centre)?;
        let base = Vector3::from(table.xyz_mm);
        let ball = self.rig.arm.ball(axes);
        if mounted == BarPresence::No {
            self.obstacles(axes, None, &ball.position, note)?;
            return None;
        }
        if let Some(clear) = clearance(&self.rig.controller.geometry, axes) {
            note(CheckQuantity::WristDeg, clear.wrist.to_degrees())?;
            note(CheckQuantity::ElbowDeg, clear.elbow.to_degrees())?;
            note(CheckQuantity::OverheadMm, clear.overhead)?;
        }
        let bar = &job.bar;
        let along = ball.position - base;
        let reading = along.norm() - bar.length_mm;
        note(CheckQuantity::ReadingLowMm, reading)?;
        note(CheckQuantity::ReadingHighMm, reading)?;
        if let (Some(cup), Some(_)) = (table.cup_axis, table.cup_limit_deg) {
            note(CheckQuantity::CupDeg, along.angle(&Vector3::from(cup)).to_degrees())?;
        }
        if let (Some(cup), Some(_)) = (job.tool.cup_axis, job.tool.cup_limit_deg) {
            let out = ball.rotation * Vector3::from(cup);
            note(CheckQuantity::ToolCupDeg, (-along).angle(&out).to_degrees())?;
        }
        self.obstacles(axes, Some(base), &ball.position, note)?;
        let room = [reading - bar.stroke_mm[0], bar.stroke_mm[1] - reading];
        let ball = BallId::new(centre)?;
        let design_row = self.posterior.design_row(axes, ball);
        // At the start itself only the bar's own noise is left.
        let own_sd_mm = self.posterior.own_sd_mm(axes, ball).max(bar.sigma_um * 1e-3);
        let mut margin = StrokeMargin { room, design_row, own_sd_mm, risk: 0.0 };
        margin.risk = margin.leaves(0.0);
        note(CheckQuantity::StrokeRisk, margin.risk)?;
        Some(margin)
    }

    /// Whether all limits are kept with their reserves, with a stroke risk of at most `risk`.
    pub(super) fn allows(&self, axes: &[f64; AXES], centre: u32, risk: f64) -> bool {
        let kept = |quantity: CheckQuantity, value: f64| {
            let limit = if matches!(quantity, CheckQuantity::StrokeRisk) {
                risk
            } else {
                quantity.limit(self.rig.job, centre)
            };
            let slack = if quantity.at_least() { value - limit } else { limit - value };
            (slack >= quantity.reserve()).then_some(())
        };
        self.evaluate(axes, centre, BarPresence::Yes, &mut { kept }).is_some()
    }

    /// Candidates about a base ball (from 1).
    pub(super) fn candidates(
        &self,
        centre: u32,
        count: usize,
        reach: &CandidateConditions,
    ) -> Vec<Candidate> {
        self.by_branch(centre, count, reach).into_iter().max_by_key(Vec::len).unwrap_or_default()
    }

    /// Candidates about a base ball (from 1), those of each branch of the arm.
    fn by_branch(&self, centre: u32, count: usize, reach: &CandidateConditions) -> [Vec<Candidate>; 8] {
        let job = self.rig.job;
        let Some((id, table)) = BallId::new(centre).zip(job.ball(centre)) else { return Default::default() };
        let sphere = Sphere {
            arm: self.rig.arm,
            controller: self.rig.controller,
            id,
            ball: Vector3::from(table.xyz_mm),
            radius_mm: job.bar.length_mm,
            near: reach.near.as_ref(),
        };
        let seed = u64::from(job.seed) << 8 | u64::from(centre);
        sphere.by_branch(count, seed, |axes| {
            reach.branch.is_none_or(|branch| self.branch_of(axes) == branch)
                && self.allows(axes, centre, reach.risk)
        })
    }

    /// The branches of the arm in which a base ball may be measured: that in which it was taught, else those in which poses leave the
    /// smallest position error of what is known first, without regard to their risk. Empty if no pose can be reached.
    pub(super) fn branches(&self, table: &BaseBallTable, known: &Posterior) -> Vec<u8> {
        if let Some(taught_deg) = table.taught_deg {
            return vec![self.branch_of(&taught_deg.map(f64::to_radians))];
        }
        let PlanKinematics { job, controller, .. } = self.rig;
        let known = known.with_ball(Vector3::from(table.xyz_mm));
        let errors = tool_rows(&known, &goal_poses(job, controller, BRANCH_WORKSPACE_POSES));
        let anywhere = CandidateConditions { risk: 1.0, branch: None, near: None };
        let branches = self.by_branch(table.id, BRANCH_CANDIDATES, &anywhere);
        let ordered = ordered_branches(branches, &known, &errors, length_sigma_mm(job, controller));
        ordered.iter().filter_map(|poses| Some(self.branch_of(&poses.first()?.axes))).collect()
    }

    /// The status bits of the branch of the arm.
    fn branch_of(&self, axes: &[f64; AXES]) -> u8 {
        status(self.rig.arm, axes) & 7
    }

    /// Standard deviation of the length of a pose, mm.
    pub(super) fn sd_mm(&self, pose: &Candidate) -> f64 {
        self.posterior.design_row(&pose.axes, pose.ball).norm()
    }

    /// The probability that the length of a pose leaves the stroke.
    pub(super) fn risk(&self, pose: &Candidate) -> f64 {
        self.risk_out(pose, 0.0)
    }

    /// The probability that the length leaves the stroke if the pose is moved `out` mm away from the ball.
    pub(super) fn risk_out(&self, pose: &Candidate, out: f64) -> f64 {
        let margin = self.evaluate(&pose.axes, pose.ball.number(), BarPresence::Yes, &mut |_, _| Some(()));
        margin.map_or(1.0, |margin| margin.leaves(out))
    }

    fn obstacles(
        &self,
        axes: &[f64; AXES],
        base: Option<Vector3<f64>>,
        ball: &Vector3<f64>,
        note: &mut impl FnMut(CheckQuantity, f64) -> Option<()>,
    ) -> Option<()> {
        let job = self.rig.job;
        if job.obstacles.is_empty() {
            return Some(());
        }
        let tool = &job.tool;
        let joints = self.rig.arm.skeleton(axes);
        let mut parts: Vec<(LineSegment, f64)> =
            joints.windows(2).skip(1).map(|pair| ([pair[0], pair[1]], tool.arm_radius_mm)).collect();
        // The last link carries the flange, which is as thick as the tool.
        if let Some(last) = parts.last_mut() {
            last.1 = tool.radius_mm.max(0.5 * tool.arm_radius_mm);
        }
        parts.push(([joints[AXES - 1], *ball], tool.radius_mm));
        if let Some(base) = base {
            let along = (ball - base).normalize();
            parts.push(([base + along * IN_CUP_MM, *ball], job.bar.radius_mm));
        }
        let distances = parts.iter().flat_map(|(segment, radius)| {
            job.obstacles.iter().map(move |obstacle| obstacle.from_segment(segment) - radius)
        });
        note(CheckQuantity::ClearanceMm, distances.fold(f64::INFINITY, f64::min))
    }
}

impl StrokeMargin {
    /// The probability that the length leaves the stroke if the pose is moved `out_mm` away from the ball.
    fn leaves(&self, out_mm: f64) -> f64 {
        let sd_mm = self.design_row.norm().hypot(self.own_sd_mm);
        let [low_mm, high_mm] = [self.room[0] + out_mm, self.room[1] - out_mm];
        (normal_tail(high_mm / sd_mm) + normal_tail(low_mm / sd_mm)).min(1.0)
    }
}

/// Upper tail of the standard normal distribution: the Chebyshev fit of erfc by Press et al.,
/// Numerical Recipes 6.2, relative error below 1.2e-7.
fn normal_tail(z: f64) -> f64 {
    const FIT: [f64; 10] = [
        -1.265_512_23,
        1.000_023_68,
        0.374_091_96,
        0.096_784_18,
        -0.186_288_06,
        0.278_868_07,
        -1.135_203_98,
        1.488_515_87,
        -0.822_152_23,
        0.170_872_77,
    ];
    let x = z.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.5 * x);
    let series = FIT.iter().rev().fold(0.0, |sum, coefficient| sum * t + coefficient);
    let tail = 0.5 * t * (series - x * x).exp();
    if z >= 0.0 { tail } else { 1.0 - tail }
}

/// The probability that a run leaves the stroke anywhere: the share of drawn robots that leave it at any of the poses;
/// the sum of the risks if that is less.
///
/// The readings of one robot are correlated: the sum of the risks of all poses is far too large, the greatest one too
/// small. Robots are drawn from the prior, and the worst pose of each row is evaluated to first order.
pub(super) fn over_run(poses: &[StrokeMargin]) -> f64 {
    let sum: f64 = poses.iter().map(|pose| pose.risk).sum();
    let largest = poses.iter().map(|pose| pose.risk).fold(0.0, f64::max);
    // A smaller risk is below the resolution of the draws.
    if sum < 1.0 / ROBOTS as f64 {
        return sum;
    }
    let critical: Vec<&StrokeMargin> = poses.iter().filter(|pose| pose.risk > NEGLIGIBLE * largest).collect();
    let unknowns = critical.first().map_or(0, |pose| pose.design_row.len());
    let mut random = Pcg64::seed_from_u64(1);
    let mut robot = DVector::zeros(unknowns);
    let mut leave = 0_u32;
    for _ in 0..ROBOTS {
        robot.iter_mut().for_each(|value| *value = StandardNormal.sample(&mut random));
        let mut leaves = |pose: &&StrokeMargin| {
            let own: f64 = StandardNormal.sample(&mut random);
            let moved = pose.design_row.dot(&robot) + pose.own_sd_mm * own;
            moved > pose.room[1] || moved < -pose.room[0]
        };
        leave += u32::from(critical.iter().any(&mut leaves));
    }
    (f64::from(leave) / ROBOTS as f64).min(sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::example::{job, robot};
    use dbbd_model::robot::Pose;

    /// Reference values: 0.5 erfc(z / sqrt 2) by Python's `math.erfc`.
    #[test]
    fn normal_tail_is_that_of_python() {
        for (z, tail) in [
            (0.0, 0.5),
            (0.5, 0.308_537_538_725_986_9),
            (1.0, 0.158_655_253_931_457_07),
            (2.0, 0.022_750_131_948_179_212),
            (3.0, 0.001_349_898_031_630_094_6),
            (4.5, 3.397_673_124_730_060_4e-6),
            (6.0, 9.865_876_450_376_98e-10),
            (-1.5, 0.933_192_798_731_141_9),
        ] {
            assert!((normal_tail(z) / tail - 1.0).abs() < 2e-7, "{z}");
        }
    }

    /// The pose with the tool ball beside the ball of the example, along Y, in the orientation of the job in `fixtures/two-balls`.
    fn pose(rig: &PlanKinematics<'_>, distance_mm: f64) -> Candidate {
        let near = [-2.8178, -61.2356, 116.7537, 13.6265, 57.4349, -206.6011].map(f64::to_radians);
        let position = Vector3::new(1300.0, distance_mm, 800.0);
        let pose = Pose { rotation: rig.arm.ball(&near).rotation, position };
        let axes = dbbd_model::robot::inverse::nearest(rig.arm, &pose, &near).expect("it is in reach");
        Candidate { ball: BallId::FIRST, axes, pose }
    }

    /// The stroke reaches 2 mm inwards and 6 mm outwards.
    #[test]
    fn room_is_the_distance_from_each_end_of_the_stroke() {
        let (job, robot) = (job(""), robot());
        let rig = PlanKinematics::new(&job, &robot);
        let prior = PlanningPrior::datasheet(&job, &robot);
        let pose = pose(&rig, 301.5);
        let cell = PlanningCell::new(rig, &prior, 1, &pose.axes);
        let margin =
            cell.evaluate(&pose.axes, 1, BarPresence::Yes, &mut |_, _| Some(())).expect("it is mounted");
        assert!((margin.room[0] - 3.5).abs() < 1e-6 && (margin.room[1] - 4.5).abs() < 1e-6);
        let sd_mm = cell.sd_mm(&pose);
        assert!((sd_mm - margin.design_row.norm()).abs() < 1e-12);
        // The sigma of the bar is 2 um where the job gives none.
        let sd_mm = sd_mm.hypot(0.002);
        let expected = normal_tail(3.5 / sd_mm) + normal_tail(4.5 / sd_mm);
        assert!((margin.risk / expected - 1.0).abs() < 1e-6);
        // Farther out there is less room above, farther in there is less room below.
        let outwards = normal_tail(5.5 / sd_mm) + normal_tail(2.5 / sd_mm);
        let inwards = normal_tail(2.0 / sd_mm) + normal_tail(6.0 / sd_mm);
        assert!((cell.risk_out(&pose, 2.0) / outwards - 1.0).abs() < 1e-6);
        assert!((cell.risk_out(&pose, -1.5) / inwards - 1.0).abs() < 1e-6);
    }

    #[test]
    fn risk_is_certain_beyond_the_stroke_and_bounded_by_the_noise_of_the_bar() {
        let (job, robot) = (job(""), robot());
        let rig = PlanKinematics::new(&job, &robot);
        let prior = PlanningPrior::datasheet(&job, &robot);
        let start = pose(&rig, 300.0);
        let cell = PlanningCell::new(rig, &prior, 1, &start.axes);
        let bar = |room: [f64; 2]| StrokeMargin {
            room,
            design_row: DVector::zeros(3),
            own_sd_mm: 0.002,
            risk: 0.0,
        };
        assert!((bar([0.002, 1.0]).leaves(0.0) / normal_tail(1.0) - 1.0).abs() < 1e-9);
        assert!((bar([1.0, 0.004]).leaves(0.0) / normal_tail(2.0) - 1.0).abs() < 1e-9);
        assert_eq!(bar([-1.0, -1.0]).leaves(0.0), 1.0);
        assert!(!cell.allows(&pose(&rig, 310.0).axes, 1, 1.0));
        assert!(cell.allows(&start.axes, 1, 1.0));
        assert!(!cell.allows(&start.axes, 1, 0.0));
    }

    /// The reserve is 0.1 degrees, and 0.5 mm about axis 1.
    #[test]
    fn a_chosen_pose_keeps_a_reserve_from_each_limit() {
        let (job, robot) = (job(""), robot());
        let start = pose(&PlanKinematics::new(&job, &robot), 300.0).axes;
        let clear = clearance(&robot.geometry, &start).expect("the wrist is spherical");
        let allows = |wrist_slack_deg: f64, overhead_slack_mm: f64| {
            let mut job = job.clone();
            job.limits.min_a5_deg = clear.wrist.to_degrees() - wrist_slack_deg;
            job.limits.min_overhead_mm = clear.overhead - overhead_slack_mm;
            let rig = PlanKinematics::new(&job, &robot);
            PlanningCell::new(rig, &PlanningPrior::datasheet(&job, &robot), 1, &start).allows(&start, 1, 1.0)
        };
        assert_eq!([allows(0.08, 9.0), allows(0.12, 9.0)], [false, true]);
        assert_eq!([allows(9.0, 0.4), allows(9.0, 0.6)], [false, true]);
    }

    #[test]
    fn bar_is_clear_of_an_obstacle_by_the_distance_less_its_radius() {
        let box_below = "[[obstacle]]\nshape = \"box\"\nlow_mm = [1250.0, 120.0, 600.0]\nhigh_mm = [1350.0, 180.0, 740.0]\n";
        let (job, robot) = (job(box_below), robot());
        let rig = PlanKinematics::new(&job, &robot);
        let prior = PlanningPrior::datasheet(&job, &robot);
        let pose = pose(&rig, 300.0);
        let cell = PlanningCell::new(rig, &prior, 1, &pose.axes);
        let mut clearance_mm = None;
        _ = cell.evaluate(&pose.axes, 1, BarPresence::Yes, &mut |quantity, value| {
            if quantity == CheckQuantity::ClearanceMm {
                clearance_mm = Some(value);
            }
            Some(())
        });
        // The bar is 60 mm above the box, less its radius of 15 mm; tool and arm are higher.
        assert!((clearance_mm.expect("there is an obstacle") - 45.0).abs() < 1e-3, "{clearance_mm:?}");
    }

    /// A pose that leaves its stroke outwards or inwards where the only unknown passes a bound.
    fn margin(room: [f64; 2], derivative: f64, risk: f64) -> StrokeMargin {
        StrokeMargin { room, design_row: DVector::from_vec(vec![derivative]), own_sd_mm: 0.0, risk }
    }

    /// P(x > 1) = 0.158655 by the table of the normal distribution; 20 000 draws have a standard deviation of 0.0026.
    #[test]
    fn poses_of_one_robot_are_at_risk_together() {
        let tail = 0.158_655;
        let outwards = margin([9.0, 1.0], 1.0, tail);
        let risk = over_run(&[outwards.clone(), outwards.clone(), outwards.clone()]);
        assert!((risk - tail).abs() < 0.008, "{risk}");
        // Inwards the opposite robots leave the stroke; outwards they do so with the opposite derivative.
        let inwards = over_run(&[outwards.clone(), margin([1.0, 9.0], 1.0, tail)]);
        assert!((inwards - 2.0 * tail).abs() < 0.011, "{inwards}");
        let opposite = over_run(&[outwards.clone(), margin([9.0, 1.0], -1.0, tail)]);
        assert!((opposite - 2.0 * tail).abs() < 0.011, "{opposite}");
        let same = over_run(&[outwards, margin([1.0, 9.0], -1.0, tail)]);
        assert!((same - tail).abs() < 0.008, "{same}");
    }

    #[test]
    fn risk_is_at_most_the_sum_and_exact_below_the_resolution() {
        // Below 1 / 20 000 nothing is drawn.
        assert_eq!(over_run(&[margin([-9.0, 9.0], 1.0, 1e-5), margin([9.0, 9.0], 1.0, 3e-5)]), 4e-5);
        assert_eq!(over_run(&[margin([9.0, 9.0], 1.0, 6e-5)]), 0.0);
        assert_eq!(over_run(&[margin([-9.0, 9.0], 1.0, 0.25)]), 0.25);
        assert_eq!(over_run(&[]), 0.0);
    }

    #[test]
    fn poses_of_a_ten_thousandth_of_the_greatest_risk_are_neglected() {
        let risky = margin([9.0, 9.0], 1.0, 1.0);
        let always = |risk| over_run(&[risky.clone(), margin([-9.0, 9.0], 1.0, risk)]);
        assert_eq!([always(1.5e-4), always(0.5e-4)], [1.0, 0.0]);
    }
}
