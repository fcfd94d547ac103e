//! Rank and base set of the parameters asked for, at one model.

use super::linear_system::factor;
use super::selection::is_place;
use crate::math::{BaseSet, base_set};
use crate::measurement::{LengthModel, MeasurementPieces};
use crate::robot::Joint::J1;
use crate::robot::{ParamId, Unit};

/// A sum of parameters that is identifiable although its members are not: linearly dependent parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Combination {
    /// The member that carries it.
    pub kept: ParamId,
    /// All members with their coefficients, the kept one's 1.
    pub members: Vec<(ParamId, f64)>,
}

impl Combination {
    /// The members with their coefficients where each is in units of an error that nobody would be surprised by.
    pub fn scaled(&self) -> impl Iterator<Item = (ParamId, f64)> {
        let unit = plausible(self.kept);
        self.members.iter().map(move |(id, coefficient)| (*id, coefficient * plausible(*id) / unit))
    }

    pub fn contains(&self, id: ParamId) -> bool {
        self.members.iter().any(|(member, _)| *member == id)
    }
}

/// Rank and base set of a list of parameters.
#[derive(Clone, Debug)]
pub struct Analysis {
    /// The parameters asked for, in canonical order; indices below are into this list.
    pub ids: Vec<ParamId>,
    /// The base set; indices are into `ids`.
    pub base: BaseSet,
}

impl Analysis {
    /// The parameters kept, in canonical order.
    pub fn kept(&self) -> Vec<ParamId> {
        let mut kept: Vec<ParamId> = self.base.kept.iter().map(|&k| self.ids[k]).collect();
        kept.sort();
        kept
    }

    /// The parameters that change no length.
    pub fn zero(&self) -> Vec<ParamId> {
        self.base.zero.iter().map(|&k| self.ids[k]).collect()
    }

    /// The parameters that depend on those kept.
    pub fn dependent(&self) -> Vec<ParamId> {
        self.base.dependent.iter().map(|(k, _)| self.ids[*k]).collect()
    }

    /// The combination of each kept parameter on which others depend.
    pub fn combinations(&self) -> Vec<Combination> {
        let mut found = Vec::new();
        for (place, &k) in self.base.kept.iter().enumerate() {
            let mut members = vec![(self.ids[k], 1.0)];
            for (column, coefficients) in &self.base.dependent {
                let id = self.ids[*column];
                if matters(self.ids[k], id, coefficients[place]) {
                    members.push((id, coefficients[place]));
                }
            }
            if members.len() > 1 {
                found.push(Combination { kept: self.ids[k], members });
            }
        }
        found.sort_by_key(|combination| combination.kept);
        found
    }
}

/// Which of `ids` are identifiable at `model`; `None` when a number is not finite.
///
/// The set-up is preferred over the robot's own parameters, and among these the joints over what
/// moves the robot's base as a whole or its scale: what a user would fix is left out first.
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

/// The order in which parameters are taken into a base set.
pub fn order_of_choice(ids: &[ParamId]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..ids.len()).collect();
    order.sort_by_key(|&at| (tier(ids[at]), at));
    order
}

/// Lower is kept first.
fn tier(id: ParamId) -> u8 {
    match id {
        _ if is_place(&id) => 0,
        ParamId::Alpha(J1) | ParamId::A(J1) | ParamId::Theta(J1) | ParamId::D(J1) => 2,
        ParamId::BarOffset(_) => 3,
        // Sag and gear error must not take the place of a length or an angle.
        _ if id.is_optional() => 4,
        _ => 1,
    }
}

/// Whether a coefficient of `other` in the combination of `kept` is more than rounding: what a
/// plausible error of `other` (1 mm, 1 mrad) moves is compared with that of `kept`.
fn matters(kept: ParamId, other: ParamId, coefficient: f64) -> bool {
    coefficient.abs() * plausible(other) > 1e-6 * plausible(kept)
}

/// An error that nobody would be surprised by: 1 mm, 1 mrad, 1 mrad at 1000 N m.
fn plausible(id: ParamId) -> f64 {
    match id.unit() {
        Unit::Mm => 1.0,
        Unit::Rad => 1e-3,
        Unit::RadPerNm => 1e-6,
    }
}
