//! 95 % intervals of the parameters, from their standard deviations.

use super::distribution::coverage_95;
use super::estimate::Estimate;
use super::lengths::Lengths;
use super::result::{Identification, SigmaSource};

/// Writes the intervals into the result, and where the lengths' sigma comes from.
pub(super) fn tell(result: &mut Identification, estimate: &Estimate, lengths: &Lengths) {
    result.sigma_source = match estimate.freedom {
        Some(_) => SigmaSource::Estimated,
        None if lengths.known => SigmaSource::Given,
        None => SigmaSource::Assumed,
    };
    result.sigma_freedom = estimate.freedom;
    if result.sigma_source == SigmaSource::Assumed {
        return;
    }
    let factor = coverage_95(estimate.freedom);
    result.coverage_factor = Some(factor);
    for parameter in &mut result.parameters {
        let about = |sd: f64| [parameter.identified - factor * sd, parameter.identified + factor * sd];
        parameter.interval95 = parameter.sd.map(about);
    }
}
