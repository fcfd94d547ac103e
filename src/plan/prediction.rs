//! What a plan will tell, for `plan.json`, the page and the terminal.

use serde::{Deserialize, Serialize};

use super::datasheet::length_sigma_mm;
use super::how_many::{Against, against, enough};
use super::region::{self, Region, regions};
use super::second_ball::second_ball;
use super::workspace::workspace;
use super::{Kind, Plan, PlanRow};
use crate::identifiability::{Belief, ErrorSummary, Observability, outlook};
use crate::model::{AXES, Reading, Robot};

/// A parameter of which the lengths alone leave more than this many tolerances is too weak.
const WEAK: f64 = 3.0;
/// Poses over which the 3-D error is taken, as in an identification.
const POSES: usize = 2000;
/// Of these so many where it is taken for many pose sets.
const FEW_POSES: usize = 300;

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
    // A plan of an earlier version, as captures carry it, lacks these.
    /// What fewer and more lengths tell.
    #[serde(default)]
    pub against: Vec<Against>,
    /// The error left afterwards by the distance from the base balls.
    #[serde(default)]
    pub regions: Vec<Region>,
    /// How many lengths are enough, how far the result is valid, where a second ball would help: in words.
    #[serde(default)]
    pub advice: Vec<String>,
}

/// A 3-D error over the workspace, mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Error3d {
    /// Mean over robots and poses.
    pub mean: f64,
    /// 95th percentile over robots and poses.
    pub p95: f64,
    /// Largest over the poses: 95 % of the robots stay below it.
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
        let few: Vec<[f64; AXES]> = poses.iter().take(FEW_POSES).copied().collect();
        let against = against(belief, &readings, sigma_mm, &few);
        let regions = regions(&self.header.job, &seen.map);
        let mut advice = Vec::new();
        // In a stage the next plan is the one that matters.
        if self.header.stage.is_none() {
            advice.extend(enough(&against, robot.repeatability_mm));
            advice.extend(region::words(&regions));
            advice.extend(second_ball(&self.header.job, robot.controller(), readings.len(), &few));
        }
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
            against,
            regions,
            advice,
        };
        Some((prediction, seen.map))
    }
}

impl From<ErrorSummary> for Error3d {
    fn from(summary: ErrorSummary) -> Self {
        Self { mean: summary.mean, p95: summary.p95, max: summary.max }
    }
}
