//! The runs of a plant as one estimate: each robot at its first run, each bar with its drift and its jumps, each type of robot
//! with the mean and the covariance of its robots.
//!
//! A run contributes the information of its lengths without its prior (`kind`). The runs of a robot are combined into one
//! Gaussian of the robot at its first run and of the bars' offsets at the times of its runs (`fold`). The robots are then
//! eliminated by Schur complements, which leaves one system of the means of the types and the bars: a longer bar and larger
//! robots of a type have similar effects (`plant`, `bars`). The covariances of the types follow by empirical Bayes (`kind`).
//! Memory grows with the number of robots and bars, not of runs.

mod bars;
mod fold;
mod kind;
mod plant;

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use self::fold::{Folded, fold};
use self::kind::{Kind, kinds};
use self::plant::Plant;
use crate::catalogue::FleetFinding;
use dbbd_model::math::distributions::COVERAGE_95;
use dbbd_model::robot::{ParamId, Robot, RobotPosterior};

/// The offset of a bar is constant within this number of days.
const EPOCH_DAYS: f64 = 10.0;
const YEAR_DAYS: f64 = 365.25;
/// Most iterations, and the relative change of the types' covariances that ends them.
const ITERATIONS: usize = 200;
const SETTLED: f64 = 1e-3;
/// Searches for jumps; between them the covariances of the types are iterated again.
const SEARCHES: usize = 4;

/// The posterior and prior of an identification.
#[derive(Clone, Debug)]
pub struct RunPosterior {
    pub robot: String,
    /// The robot's type.
    pub kind: String,
    pub bar: String,
    /// Days since any fixed one.
    pub day: f64,
    pub ids: Vec<ParamId>,
    /// Corrections of the nominal values, mm or rad.
    pub corrections: DVector<f64>,
    pub covariance: DMatrix<f64>,
    /// Prior standard deviations about the nominal values; `None` for free parameters.
    pub prior: Vec<Option<f64>>,
}

#[derive(Clone, Copy, Debug)]
pub struct Assumptions {
    /// Standard deviation of a robot's drift in a year, in units of its prior.
    pub drift: f64,
    /// Standard uncertainty of a bar's length by its certificate, mm.
    pub bar_u_mm: f64,
}

impl Default for Assumptions {
    fn default() -> Self {
        Self { drift: 0.1, bar_u_mm: 0.05 }
    }
}

/// A number with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ValueWithSd {
    pub value: f64,
    pub sd: f64,
}

impl ValueWithSd {
    /// Whether the 95 % interval contains the value.
    pub fn covers(&self, truth: f64) -> bool {
        (self.value - truth).abs() <= COVERAGE_95 * self.sd
    }
}

/// A bar: its offset is `offset + drift * years since the first run + sum of jumps before`.
#[derive(Clone, Debug, serde::Serialize)]
pub struct BarHistory {
    pub bar: String,
    /// Offset at the plant's first run, mm.
    pub offset_mm: ValueWithSd,
    pub drift_mm_a_year: ValueWithSd,
    pub jumps: Vec<Jump>,
    /// Offset at the plant's last run, mm.
    pub offset_now_mm: ValueWithSd,
}

/// A sudden change of a bar, as after a fall.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Jump {
    /// It happened between these days.
    pub after_day: f64,
    pub before_day: f64,
    pub change_mm: ValueWithSd,
}

/// A robot at its first run.
#[derive(Clone, Debug)]
pub struct FleetRobot {
    pub robot: String,
    pub kind: String,
    pub corrections: DVector<f64>,
    pub covariance: DMatrix<f64>,
    /// Days of runs that contradict the run before: a collision, or another change.
    pub crashes: Vec<f64>,
}

/// The prior of a new robot of a type.
#[derive(Clone, Debug)]
pub struct FleetType {
    pub kind: String,
    pub ids: Vec<ParamId>,
    pub mean: DVector<f64>,
    /// Covariance of a new robot about `mean`, including the uncertainty of the mean.
    pub covariance: DMatrix<f64>,
    pub robots: usize,
}

impl FleetType {
    /// A new robot of the type, for `dbbd identify --robot`, with the prior of the type as its posterior. `None` if `nominal`
    /// lacks a parameter.
    pub fn robot(&self, nominal: &Robot) -> Option<Robot> {
        let mut robot = nominal.clone();
        for (id, correction) in self.ids.iter().zip(self.mean.iter()) {
            *robot.geometry.value_mut(*id)? += correction;
        }
        let root = self.covariance.clone().cholesky()?.l();
        robot.posterior = Some(RobotPosterior::new(&self.ids, &robot.geometry, &root)?);
        robot.serial = None;
        Some(robot)
    }
}

#[derive(Clone, Debug, Default)]
pub struct Fleet {
    pub bars: Vec<BarHistory>,
    pub robots: Vec<FleetRobot>,
    pub types: Vec<FleetType>,
    /// Number of runs whose posterior is singular.
    pub unusable: usize,
}

impl Fleet {
    /// Bars that jumped, and robots that changed suddenly.
    pub fn findings(&self) -> Vec<FleetFinding> {
        let mut findings = Vec::new();
        for bar in &self.bars {
            findings.extend(bar.jumps.iter().map(|Jump { change_mm, .. }| {
                let [um, sd_um] = [change_mm.value, change_mm.sd].map(|mm| 1e3 * mm);
                FleetFinding::BarJumped { bar: bar.bar.clone(), um, sd_um }
            }));
        }
        for robot in self.robots.iter().filter(|robot| !robot.crashes.is_empty()) {
            let (robot, times) = (robot.robot.clone(), robot.crashes.len());
            findings.push(FleetFinding::RobotChanged { robot, times });
        }
        findings
    }
}

/// The number of a bar, and of an epoch.
type Knot = (usize, i64);

/// The inverse of a symmetric positive definite matrix; `None` if it is not positive definite.
fn inverse(matrix: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    Some(matrix.clone().cholesky()?.inverse())
}

/// Estimates a plant from its runs, in any order. `None` if a number is not finite.
pub fn fleet(runs: &[RunPosterior], assumed: &Assumptions) -> Option<Fleet> {
    let mut by_robot: BTreeMap<&str, Vec<&RunPosterior>> = BTreeMap::new();
    runs.iter().for_each(|run| by_robot.entry(&run.robot).or_default().push(run));
    let mut bars: Vec<String> = runs.iter().map(|run| run.bar.clone()).collect();
    bars.sort_unstable();
    bars.dedup();
    let kinds = kinds(runs);
    let (mut robots, mut unusable) = (Vec::new(), 0);
    for own in by_robot.values_mut() {
        own.sort_by(|a, b| a.day.total_cmp(&b.day));
        let (folded, without) = fold(own, &kinds, &bars, assumed)?;
        unusable += without;
        robots.push(folded);
    }
    let mut plant = Plant::new(robots, kinds, bars, *assumed);
    for _ in 0..SEARCHES {
        plant.settle()?;
        if !plant.finds_jumps()? {
            break;
        }
    }
    Some(Fleet { unusable, ..plant.fleet()? })
}

#[cfg(test)]
mod tests;
