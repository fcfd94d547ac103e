//! What came out of a request.

use dbbd_model::diagnostic::FindingRecord;
use serde::{Deserialize, Serialize};

/// What came out of a request. `F` is a finding and `D` the result document: where the answer is made they have their types
/// ([`super::Answer`]); who reads the answer of another process has their values ([`AnswerRecord`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AnswerOf<F, D> {
    /// What was found of the inputs and of the result, in the order in which it was found.
    pub findings: Vec<F>,
    /// The result, or why there is none.
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

/// How a request ended that has a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AnswerOutcome {
    Done,
    /// With a loss or a warning that the user must see.
    Warned,
    /// A check cannot decide.
    Undecided,
    /// A check found that the robot fails or has changed.
    Failed,
}

impl AnswerOutcome {
    /// Whether the user must see a warning about the result.
    pub fn is_doubtful(self) -> bool {
        matches!(self, Self::Warned | Self::Undecided)
    }
}

impl<D> RequestResult<D> {
    /// The same result with another form of its document.
    pub(super) fn map<E>(self, form: impl FnOnce(D) -> E) -> RequestResult<E> {
        RequestResult { outcome: self.outcome, files: self.files, document: form(self.document) }
    }
}
