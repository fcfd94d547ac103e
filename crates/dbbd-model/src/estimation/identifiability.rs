//! Identifiability: rank, base set, base-parameter groups, observability indices O1 to O5, correlations.
//!
//! The indices are those of Sun and Hollerbach, "Observability index selection for robot calibration", ICRA 2008: with the
//! singular values s1 >= .. >= sL of the scaled columns and the number of lengths m,
//! O1 = (s1 .. sL)^(1/L) / sqrt(m), O2 = sL / s1, O3 = sL, O4 = sL^2 / s1, O5 = 1 / sum(1 / s).

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::linear_system::factor;
use super::selection::is_place;
use crate::math::{BaseSet, base_set, svd};
use crate::measurement::{LengthModel, MeasurementPieces};
use crate::robot::Joint::J1;
use crate::robot::{ParamId, ParamUnit};

/// A base-parameter group: a linear combination of parameters that is identifiable although its members are not.
#[derive(Clone, Debug, PartialEq)]
pub struct Combination {
    /// The member in the base set.
    pub kept: ParamId,
    /// All members with their coefficients; that of the kept one is 1.
    pub members: Vec<(ParamId, f64)>,
}

impl Combination {
    /// The members with their coefficients in units of `typical_error`.
    pub fn scaled(&self) -> impl Iterator<Item = (ParamId, f64)> {
        let unit = typical_error(self.kept);
        self.members.iter().map(move |(id, coefficient)| (*id, coefficient * typical_error(*id) / unit))
    }

    pub fn contains(&self, id: ParamId) -> bool {
        self.members.iter().any(|(member, _)| *member == id)
    }
}

#[derive(Clone, Debug)]
pub struct Analysis {
    /// The parameters, in canonical order.
    pub ids: Vec<ParamId>,
    /// The base set by indices of `ids`.
    pub base: BaseSet,
}

impl Analysis {
    /// The parameters of the base set, in canonical order.
    pub fn kept(&self) -> Vec<ParamId> {
        let mut kept: Vec<ParamId> = self.base.kept.iter().map(|&k| self.ids[k]).collect();
        kept.sort();
        kept
    }

    /// The parameters that change no length.
    pub fn zero(&self) -> Vec<ParamId> {
        self.base.zero.iter().map(|&k| self.ids[k]).collect()
    }

    /// The parameters that depend linearly on the base set.
    pub fn dependent(&self) -> Vec<ParamId> {
        self.base.dependent.iter().map(|(k, _)| self.ids[*k]).collect()
    }

    /// The combinations, sorted by the kept parameter.
    pub fn combinations(&self) -> Vec<Combination> {
        let combination = |(place, &k): (usize, &usize)| {
            let kept = self.ids[k];
            let dependent =
                self.base.dependent.iter().map(|(column, x)| (self.ids[*column], x[place])).filter(
                    |(id, coefficient)| {
                        coefficient.abs() * typical_error(*id) > ROUNDING * typical_error(kept)
                    },
                );
            Combination { kept, members: std::iter::once((kept, 1.0)).chain(dependent).collect() }
        };
        let mut combinations: Vec<Combination> = self.base.kept.iter().enumerate().map(combination).collect();
        combinations.retain(|combination| combination.members.len() > 1);
        combinations.sort_by_key(|combination| combination.kept);
        combinations
    }
}

/// Coefficients below this, in units of [`typical_error`], are rounding.
const ROUNDING: f64 = 1e-6;

/// Which of `ids` are identifiable at `model`; `None` if a number is not finite.
///
/// The set-up is preferred to the parameters of the robot, and among these the joints to what moves the base of the robot
/// or changes its scale: the parameters that a user would fix are the last to enter the base set.
pub fn analyse<L: MeasurementPieces + ?Sized>(
    model: &LengthModel,
    readings: &L,
    ids: &[ParamId],
) -> Option<Analysis> {
    let mut ids = ids.to_vec();
    ids.sort();
    let base = base_set(&factor(model, readings, &ids), &order_of_choice(&ids))?;
    Some(Analysis { ids, base })
}

/// The order of preference for a base set.
pub fn order_of_choice(ids: &[ParamId]) -> Vec<usize> {
    let tier = |id: ParamId| match id {
        _ if is_place(&id) => 0,
        ParamId::Alpha(J1) | ParamId::A(J1) | ParamId::Theta(J1) | ParamId::D(J1) => 2,
        ParamId::BarOffset(_) => 3,
        // Compliance and gear errors must not replace a length or an angle.
        _ if id.is_optional() => 4,
        _ => 1,
    };
    let mut order: Vec<usize> = (0..ids.len()).collect();
    order.sort_by_key(|&at| (tier(ids[at]), at));
    order
}

/// The unit in which coefficients are compared: 1 mm, 1 mrad, 1 mrad at 1000 N m.
fn typical_error(id: ParamId) -> f64 {
    match id.unit() {
        ParamUnit::Mm => 1.0,
        ParamUnit::Rad => 1e-3,
        ParamUnit::RadPerNm => 1e-6,
    }
}

/// The five indices; larger is better.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Observability {
    /// Geometric mean of the singular values over the root of the number of lengths.
    pub o1: f64,
    /// Inverse condition number.
    pub o2: f64,
    /// Smallest singular value.
    pub o3: f64,
    /// Noise amplification index.
    pub o4: f64,
    /// Harmonic mean of the singular values over their number.
    pub o5: f64,
}

/// The indices of `factor`: independent columns in comparable units, of `lengths` lengths. `None` without columns, or if a
/// number is not finite.
pub fn observability(factor: &DMatrix<f64>, lengths: usize) -> Option<Observability> {
    let values = svd(factor)?.values;
    let (largest, smallest) = (*values.iter().next()?, *values.iter().next_back()?);
    if largest == 0.0 {
        return None;
    }
    let mean_log = values.iter().map(|value| value.ln()).sum::<f64>() / values.len() as f64;
    Some(Observability {
        o1: mean_log.exp() / (lengths as f64).sqrt(),
        o2: smallest / largest,
        o3: smallest,
        o4: smallest * smallest / largest,
        o5: 1.0 / values.iter().map(|value| 1.0 / value).sum::<f64>(),
    })
}

/// Weaker correlations are not reported.
const STRONG: f64 = 0.9;
const MOST: usize = 10;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correlation {
    pub pair: [ParamId; 2],
    /// Correlation coefficient, -1..1.
    pub r: f64,
}

/// The pairs of `ids` with |r| > 0.9 by their `covariance`, strongest first, at most ten.
pub fn correlations(ids: &[ParamId], covariance: &DMatrix<f64>) -> Vec<Correlation> {
    let sd: Vec<f64> = covariance.diagonal().iter().map(|variance| variance.sqrt()).collect();
    let mut strong = Vec::new();
    for i in 0..ids.len() {
        for j in i + 1..ids.len() {
            let r = covariance[(i, j)] / (sd[i] * sd[j]);
            if r.abs() > STRONG {
                strong.push(Correlation { pair: [ids[i], ids[j]], r: r.clamp(-1.0, 1.0) });
            }
        }
    }
    strong.sort_by(|a, b| b.r.abs().total_cmp(&a.r.abs()));
    strong.truncate(MOST);
    strong
}
