//! The queries behind the pages of a plant.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::Archive;
use super::drift::{LastCheck, day_of, day_text};
use super::query::{ArchivedRun, like};
use super::question::{Decided, Filter, Order};
use super::work::{ArchivedResult, IdentifySettings, QueueCounts};
use crate::ArchiveFinding::{NoSuchBar, NoSuchRobot};
use dbbd_model::conformity::ConformityOutcome;
use dbbd_model::diagnostic::Diagnostic;

/// Rows of a page.
pub(super) const PAGE_ROWS: u64 = 50;

/// A robot with its last run and its last check.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct RobotState {
    pub(super) robot: String,
    #[serde(rename = "type")]
    kind: String,
    last: String,
    check_run: Option<String>,
    checked: Option<String>,
    decision: Option<String>,
}

impl RobotState {
    pub(super) fn checked(&self) -> LastCheck<'_> {
        LastCheck {
            on: self.checked.as_deref(),
            failed: matches!(self.decision.as_deref(), Some("fail" | "changed")),
        }
    }
}

/// A bar with its last run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct BarState {
    pub(super) bar: String,
    certificate: Option<String>,
    certified_on: Option<String>,
    last: String,
    robot: String,
}

/// The rows of a page, and the number of rows on all pages.
pub(super) struct PageRows<T> {
    pub(super) rows: Vec<T>,
    pub(super) count: u64,
}

