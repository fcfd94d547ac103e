//! What an identification left to the data, in lines: prior, optional groups, Monte Carlo.

use crate::identify::result::{Identification, SigmaSource};

/// The lines of the summary; a group that could not be tested stands only in the files.
pub(super) fn lines(result: &Identification) -> Vec<String> {
    let mut lines: Vec<String> =
        result.groups.iter().filter(|group| group.f.is_some()).map(|group| group.text.clone()).collect();
    if let Some(prior) = &result.prior
        && !prior.tried.is_empty()
    {
        let chosen = prior.tried.iter().find(|tried| tried.scale == prior.scale);
        let rms = chosen.map_or(f64::NAN, |tried| tried.held_out_rms_mm);
        lines.push(format!(
            "prior scale {} by cross-validation over {} values: held-out rms {rms:.4} mm",
            prior.scale,
            prior.tried.len()
        ));
    }
    if let Some(drawn) = &result.monte_carlo {
        lines.push(match drawn.disagree.as_slice() {
            [] => format!("Monte Carlo, {} trials: the linear 95 % intervals hold", drawn.used),
            names => format!(
                "Monte Carlo, {} trials: the linear 95 % intervals do not hold for {}",
                drawn.used,
                names.join(", ")
            ),
        });
    }
    lines
}

/// Where sigma comes from, in a word.
pub(super) fn source(source: SigmaSource) -> &'static str {
    match source {
        SigmaSource::Given => "given",
        SigmaSource::Estimated => "estimated",
        SigmaSource::Assumed => "assumed",
    }
}
