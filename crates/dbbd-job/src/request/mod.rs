//! The request of a computation, and its answer: the same for the command line, the service, the workers of the archive
//! and Python.
//!
//! A request is processed in one direction: its inputs are read once into typed values with their provenance, the
//! result is computed, its files are written, and the answer is made. This module must not know who asks and how the
//! answer is shown.

mod answer;
mod catalogue;
pub mod certificate;
pub mod check;
mod child;
pub mod circle;
pub mod compensate;
mod earlier;
pub mod identify;
pub mod plan;
mod protocols;
mod robots;
mod row_indices;
pub mod scene;
mod watch;
mod workspace;

pub use answer::{AnswerOf, AnswerOutcome, AnswerRecord, AnswerResult, RequestResult};
pub use catalogue::RequestFinding;
pub use child::{RequestChild, read_answer};
pub use earlier::{other_run, read_identity};
pub use protocols::{read_protocol, read_protocol_file};
pub use robots::{aged, carrying, edited};
pub use row_indices::RowIndices;
pub use watch::{BusyIndicator, RequestWatch, open_text, read_table};
pub use workspace::checked_workspace;

use std::path::Path;

use certificate::{CertificateDocument, CertificateRequest};
use check::{CheckDocument, CheckRequest};
use circle::{CircleDocument, CircleRequest};
use compensate::{CompensateDocument, CompensateRequest};
use dbbd_model::base::serialised;
use dbbd_model::conformity::DecisionRule;
use dbbd_model::diagnostic::{Diagnostic, Severity};
use dbbd_model::plausibility::{POSITIVE, PlausibilityFinding, PlausibleRange, Quantity};
use identify::{IdentifyDocument, IdentifyRequest};
use plan::{PlanDocument, PlanRequest, PlannedPoses};
use serde::{Deserialize, Serialize};
use watch::RequestSession;

/// A computation that is requested. Relative paths start at the directory of the process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "request", rename_all = "snake_case")]
pub enum Request {
    Identify(IdentifyRequest),
    Plan(PlanRequest),
    Check(CheckRequest),
    Compensate(CompensateRequest),
    Circle(CircleRequest),
    Certificate(CertificateRequest),
}

impl Request {
    /// Reads a request that `from` gave as JSON.
    pub fn from_json(from: &str, text: &str) -> Result<Self, Diagnostic> {
        serde_json::from_str(text)
            .map_err(|why| Diagnostic::file(from, RequestFinding::NotARequest { why: why.to_string() }))
    }

    /// Reads the inputs, computes, and writes the files.
    pub fn answer(&self, watch: &dyn RequestWatch) -> Answer {
        let session = RequestSession::new(watch);
        if let Err(wrong) = self.check_numbers() {
            return Answer::of(Err(wrong.into()), session.into_findings());
        }
        let result = match self {
            Self::Identify(request) => request
                .result(&session)
                .map(|result| result.map(|document| AnswerDocument::Identify(Box::new(document)))),
            Self::Plan(request) => request
                .result(&session)
                .map(|result| result.map(|document| AnswerDocument::Plan(Box::new(document)))),
            Self::Check(request) => request
                .result(&session)
                .map(|result| result.map(|document| AnswerDocument::Check(Box::new(document)))),
            Self::Compensate(request) => {
                request.result(&session).map(|result| result.map(AnswerDocument::Compensate))
            }
            Self::Circle(request) => request
                .result(&session)
                .map(|result| result.map(|document| AnswerDocument::Circle(Box::new(document)))),
            Self::Certificate(request) => {
                request.result(&session).map(|result| result.map(AnswerDocument::Certificate))
            }
        };
        Answer::of(result, session.into_findings())
    }

    /// Refuses numbers that their quantities cannot have, whoever asks.
    ///
    /// # Errors
    /// The first such number, by the name of its key.
    pub fn check_numbers(&self) -> Result<(), PlausibilityFinding> {
        let point = |mm: &[f64; 3]| mm.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
        let tool = |mm: &Option<[f64; 3]>| mm.as_ref().map(point).filter(|mm| *mm > 0.0);
        let numbers: Vec<(&str, Option<f64>, PlausibleRange)> = match self {
            Self::Identify(request) => vec![
                ("tool_mm", tool(&request.tool_mm), Quantity::ToolBallDistance.range()),
                ("bar_u_mm", request.bar_u_mm, Quantity::StandardLengthUncertainty.range()),
                ("tolerance_mm", request.tolerance_mm, Quantity::PositionTolerance.range()),
            ],
            Self::Plan(PlanRequest { poses: PlannedPoses::Check(check), .. }) => vec![
                ("tolerance_mm", check.tolerance_mm, Quantity::PositionTolerance.range()),
                ("risk", Some(check.risk), Quantity::DecisionRisk.range()),
            ],
            Self::Check(request) => {
                let risk =
                    if let DecisionRule::GuardBand { risk } = request.rule { Some(risk) } else { None };
                vec![
                    ("tolerance_mm", request.tolerance_mm, Quantity::PositionTolerance.range()),
                    ("risk", risk, Quantity::DecisionRisk.range()),
                    ("tool_mm", tool(&request.tool_mm), Quantity::ToolBallDistance.range()),
                    ("sigma_mm", request.sigma_mm, Quantity::LengthSd.range().from(POSITIVE)),
                    ("bar_u_mm", request.bar_u_mm, Quantity::StandardLengthUncertainty.range()),
                ]
            }
            Self::Compensate(request) => {
                vec![("limit_mm", Some(request.limit_mm), Quantity::CorrectionLimit.range())]
            }
            Self::Circle(request) => vec![
                ("bar_u_mm", request.bar_u_mm, Quantity::StandardLengthUncertainty.range()),
                ("expansion_per_k", request.expansion_per_k, Quantity::Expansion.range()),
                ("certified_c", request.certified_c, Quantity::CertificateTemperature.range()),
                ("machine_expansion_per_k", request.machine_expansion_per_k, Quantity::Expansion.range()),
            ],
            Self::Plan(_) | Self::Certificate(_) => Vec::new(),
        };
        numbers
            .into_iter()
            .try_for_each(|(key, value, range)| value.map_or(Ok(()), |value| range.check(key, value)))
    }

