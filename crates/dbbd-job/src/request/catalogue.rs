//! What is found of a request before its inputs are read.

use dbbd_model::findings;

findings! {
    /// A text that is no request.
    RequestFinding "Requests" {
        E0004 "a request is not valid",
        cause: "`dbbd request`, or `request` of the Python package, read something else than a request as JSON, or a request of another version of dbbd.",
        cure: "Let all processes be of one version; update them together. Correct the field that the message names." {
            NotARequest { why: String } => "is not a request: {why}";
        }
    }
}
