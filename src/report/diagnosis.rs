//! Sections of the identification page: what to measure next, what is hardly told apart, what the axes show.

use serde::Serialize;

use super::identification_view::{IdentificationPlots, ObservationPoint};
use super::page::Fact;
use super::plot::against_axis::{AxisPlot, AxisPoint};
use super::scale::{fixed, index, rounded};
use crate::identify::result::{Advice, Correlated, Identification, JointEffect};
use crate::model::AXES;

/// Points of a panel at most: evenly taken from a long run.
const POINTS: usize = 1500;

#[derive(Serialize)]
pub(super) struct AdviceLine {
    text: String,
    before: String,
    after: String,
    tells: String,
}

/// What was tried, best first.
pub(super) fn advice(result: &Identification) -> Vec<AdviceLine> {
    let line = |advice: &Advice| AdviceLine {
        // The figures stand in columns of their own.
        text: advice.text.split(": predicted").next().unwrap_or_default().to_owned(),
        before: fixed(advice.before_mm, 3),
        after: fixed(advice.after_mm, 3),
        tells: if advice.tells.is_empty() { "–".into() } else { advice.tells.join(", ") },
    };
    result.advice.iter().map(line).collect()
}

/// Pairs with their correlation.
pub(super) fn correlated(result: &Identification) -> Vec<[String; 3]> {
    let line = |pair: &Correlated| {
        let [a, b] = pair.pair.clone();
        [a, b, fixed(pair.r, 4)]
    };
    result.correlated.iter().map(line).collect()
}

/// The observability indices.
pub(super) fn facts(result: &Identification) -> Vec<Fact> {
    let Some(all) = result.observability else { return Vec::new() };
    let values = [all.o1, all.o2, all.o3, all.o4, all.o5];
    let names = ["Observability O1", "O2", "O3", "O4", "O5"];
    names.into_iter().zip(values).map(|(name, value)| Fact::new(name, index(value))).collect()
}

/// What the residuals show at single axes, in sentences.
pub(super) fn joints(result: &Identification) -> Vec<String> {
    let line = |effect: &JointEffect| {
        let (axis, um) = (effect.axis, rounded(effect.rms_mm * 1e3, 2));
        match effect.play_rad {
            Some(play) => {
                let mrad = rounded(play * 1e3, 2);
                format!(
                    "Axis {axis}: some {mrad} mrad between rising and falling, {um} µm rms of the lengths."
                )
            }
            None => format!("Axis {axis}: an error that returns with its angle, {um} µm rms of the lengths."),
        }
    };
    result.joints.iter().map(line).collect()
}

/// Six panels: the residual afterwards against each axis angle, outliers left out.
pub(super) fn panels(result: &Identification, plots: &IdentificationPlots) -> Vec<String> {
    let sound: Vec<&ObservationPoint> = plots.observations.iter().filter(|o| !o.is_outlier(result)).collect();
    let shown: Vec<&ObservationPoint> =
        sound.iter().copied().step_by(sound.len().div_ceil(POINTS).max(1)).collect();
    if shown.is_empty() {
        return Vec::new();
    }
    let largest_mm =
        shown.iter().map(|o| o.after_mm.abs()).filter(|size| size.is_finite()).fold(0.0, f64::max);
    (0..AXES)
        .map(|axis| {
            let point = |o: &&ObservationPoint| AxisPoint {
                angle_deg: o.axes_deg[axis],
                residual_mm: o.after_mm,
                sense: o.senses[axis],
            };
            let title = format!("Axis {}", axis + 1);
            AxisPlot { title, points: shown.iter().map(point).collect(), largest_mm }.to_svg()
        })
        .collect()
}
