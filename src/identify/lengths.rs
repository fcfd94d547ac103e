//! The lengths as the solver takes them.

use super::options::Options;
use crate::model::{Observations, Reading};

/// Lengths with the standard deviations they are weighted by.
#[derive(Clone, Debug)]
pub(super) struct Lengths {
    pub(super) readings: Vec<Reading>,
    /// As given, mm; 1 where nothing is known.
    pub(super) given: Vec<f64>,
    /// Whether the user vouches for them, so that they are not brought to what the residuals show.
    pub(super) vouched: bool,
    /// Whether anything is known of them at all.
    pub(super) known: bool,
}

impl Lengths {
    /// Of observations, by the sigma that the options or the rows give.
    pub(super) fn of(observations: &Observations, options: &Options) -> Self {
        let known = options.sigma_mm.is_some() || observations.rows.iter().all(|row| row.sigma_mm.is_some());
        let given = |sigma: Option<f64>| match options.sigma_mm {
            Some(sigma) => sigma,
            // One row without a sigma makes all equal: a guess for it would weigh as a measurement.
            None if known => sigma.unwrap_or(1.0),
            None => 1.0,
        };
        Self {
            readings: observations.rows.iter().map(Reading::from).collect(),
            given: observations.rows.iter().map(|row| given(row.sigma_mm)).collect(),
            vouched: options.sigma_mm.is_some(),
            known,
        }
    }
}
