//! Why there is no plan.

use crate::catalogue::{JobFinding, PlanFinding};
use crate::diagnostic::Diagnostic;

/// How many findings of a refusal are shown.
const SHOWN: usize = 10;
/// Why a plan would not be safe, or not be possible.
#[derive(Clone, Debug, PartialEq)]
pub struct Refusal {
    /// In the order of the rows.
    pub findings: Vec<Diagnostic>,
    /// What would help.
    pub recommendations: Vec<Diagnostic>,
}

impl Refusal {
    /// Whether other poses may help: nothing is refused but a risk of leaving the stroke, or a clearance.
    pub(super) fn is_for_caution(&self) -> bool {
        self.findings.iter().all(|finding| matches!(finding.code.0, "E0706" | "E0708"))
    }

    /// Whether another place of the base ball may help: for that risk, or where too few poses can be chosen.
    pub(super) fn is_for_place(&self) -> bool {
        self.findings.iter().all(|finding| matches!(finding.code.0, "E0706" | "E0710"))
    }

    /// The first findings, and what would help.
    pub fn shown(&self) -> impl Iterator<Item = &Diagnostic> {
        self.findings.iter().take(SHOWN).chain(&self.recommendations)
    }
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.shown().try_for_each(|finding| writeln!(out, "{}: {finding}", finding.code))
    }
}

impl From<Refusal> for Diagnostic {
    fn from(refusal: Refusal) -> Self {
        let findings = refusal.findings.len();
        PlanFinding::Refused { findings, shown: findings.min(SHOWN) }.into()
    }
}

impl From<Diagnostic> for Refusal {
    fn from(finding: Diagnostic) -> Self {
        Self { findings: vec![finding], recommendations: Vec::new() }
    }
}

impl From<JobFinding> for Refusal {
    fn from(finding: JobFinding) -> Self {
        Diagnostic::new(finding).into()
    }
}
