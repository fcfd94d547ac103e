//! The first line about a calibration: how far the tool ball is off before and after, with its uncertainty, for which
//! tool, and how long that holds. Terminal, report, certificate and workbench make their first line of it.

use std::fmt;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{Standing, UncertaintyBudget};
use crate::base::number::significant;
use crate::estimation::result::PredictedPair;
use crate::estimation::{CalibrationResult, Validity};

/// Figures of an error and of its uncertainty (JCGM 100:2008, 7.2.6).
const FIGURES: usize = 2;

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Headline {
    /// Mean position error of the tool ball over the workspace, predicted before any length, mm.
    pub before_mm: f64,
    /// The same of the identified robot, mm.
    pub after_mm: f64,
    /// Expanded uncertainty of the position of the tool ball, mm.
    pub u_mm: f64,
    /// Its coverage factor.
    pub k: f64,
    /// The tool ball in the flange frame, mm; `None` if the result has no validity, as the next three.
    pub tool_mm: Option<[f64; 3]>,
    pub payload_kg: Option<f64>,
    /// Day of the measurements, if it is known.
    pub measured: Option<String>,
    /// The day on which the validity ends or ended.
    pub until: Option<String>,
    #[serde(skip)]
    for_tool: String,
    #[serde(skip)]
    holds: String,
}

/// What `result.json` states about the accuracy of its calibration.
#[derive(Deserialize)]
struct StatedAccuracy {
    predicted_position_uncertainty_mm: PredictedPair,
    budget: UncertaintyBudget,
    validity: Option<Validity>,
}

impl Headline {
    pub fn of(result: &CalibrationResult, budget: &UncertaintyBudget, standing: &Standing) -> Self {
        let predicted = &result.predicted_position_uncertainty_mm;
        Self::new(predicted, budget, result.validity.as_ref(), standing)
    }

    /// From the content of a `result.json`; `None` if it lacks what the line states.
    pub fn of_json(content: &Value, standing: &Standing) -> Option<Self> {
        let stated: StatedAccuracy = StatedAccuracy::deserialize(content).ok()?;
        let predicted = &stated.predicted_position_uncertainty_mm;
        Some(Self::new(predicted, &stated.budget, stated.validity.as_ref(), standing))
    }

    fn new(
        predicted: &PredictedPair,
        budget: &UncertaintyBudget,
        validity: Option<&Validity>,
        standing: &Standing,
    ) -> Self {
        let measured = validity.and_then(Validity::day);
        let holds = match (standing, validity.and_then(|validity| validity.months), measured) {
            (Standing::Usable { until: Some(until) }, ..) => format!("valid until {until}"),
            (Standing::Usable { until: None }, Some(months), _) => {
                format!("valid for {months:.1} months from the measurement")
            }
            (Standing::Usable { until: None }, None, Some(day)) => format!("measured on {day}"),
            (Standing::Usable { until: None }, None, None) => "measured on a day that is not stated".into(),
            (Standing::Warned, ..) => "with warnings: to be used only if they are judged harmless".into(),
            (Standing::Undecided, ..) => "the last check decided nothing".into(),
            (Standing::Over { until }, ..) => format!("the validity ended on {until}"),
            (Standing::Failed, ..) => "not to be used: the last check failed".into(),
        };
        let until = match standing {
            Standing::Usable { until } => until.clone(),
            Standing::Over { until } => Some(until.clone()),
            Standing::Warned | Standing::Undecided | Standing::Failed => None,
        };
        Self {
            before_mm: predicted.nominal.mean,
            after_mm: predicted.identified.mean,
            u_mm: budget.expanded_mm,
            k: budget.coverage_factor,
            tool_mm: validity.map(|validity| validity.tool_mm),
            payload_kg: validity.and_then(|validity| validity.payload_kg),
            measured: measured.map(str::to_owned),
            until,
            for_tool: validity.map_or_else(|| "for this tool".into(), Validity::conditions),
            holds,
        }
    }
}

impl fmt::Display for Headline {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [before, after, u] =
            [self.before_mm, self.after_mm, self.u_mm].map(|mm| significant(mm, FIGURES));
        let Self { k, for_tool, holds, .. } = self;
        write!(
            out,
            "Mean error of the tool ball over the workspace: {before} mm before, {after} mm after, U = {u} mm (k = {k}); \
             {for_tool}; {holds}."
        )
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn line(validity: Value, standing: &Standing) -> String {
        let error = |mean: f64| json!({ "mean": mean, "p95": 3.0, "max": 4.0 });
        let content = json!({
            "predicted_position_uncertainty_mm": { "nominal": error(2.364), "identified": error(0.0741) },
            "budget": { "lines": [], "combined_mm": 0.0823, "coverage_factor": 2.0, "expanded_mm": 0.1646 },
            "validity": validity,
        });
        let headline = Headline::of_json(&content, standing).unwrap().to_string();
        let rest = headline.strip_prefix(
            "Mean error of the tool ball over the workspace: 2.4 mm before, 0.074 mm after, U = 0.16 mm (k = 2); ",
        );
        rest.unwrap_or_else(|| panic!("{headline}")).to_owned()
    }

    #[test]
    fn it_states_the_tool_and_how_long_it_holds() {
        let validity = |until: Option<&str>, months: Option<f64>, payload_kg: Option<f64>| {
            json!({
                "tool_mm": [30.0, -20.0, 10.0], "payload_kg": payload_kg, "measured": "2026-03-01T12:00:00Z",
                "expanded_uncertainty_mm": 0.1646, "limit_mm": months, "months": months, "until": until,
                "basis": "hyper_prior",
            })
        };
        let tool = "for the tool at (30.0, -20.0, 10.0) mm, up to 50 kg";
        let usable = |until: Option<&str>| Standing::Usable { until: until.map(str::to_owned) };
        let cases = [
            (
                validity(Some("2026-09-01"), Some(6.0), Some(50.0)),
                usable(Some("2026-09-01")),
                "valid until 2026-09-01",
            ),
            (
                validity(None, Some(6.0), Some(50.0)),
                usable(None),
                "valid for 6.0 months from the measurement",
            ),
            (validity(None, None, Some(50.0)), usable(None), "measured on 2026-03-01"),
            (validity(None, None, Some(50.0)), Standing::Failed, "not to be used: the last check failed"),
            (
                validity(None, None, Some(50.0)),
                Standing::Over { until: "2026-09-01".into() },
                "the validity ended on 2026-09-01",
            ),
        ];
        for (validity, standing, holds) in cases {
            assert_eq!(line(validity, &standing), format!("{tool}; {holds}."));
        }
        assert_eq!(line(Value::Null, &usable(None)), "for this tool; measured on a day that is not stated.");
        assert!(line(validity(None, None, None), &usable(None)).contains("payload not stated"));
        assert_eq!(Headline::of_json(&json!({ "validity": null }), &usable(None)), None);
    }
}