/// Counts of the robots of a plant.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct PlantTotals {
    pub(super) robots: u64,
    /// Number of robots by the decision of their last check; `none` without a check.
    pub(super) decisions: Vec<(&'static str, u64)>,
    /// Robots whose last check failed or is older than the interval.
    pub(super) overdue: u64,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum HistorySubject<'a> {
    Robot(&'a str),
    Bar(&'a str),
}

impl<'a> HistorySubject<'a> {
    /// The name (`$1`) and the query for the results with the settings `$2`.
    fn results(self) -> (&'a str, String) {
        let (column, name, posterior) = match self {
            Self::Robot(name) => ("robot", name, "NULL"),
            Self::Bar(name) => ("bar", name, "result.posterior"),
        };
        let sql = format!(
            "SELECT run.sha256, run.measured, result.has_warnings, result.error_nominal_mm, {posterior} \
             FROM run JOIN result ON result.run = run.sha256 AND result.settings = $2 WHERE run.{column} = $1"
        );
        (name, sql)
    }
}

/// A result in the history of a robot or a bar.
pub(super) struct PastResult {
    run: String,
    /// Days since 1970-01-01.
    pub(super) day: f64,
    pub(super) has_warnings: bool,
    pub(super) error_mm: Option<f64>,
    /// JSON of the posterior; for a bar only.
    pub(super) posterior: Option<String>,
}

type PastRow = (String, String, i64, Option<f64>, Option<String>);

impl PastResult {
    /// The result of a row; `None` for a run without a date.
    fn of_row((run, measured, has_warnings, error_mm, posterior): PastRow) -> Option<Self> {
        Some(Self { run, day: day_of(&measured)?, has_warnings: has_warnings != 0, error_mm, posterior })
    }

    /// Appends a result unless the last one is of the same run.
    fn append(self, history: &mut Vec<Self>) {
        if history.last().is_none_or(|last| last.run != self.run) {
            history.push(self);
        }
    }
}

/// A job of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunJob {
    #[serde(skip_serializing)]
    pub(super) run: String,
    pub settings: String,
    /// The requested version; empty for any.
    pub version: String,
    pub state: String,
    /// Why it failed.
    pub code: Option<String>,
    pub message: Option<String>,
}

impl Archive {
    pub(super) fn robots(&mut self, filter: &Filter) -> Result<PageRows<RobotState>, Diagnostic> {
        let decision = match filter.decision {
            Decided::Any => "1 = 1",
            Decided::Pass => "decision = 'pass'",
            Decided::Fail => "decision = 'fail'",
            Decided::Unchanged => "decision = 'unchanged'",
            Decided::Changed => "decision = 'changed'",
            Decided::Undecided => "decision = 'undecided'",
            Decided::None => "decision IS NULL",
        };
        let order = match filter.order {
            Order::Name => "robot",
            Order::Check => "coalesce(checked, ''), robot",
        };
        let from = format!(
            "SELECT *, count(*) OVER () AS count FROM robot_state \
             WHERE (lower(robot) LIKE $1 ESCAPE '\\' OR lower(type) LIKE $1 ESCAPE '\\') AND {decision} ORDER BY {order}"
        );
        self.paged(&from, filter)
    }

    pub(super) fn bars(&mut self, filter: &Filter) -> Result<PageRows<BarState>, Diagnostic> {
        let from = "SELECT *, count(*) OVER () AS count FROM bar_state \
            WHERE lower(bar) LIKE $1 ESCAPE '\\' OR lower(certificate) LIKE $1 ESCAPE '\\' ORDER BY bar";
        self.paged(from, filter)
    }

    fn paged<T: DeserializeOwned>(&mut self, sql: &str, filter: &Filter) -> Result<PageRows<T>, Diagnostic> {
        #[derive(Deserialize)]
        struct CountedRow<T> {
            #[serde(flatten)]
            row: T,
            count: u64,
        }
        let before = PAGE_ROWS * u64::from(filter.page.saturating_sub(1));
        let parameters = (like(&filter.q), PAGE_ROWS, before);
        let found: Vec<CountedRow<T>> =
            self.database.query(&format!("{sql} LIMIT $2 OFFSET $3"), parameters)?;
        let count = found.first().map_or(0, |row| row.count);
        Ok(PageRows { rows: found.into_iter().map(|found| found.row).collect(), count })
    }

    pub(super) fn robot(&mut self, robot: &str) -> Result<RobotState, Diagnostic> {
        let found = self.database.query("SELECT * FROM robot_state WHERE robot = $1", robot)?.pop();
        found.ok_or_else(|| NoSuchRobot { robot: robot.into() }.into())
    }

    pub(super) fn bar(&mut self, bar: &str) -> Result<BarState, Diagnostic> {
        let found = self.database.query("SELECT * FROM bar_state WHERE bar = $1", bar)?.pop();
        found.ok_or_else(|| NoSuchBar { bar: bar.into() }.into())
    }

    /// Counts the robots by decision, and those that failed or were checked before the date `cutoff`.
    pub(super) fn totals(&mut self, cutoff: &str) -> Result<PlantTotals, Diagnostic> {
        let sql = "SELECT coalesce(decision, 'none'), count(*), count(CASE WHEN checked < $1 OR decision IN ('fail', 'changed') THEN 1 END) \
            FROM robot_state GROUP BY coalesce(decision, 'none')";
        let mut totals = PlantTotals::default();
        let words = ConformityOutcome::ALL.map(ConformityOutcome::name);
        let mut counts: Vec<(&str, u64)> = words.into_iter().chain(["none"]).map(|word| (word, 0)).collect();
        for (word, count, overdue) in self.database.tuples::<(String, u64, u64)>(sql, cutoff)? {
            totals.robots += count;
            totals.overdue += overdue;
            // An unknown decision counts as none.
            let at = counts.iter().position(|(known, _)| *known == word).unwrap_or(words.len());
            counts[at].1 += count;
        }
        totals.decisions = counts;
        Ok(totals)
    }

    /// The newest results with the default settings, one per run, in the order of time. Runs without a date are left
    /// out.
    pub(super) fn history(
        &mut self,
        subject: HistorySubject<'_>,
        most: u64,
    ) -> Result<Vec<PastResult>, Diagnostic> {
        let (name, from) = subject.results();
        let sql = format!("{from} ORDER BY run.measured DESC, run.sha256, result.made_at DESC LIMIT $3");
        let rows: Vec<PastRow> = self.database.tuples(&sql, (name, IdentifySettings::DEFAULT, most))?;
        let mut found = Vec::new();
        // The first result of a run is the one of the newest version.
        rows.into_iter().filter_map(PastResult::of_row).for_each(|past| past.append(&mut found));
        found.reverse();
        Ok(found)
    }

    /// About `most` results of a bar, spread over its life: a bar of many robots has hundreds in a month.
    pub(super) fn life_of_bar(&mut self, bar: &str, most: u64) -> Result<Vec<PastResult>, Diagnostic> {
        let newest = self.history(HistorySubject::Bar(bar), most)?;
        let sql = "SELECT min(measured), max(measured) FROM run WHERE bar = $1 AND measured > ''";
        let ends: Option<(Option<String>, Option<String>)> = self.database.tuples(sql, bar)?.pop();
        let (first, last) = ends.unwrap_or_default();
        let [first, last] = [first, last].map(|end| end.and_then(|end| day_of(&end)));
        let (Some(first), Some(last), true) = (first, last, newest.len() as u64 == most) else {
            return Ok(newest);
        };
        let step = ((last - first) / most as f64).max(1.0);
        let (name, from) = HistorySubject::Bar(bar).results();
        let sql = format!("{from} AND run.measured >= $3 ORDER BY run.measured, run.sha256 LIMIT 1");
        let mut found = Vec::new();
        for part in 0..most {
            let since = day_text(first + step * part as f64);
            let next: Vec<PastRow> = self.database.tuples(&sql, (name, IdentifySettings::DEFAULT, since))?;
            next.into_iter().filter_map(PastResult::of_row).for_each(|past| past.append(&mut found));
        }
        found.extend(newest.into_iter().next_back());
        Ok(found)
    }

    /// The jobs of these runs, the newest last.
    pub fn jobs(&mut self, runs: &[ArchivedRun]) -> Result<Vec<RunJob>, Diagnostic> {
        if runs.is_empty() {
            return Ok(Vec::new());
        }
        let places: Vec<String> = (1..=runs.len()).map(|at| format!("${at}")).collect();
        let sql = format!(
            "SELECT run, settings, version, state, code, message FROM job WHERE run IN ({}) ORDER BY asked_at, settings",
            places.join(", ")
        );
        self.database.query(&sql, runs.iter().map(|run| &run.sha256).collect::<Vec<_>>())
    }

    /// All results of a run, the newest last.
    pub(super) fn results_of(&mut self, run: &ArchivedRun) -> Result<Vec<ArchivedResult>, Diagnostic> {
        self.results_where("run.sha256 = $1", &run.sha256)
    }

    /// The numbers of runs and results, and the age of the oldest waiting job, s.
    pub(super) fn sizes(&mut self) -> Result<([u64; 2], f64), Diagnostic> {
        let sql = "SELECT (SELECT count(*) FROM run), (SELECT count(*) FROM result), \
            (SELECT {now} - min(asked_at) FROM job WHERE state = 'waiting')";
        let sizes: Option<(u64, u64, Option<f64>)> = self.database.tuples(sql, ())?.pop();
        let (runs, results, age_ms) = sizes.unwrap_or_default();
        Ok(([runs, results], age_ms.map_or(0.0, |ms| 1e-3 * ms.max(0.0))))
    }
}

impl QueueCounts {
    /// The number of jobs in each state.
    pub(super) fn named(&self) -> Vec<(&'static str, u64)> {
        let Self { waiting, running, done, failed } = *self;
        vec![("waiting", waiting), ("running", running), ("done", done), ("failed", failed)]
    }
}
