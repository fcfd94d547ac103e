//! The first lines of a page: a verdict in one sentence, and the next action. The pages of the workbench say it in the
//! same words (`say.result.*` and `say.check.*` of their texts).

use dbbd_model::conformity::{
    ComparisonSubject, ConformityOutcome, Headline, InterimCheck, ResultComparison, Standing,
    UncertaintyBudget,
};
use dbbd_model::estimation::{CalibrationResult, Validity};
use serde::Serialize;

use super::scale::significant;

/// A verdict with its sentences. The template gives each kind a colour and a shape.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verdict {
    kind: VerdictKind,
    /// The verdict in one word; the sentence goes on behind it.
    word: &'static str,
    sentence: String,
    /// The time and the conditions for which a checked calibration may be used, if they are known.
    validity: Option<String>,
    /// What to do next, a sentence each.
    next: Vec<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum VerdictKind {
    Pass,
    Fail,
    Undecided,
    /// Nothing was to be decided.
    None,
}

/// A quantity with two significant digits (JCGM 100:2008, 7.2.6).
fn mm(value: f64) -> String {
    format!("{} mm", significant(value, 2))
}

/// For how long, under which conditions, and on which assumption of the drift a calibration is valid.
pub(super) fn holds(validity: &Validity) -> String {
    format!("Valid {validity}.")
}

impl Verdict {
    /// The verdict on a calibration as it stands: its headline, and what to do next.
    pub fn of_calibration(
        result: &CalibrationResult,
        budget: &UncertaintyBudget,
        standing: &Standing,
    ) -> Self {
        // A check with a tolerance limits it too.
        let is_limited = matches!(standing, Standing::Usable { until: Some(_) })
            || result.validity.as_ref().is_some_and(|validity| validity.limit_mm.is_some());
        let (kind, word, next) = match standing {
            Standing::Usable { .. } => (
                if is_limited { VerdictKind::Pass } else { VerdictKind::None },
                if is_limited { "Valid." } else { "Identified." },
                "Correct the programs of the robot, and check it after a collision or a repair.",
            ),
            Standing::Warned => (
                VerdictKind::Undecided,
                "With warnings.",
                "Read the warnings, and do what they say before you use this result.",
            ),
            Standing::Undecided => (
                VerdictKind::Undecided,
                "Undecided.",
                "Check the robot again with more poses, or state a tolerance that they can decide.",
            ),
            Standing::Over { .. } => {
                (VerdictKind::Undecided, "Ended.", "Check the robot, or renew its calibration.")
            }
            Standing::Failed => (
                VerdictKind::Fail,
                "Not valid.",
                "Look at what changed, repair it or identify the robot again.",
            ),
        };
        let better = match standing {
            Standing::Usable { .. } | Standing::Warned => result.recommendations.iter().find(|one| one.adds),
            Standing::Undecided | Standing::Over { .. } | Standing::Failed => None,
        };
        let better = better.map(|one| {
            format!(
                "To be better, measure {}: the mean error is predicted to fall from {} to {}.",
                one.what(),
                mm(one.before_mm),
                mm(one.after_mm)
            )
        });
        Self {
            kind,
            word,
            sentence: Headline::of(result, budget, standing).to_string(),
            validity: None,
            next: std::iter::once(next.to_owned()).chain(better).collect(),
        }
    }

    /// The verdict in one sentence, without its word.
    pub fn sentence(&self) -> &str {
        &self.sentence
    }

    /// What to do next, a sentence each.
    pub fn next(&self) -> &[String] {
        &self.next
    }

    /// The verdict without the next action.
    pub(crate) fn statement(&self) -> String {
        format!("{} {}", self.word, self.sentence)
    }

    pub(crate) fn of_check(check: &InterimCheck) -> Self {
        let decision = &check.decision;
        let tolerance = decision.tolerance_mm.map(|tolerance| format!(", tolerance {}", mm(tolerance)));
        let sentence = format!(
            "The position error is {} (upper limit {}{}).",
            mm(decision.position_error_mm),
            mm(decision.upper_mm),
            tolerance.unwrap_or_default()
        );
        let (kind, word, next) = match decision.decision {
            outcome @ (ConformityOutcome::Pass | ConformityOutcome::Unchanged) => (
                VerdictKind::Pass,
                if outcome == ConformityOutcome::Pass { "Pass." } else { "Unchanged." },
                "Go on using the calibration. Check the robot again after a collision or a repair.",
            ),
            outcome @ (ConformityOutcome::Fail | ConformityOutcome::Changed) => (
                VerdictKind::Fail,
                if outcome == ConformityOutcome::Fail { "Fail." } else { "Changed." },
                "Do not use the calibration. Look at what changed, repair it or identify the robot again, and then correct \
                 its programs.",
            ),
            ConformityOutcome::Undecided => (
                VerdictKind::Undecided,
                "Undecided.",
                "These lengths cannot decide. Measure more poses, or state a tolerance that they can decide.",
            ),
        };
        Self { kind, word, sentence, validity: check.validity.as_ref().map(holds), next: vec![next.into()] }
    }

    /// The verdict of a comparison; `changed` are the names of parameters that changed significantly.
    pub(crate) fn of_comparison(comparison: &ResultComparison, changed: &[String]) -> Self {
        let (moved_mm, next) = match &comparison.subject {
            ComparisonSubject::Results(results) => (
                Some(results.position_change_mm.whole.p95),
                "Find out why it changed, and correct the programs with the last result.",
            ),
            ComparisonSubject::Circles { .. } => (None, "Find out why it changed: calibrate the robot."),
        };
        let (expected_mm, is_moved) = match &comparison.subject {
            ComparisonSubject::Results(results) => {
                let position = &results.position_change_mm;
                let is_moved = position.is_significant == Some(true);
                (position.expected.filter(|_| !is_moved).map(|expected| expected.summary.p95), is_moved)
            }
            ComparisonSubject::Circles { .. } => (None, false),
        };
        let moved = match (moved_mm, expected_mm) {
            (Some(moved), Some(expected)) => format!(
                " At 95 % of the poses the predictions differ by less than {}; {} are expected from their uncertainties alone.",
                mm(moved),
                mm(expected)
            ),
            (Some(moved), None) => format!(" 95 % of the poses moved by less than {}.", mm(moved)),
            (None, _) => String::new(),
        };
        if changed.is_empty() && !is_moved {
            return Self {
                kind: VerdictKind::Pass,
                word: "Unchanged.",
                sentence: format!("Nothing changed significantly.{moved}"),
                validity: None,
                next: vec!["Nothing: go on using it.".into()],
            };
        }
        let exceeded = moved_mm.filter(|_| expected_mm.is_none()).zip(comparison.tolerance_mm);
        let exceeded = exceeded.is_some_and(|(moved, tolerance)| moved > tolerance);
        Self {
            kind: if exceeded { VerdictKind::Fail } else { VerdictKind::Undecided },
            word: "Changed.",
            sentence: match changed {
                [] => format!("The position changed significantly.{moved}"),
                changed => format!("Changed significantly: {}.{moved}", changed.join(", ")),
            },
            validity: None,
            next: vec![next.into()],
        }
    }
}
