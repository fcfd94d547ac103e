//! The lengths that an identification leaves out: those that the last result left out, or those that the page requests.

use dbbd_job::request::RowIndices;
use dbbd_job::request::identify::Exclusion;
use dbbd_model::base::text::is_control;
use dbbd_model::diagnostic::Diagnostic;
use serde_json::Value;

use super::files::{FoundRun, WorkFiles};
use crate::live::ExcludedRows;
use crate::live::ServiceFinding::RemarkLength;

/// Longest reason, characters.
const LONGEST_REASON: usize = 250;

/// The rows that the last result left out, unless `run`, which is identified next, is newer than the result.
pub(super) fn of_result(files: &WorkFiles, run: Option<&FoundRun>) -> Vec<Exclusion> {
    let is_current = |changed_ms: u64| run.is_none_or(|run| run.changed_ms <= changed_ms);
    let result = files.result.as_ref().filter(|result| is_current(result.directory.changed_ms));
    let listed = result.and_then(|result| result.content["excluded"].as_array());
    listed.into_iter().flatten().filter_map(excluded).collect()
}

/// A row as `result.json` lists it.
fn excluded(row: &Value) -> Option<Exclusion> {
    let index = row["index"].as_u64().and_then(|index| u32::try_from(index).ok())?;
    let text = |key: &str| row[key].as_str().map(str::to_owned);
    Some(Exclusion { rows: RowIndices::from_iter([index]), reason: text("reason"), by: text("by") })
}

/// The rows that the page requests to leave out, or without a request the rows that the last result left out. A row
/// that was left out before for the same reason keeps the name of who did it; the others get the name `user`.
pub(super) fn asked(
    files: &WorkFiles,
    run: &FoundRun,
    rows: Option<&[ExcludedRows]>,
    user: Option<&str>,
) -> Result<Vec<Exclusion>, Diagnostic> {
    let known = of_result(files, Some(run));
    let Some(rows) = rows else { return Ok(known) };
    let exclusion = |asked: &ExcludedRows| {
        let reason = asked.reason.as_deref().map(str::trim).filter(|reason| !reason.is_empty());
        let is_long = |text: &str| text.chars().count() > LONGEST_REASON || text.contains(is_control);
        if reason.is_some_and(is_long) {
            return Err(Diagnostic::new(RemarkLength { most: LONGEST_REASON }));
        }
        let rows = RowIndices::from_iter(asked.rows.iter().copied());
        let before = known.iter().find(|known| known.rows == rows && known.reason.as_deref() == reason);
        let by = before.map_or(user.map(str::to_owned), |before| before.by.clone());
        Ok(Exclusion { rows, reason: reason.map(str::to_owned), by })
    };
    rows.iter().map(exclusion).collect()
}

/// The `--exclude` options of the command line, each with a space before it.
pub(super) fn options(exclusions: &[Exclusion]) -> String {
    let option = |exclusion: &Exclusion| match &exclusion.reason {
        None => format!(" --exclude {}", exclusion.rows),
        Some(reason) => {
            format!(" --exclude '{}:{}'", exclusion.rows, reason.replace('\'', "'\\''"))
        }
    };
    exclusions.iter().map(option).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::files::{FoundDirectory, FoundDocument};
    use super::*;

    fn left_out() -> WorkFiles {
        let row = json!({ "index": 5, "ball": 1, "residual_mm": 0.1, "by": "A", "reason": "it's loose" });
        let result =
            FoundDocument { directory: FoundDirectory::default(), content: json!({ "excluded": [row] }) };
        WorkFiles { result: Some(result), ..WorkFiles::default() }
    }

    fn rows(index: u32, reason: &str) -> ExcludedRows {
        ExcludedRows { rows: vec![index], reason: Some(reason.into()) }
    }

    #[test]
    fn what_was_left_out_stays_and_keeps_its_author() {
        let (files, run) = (left_out(), FoundRun::default());
        assert_eq!(asked(&files, &run, None, Some("B")).unwrap(), of_result(&files, None));
        let both =
            asked(&files, &run, Some(&[rows(5, "it's loose"), rows(7, "a knock")]), Some("B")).unwrap();
        assert_eq!(both.iter().map(|one| one.by.as_deref()).collect::<Vec<_>>(), [Some("A"), Some("B")]);
        assert!(asked(&files, &run, Some(&[]), None).unwrap().is_empty());
        assert_eq!(options(&both), " --exclude '5:it'\\''s loose' --exclude '7:a knock'");
        let long = "x".repeat(LONGEST_REASON + 1);
        assert!(asked(&files, &run, Some(&[rows(1, &long)]), None).is_err());
        assert!(asked(&files, &run, Some(&[rows(1, "a\nb")]), None).is_err());
    }
}
