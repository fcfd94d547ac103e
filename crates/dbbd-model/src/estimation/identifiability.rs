//! Identifiability: rank, base set, base-parameter groups, observability indices O1 to O5, correlations.
//!
//! The indices are those of Sun and Hollerbach, "Observability index selection for robot calibration", ICRA 2008: with the
//! singular values s1 >= .. >= sL of the scaled columns and the number of lengths m,
//! O1 = (s1 .. sL)^(1/L) / sqrt(m), O2 = sL / s1, O3 = sL, O4 = sL^2 / s1, O5 = 1 / sum(1 / s).

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::linear_system::linear_system;
use crate::math::{BaseSet, Triangle, base_set, svd};
use crate::measurement::{LengthModel, MeasurementPieces};
use crate::robot::Joint::J1;
use crate::robot::{ParamGroup, ParamId, ParamUnit};

/// A base-parameter group: a linear combination of parameters that is identifiable although its members are not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Combination {
    /// All members with their coefficients; the coefficient of the kept member is 1.
    #[serde(with = "members")]
    pub members: Vec<(ParamId, f64)>,
    /// The member in the base set.
    pub kept: ParamId,
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

/// Members of a combination as an object: the name of each parameter with its coefficient, in their order.
mod members {
    use std::fmt;

    use serde::de::{MapAccess, Visitor};
    use serde::{Deserializer, Serializer};

    use crate::robot::ParamId;

    pub(super) fn serialize<S: Serializer>(
        members: &[(ParamId, f64)],
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.collect_map(members.iter().copied())
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Vec<(ParamId, f64)>, D::Error> {
        struct Members;

        impl<'de> Visitor<'de> for Members {
            type Value = Vec<(ParamId, f64)>;

            fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                out.write_str("coefficients by the names of parameters")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                std::iter::from_fn(|| map.next_entry().transpose()).collect()
            }
        }

        deserializer.deserialize_map(Members)
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
    /// The analysis of rows by parameters in canonical order; `None` if a number is not finite.
    pub(super) fn of(ids: Vec<ParamId>, rows: &mut Triangle) -> Option<Self> {
        let base = base_set(&rows.factor(), &order_of_choice(&ids))?;
        Some(Self { ids, base })
    }

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

/// Analyses which of `ids` are identifiable at `model`; `None` if a number is not finite.
///
/// The set-up is preferred to the parameters of the robot. Among these the joints are preferred to parameters that move
/// the base of the robot or change its scale: the parameters that a user would fix are the last to enter the base set.
pub fn analyse<L: MeasurementPieces + ?Sized>(
    model: &LengthModel,
    readings: &L,
    ids: &[ParamId],
) -> Option<Analysis> {
    let mut ids = ids.to_vec();
    ids.sort();
    let mut rows = linear_system(model, readings, &ids);
    Analysis::of(ids, &mut rows)
}

/// The order of preference for a base set.
pub fn order_of_choice(ids: &[ParamId]) -> Vec<usize> {
    // The place of the base has the same effect as the first row of the table.
    let first_row = [ParamId::Alpha(J1), ParamId::A(J1), ParamId::Theta(J1), ParamId::D(J1)];
    let tier = |id: ParamId| match id.group() {
        ParamGroup::Tool | ParamGroup::Targets | ParamGroup::Balls | ParamGroup::Tracker => 0,
        ParamGroup::Geometric if first_row.contains(&id) => 2,
        ParamGroup::Geometric => 1,
        ParamGroup::Bar => 3,
        // Compliance and gear errors must not replace a length or an angle.
        ParamGroup::Compliance | ParamGroup::Gear => 4,
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
const MAX_PAIRS: usize = 10;

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
    strong.truncate(MAX_PAIRS);
    strong
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{BallId, BarId, Coordinate, Joint};

    #[test]
    fn base_set_prefers_places_then_the_arm_then_its_first_row_then_the_bar() {
        let ids = [
            ParamId::GearCos(Joint::J2),
            ParamId::BarOffset(BarId::FIRST),
            ParamId::D(J1),
            ParamId::Beta(Joint::J3),
            ParamId::Tool(Coordinate::X),
            ParamId::Compliance(Joint::J2),
            ParamId::Ball(BallId::FIRST, Coordinate::Y),
        ];
        assert_eq!(order_of_choice(&ids), [4, 6, 3, 2, 1, 0, 5]);
    }

    /// Singular values 4 and 1 of 9 lengths: sqrt(4 * 1) / 3, 1 / 4, 1, 1 / 4, 1 / (1 / 4 + 1) (Sun and Hollerbach, ICRA 2008).
    #[test]
    fn five_indices_of_two_singular_values() {
        let found = observability(&DMatrix::from_row_slice(2, 2, &[0.0, 4.0, 1.0, 0.0]), 9).unwrap();
        let Observability { o1, o2, o3, o4, o5 } = found;
        for (found, expected) in [o1, o2, o3, o4, o5].into_iter().zip([2.0 / 3.0, 0.25, 1.0, 0.25, 0.8]) {
            assert!((found - expected).abs() < 1e-14, "{found}");
        }
        assert_eq!(observability(&DMatrix::zeros(2, 2), 9), None);
    }

    #[test]
    fn strong_correlations_come_first_by_their_size() {
        let ids = [ParamId::A(Joint::J2), ParamId::D(Joint::J3), ParamId::Theta(Joint::J4)];
        // Standard deviations 1, 2 and 0.1 with correlations 0.92, -0.95 and 0.89.
        let covariance =
            DMatrix::from_row_slice(3, 3, &[1.0, 1.84, -0.095, 1.84, 4.0, 0.178, -0.095, 0.178, 0.01]);
        let found = correlations(&ids, &covariance);
        let pairs: Vec<[ParamId; 2]> = found.iter().map(|found| found.pair).collect();
        assert_eq!(pairs, [[ids[0], ids[2]], [ids[0], ids[1]]]);
        assert!((found[0].r + 0.95).abs() < 1e-12 && (found[1].r - 0.92).abs() < 1e-12);
    }

    /// 0.002 mm of d2 for a milliradian of alpha1: a coefficient of 2 mm/rad is 0.002 in comparable units.
    #[test]
    fn coefficients_are_compared_in_typical_errors() {
        let (length, angle, compliance) =
            (ParamId::D(Joint::J2), ParamId::Alpha(Joint::J2), ParamId::Compliance(Joint::J2));
        let members = vec![(length, 1.0), (angle, 2.0), (compliance, 5.0)];
        let combination = Combination { kept: length, members: members.clone() };
        let scaled: Vec<f64> = combination.scaled().map(|(_, coefficient)| coefficient).collect();
        for (found, expected) in scaled.into_iter().zip([1.0, 2e-3, 5e-6]) {
            assert!((found / expected - 1.0).abs() < 1e-12);
        }
        let of_angle: Vec<f64> = Combination { kept: angle, members }.scaled().map(|(_, c)| c).collect();
        assert!((of_angle[0] - 1e3).abs() < 1e-9 && (of_angle[1] - 2.0).abs() < 1e-12);
        assert!(combination.contains(angle) && !combination.contains(ParamId::D(J1)));
    }
}
