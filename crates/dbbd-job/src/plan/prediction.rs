//! What a plan will determine, for `plan.json`, the page and the terminal.

use serde::Serialize;

use super::job::BaseBallTable;
use super::prior::length_sigma_mm;
use super::region::{ErrorShell, regions, validity};
use super::workspace::workspace;
use super::{Plan, PlanRow, PlanningPrior, PoseKind};
use crate::plan::PlanFinding;
use dbbd_model::design::length_count::{LengthCount, Sufficiency, by_count, sufficiency};
use dbbd_model::design::second_ball::{OneBall, SecondBall};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::priors::WEAK;
use dbbd_model::estimation::result::MapPoint;
use dbbd_model::estimation::wording;
use dbbd_model::estimation::{
    DesignPrediction, ErrorSummary, Observability, ParameterPrediction, predict_design,
};
use dbbd_model::measurement::PreparedMeasurement;
use dbbd_model::robot::inverse::clearance;
use dbbd_model::robot::{AXES, BallId, Robot};

/// Poses over which the 3-D error is taken, as in an identification.
const PREDICTION_WORKSPACE_POSES: usize = 2000;
/// The same where it is taken for many pose sets.
const FEW_POSES: usize = 300;
/// A second ball helps when it leaves less than this share of the error.
const HELPS: f64 = 0.85;

/// What the poses of a plan will determine, with the bar's sigma and the robot's repeatability as noise.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlanPrediction {
    /// Number of lengths that will be measured.
    pub lengths: usize,
    /// Standard deviation of one length, mm: of the bar and of the robot's repeatability together.
    pub sigma_mm: f64,
    /// Rank of the scaled Jacobian of all parameters.
    pub rank: usize,
    /// Number of parameters.
    pub of: usize,
    /// Condition number of the unit-norm columns of the base set.
    pub condition: f64,
    /// Observability indices of the base set, its columns in units of their prior deviations.
    pub observability: Option<Observability>,
    pub parameters: Vec<PredictedParameter>,
    /// Combinations of which only one value is identifiable, in words.
    pub dependent: Vec<String>,
    /// The same for a terminal.
    #[serde(skip)]
    pub dependent_in_short: Vec<String>,
    /// 3-D error over the workspace after the best rigid alignment, mm, as the robot is known now.
    pub now_mm: ErrorSummary,
    /// The same after an identification with the datasheet as prior, mm.
    pub identified_mm: ErrorSummary,
    /// The same for fewer and for more lengths.
    pub against: Vec<LengthCount>,
    /// The error left afterwards by the distance from the base balls.
    pub regions: Vec<ErrorShell>,
    #[serde(rename = "advice")]
    pub recommendations: Vec<Diagnostic>,
}

/// The standard deviations of one parameter, mm or rad.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PredictedParameter {
    pub name: String,
    pub unit: String,
    pub before: f64,
    pub sd: f64,
    /// From the lengths without the prior; absent outside the base set.
    pub alone: Option<f64>,
    #[serde(rename = "fate")]
    pub identifiability: Identifiability,
}

/// Whether the lengths without the prior determine a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Identifiability {
    /// To 3 tolerances or better.
    Identified,
    /// Worse than that.
    #[serde(rename = "too_weak")]
    PoorlyObservable,
    /// Only in a combination that another parameter represents.
    Dependent,
    /// It changes no length.
    #[serde(rename = "unseen")]
    Unobservable,
}

impl PlanRow {
    /// The row as a length to be measured.
    pub fn reading(&self) -> PreparedMeasurement {
        PreparedMeasurement::new(
            self.axes_deg.map(f64::to_radians),
            BallId::numbered(self.centre),
            self.length_mm,
        )
    }
}

