//! The decision on conformity with a tolerance by the distribution of what is measured (JCGM 106:2012).

use serde::Serialize;

/// How the decision is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rule {
    /// Pass, or fail, only where the probability of the contrary is at most `risk`; undecided between (guard bands,
    /// JCGM 106 8.3).
    GuardBand { risk: f64 },
    /// By the median alone (shared risk, JCGM 106 8.2).
    SimpleAcceptance,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    Pass,
    Fail,
    Undecided,
}

/// A decision with its rule and the risk that it is wrong.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Decision {
    pub decision: Outcome,
    /// The rule in a word: `guard_band`, `simple_acceptance`, or `change` where no tolerance was given.
    pub rule: &'static str,
    pub tolerance_mm: Option<f64>,
    /// The position error that 95 % of the poses do not exceed: its median,
    pub position_error_mm: f64,
    /// and the value that it exceeds with the risk allowed (a twentieth where none is stated).
    pub upper_mm: f64,
    /// Distance from the tolerance that the median must keep to pass.
    pub guard_band_mm: Option<f64>,
    /// The probability that the decision is wrong; of `undecided` that the tolerance is exceeded.
    pub specific_risk: Option<f64>,
}

/// A risk where the rule states none.
const USUAL_RISK: f64 = 0.05;

/// Decides by drawn values (ascending) of what the tolerance applies to; without a tolerance by whether anything changed.
pub fn decide(sizes_mm: &[f64], tolerance_mm: Option<f64>, rule: Rule, changed: bool) -> Decision {
    let at = |share: f64| {
        let place = (share * sizes_mm.len() as f64).ceil() as usize;
        sizes_mm
            .get(place.saturating_sub(1).min(sizes_mm.len().saturating_sub(1)))
            .copied()
            .unwrap_or(f64::NAN)
    };
    let risk = match rule {
        Rule::GuardBand { risk } => risk,
        Rule::SimpleAcceptance => USUAL_RISK,
    };
    let (median, upper) = (at(0.5), at(1.0 - risk));
    let whole = Decision {
        decision: if changed { Outcome::Fail } else { Outcome::Pass },
        rule: "change",
        tolerance_mm,
        position_error_mm: median,
        upper_mm: upper,
        guard_band_mm: None,
        specific_risk: None,
    };
    let Some(tolerance) = tolerance_mm else { return whole };
    let within = sizes_mm.partition_point(|size| *size <= tolerance);
    let share = |count: usize| count as f64 / sizes_mm.len().max(1) as f64;
    let (keeps, exceeds) = (share(within), share(sizes_mm.len() - within));
    let (decision, rule) = match rule {
        Rule::SimpleAcceptance if median <= tolerance => (Outcome::Pass, "simple_acceptance"),
        Rule::SimpleAcceptance => (Outcome::Fail, "simple_acceptance"),
        Rule::GuardBand { risk } if exceeds <= risk => (Outcome::Pass, "guard_band"),
        Rule::GuardBand { risk } if keeps <= risk => (Outcome::Fail, "guard_band"),
        Rule::GuardBand { .. } => (Outcome::Undecided, "guard_band"),
    };
    Decision {
        decision,
        rule,
        guard_band_mm: (rule == "guard_band").then_some(upper - median),
        specific_risk: Some(if decision == Outcome::Fail { keeps } else { exceeds }),
        ..whole
    }
}

impl Decision {
    /// Where a failure is no finding of the lengths.
    pub(super) fn unless_failed(self) -> Self {
        if self.decision != Outcome::Fail {
            return self;
        }
        let specific_risk = self.specific_risk.map(|keeps| 1.0 - keeps);
        Self { decision: Outcome::Undecided, specific_risk, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decision_keeps_its_risk() {
        let sizes: Vec<f64> = (1..=100).map(f64::from).collect();
        let rule = Rule::GuardBand { risk: 0.05 };
        for (tolerance, decision, risk) in [
            (95.0, Outcome::Pass, 0.05),
            (94.0, Outcome::Undecided, 0.06),
            (6.0, Outcome::Undecided, 0.94),
            (5.0, Outcome::Fail, 0.05),
        ] {
            let found = decide(&sizes, Some(tolerance), rule, false);
            assert_eq!(found.decision, decision, "{tolerance}");
            assert!((found.specific_risk.unwrap() - risk).abs() < 1e-12);
            assert_eq!((found.guard_band_mm, found.upper_mm), (Some(45.0), 95.0));
        }
        let shared = decide(&sizes, Some(60.0), Rule::SimpleAcceptance, false);
        assert_eq!((shared.decision, shared.guard_band_mm), (Outcome::Pass, None));
        assert_eq!(decide(&sizes, None, rule, true).decision, Outcome::Fail);
        assert_eq!(decide(&sizes, None, rule, false).decision, Outcome::Pass);
    }
}
