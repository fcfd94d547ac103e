//! The decision on conformity with a tolerance, from the distribution of the measurand (JCGM 106:2012).

use serde::{Deserialize, Serialize};

/// The decision rule.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DecisionRule {
    /// Guard bands (JCGM 106 8.3): pass or fail only if the probability of the contrary is at most `risk`, else
    /// undecided.
    GuardBand { risk: f64 },
    /// Shared risk (JCGM 106 8.2): the median decides.
    SimpleAcceptance,
}

/// The outcome of a check. Only a tolerance can be passed or failed; without one the robot is unchanged or changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ConformityOutcome {
    Pass,
    Fail,
    Undecided,
    Unchanged,
    Changed,
}

impl ConformityOutcome {
    pub const ALL: [Self; 5] = [Self::Pass, Self::Fail, Self::Undecided, Self::Unchanged, Self::Changed];

    pub fn name(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Fail => "fail",
            Self::Undecided => "undecided",
            Self::Unchanged => "unchanged",
            Self::Changed => "changed",
        }
    }

    /// Whether the check confirms the calibration; `None` if it decides nothing.
    pub fn confirms(self) -> Option<bool> {
        match self {
            Self::Pass | Self::Unchanged => Some(true),
            Self::Fail | Self::Changed => Some(false),
            Self::Undecided => None,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ConformityDecision {
    pub decision: ConformityOutcome,
    /// `guard_band`, `simple_acceptance`, or `change` without a tolerance.
    pub rule: &'static str,
    pub tolerance_mm: Option<f64>,
    /// Median of the position error (the 95th percentile over the poses).
    pub position_error_mm: f64,
    /// The value that the position error exceeds with the allowed risk (0.05 if the rule states none).
    pub upper_mm: f64,
    /// Least distance of the median from the tolerance to pass.
    pub guard_band_mm: Option<f64>,
    /// Probability that the decision is wrong. If undecided: that the tolerance is exceeded.
    pub specific_risk: Option<f64>,
}

const DEFAULT_RISK: f64 = 0.05;

/// Decides by ascending draws of the position error; without a tolerance by whether anything changed.
pub fn decide(
    sizes_mm: &[f64],
    tolerance_mm: Option<f64>,
    rule: DecisionRule,
    changed: bool,
) -> ConformityDecision {
    let at = |share: f64| {
        let count = (share * sizes_mm.len() as f64).ceil() as usize;
        let at = count.clamp(1, sizes_mm.len().max(1)) - 1;
        sizes_mm.get(at).copied().unwrap_or(f64::NAN)
    };
    let risk = match rule {
        DecisionRule::GuardBand { risk } => risk,
        DecisionRule::SimpleAcceptance => DEFAULT_RISK,
    };
    let (median, upper) = (at(0.5), at(1.0 - risk));
    let by_change = ConformityDecision {
        decision: if changed { ConformityOutcome::Changed } else { ConformityOutcome::Unchanged },
        rule: "change",
        tolerance_mm,
        position_error_mm: median,
        upper_mm: upper,
        guard_band_mm: None,
        specific_risk: None,
    };
    let Some(tolerance) = tolerance_mm else { return by_change };
    let within = sizes_mm.partition_point(|size| *size <= tolerance);
    let share = |count: usize| count as f64 / sizes_mm.len().max(1) as f64;
    let (conforms, exceeds) = (share(within), share(sizes_mm.len() - within));
    let (decision, rule) = match rule {
        DecisionRule::SimpleAcceptance if median <= tolerance => {
            (ConformityOutcome::Pass, "simple_acceptance")
        }
        DecisionRule::SimpleAcceptance => (ConformityOutcome::Fail, "simple_acceptance"),
        DecisionRule::GuardBand { risk } if exceeds <= risk => (ConformityOutcome::Pass, "guard_band"),
        DecisionRule::GuardBand { risk } if conforms <= risk => (ConformityOutcome::Fail, "guard_band"),
        DecisionRule::GuardBand { .. } => (ConformityOutcome::Undecided, "guard_band"),
    };
    ConformityDecision {
        decision,
        rule,
        guard_band_mm: (rule == "guard_band").then_some(upper - median),
        specific_risk: Some(if decision == ConformityOutcome::Fail { conforms } else { exceeds }),
        ..by_change
    }
}

impl ConformityDecision {
    /// How many times as large the position uncertainty may become until the robot does not pass any more; `None` if it does
    /// not pass now, or without a tolerance.
    pub(super) fn growth(&self) -> Option<f64> {
        let decides_mm =
            if self.rule == "simple_acceptance" { self.position_error_mm } else { self.upper_mm };
        let growth = self.tolerance_mm? / decides_mm;
        (self.decision.confirms() == Some(true)).then_some(growth)
    }

    /// Decides nothing: the lengths are not of this robot.
    pub(super) fn nothing(self) -> Self {
        Self { decision: ConformityOutcome::Undecided, specific_risk: None, ..self }
    }

    /// Turns a failure into `undecided`, if lengths that agree with the robot would fail as well.
    pub(super) fn failure_as_undecided(self) -> Self {
        if self.decision.confirms() != Some(false) {
            return self;
        }
        let specific_risk = self.specific_risk.map(|conforms| 1.0 - conforms);
        Self { decision: ConformityOutcome::Undecided, specific_risk, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decisions_respect_the_allowed_risk() {
        let sizes: Vec<f64> = (1..=100).map(f64::from).collect();
        let rule = DecisionRule::GuardBand { risk: 0.05 };
        for (tolerance, decision, risk) in [
            (95.0, ConformityOutcome::Pass, 0.05),
            (94.0, ConformityOutcome::Undecided, 0.06),
            (6.0, ConformityOutcome::Undecided, 0.94),
            (5.0, ConformityOutcome::Fail, 0.05),
        ] {
            let found = decide(&sizes, Some(tolerance), rule, false);
            assert_eq!(found.decision, decision, "{tolerance}");
            assert!((found.specific_risk.unwrap() - risk).abs() < 1e-12);
            assert_eq!((found.guard_band_mm, found.upper_mm), (Some(45.0), 95.0));
        }
        let shared = decide(&sizes, Some(60.0), DecisionRule::SimpleAcceptance, false);
        assert_eq!((shared.decision, shared.guard_band_mm), (ConformityOutcome::Pass, None));
        assert_eq!(decide(&sizes, None, rule, true).decision, ConformityOutcome::Changed);
        assert_eq!(decide(&sizes, None, rule, false).decision, ConformityOutcome::Unchanged);
    }

    /// A robot passes until the size that decides has grown to the tolerance: the 95th of 100 draws, or their median.
    #[test]
    fn uncertainty_may_grow_until_the_robot_does_not_pass() {
        let sizes: Vec<f64> = (1..=100).map(f64::from).collect();
        let guarded = DecisionRule::GuardBand { risk: 0.05 };
        for (tolerance, rule, growth) in [
            (Some(190.0), guarded, Some(2.0)),
            (Some(94.0), guarded, None),
            (Some(75.0), DecisionRule::SimpleAcceptance, Some(1.5)),
            (Some(40.0), DecisionRule::SimpleAcceptance, None),
            (None, guarded, None),
        ] {
            assert_eq!(decide(&sizes, tolerance, rule, false).growth(), growth, "{tolerance:?} {rule:?}");
        }
    }

    /// JCGM 106: the specific risk is the probability that the decision is wrong; of an undecided one, that the tolerance is
    /// exceeded.
    #[test]
    fn specific_risks_of_all_outcomes() {
        let sizes: Vec<f64> = (1..=200).map(|at| f64::from(at) * 0.01).collect();
        let simple = |tolerance| decide(&sizes, Some(tolerance), DecisionRule::SimpleAcceptance, false);
        let (pass, fail) = (simple(1.2), simple(0.9));
        assert_eq!((pass.decision, pass.rule), (ConformityOutcome::Pass, "simple_acceptance"));
        assert!((pass.specific_risk.unwrap() - 0.4).abs() < 1e-12);
        assert_eq!(fail.decision, ConformityOutcome::Fail);
        assert!((fail.specific_risk.unwrap() - 0.45).abs() < 1e-12);
        // The median is at the tolerance: accepted.
        assert_eq!(simple(1.0).decision, ConformityOutcome::Pass);
        assert!((pass.position_error_mm - 1.0).abs() < 1e-12 && (pass.upper_mm - 1.9).abs() < 1e-12);
        let guarded =
            |tolerance| decide(&sizes, Some(tolerance), DecisionRule::GuardBand { risk: 0.1 }, false);
        let failed = guarded(0.15);
        assert_eq!(failed.decision, ConformityOutcome::Fail);
        assert!((failed.upper_mm - 1.8).abs() < 1e-12);
        assert!((failed.specific_risk.unwrap() - 0.075).abs() < 1e-12);
        assert!((failed.guard_band_mm.unwrap() - 0.8).abs() < 1e-12);
        let undecided = failed.failure_as_undecided();
        assert_eq!(undecided.decision, ConformityOutcome::Undecided);
        assert!((undecided.specific_risk.unwrap() - 0.925).abs() < 1e-12);
        let passed = guarded(1.905).failure_as_undecided();
        assert_eq!(passed.decision, ConformityOutcome::Pass);
        assert!((passed.specific_risk.unwrap() - 0.05).abs() < 1e-12);
    }

    #[test]
    fn without_a_tolerance_a_change_decides_and_without_draws_nothing_is_known() {
        let found = decide(&[1.0, 2.0, 3.0], None, DecisionRule::SimpleAcceptance, true);
        assert_eq!((found.rule, found.specific_risk, found.guard_band_mm), ("change", None, None));
        assert_eq!((found.position_error_mm, found.upper_mm), (2.0, 3.0));
        assert!(decide(&[], None, DecisionRule::SimpleAcceptance, false).upper_mm.is_nan());
    }
}
