//! What a plan will tell, for `plan.json`, the page and the terminal.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::{Job, Kind, Plan, PlanRow};
use crate::identifiability::{Belief, ErrorSummary, Observability, Workspace, outlook};
use crate::model::inverse::nearest;
use crate::model::pose::{rot_x, rot_y, rot_z};
use crate::model::{AXES, LengthModel, Pose, Reading, Robot};

/// A parameter of which the lengths alone leave more than this many tolerances is too weak.
const WEAK: f64 = 3.0;
/// Poses over which the 3-D error is taken, and their seed: those of an identification.
const POSES: usize = 2000;
const SEED: u64 = 1;
/// ISO 9283 repeatability is the mean distance plus three standard deviations; for an isotropic
/// normal error of deviation s that is (1.596 + 3 * 0.673) s.
const REPEATABILITY: f64 = 3.616;

/// What the poses of a plan will tell, with lengths of the bar's sigma and the robot's repeatability.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prediction {
    /// Lengths that will be measured.
    pub lengths: usize,
    /// Standard deviation of one length, mm: of the bar and of the robot's repeatability together.
    pub sigma_mm: f64,
    /// Rank of the scaled Jacobian of all parameters.
    pub rank: usize,
    /// Number of parameters.
    pub of: usize,
    /// Condition number of the unit-norm columns of the base set.
    pub condition: f64,
    /// Observability indices of the base set, its columns in units of what is known beforehand.
    pub observability: Option<Observability>,
    /// Every parameter.
    pub parameters: Vec<PredictedParameter>,
    /// Combinations of which only one value can be told, in words.
    pub dependent: Vec<String>,
    /// 3-D error over the workspace after one best rigid alignment, mm, as the robot is known now.
    pub now_mm: Error3d,
    /// The same after an identification with the datasheet as prior, mm.
    pub identified_mm: Error3d,
}

/// A 3-D error over the workspace, mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Error3d {
    /// Mean over robots and poses.
    pub mean: f64,
    /// 95th percentile over robots and poses.
    pub p95: f64,
    /// Largest over the poses, averaged over the robots.
    pub max: f64,
}

/// One parameter's standard deviations, mm or rad.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PredictedParameter {
    /// Its name.
    pub name: String,
    /// `mm` or `rad`.
    pub unit: String,
    /// As it is known beforehand.
    pub before: f64,
    /// With the lengths and what is known beforehand.
    pub sd: f64,
    /// From the lengths alone; absent for one outside the base set.
    pub alone: Option<f64>,
    /// What the lengths alone make of it.
    pub fate: Fate,
}

/// What the lengths alone make of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fate {
    /// Told to 3 tolerances or better.
    Identified,
    /// Told, but worse than that.
    TooWeak,
    /// Only in a combination that another parameter carries.
    Dependent,
    /// It changes no length.
    Unseen,
}

/// A prediction and its map: where the ball is and the root mean square of its error there, mm.
pub type Foretold = (Prediction, Vec<([f64; 3], f64)>);

/// Standard deviation of one length, mm: of the bar and of the robot's repeatability together.
pub fn length_sigma_mm(job: &Job, robot: &Robot) -> f64 {
    (job.bar.sigma_um * 1e-3).hypot(robot.repeatability_mm.unwrap_or(0.0) / REPEATABILITY)
}

/// What is known before anything is measured: the robot's tolerance, the bar's certificate.
pub fn datasheet(job: &Job, robot: &Robot) -> Belief {
    let model = LengthModel::new(robot.geometry.clone(), &job.balls());
    // A certificate states two standard deviations.
    Belief::datasheet(robot, model, job.bar.length_u_mm.map(|u| 0.5 * u))
}

impl PlanRow {
    /// The row as a length to be measured.
    pub fn reading(&self) -> Reading {
        Reading::new(
            self.axes_deg.map(f64::to_radians),
            self.centre.saturating_sub(1) as usize,
            self.length_mm,
        )
    }
}

