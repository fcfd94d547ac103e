//! The checked quantities at one position of the arm: limits, singularities, cups, obstacles, stroke.

use nalgebra::{DVector, Vector3};

use super::PlanningPrior;
use super::clearance::{IN_CUP_MM, LineSegment};
use super::quantity::CheckQuantity;
use super::rig::PlanKinematics;
use dbbd_model::design::{Candidate, Near, Sphere};
use dbbd_model::estimation::Posterior;
use dbbd_model::robot::inverse::{clearance, status};
use dbbd_model::robot::{AXES, BallId};

/// The robot in its cell with what is known of it when a run starts.
pub(crate) struct PlanningCell<'a> {
    pub(crate) rig: PlanKinematics<'a>,
    posterior: Posterior,
}

/// Distance of a reading from the ends of the stroke, with its uncertainty.
#[derive(Clone)]
pub(crate) struct StrokeMargin {
    /// To the lower and to the upper end of the stroke, mm.
    pub(crate) room: [f64; 2],
    /// The reading's derivative in the coordinates of the prior, mm.
    pub(crate) design_row: DVector<f64>,
    /// Probability of leaving the stroke at this pose.
    pub(crate) risk: f64,
}

/// Whether the bar is mounted; without it only limits and clearance of the arm count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BarPresence {
    Yes,
    No,
}

/// Conditions on candidates.
pub(crate) struct CandidateConditions {
    pub(crate) risk: f64,
    /// Status bits of the only branch, if it matters.
    pub(crate) branch: Option<u8>,
    pub(crate) near: Option<Near>,
}

impl<'a> PlanningCell<'a> {
    /// For a run about base ball `centre` (from 1) that starts at axis angles in rad.
    pub(crate) fn new(
        rig: PlanKinematics<'a>,
        prior: &PlanningPrior,
        centre: u32,
        start: &[f64; AXES],
    ) -> Self {
        Self { rig, posterior: prior.at_start(&rig, centre, start).posterior }
    }

    /// Computes all quantities at axis angles in rad, the cheap ones first, until `note` returns `None`.
    pub(crate) fn evaluate(
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
        let design_row = self.posterior.design_row(axes, BallId::new(centre)?);
        let risk = self.leaves(room, &design_row);
        note(CheckQuantity::StrokeRisk, risk)?;
        Some(StrokeMargin { room, design_row, risk })
    }

    /// Whether all limits are kept, with a stroke risk of at most `risk`.
    pub(crate) fn allows(&self, axes: &[f64; AXES], centre: u32, risk: f64) -> bool {
        let kept = |quantity: CheckQuantity, value: f64| {
            let limit = match quantity {
                CheckQuantity::StrokeRisk => risk,
                _ => quantity.limit(self.rig.job, centre),
            };
            (if quantity.at_least() { value >= limit } else { value <= limit }).then_some(())
        };
        self.evaluate(axes, centre, BarPresence::Yes, &mut { kept }).is_some()
    }

    /// Candidates about a base ball (from 1).
    pub(crate) fn candidates(
        &self,
        centre: u32,
        count: usize,
        reach: &CandidateConditions,
    ) -> Vec<Candidate> {
        let job = self.rig.job;
        let Some(table) = job.ball(centre) else { return Vec::new() };
        let sphere = Sphere {
            arm: self.rig.arm,
            controller: self.rig.controller,
            id: BallId::numbered(centre),
            ball: Vector3::from(table.xyz_mm),
            radius_mm: job.bar.length_mm,
            near: reach.near.as_ref(),
        };
        let seed = u64::from(job.seed) << 8 | u64::from(centre);
        sphere.candidates(count, seed, |axes| {
            reach.branch.is_none_or(|branch| status(self.rig.arm, axes) & 7 == branch)
                && self.allows(axes, centre, reach.risk)
        })
    }

    /// Standard deviation of the length of a pose, mm.
    pub(crate) fn sd_mm(&self, pose: &Candidate) -> f64 {
        self.posterior.design_row(&pose.axes, pose.ball).norm()
    }

    /// The probability that the length of a pose leaves the stroke.
    pub(crate) fn risk(&self, pose: &Candidate) -> f64 {
        self.risk_out(pose, 0.0)
    }

    /// The same `out` mm farther from the ball.
    pub(crate) fn risk_out(&self, pose: &Candidate, out: f64) -> f64 {
        let margin = self.evaluate(&pose.axes, pose.ball.number(), BarPresence::Yes, &mut |_, _| Some(()));
        margin.map_or(1.0, |one| self.leaves([one.room[0] + out, one.room[1] - out], &one.design_row))
    }

    /// The probability that a length with this room (mm) leaves the stroke.
    fn leaves(&self, room: [f64; 2], design_row: &DVector<f64>) -> f64 {
        // At the start itself only the bar's own noise is left.
        let sd = design_row.norm().max(self.rig.job.bar.sigma_um * 1e-3);
        (normal_tail(room[1] / sd) + normal_tail(room[0] / sd)).min(1.0)
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

/// Upper tail of the standard normal distribution: the Chebyshev fit of erfc by Press et al.,
/// Numerical Recipes 6.2, relative error below 1.2e-7.
pub(crate) fn normal_tail(z: f64) -> f64 {
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
