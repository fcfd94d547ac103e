//! Shows the answer to a request, and determines how the command ends.

use super::{CommandOutcome, CommandOutput, certificate, check, circle, compensate, identify, plan};
use dbbd_job::request::{Answer, AnswerDocument, AnswerOutcome, AnswerResult, Request, RequestResult};
use dbbd_model::diagnostic::Diagnostic;

/// Computes a request and shows its answer.
pub(super) fn run(request: &Request, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    show(request, request.answer(out), out)
}

/// Shows an answer. Its findings were reported while it was computed, but for those of the result document.
pub(super) fn show(
    request: &Request,
    answer: Answer,
    out: &CommandOutput,
) -> Result<CommandOutcome, Diagnostic> {
    let RequestResult { outcome, document, .. } = match answer.result {
        AnswerResult::Result(result) => result,
        AnswerResult::Refusal(refusal) => return Err(refusal),
    };
    // The document of an identification has its findings itself: it is printed before they are reported.
    out.document(&document)?;
    let directory = request.out();
    match &document {
        AnswerDocument::Identify(document) => identify::show(out, document, directory),
        AnswerDocument::Plan(document) => plan::show(out, document, directory),
        AnswerDocument::Check(document) => check::show(out, document, directory),
        AnswerDocument::Compensate(document) => compensate::show(out, document, directory),
        AnswerDocument::Circle(document) => circle::show(out, document, directory),
        AnswerDocument::Certificate(document) => certificate::show(out, document, directory),
    }
    Ok(outcome.into())
}

impl From<AnswerOutcome> for CommandOutcome {
    fn from(outcome: AnswerOutcome) -> Self {
        match outcome {
            AnswerOutcome::Done => Self::Done,
            AnswerOutcome::Warned | AnswerOutcome::Undecided => Self::Warned,
            AnswerOutcome::Failed => Self::Failed,
        }
    }
}