impl Plan {
    /// What this plan will add to `belief`; `None` when a number is not finite.
    pub fn foretell(&self, robot: &Robot, belief: &Belief) -> Option<Foretold> {
        let dwells = self.rows.iter().filter(|row| row.kind != Kind::Transit);
        let readings: Vec<Reading> = dwells.map(PlanRow::reading).collect();
        let poses = workspace(&self.header.job, robot, POSES);
        let sigma_mm = length_sigma_mm(&self.header.job, robot);
        let seen = outlook(belief, &readings, sigma_mm, &poses)?;
        let (kept, unseen) = (seen.analysis.kept(), seen.analysis.zero());
        let parameters = seen
            .parameters
            .iter()
            .map(|parameter| {
                let id = parameter.id;
                let known = if id.is_geometric() { parameter.before } else { f64::INFINITY };
                let fate = match parameter.alone {
                    Some(alone) if alone <= WEAK * known => Fate::Identified,
                    Some(_) => Fate::TooWeak,
                    None if kept.contains(&id) => Fate::TooWeak,
                    None if unseen.contains(&id) => Fate::Unseen,
                    None => Fate::Dependent,
                };
                PredictedParameter {
                    name: id.to_string(),
                    unit: id.unit().into(),
                    before: parameter.before,
                    sd: parameter.after,
                    alone: parameter.alone,
                    fate,
                }
            })
            .collect();
        let prediction = Prediction {
            lengths: readings.len(),
            sigma_mm,
            rank: seen.analysis.base.rank,
            of: seen.analysis.ids.len(),
            condition: seen.analysis.base.condition,
            observability: seen.observability,
            parameters,
            dependent: seen.analysis.combinations().into_iter().map(|combination| combination.text).collect(),
            now_mm: seen.error_mm[0].into(),
            identified_mm: seen.error_mm[1].into(),
        };
        Some((prediction, seen.map))
    }
}

/// Axis vectors (rad) over which an error is taken: in the user's box if there is one, else uniform within the limits.
pub fn workspace(job: &Job, robot: &Robot, count: usize) -> Vec<[f64; AXES]> {
    let limits = robot.controller();
    let Some([low, high]) = job.optimise.as_ref().and_then(|optimise| optimise.workspace_mm) else {
        return Workspace::uniform(limits, count, SEED);
    };
    in_box(robot, low, high, count)
}

/// Axis vectors (rad) of `count` poses with the ball uniform in a box (mm), the tool down but for turns of up to
/// 45 degrees about each axis, the arm in front and its elbow up: where and how production work is done.
pub fn in_box(robot: &Robot, low: [f64; 3], high: [f64; 3], count: usize) -> Vec<[f64; AXES]> {
    let mut random = Pcg64::seed_from_u64(SEED);
    let home = [0.0, -60.0, 90.0, 0.0, 60.0, 0.0].map(f64::to_radians);
    let limits = &robot.controller().limits_deg;
    let within = |axes: &[f64; AXES]| {
        axes.iter().zip(limits).all(|(axis, [low, high])| (*low..=*high).contains(&axis.to_degrees()))
    };
    // A box far from the arm has few poses, or none.
    let mut found = Vec::with_capacity(count);
    for _ in 0..20 * count {
        let position = Vector3::from_fn(|i, _| random.random_range(low[i]..high[i]));
        let mut turn = || random.random_range(-std::f64::consts::FRAC_PI_4..std::f64::consts::FRAC_PI_4);
        let rotation = rot_z(turn()) * rot_y(turn()) * rot_x(turn()) * rot_x(std::f64::consts::PI);
        if let Ok(axes) = nearest(&robot.geometry, &Pose { rotation, position }, &home)
            && within(&axes)
        {
            found.push(axes);
        }
        if found.len() == count {
            break;
        }
    }
    found
}

impl From<ErrorSummary> for Error3d {
    fn from(summary: ErrorSummary) -> Self {
        Self { mean: summary.mean, p95: summary.p95, max: summary.max }
    }
}
