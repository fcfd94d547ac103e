//! What `plan.html` shows besides the plan itself.

use serde::Serialize;

use super::page::{Fact, Provenance};
use super::plot::HeatMap;
use crate::identify::result::{PredictedPair, Status, Warning};
use crate::model::AXES;
use crate::plan::how_many::Against;
use crate::plan::region::Region;

/// What the page shows besides the plan itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlanView {
    /// Distance kept from the ends of the stroke, mm.
    pub margin_mm: f64,
    /// The base balls: number and centre in the robot base, mm.
    pub centres: Vec<(u32, [f64; 3])>,
    /// The robot at a few poses: a polyline through its joints each, base first, mm.
    pub skeletons: Vec<Vec<[f64; 3]>>,
    /// Lowest and highest angle of each axis, degrees.
    pub limits_deg: [[f64; 2]; AXES],
    /// The circles.
    pub circles: Vec<CircleRow>,
    /// The checks that were made.
    pub checks: Vec<CheckRow>,
    /// Predicted 3-D error of the nominal robot, and after identification with this plan.
    pub predicted_error_mm: Option<PredictedPair>,
    /// What the plan will tell of each parameter.
    pub predicted: Vec<PredictedRow>,
    /// In words: the combinations of which only one value can be told.
    pub dependent: Vec<String>,
    /// Maps of the predicted error.
    pub maps: Vec<HeatMap>,
    /// What fewer and more lengths tell.
    pub against: Vec<Against>,
    /// The error left by the distance from the base balls.
    pub regions: Vec<Region>,
    /// How many lengths are enough, how far the result is valid, in words.
    pub advice: Vec<String>,
    /// Manipulability at each row, m^3.
    pub manipulability: Vec<f64>,
    /// More lines for the summary: durations, bar, protocol.
    pub facts: Vec<Fact>,
    /// What the user must see.
    pub warnings: Vec<Warning>,
    /// Where it comes from.
    pub provenance: Provenance,
}

/// A circle, in words.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CircleRow {
    /// Its number.
    pub number: u32,
    /// Its base ball.
    pub centre: u32,
    /// Its plane or normal.
    pub plane: String,
    /// Its radius, mm.
    pub radius_mm: f64,
    /// Number of points.
    pub points: usize,
    /// Sense of motion.
    pub direction: String,
    /// How the tool is turned.
    pub orientation: String,
    /// Dwell or continuous.
    pub mode: String,
}

/// A check: the worst value against its limit.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CheckRow {
    /// What was checked.
    pub quantity: String,
    /// The worst value, with unit.
    pub worst: String,
    /// Its limit, with unit.
    pub limit: String,
    /// Where the worst is: row, circle.
    pub place: String,
    /// Whether it passed.
    pub passed: bool,
}

/// What a plan will tell of a parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct PredictedRow {
    /// Its name.
    pub name: String,
    /// `mm`, `rad` or `rad/Nm`.
    pub unit: String,
    /// The maker's standard deviation, in the unit.
    pub tolerance: Option<f64>,
    /// Standard deviation after identification, in the unit.
    pub sd: Option<f64>,
    /// What will become of it.
    pub status: Status,
    /// Why, in words.
    pub reason: String,
}
