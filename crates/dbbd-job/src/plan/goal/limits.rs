//! What limits a goal: the sources of the uncertainty that is left.

use crate::plan::prior::KnownCell;
use dbbd_model::estimation::Priors;
use dbbd_model::robot::Tolerance;

/// A source of the uncertainty that is left after a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum GoalLimit {
    Scatter,
    Bar,
    ToolBall,
    Flange,
    Load,
}

impl GoalLimit {
    pub(super) const ALL: [Self; 5] = [Self::Scatter, Self::Bar, Self::ToolBall, Self::Flange, Self::Load];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Scatter => "the scatter of the lengths (repeatability_mm, sigma_um)",
            Self::Bar => "the uncertainty of the bar's length (length_u_mm)",
            Self::ToolBall => "the uncertainty of the tool ball (ball_u_mm)",
            Self::Flange => "the tolerance of the flange (flange_mm, flange_deg)",
            Self::Load => "the uncertainty of the payload (u_kg, u_mm)",
        }
    }

    /// The cell almost without this source.
    pub(super) fn removed(self, cell: &KnownCell) -> KnownCell {
        /// The rest of a source is negligible beside the others.
        const REST: f64 = 0.01;
        let mut cell = cell.clone();
        let bar = &mut cell.job.bar;
        match self {
            Self::Scatter => bar.sigma_um *= REST,
            Self::Bar => bar.length_u_mm = Some(REST * 2.0 * Priors::certified_bar_mm(bar.u_mm())),
            Self::ToolBall | Self::Flange | Self::Load => {}
        }
        let KnownCell { robot, .. } = &mut cell;
        let mut nominal = robot.nominal.take();
        for robot in [Some(&mut *robot), nominal.as_deref_mut()].into_iter().flatten() {
            match self {
                Self::Scatter => robot.repeatability_mm = robot.repeatability_mm.map(|mm| REST * mm),
                Self::Bar => {}
                Self::ToolBall => robot.ball_u_mm *= REST,
                Self::Flange => {
                    let Tolerance { length_mm, angle_deg, .. } = robot.tolerance;
                    robot.tolerance.flange_mm = Some(REST * length_mm);
                    robot.tolerance.flange_deg = Some(REST * angle_deg);
                }
                Self::Load => robot.geometry.load.payloads.iter_mut().for_each(|payload| {
                    payload.u_kg *= REST;
                    payload.u_mm *= REST;
                }),
            }
        }
        robot.nominal = nominal;
        cell
    }
}
