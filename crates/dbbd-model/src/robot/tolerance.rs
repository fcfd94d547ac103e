//! The tolerance that a maker promises of the parameters of a robot.

use serde::{Deserialize, Serialize};

use super::{Joint, ParamId};

/// The maker's tolerance of each geometric parameter, as one standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tolerance {
    /// Tolerance of a and d.
    pub length_mm: f64,
    /// Tolerance of alpha, theta and beta.
    pub angle_deg: f64,
    /// Tolerance of d6: the position of the flange on the last axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flange_mm: Option<f64>,
    /// Tolerance of theta6: the rotation of the flange about the last axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flange_deg: Option<f64>,
}

/// The tolerances of a flange, which is turned on a lathe and marked by a pin.
const USUAL_FLANGE_MM: f64 = 0.05;
const USUAL_FLANGE_DEG: f64 = 0.02;

impl Tolerance {
    /// The tolerance of lengths and angles, with none stated for the flange.
    pub fn of(length_mm: f64, angle_deg: f64) -> Self {
        Self { length_mm, angle_deg, flange_mm: None, flange_deg: None }
    }

    /// The prior standard deviation of d6, mm, by which an identification decides what is flange and what is a ball beside its
    /// place. If it is not stated, an offset is that of the ball: a flange is turned on a lathe.
    pub fn flange_prior_mm(&self) -> f64 {
        self.flange_mm.unwrap_or(USUAL_FLANGE_MM)
    }

    /// As [`Self::flange_prior_mm`] for theta6, rad.
    pub fn flange_prior_rad(&self) -> f64 {
        self.flange_deg.unwrap_or(USUAL_FLANGE_DEG).to_radians()
    }

    /// States the tolerances of the flange that an identification assumes.
    pub fn state_flange(&mut self) {
        self.flange_mm.get_or_insert(USUAL_FLANGE_MM);
        self.flange_deg.get_or_insert(USUAL_FLANGE_DEG);
    }

    /// The standard deviations that d6 (mm) and theta6 (rad) may have beyond those of the prior: if they are not stated, the
    /// tolerances of the other lengths and angles hold for them too.
    pub(super) fn flange_beyond_prior(&self) -> [(ParamId, f64); 2] {
        let beyond = |stated: Option<f64>, tolerance: f64, prior: f64| match stated {
            Some(_) => 0.0,
            None => (tolerance * tolerance - prior * prior).max(0.0).sqrt(),
        };
        let angle_rad = self.angle_deg.to_radians();
        [
            (ParamId::D(Joint::J6), beyond(self.flange_mm, self.length_mm, self.flange_prior_mm())),
            (ParamId::Theta(Joint::J6), beyond(self.flange_deg, angle_rad, self.flange_prior_rad())),
        ]
    }
}

impl Default for Tolerance {
    /// For an industrial robot without an accuracy option, which has a position error of about a millimetre.
    fn default() -> Self {
        Self::of(1.0, 0.1)
    }
}
