//! What `report.html` shows besides the identification's result.

use std::collections::BTreeMap;

use super::handing_back::{AxisZero, BallPlace};
use super::page::{Fact, Provenance};
use super::plot::HeatMap;
use crate::identify::result::Identification;
use crate::model::AXES;
use crate::plan::Kind;

/// What the page shows besides the result itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct IdentificationPlots {
    /// The observations with their residuals, outliers included; an even sample of many.
    pub observations: Vec<ObservationPoint>,
    /// How many lengths there are to each base ball, and
    pub per_ball: BTreeMap<usize, usize>,
    /// how many of them at the reference pose.
    pub references: usize,
    /// The circles, for the polar plots; none for poses that lie on no circle.
    pub circles: Vec<CirclePanel>,
    /// One standard deviation of what the robot's maker promises.
    pub tolerance: Option<Tolerance>,
    /// Maps of the predicted error.
    pub maps: Vec<HeatMap>,
    /// The zero errors of the axes.
    pub zeros: Vec<AxisZero>,
    /// Tool ball and base balls.
    pub balls: Vec<BallPlace>,
    /// More lines for "what was measured": bar, temperature, certificate.
    pub facts: Vec<Fact>,
    /// Where it comes from.
    pub provenance: Provenance,
}

/// One observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservationPoint {
    /// Its index.
    pub index: u32,
    /// Its base ball, from 1.
    pub centre: usize,
    /// The axis angles, degrees.
    pub axes_deg: [f64; AXES],
    /// The sense in which each axis came to them: -1, 0 where it is not known, 1.
    pub senses: [i8; AXES],
    /// Residual with the nominal robot, mm.
    pub before_mm: f64,
    /// Residual with the identified robot, mm.
    pub after_mm: f64,
    /// Number of its circle, where it lies on one.
    pub circle: Option<u32>,
    /// Its angle on that circle, degrees.
    pub angle_deg: Option<f64>,
    /// What the plan had it for, where there was one.
    pub kind: Option<Kind>,
}

impl ObservationPoint {
    /// Whether the identification set it aside.
    pub(super) fn is_outlier(&self, result: &Identification) -> bool {
        result.outliers.iter().any(|o| o.index == self.index && o.centre == self.centre)
    }
}

/// A circle of the plan.
#[derive(Clone, Debug, PartialEq)]
pub struct CirclePanel {
    /// Its number.
    pub number: u32,
    /// Its name, such as `Circle 1, XY, ball 1`.
    pub name: String,
    /// Nominal radius, mm.
    pub radius_mm: Option<f64>,
    /// What stands at 0 and at 90 degrees, such as `+X`, `+Y`.
    pub axis_names: Option<[String; 2]>,
}

/// One standard deviation of what a robot's maker promises.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Of lengths, mm.
    pub length_mm: f64,
    /// Of angles, rad.
    pub angle_rad: f64,
}
