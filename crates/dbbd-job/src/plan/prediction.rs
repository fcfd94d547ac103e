//! Predicts the result of a plan, for `plan.json`, the page and the terminal.

use nalgebra::Vector3;
use serde::Serialize;

use super::job::{BaseBallTable, Job, JobBar};
use super::prior::length_sigma_mm;
use super::rows::approaches;
use super::workspace::workspace;
use super::{PlanRow, PlanningPrior, PoseKind};
use crate::plan::PlanFinding;
use dbbd_model::design::Candidate;
use dbbd_model::design::length_count::{LengthCount, Sufficiency, by_count, sufficiency};
use dbbd_model::design::second_ball::{OneBall, SecondBall};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::priors::WEAK;
use dbbd_model::estimation::result::MapPoint;
use dbbd_model::estimation::wording;
use dbbd_model::estimation::{
    DesignPrediction, ErrorSummary, Observability, ParameterPrediction, PlannedLengths,
};
use dbbd_model::measurement::{LengthModel, Measurement, PreparedMeasurement};
use dbbd_model::robot::inverse::clearance;
use dbbd_model::robot::{AXES, Approach, Robot};

/// Poses over which the 3-D error is taken, as in an identification.
const PREDICTION_WORKSPACE_POSES: usize = 2000;
/// Number of such poses where the error is taken for many pose sets.
const FEW_POSES: usize = 300;
/// A second ball helps when it leaves less than this share of the error.
const HELPS: f64 = 0.85;
/// Outer radii of the shells about the base balls, mm.
const WITHIN_MM: [f64; 5] = [300.0, 600.0, 1000.0, 1500.0, f64::INFINITY];
/// A result is valid in shells with an error of up to this many times the least one.
const ALIKE: f64 = 2.0;
/// Minimum number of poses of a shell.
const MIN_SHELL_POSES: usize = 10;

/// Predicted result of the poses of a plan, with the bar's sigma and the robot's repeatability as noise.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlanPrediction {
    /// Number of lengths that will be measured.
    pub lengths: usize,
    /// Standard deviation of one length, mm: the bar's sigma and the robot's repeatability together.
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
    /// Combinations of parameters of which only one value is identifiable, in words.
    pub dependent: Vec<String>,
    /// The same combinations in short, for a terminal.
    #[serde(skip)]
    pub dependent_in_short: Vec<String>,
    /// 3-D error over the workspace after the best rigid alignment, mm, as the robot is known now.
    pub now_mm: ErrorSummary,
    /// The same error after an identification with the datasheet as prior, mm.
    pub identified_mm: ErrorSummary,
    /// The same prediction for fewer and for more lengths.
    pub against: Vec<LengthCount>,
    /// The error left after the identification, by the distance from the base balls.
    pub regions: Vec<ErrorShell>,
    pub recommendations: Vec<Diagnostic>,
}

/// The standard deviations of one parameter, mm or rad.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PredictedParameter {
    pub name: String,
    pub unit: String,
    pub before: f64,
    pub sd: f64,
    /// Standard deviation from the lengths without the prior; absent outside the base set.
    pub alone: Option<f64>,
    pub identifiability: Identifiability,
}

/// Whether the lengths without the prior determine a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Identifiability {
    /// The lengths determine the parameter to 3 tolerances or better.
    Identified,
    /// The lengths determine the parameter worse than that.
    PoorlyObservable,
    /// The lengths determine only a combination, which another parameter represents.
    Dependent,
    /// The parameter changes no length.
    Unobservable,
}

impl PlanRow {
    /// The row as a length to be measured with a bar of the job.
    pub fn reading(&self, bar: &JobBar) -> PreparedMeasurement {
        let axes = self.axes_deg.map(f64::to_radians);
        let force_n = bar.force_n.unwrap_or(0.0);
        PreparedMeasurement { force_n, ..PreparedMeasurement::new(axes, self.centre, self.length_mm) }
    }
}

