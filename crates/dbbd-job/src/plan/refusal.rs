//! The refusal of a plan, with its reasons.

use crate::plan::PlanFinding;
use crate::plan::job::JobFinding;
use dbbd_model::diagnostic::Diagnostic;

/// Number of findings of a refusal that are printed.
const PRINTED: usize = 10;

/// The reasons why a plan would be unsafe or impossible.
#[derive(Clone, Debug, PartialEq)]
pub struct Refusal {
    /// The reasons, in the order of the rows.
    pub findings: Vec<Diagnostic>,
    pub recommendations: Vec<Diagnostic>,
}

impl Refusal {
    /// Whether other poses may help: only stroke risk or clearance is refused.
    pub(super) fn is_for_caution(&self) -> bool {
        self.all(|finding| matches!(finding, PlanFinding::StrokeRisk { .. } | PlanFinding::Obstacle { .. }))
    }

    /// Whether another place of the base ball may help: only stroke risk or too few poses are refused.
    pub(super) fn is_for_place(&self) -> bool {
        self.all(|finding| matches!(finding, PlanFinding::StrokeRisk { .. }) || finding.is_too_few_poses())
    }

    fn all(&self, holds: impl Fn(&PlanFinding) -> bool) -> bool {
        self.findings.iter().all(|diagnostic| diagnostic.finding().is_some_and(&holds))
    }

    /// The findings to print: the first ones, then the recommendations.
    pub fn printed(&self) -> impl Iterator<Item = &Diagnostic> {
        self.findings.iter().take(PRINTED).chain(&self.recommendations)
    }
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.printed().try_for_each(|finding| writeln!(out, "{}: {finding}", finding.code()))
    }
}

impl From<Refusal> for Diagnostic {
    fn from(refusal: Refusal) -> Self {
        let findings = refusal.findings.len();
        PlanFinding::Refused { findings, shown: findings.min(PRINTED) }.into()
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