    /// The directory into which the files are written.
    pub fn out(&self) -> &Path {
        match self {
            Self::Identify(request) => &request.out,
            Self::Plan(request) => &request.out,
            Self::Check(request) => &request.out,
            Self::Compensate(request) => &request.out,
            Self::Circle(request) => &request.out,
            Self::Certificate(request) => &request.out,
        }
    }
}

/// An answer in the process that makes it.
pub type Answer = AnswerOf<Diagnostic, AnswerDocument>;

/// The result document of each kind of request, which `--json` prints.
#[derive(Serialize)]
#[serde(untagged)]
pub enum AnswerDocument {
    Identify(Box<IdentifyDocument>),
    Plan(Box<PlanDocument>),
    Check(Box<CheckDocument>),
    Compensate(CompensateDocument),
    Circle(Box<CircleDocument>),
    Certificate(CertificateDocument),
}

impl AnswerDocument {
    /// The findings inside the document, which were not reported before.
    fn own_findings(&self) -> Vec<Diagnostic> {
        match self {
            Self::Identify(document) => document.calibration.diagnostics().collect(),
            Self::Plan(_) | Self::Check(_) | Self::Compensate(_) | Self::Circle(_) | Self::Certificate(_) => {
                Vec::new()
            }
        }
    }
}

impl Answer {
    /// The answer in the form for another process, without the end of its last line.
    pub fn to_json(&self) -> Result<String, Diagnostic> {
        Ok(serialised::json(self)?)
    }

    /// The answer to a request after which `findings` were reported.
    fn of(result: Result<RequestResult<AnswerDocument>, Diagnostic>, mut findings: Vec<Diagnostic>) -> Self {
        let mut result = match result {
            Ok(result) => result,
            Err(refusal) => return Self { findings, result: AnswerResult::Refusal(refusal) },
        };
        findings.extend(result.document.own_findings());
        let is_warning = |finding: &Diagnostic| finding.severity() == Severity::Warning;
        if result.outcome == AnswerOutcome::Done && findings.iter().any(is_warning) {
            result.outcome = AnswerOutcome::Warned;
        }
        Self { findings, result: AnswerResult::Result(result) }
    }
}

#[cfg(test)]
mod tests {
    use dbbd_model::estimation::EstimationFinding;

    use dbbd_model::diagnostic::FindingRecord;

    use super::*;

    fn result(outcome: AnswerOutcome) -> Result<RequestResult<AnswerDocument>, Diagnostic> {
        let files = vec!["dcc.xml".to_owned()];
        let document = AnswerDocument::Certificate(CertificateDocument { files: files.clone() });
        Ok(RequestResult { outcome, files, document })
    }

    fn read(answer: &Answer) -> AnswerRecord {
        serde_json::from_str(&serde_json::to_string(answer).unwrap()).unwrap()
    }

    #[test]
    fn a_warning_is_an_outcome() {
        let warning = || Diagnostic::file("run.dbbd", EstimationFinding::PartOfRunLost);
        for (computed, findings, wanted) in [
            (AnswerOutcome::Done, vec![], AnswerOutcome::Done),
            (AnswerOutcome::Done, vec![warning()], AnswerOutcome::Warned),
            (AnswerOutcome::Undecided, vec![], AnswerOutcome::Undecided),
            (AnswerOutcome::Failed, vec![warning()], AnswerOutcome::Failed),
        ] {
            let answer = read(&Answer::of(result(computed), findings.clone()));
            let AnswerResult::Result(RequestResult { outcome, files, document }) = answer.result else {
                panic!("refused")
            };
            assert_eq!(
                (outcome, files, &document["files"][0]),
                (wanted, vec!["dcc.xml".into()], &"dcc.xml".into())
            );
            assert_eq!(answer.findings, findings.iter().map(FindingRecord::from).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_refusal_is_read_back_with_its_code() {
        let refusal = Diagnostic::line("obs.csv", 3, EstimationFinding::NoRobot);
        let answer = read(&Answer::of(Err(refusal.clone()), Vec::new()));
        assert_eq!(answer.result, AnswerResult::Refusal(FindingRecord::from(&refusal)));
    }
}