impl PlanPrediction {
    /// The information that the rows of a plan will add to `prior`, and the map of the error that is left; `None` if a
    /// number is not finite. `is_stage`: the rows are a stage, after which only the next plan matters.
    pub(super) fn of_rows(
        job: &Job,
        rows: &[PlanRow],
        is_stage: bool,
        robot: &Robot,
        prior: &PlanningPrior,
    ) -> Option<(Self, Vec<MapPoint>)> {
        let planned = planned_lengths(job, rows, &prior.posterior.model);
        let poses = workspace(job, robot, PREDICTION_WORKSPACE_POSES);
        let few = poses.get(..FEW_POSES).unwrap_or(&poses).to_vec();
        let sigma_mm = length_sigma_mm(job, robot);
        let start = first_model(robot, prior);
        let [of_all, of_few] = [poses, few.clone()].map(|poses| prior.options(job, Some(poses)));
        let whole = PlannedLengths::new(prior.identification(robot, &start, &of_all), &planned).ok()?;
        let seen = whole.predict(&prior.posterior, 0..planned.len(), sigma_mm)?;
        let now_mm = whole.stated_before();
        // Few poses of the workspace compare numbers of lengths; that of the plan has the error that the plan states.
        let mut against = by_count(&prior.posterior, &whole.over(&of_few), sigma_mm);
        let all = against.iter().find(|count| count.lengths == planned.len());
        let scale = all.map_or(1.0, |count| seen.forecast.position_mm.mean / count.error_mm);
        against.iter_mut().for_each(|count| count.error_mm *= scale);
        let regions = regions(job, &seen.forecast.map);
        let recommendations = if is_stage {
            Vec::new()
        } else {
            let count = sufficiency(&against, robot.repeatability_mm).map(PlanFinding::from);
            let ball = second_ball(job, robot.controller(), planned.len(), &few);
            count.into_iter().chain(validity(&regions)).chain(ball).map(Diagnostic::from).collect()
        };
        let prediction = Self {
            lengths: planned.len(),
            sigma_mm,
            rank: seen.analysis.base.rank,
            of: seen.analysis.ids.len(),
            condition: seen.analysis.base.condition,
            parameters: seen.parameters.iter().map(|known| predicted(&seen, known)).collect(),
            dependent_in_short: wording::in_short(&seen.analysis.combinations()),
            dependent: seen.analysis.combinations().iter().map(ToString::to_string).collect(),
            now_mm,
            identified_mm: seen.forecast.position_mm,
            observability: seen.observability,
            against,
            regions,
            recommendations,
        };
        Some((prediction, seen.forecast.map))
    }
}

/// The model from which an identification begins: a robot that was not identified is identified from its nominal geometry.
pub(super) fn first_model(robot: &Robot, prior: &PlanningPrior) -> LengthModel {
    let model = prior.posterior.model.clone();
    match prior.calibrated {
        Some(_) => model,
        None => LengthModel { geometry: robot.controller().geometry.clone(), ..model },
    }
}

/// The rows of a plan as a table of lengths that agree with the model.
pub(super) fn planned_lengths(job: &Job, rows: &[PlanRow], model: &LengthModel) -> Vec<Measurement> {
    let with_approach = rows.iter().zip(approaches(rows));
    let dwells = with_approach.filter(|(row, _)| row.kind != PoseKind::Transit);
    let readings = dwells.map(|(row, approach)| {
        (row.index, PreparedMeasurement { approach, force_n: 0.0, ..row.reading(&job.bar) })
    });
    lengths(job, readings, model)
}

/// Poses as a table of lengths that agree with the model, in the order in which they are given.
pub(super) fn lengths_at(job: &Job, poses: &[Candidate], model: &LengthModel) -> Vec<Measurement> {
    let with_approach = poses.iter().zip(Approach::along(poses.iter().map(|pose| pose.axes)));
    let readings = (1..).zip(with_approach).map(|(index, (pose, approach))| {
        (index, PreparedMeasurement { approach, ..PreparedMeasurement::new(pose.axes, pose.ball, 0.0) })
    });
    lengths(job, readings, model)
}

fn lengths(
    job: &Job,
    readings: impl Iterator<Item = (u32, PreparedMeasurement)>,
    model: &LengthModel,
) -> Vec<Measurement> {
    let (model, sigma_mm) = (model.prepare(), Some(job.bar.sigma_um * 1e-3));
    let length = |(index, mut reading): (u32, PreparedMeasurement)| {
        reading.length_mm = model.length(&reading);
        Measurement { sigma_mm, ..Measurement::of_prepared(index, &reading) }
    };
    readings.map(length).collect()
}

/// Whether a second ball would help; `None` for a job with several balls, or if no pose can be chosen.
fn second_ball(job: &Job, robot: &Robot, lengths: usize, workspace: &[[f64; AXES]]) -> Option<PlanFinding> {
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
    let prior = |balls: &[Vector3<f64>]| {
        let about = job.with_centres(balls.iter().map(|ball| BaseBallTable {
            xyz_mm: (*ball).into(),
            taught_deg: None,
            ..table.clone()
        }));
        PlanningPrior::before_lengths(&about, robot)
    };
    let best = one.second(prior, |axes| {
        clearance(&robot.geometry, axes).is_none_or(|clear| {
            clear.wrist.to_degrees() > limits.min_a5_deg
                && clear.elbow.to_degrees() > limits.min_elbow_deg
                && clear.overhead > limits.min_overhead_mm
        })
    })?;
    let SecondBall { place, ball, share, turned_share, places } = best;
    let turned_percent = 100.0 * turned_share.min(1.0);
    Some(if share < HELPS {
        let ([x_mm, y_mm, z_mm], percent) = (ball.into(), 100.0 * share);
        PlanFinding::SecondBall { place, x_mm, y_mm, z_mm, percent, turned_percent }
    } else {
        PlanFinding::NoSecondBall { places, percent: 100.0 * HELPS, turned_percent }
    })
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

/// The error in a shell about the base balls.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ErrorShell {
    /// Least distance from the nearest base ball, mm.
    beyond_mm: f64,
    /// Greatest distance, absent for the outermost shell.
    within_mm: Option<f64>,
    /// Root mean square of the predicted position uncertainty, mm.
    error_mm: f64,
}

