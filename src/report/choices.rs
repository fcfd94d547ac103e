//! What was left to the data: sigma, coverage, prior, optional groups, Monte Carlo.

use serde::Serialize;

use super::page::Fact;
use super::scale::significant;
use crate::identify::result::{Identification, SigmaSource};

/// The choices as the page takes them.
#[derive(Serialize)]
pub(super) struct Choices {
    /// Each a sentence.
    sentences: Vec<String>,
    /// Factor on the prior, held-out rms in mm, whether it was taken.
    scales: Vec<(String, String, bool)>,
    /// How wide the 95 % intervals are.
    coverage: Option<String>,
    /// Trials of the Monte Carlo.
    trials: Option<usize>,
}

pub(super) fn choices(result: &Identification) -> Choices {
    let mut sentences: Vec<String> = result.groups.iter().map(|group| group.text.clone()).collect();
    if let Some(prior) = result.prior.as_ref().filter(|prior| prior.scale != 1.0 || !prior.tried.is_empty()) {
        let how = if prior.tried.is_empty() { "" } else { ", chosen by cross-validation" };
        sentences.push(format!(
            "the prior ({}) counts with {} times its standard deviations{how}",
            prior.source,
            significant(prior.scale, 3)
        ));
    }
    if let Some(drawn) = &result.monte_carlo {
        let verdict = match drawn.disagree.as_slice() {
            [] => "all intervals agree with the linear ones to a tenth of their half width".into(),
            names => format!("the intervals of {} differ from the linear ones", names.join(", ")),
        };
        sentences.push(format!("Monte Carlo with {} trials: {verdict}", drawn.used));
    }
    let tried = result.prior.iter().flat_map(|prior| prior.tried.iter().map(|tried| (prior.scale, tried)));
    Choices {
        sentences,
        scales: tried
            .map(|(taken, tried)| {
                let rms = significant(tried.held_out_rms_mm, 4);
                (significant(tried.scale, 3), rms, tried.scale == taken)
            })
            .collect(),
        coverage: result.coverage_factor.map(|factor| match result.sigma_freedom {
            Some(freedom) => format!(
                "{} sd (Student's t with {freedom} degrees of freedom, because sigma was estimated)",
                significant(factor, 4)
            ),
            None => format!("{} sd (normal, because sigma was given)", significant(factor, 4)),
        }),
        trials: result.monte_carlo.as_ref().map(|drawn| drawn.used),
    }
}

/// The lengths' standard deviation, and where it comes from.
pub(super) fn sigma(result: &Identification) -> Fact {
    let source = match result.sigma_source {
        SigmaSource::Given => "given",
        SigmaSource::Estimated => "estimated from the residuals",
        SigmaSource::Assumed => "assumed: nothing tells it",
    };
    Fact::new("Standard deviation of a length", format!("{} mm, {source}", significant(result.sigma_mm, 3)))
}
