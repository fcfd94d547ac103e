//! A fit with errors of the joints, and what a result says of it.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::evidence::Hypers;
use super::noise_shape::NoiseShape;
use super::pose_rows::LengthNoise;
use super::prior::PriorRows;
use super::priors::Group;
use crate::measurement::LengthModel;
use crate::robot::{AXES, ParamId, Process, RobotUncertainty};

/// A fit with errors of the joints.
#[derive(Clone, Debug)]
pub(crate) struct JointFit {
    pub(super) model: LengthModel,
    /// Parameters that are estimated, in canonical order.
    pub(super) ids: Vec<ParamId>,
    /// Their priors.
    pub(super) prior: PriorRows,
    /// A root of the covariance of parameters and coefficients, a row each.
    pub(super) root: DMatrix<f64>,
    pub(super) groups: Vec<GroupEvidence>,
    /// How many parameters and coefficients the data determine.
    pub(super) effective_parameters: f64,
    /// Of the lengths with all that moves them, mm.
    pub(super) sigma_mm: f64,
    pub(super) noise: LengthNoise<'static>,
    pub(super) hypers: Hypers,
    /// Those that the uncertainty is of.
    pub(super) cautious: Hypers,
    pub(super) shape: NoiseShape,
    /// Gain in the logarithm of the evidence over the geometry alone.
    pub(super) gain: f64,
}

/// What the evidence says of a group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroupEvidence {
    pub group: Group,
    /// One standard deviation of its members by the evidence: rad, of compliance in prior standard deviations.
    pub sd: f64,
    /// How many of its members the data determine.
    pub effective_parameters: f64,
    /// What it explains of the lengths beyond the geometry and the groups before it, root mean square, mm.
    pub rms_mm: f64,
    /// Its share of the squares of the residuals that the geometry alone leaves.
    pub share: f64,
}

/// The errors of the joints in a result; this is `joint_errors` of `result.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointSummary {
    /// In `result.json` they are `groups`.
    #[serde(skip)]
    pub groups: Vec<GroupEvidence>,
    /// Standard deviation of the pose in each direction, mm.
    #[serde(rename = "pose_sigma_mm")]
    pub pose_mm: f64,
    /// Standard deviation of a length besides that of the pose, mm.
    #[serde(rename = "length_sigma_mm")]
    pub length_mm: f64,
    /// The smooth functions are the sum of a fast and a slow process.
    pub smooth: [Process; 2],
    /// Half of the reversal error of each joint as noise, one standard deviation, rad, if no sense of approach is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub backlash_noise_rad: Option<[f64; AXES]>,
    /// Gain in the logarithm of the evidence over the geometry alone.
    #[serde(rename = "log_evidence_gain")]
    pub gain: f64,
}

impl JointFit {
    /// What is not known of the robot, its tool ball and the base balls.
    pub(super) fn uncertainty(&self) -> RobotUncertainty {
        let is_own = |id: ParamId| id.moves_tool_ball() || matches!(id, ParamId::Ball(..));
        let own = (0..self.ids.len()).filter(|&k| is_own(self.ids[k]));
        let own: Vec<usize> = own.collect();
        let rows: Vec<usize> = own.iter().copied().chain(self.ids.len()..self.root.nrows()).collect();
        RobotUncertainty {
            parameters: own.iter().map(|&k| self.ids[k]).collect(),
            root: self.root.select_rows(&rows),
            pose_mm: self.noise.pose_mm,
            smooth: self.cautious.processes().to_vec(),
            unapproached_rad: self.unapproached_rad(),
        }
    }

    /// What an unknown sense of approach leaves of each joint's angle, rad.
    fn unapproached_rad(&self) -> [f64; AXES] {
        let errors = &self.model.geometry.joint_errors;
        let mut found = self.shape.backlash.sds().map(|sd| sd * self.noise.pose_mm);
        if self.shape.backlash.is_known() {
            for (place, sd) in errors.backlash_places().into_iter().zip(&mut found) {
                let row = place.map(|place| self.root.row(self.ids.len() + place).norm());
                *sd = sd.hypot(row.unwrap_or(0.0));
            }
        }
        found
    }

    pub(super) fn summary(&self) -> JointSummary {
        JointSummary {
            groups: self.groups.clone(),
            smooth: self.hypers.processes(),
            pose_mm: self.noise.pose_mm,
            length_mm: self.noise.length_mm,
            backlash_noise_rad: (!self.shape.backlash.is_known()).then(|| self.unapproached_rad()),
            gain: self.gain,
        }
    }
}
