//! Pages and exports.

use super::findings;

findings! {
    /// A result that cannot be written in the form that was asked for.
    ReportFinding {
        E1701 "a page cannot be made",
        cause: "The template of the page does not fit the result: a fault of dbbd, not of the data. The other files are complete.",
        cure: "Report it with the version of dbbd and the input." {
            NoPage { page: String, why: String } => "the page {page} cannot be made: {why}";
        }
        E1702 "a record of a capture cannot be exported",
        cause: "A record holds no JSON where it must: the capture is of another version of dbbd, or was edited.",
        cure: "`dbbd recover` writes a capture without its damaged records; export that one." {
            NotJson { record: String, why: String } => "a {record} record is not JSON: {why}";
        }
    }
}
