//! The decision on conformity with a tolerance, from the distribution of the measurand (JCGM 106:2012).

use serde::Serialize;

/// The decision rule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DecisionRule {
    /// Guard bands (JCGM 106 8.3): pass or fail only if the probability of the contrary is at most `risk`, else
    /// undecided.
    GuardBand { risk: f64 },
    /// Shared risk (JCGM 106 8.2): the median decides.
    SimpleAcceptance,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ConformityOutcome {
    Pass,
    Fail,
    Undecided,
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
        decision: if changed { ConformityOutcome::Fail } else { ConformityOutcome::Pass },
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
    /// Turns a failure into `undecided`, if lengths that agree with the robot would fail as well.
    pub(super) fn failure_as_undecided(self) -> Self {
        if self.decision != ConformityOutcome::Fail {
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
        assert_eq!(decide(&sizes, None, rule, true).decision, ConformityOutcome::Fail);
        assert_eq!(decide(&sizes, None, rule, false).decision, ConformityOutcome::Pass);
    }
}
