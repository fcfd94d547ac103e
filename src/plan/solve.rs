//! From poses to rows: what KRL prints, and the axis angles that the controller takes for it.

use std::ops::Range;

use super::check::unreachable;
use super::job::Job;
use super::rig::{Rig, axis_margin_deg};
use super::steps::Step;
use super::{Kind, Motion, PlanRow};
use crate::catalogue::PlanFinding;
use crate::robot::inverse::{Unsolved, branches, nearest, status, turn, turns_within};
use crate::robot::{AXES, Pose};

/// Axis angles of a branch along a run of steps.
pub(crate) struct Branch {
    pub(crate) rows: Vec<PlanRow>,
    /// Least distance from any limit, degrees: negative outside.
    pub(crate) margin_deg: f64,
}

impl Rig<'_> {
    /// The start angles from which a run of steps may be taken: every branch in every turn.
    ///
    /// # Errors
    /// The first pose is out of reach, or beyond all limits.
    pub(crate) fn starts(&self, first: &Step) -> Result<Vec<[f64; AXES]>, Unsolved> {
        if let Some(axes) = first.axes {
            return Ok(vec![axes]);
        }
        let all = branches(self.arm, &first.pose)?;
        let within: Vec<_> =
            all.iter().flat_map(|axes| turns_within(axes, &self.controller.limits_deg)).collect();
        // Beyond all limits, the findings will say by how much.
        Ok(if within.is_empty() { all } else { within })
    }

    /// The rows of a run of steps, followed from `start` without leaving its branch.
    ///
    /// # Errors
    /// A pose that cannot be reached.
    pub(crate) fn follow(
        &self,
        job: &Job,
        steps: &[Step],
        first_index: u32,
        start: &[f64; AXES],
    ) -> Result<Branch, PlanFinding> {
        let frames = job.motion.frames();
        let mut near = *start;
        // Where the robot is before the auxiliary points of a pass: these are far away on its circle.
        let mut before_pass = None;
        let mut rows = Vec::with_capacity(steps.len());
        let mut margin_deg = f64::INFINITY;
        for ((index, step), next) in
            (first_index..).zip(steps).zip(steps.iter().skip(1).map(Some).chain([None]))
        {
            let auxiliary = |step: &Step| step.kind == Kind::Transit && step.motion == Motion::Circ;
            if auxiliary(step) && next.is_some_and(auxiliary) {
                before_pass = Some(near);
            } else if !auxiliary(step) {
                near = before_pass.take().unwrap_or(near);
            }
            near = step.axes.unwrap_or(near);
            let failed = |why| unreachable(index, step.pose.position.into(), &why);
            let commanded = self.commanded(&step.pose, &near).map_err(failed)?;
            let (xyz_mm, abc_deg) = frames.as_driven(frames.as_printed(&commanded));
            let rounded = Pose::from_kuka(xyz_mm, abc_deg);
            near = nearest(&self.controller.geometry, &rounded, &near).map_err(failed)?;
            let axes_deg = near.map(|a| if a.to_degrees().abs() < 1e-6 { 0.0 } else { a.to_degrees() });
            let axes = axes_deg.map(f64::to_radians);
            margin_deg = margin_deg
                .min(axis_margin_deg(self.controller, &axes))
                .min(axes_deg[4].abs() - job.limits.min_a5_deg);
            let centre = job.ball(step.centre).map_or([0.0; 3], |table| table.xyz_mm);
            rows.push(PlanRow {
                index,
                circle: step.circle,
                centre: step.centre,
                kind: step.kind,
                motion: step.motion,
                xyz_mm,
                abc_deg,
                axes_deg,
                status: status(&self.controller.geometry, &axes),
                turn: turn(&axes),
                length_mm: self.arm.length(&axes, &centre.into(), 0.0),
                dwell_s: step.dwell_s,
            });
        }
        Ok(Branch { rows, margin_deg })
    }
}

/// The runs of steps in which the bar stays on: each begins with a PTP motion to a pose at which the robot is not yet.
pub(crate) fn runs(steps: &[Step]) -> Vec<Range<usize>> {
    let begins: Vec<usize> = (0..steps.len())
        .filter(|&i| {
            let there = i > 0 && steps[i].pose == steps[i - 1].pose;
            steps[i].motion == Motion::Ptp && !there
        })
        .collect();
    let ends = begins.iter().skip(1).copied().chain([steps.len()]);
    begins.iter().copied().zip(ends).map(|(first, past)| first..past).collect()
}
