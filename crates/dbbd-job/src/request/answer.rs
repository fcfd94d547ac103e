//! The answer to a request.

use dbbd_model::diagnostic::FindingRecord;
use serde::{Deserialize, Serialize};

/// The answer to a request. `F` is a finding and `D` the result document. Where the answer is made, they have their own
/// types ([`super::Answer`]); a reader of the answer of another process has their values ([`AnswerRecord`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AnswerOf<F, D> {
    /// The findings about the inputs and the result, in the order in which they were found.
    pub findings: Vec<F>,
    /// The result, or the reason why there is none.
    #[serde(flatten)]
    pub result: AnswerResult<F, D>,
}

/// The result of a request, or its refusal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AnswerResult<F, D> {
    Result(RequestResult<D>),
    Refusal(F),
}

/// A result whose files are written.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RequestResult<D> {
    pub outcome: AnswerOutcome,
    /// The names of the files written to the directory of the request.
    pub files: Vec<String>,
    pub document: D,
}

/// An answer of another process.
pub type AnswerRecord = AnswerOf<FindingRecord, serde_json::Value>;

/// The outcome of a request that has a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AnswerOutcome {
    Done,
    /// The result has a loss or a warning that the user must see.
    Warned,
    /// The check cannot decide.
    Undecided,
    /// The check found that the robot fails or has changed.
    Failed,
}

impl AnswerOutcome {
    /// Whether the user must see a warning about the result.
    pub fn has_warnings(self) -> bool {
        matches!(self, Self::Warned | Self::Undecided)
    }
}

impl<D> RequestResult<D> {
    /// The same result with another form of its document.
    pub(super) fn map<E>(self, form: impl FnOnce(D) -> E) -> RequestResult<E> {
        RequestResult { outcome: self.outcome, files: self.files, document: form(self.document) }
    }
}