/// The shells about the job's base balls in which the map has enough poses.
fn regions(job: &Job, map: &[MapPoint]) -> Vec<ErrorShell> {
    let far = |place: &Vector3<f64>| {
        let off = |ball: &[f64; 3]| (place - Vector3::from(*ball)).norm();
        job.centres.iter().map(|table| off(&table.xyz_mm)).fold(f64::INFINITY, f64::min)
    };
    let mut beyond_mm = 0.0;
    let mut regions = Vec::new();
    for within in WITHIN_MM {
        let there = map.iter().filter(|point| (beyond_mm..within).contains(&far(&point.position)));
        let errors: Vec<f64> = there.map(|point| point.rms_mm).collect();
        if errors.len() >= MIN_SHELL_POSES {
            let square = errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64;
            let within_mm = within.is_finite().then_some(within);
            regions.push(ErrorShell { beyond_mm, within_mm, error_mm: square.sqrt() });
        }
        beyond_mm = within;
    }
    regions
}

/// The finding that states up to which distance the result is valid.
fn validity(regions: &[ErrorShell]) -> Option<PlanFinding> {
    let least_mm = regions.iter().map(|region| region.error_mm).fold(f64::INFINITY, f64::min);
    let good = regions.iter().take_while(|region| region.error_mm <= ALIKE * least_mm).last()?;
    let worst = regions.iter().map(|region| region.error_mm).fold(0.0, f64::max);
    Some(match good.within_mm {
        Some(within_mm) if worst > ALIKE * least_mm => {
            let most_mm = good.error_mm.max(least_mm);
            PlanFinding::ValidNear { within_mm, least_mm, most_mm, farther_mm: worst }
        }
        _ => PlanFinding::ValidEverywhere { least_mm, most_mm: worst },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::example::job;

    /// `count` points with this error at a distance from the ball of the example.
    fn shell(count: usize, distance_mm: f64, rms_mm: f64) -> Vec<MapPoint> {
        vec![MapPoint { position: Vector3::new(1300.0, distance_mm, 800.0), rms_mm }; count]
    }

    #[test]
    fn shells_have_the_root_mean_square_of_enough_poses() {
        // Half of the points have 3 and half have 4: sqrt(12.5). Nine poses are too few.
        let map = [
            shell(5, 100.0, 3.0),
            shell(5, 299.0, 4.0),
            shell(9, 400.0, 1.0),
            shell(10, 600.0, 2.0),
            shell(10, 5000.0, 7.0),
        ]
        .concat();
        let found = regions(&job(""), &map);
        let expected = [(0.0, Some(300.0), 12.5_f64.sqrt()), (600.0, Some(1000.0), 2.0), (1500.0, None, 7.0)];
        assert_eq!(found.len(), expected.len());
        for (region, (beyond_mm, within_mm, error_mm)) in found.iter().zip(expected) {
            assert_eq!((region.beyond_mm, region.within_mm), (beyond_mm, within_mm));
            assert!((region.error_mm - error_mm).abs() < 1e-12);
        }
    }

    #[test]
    fn result_is_valid_up_to_twice_the_least_error() {
        let region = |within_mm, error_mm| ErrorShell { beyond_mm: 0.0, within_mm, error_mm };
        let near = [region(Some(300.0), 0.1), region(Some(600.0), 0.2), region(Some(1000.0), 0.21)];
        assert!(matches!(
            validity(&near),
            Some(PlanFinding::ValidNear { within_mm, least_mm, most_mm, farther_mm })
                if [within_mm, least_mm, most_mm, farther_mm] == [600.0, 0.1, 0.2, 0.21]
        ));
        assert!(matches!(
            validity(&near[..2]),
            Some(PlanFinding::ValidEverywhere { least_mm, most_mm }) if [least_mm, most_mm] == [0.1, 0.2]
        ));
        assert!(validity(&[]).is_none());
    }
}