impl Plan {
    /// Predicts what this plan will add to `prior`, and stores it in the header. Returns the map of the error that is left,
    /// empty if a number is not finite.
    pub fn predict(&mut self, robot: &Robot, prior: &PlanningPrior) -> Vec<MapPoint> {
        let dwells = self.rows.iter().filter(|row| row.kind != PoseKind::Transit);
        let readings: Vec<PreparedMeasurement> = dwells.map(PlanRow::reading).collect();
        let poses = workspace(&self.header.job, robot, PREDICTION_WORKSPACE_POSES);
        let sigma_mm = length_sigma_mm(&self.header.job, robot);
        let Some(seen) = predict_design(&prior.posterior, &readings, sigma_mm, &poses) else {
            return Vec::new();
        };
        let few = poses.get(..FEW_POSES).unwrap_or(&poses);
        let against = by_count(&prior.posterior, &readings, sigma_mm, few);
        let regions = regions(&self.header.job, &seen.map);
        // After a stage only the next plan matters.
        let recommendations = if self.header.stage.is_some() {
            Vec::new()
        } else {
            let count = sufficiency(&against, robot.repeatability_mm).map(PlanFinding::from);
            let ball = self.second_ball(robot.controller(), readings.len(), few);
            count.into_iter().chain(validity(&regions)).chain(ball).map(Diagnostic::from).collect()
        };
        self.header.predictions = Some(PlanPrediction {
            lengths: readings.len(),
            sigma_mm,
            rank: seen.analysis.base.rank,
            of: seen.analysis.ids.len(),
            condition: seen.analysis.base.condition,
            parameters: seen.parameters.iter().map(|known| predicted(&seen, known)).collect(),
            dependent_in_short: wording::in_short(&seen.analysis.combinations()),
            dependent: seen.analysis.combinations().iter().map(ToString::to_string).collect(),
            now_mm: seen.error_mm[0],
            identified_mm: seen.error_mm[1],
            observability: seen.observability,
            against,
            regions,
            recommendations,
        });
        seen.map
    }

    /// Whether a second ball would help; `None` for a job with several balls, or if no pose can be chosen.
    fn second_ball(&self, robot: &Robot, lengths: usize, workspace: &[[f64; AXES]]) -> Option<PlanFinding> {
        let job = &self.header.job;
        let [table] = job.centres.as_slice() else { return None };
        let limits = &job.limits;
        let one = OneBall {
            robot,
            ball: table.xyz_mm.into(),
            radius_mm: job.bar.length_mm,
            lengths,
            sigma_mm: length_sigma_mm(job, robot),
            workspace,
            seed: u64::from(job.seed),
        };
        let prior = |balls: [nalgebra::Vector3<f64>; 2]| {
            let mut two = job.clone();
            two.centres = (1..)
                .zip(balls)
                .map(|(id, ball)| BaseBallTable {
                    id,
                    xyz_mm: ball.into(),
                    taught_deg: None,
                    ..table.clone()
                })
                .collect();
            PlanningPrior::of_maker(&two, robot)
        };
        let best = one.second(prior, |axes| {
            clearance(&robot.geometry, axes).is_none_or(|clear| {
                clear.wrist.to_degrees() > limits.min_a5_deg
                    && clear.elbow.to_degrees() > limits.min_elbow_deg
                    && clear.overhead > limits.min_overhead_mm
            })
        })?;
        let SecondBall { place, ball, alone_mm, share, turned_share, places } = best;
        let turned_percent = 100.0 * turned_share.min(1.0);
        Some(if share < HELPS {
            let ([x_mm, y_mm, z_mm], percent) = (ball.into(), 100.0 * share);
            PlanFinding::SecondBall { place, x_mm, y_mm, z_mm, percent, alone_mm, turned_percent }
        } else {
            PlanFinding::NoSecondBall { places, percent: 100.0 * HELPS, alone_mm, turned_percent }
        })
    }
}

fn predicted(seen: &DesignPrediction, known: &ParameterPrediction) -> PredictedParameter {
    let &ParameterPrediction { id, before, after, alone } = known;
    let limit = if id.is_geometric() { WEAK * before } else { f64::INFINITY };
    let identifiability = match alone {
        Some(alone) if alone <= limit => Identifiability::Identified,
        Some(_) => Identifiability::PoorlyObservable,
        None if seen.analysis.kept().contains(&id) => Identifiability::PoorlyObservable,
        None if seen.analysis.zero().contains(&id) => Identifiability::Unobservable,
        None => Identifiability::Dependent,
    };
    let (name, unit) = (id.to_string(), id.unit().to_string());
    PredictedParameter { name, unit, before, sd: after, alone, identifiability }
}

impl From<Sufficiency<'_>> for PlanFinding {
    fn from(found: Sufficiency<'_>) -> Self {
        match found {
            Sufficiency::Enough { few, repeatability_mm, planned, doubled } => Self::Enough {
                lengths: few.lengths,
                error_mm: few.error_mm,
                repeatability_mm,
                planned: planned.lengths,
                planned_error_mm: planned.error_mm,
                doubled: doubled.lengths,
                doubled_error_mm: doubled.error_mm,
            },
            Sufficiency::OthersNeeded { planned, doubled } => Self::OthersNeeded {
                planned: planned.lengths,
                planned_error_mm: planned.error_mm,
                doubled_error_mm: doubled.error_mm,
            },
            Sufficiency::MoreHelp { planned, doubled } => Self::MoreHelp {
                planned: planned.lengths,
                planned_error_mm: planned.error_mm,
                doubled_error_mm: doubled.error_mm,
            },
        }
    }
}
