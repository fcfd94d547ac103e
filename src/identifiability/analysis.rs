//! Rank and base set of the parameters asked for, at one model.

use nalgebra::DMatrix;

use super::wording;
use crate::linalg::{BaseSet, Triangle, base_set};
use crate::model::{LengthModel, LengthRow, ParamId, Readings, Selection};

/// A sum of parameters that can be told although its members cannot.
#[derive(Clone, Debug)]
pub struct Combination {
    /// The member that carries it.
    pub kept: ParamId,
    /// All members with their coefficients, the kept one's 1.
    pub members: Vec<(ParamId, f64)>,
    /// In words.
    pub text: String,
}

/// What the poses can tell of a list of parameters.
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

    /// The combination of each kept parameter on which others lean.
    pub fn combinations(&self) -> Vec<Combination> {
        let mut found = Vec::new();
        for (place, &k) in self.base.kept.iter().enumerate() {
            let mut members = vec![(self.ids[k], 1.0)];
            for (column, coefficients) in &self.base.dependent {
                let id = self.ids[*column];
                if wording::matters(self.ids[k], id, coefficients[place]) {
                    members.push((id, coefficients[place]));
                }
            }
            if members.len() > 1 {
                let text = wording::combination(&members);
                found.push(Combination { kept: self.ids[k], members, text });
            }
        }
        found.sort_by_key(|combination| combination.kept);
        found
    }
}

/// The triangular factor of the Jacobian of `ids` at `model`, each row divided by the standard deviation of its
/// reading where these have one; without those that are left out.
pub fn factor<L: Readings + ?Sized>(model: &LengthModel, readings: &L, ids: &[ParamId]) -> DMatrix<f64> {
    let selection = Selection::new(ids);
    let prepared = model.prepare();
    let pieces = readings.in_pieces(|readings, sigma| {
        let mut triangle = Triangle::new(ids.len());
        let mut row = vec![0.0; ids.len()];
        let mut derivatives = LengthRow::default();
        for (at, reading) in readings.iter().enumerate() {
            let sigma = sigma.get(at).copied();
            if sigma == Some(f64::INFINITY) {
                continue;
            }
            prepared.row_into(reading, &mut derivatives);
            selection.pick(&derivatives, reading.centre, &mut row);
            if let Some(sigma) = sigma {
                row.iter_mut().for_each(|value| *value /= sigma);
            }
            triangle.push(&row, 0.0);
        }
        triangle
    });
    Triangle::merged(pieces, ids.len()).factor()
}

/// Which of `ids` the readings can tell at `model`; `None` when a number is not finite.
///
/// The set-up is preferred over the robot's own parameters, and among these the joints over what
/// moves the robot's base as a whole or its scale: what a user would hold is left out first.
pub fn analyse<L: Readings + ?Sized>(model: &LengthModel, readings: &L, ids: &[ParamId]) -> Option<Analysis> {
    let mut ids = ids.to_vec();
    ids.sort();
    let base = base_set(&factor(model, readings, &ids), &order_of_choice(&ids))?;
    Some(Analysis { ids, base })
}

/// The order in which parameters are taken into a base set.
pub(super) fn order_of_choice(ids: &[ParamId]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..ids.len()).collect();
    order.sort_by_key(|&at| (tier(ids[at]), at));
    order
}

/// Lower is kept first.
fn tier(id: ParamId) -> u8 {
    match id {
        ParamId::Centre(..) | ParamId::Tool(_) => 0,
        ParamId::Alpha(0) | ParamId::A(0) | ParamId::Theta(1) | ParamId::D(1) => 2,
        ParamId::BarOffset(_) => 3,
        // Sag and gear error must not take the place of a length or an angle.
        _ if id.is_optional() => 4,
        _ => 1,
    }
}
