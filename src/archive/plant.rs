//! What the pages of a plant ask of the database.

use serde::Serialize;

use super::Archive;
use super::database::{Row, Value};
use super::drift::{Checked, day_of, day_text};
use super::query::{ArchivedRun, like};
use super::work::{ArchivedResult, Queue, Settings};
use crate::catalogue::ArchiveFinding::{NoSuchBar, NoSuchRobot};
use crate::diagnostic::Diagnostic;
use crate::live::{Decided, Filter, Order};

/// Rows of a page.
pub(super) const PAGE_ROWS: u64 = 50;

/// A robot: its last run and its last check.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct RobotState {
    pub(super) robot: String,
    #[serde(rename = "type")]
    kind: String,
    last: String,
    check_run: Option<String>,
    checked: Option<String>,
    decision: Option<String>,
}

const ROBOT: &str = "robot, type, last, check_run, checked, decision";

impl RobotState {
    fn of_row(row: &Row) -> Result<Self, Diagnostic> {
        Ok(Self {
            robot: row.text(0)?,
            kind: row.text(1)?,
            last: row.text(2)?,
            check_run: row.some_text(3)?,
            checked: row.some_text(4)?,
            decision: row.some_text(5)?,
        })
    }

    pub(super) fn checked(&self) -> Checked<'_> {
        Checked { on: self.checked.as_deref(), failed: self.decision.as_deref() == Some("fail") }
    }
}

/// A bar: its last run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct BarState {
    pub(super) bar: String,
    certificate: Option<String>,
    certified_on: Option<String>,
    last: String,
    robot: String,
}

const BAR: &str = "bar, certificate, certified_on, last, robot";

impl BarState {
    fn of_row(row: &Row) -> Result<Self, Diagnostic> {
        Ok(Self {
            bar: row.text(0)?,
            certificate: row.some_text(1)?,
            certified_on: row.some_text(2)?,
            last: row.text(3)?,
            robot: row.text(4)?,
        })
    }
}

/// Rows of a page, and how many there are on all pages.
pub(super) struct Found<T> {
    pub(super) rows: Vec<T>,
    pub(super) count: u64,
}

/// The robots of the plant in numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Totals {
    pub(super) robots: u64,
    /// By the decision of the last check; `none` of those without one.
    pub(super) decisions: Vec<(&'static str, u64)>,
    /// Those whose last check failed, or is older than the interval.
    pub(super) overdue: u64,
}

/// Whose results.
#[derive(Clone, Copy, Debug)]
pub(super) enum Subject<'a> {
    Robot(&'a str),
    Bar(&'a str),
}

impl<'a> Subject<'a> {
    /// Its name, `$1`, and the statement of its results of the settings `$2`.
    fn results(self) -> (&'a str, String) {
        let (column, name, posterior) = match self {
            Self::Robot(name) => ("robot", name, "NULL"),
            Self::Bar(name) => ("bar", name, "result.posterior"),
        };
        let sql = format!(
            "SELECT run.sha256, run.measured, result.doubtful, result.error_nominal_mm, {posterior} \
             FROM run JOIN result ON result.run = run.sha256 AND result.settings = $2 WHERE run.{column} = $1"
        );
        (name, sql)
    }
}

/// A result in the history of a robot or a bar.
pub(super) struct Past {
    run: String,
    /// Days since 1970-01-01.
    pub(super) day: f64,
    pub(super) doubtful: bool,
    pub(super) error_mm: Option<f64>,
    /// Of a bar alone.
    pub(super) posterior: Option<String>,
}

impl Past {
    /// `None` of a run without a date.
    fn of_row(row: &Row) -> Result<Option<Self>, Diagnostic> {
        let Some(day) = day_of(&row.text(1)?) else { return Ok(None) };
        let (run, doubtful, error_mm) = (row.text(0)?, row.int(2)? != 0, row.some_real(3)?);
        Ok(Some(Self { run, day, doubtful, error_mm, posterior: row.some_text(4)? }))
    }
}

/// A job of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunJob {
    #[serde(skip)]
    pub(super) run: String,
    pub settings: String,
    /// The version that was asked for; empty for any.
    pub version: String,
    pub state: String,
    /// Why it failed.
    pub code: Option<String>,
    pub message: Option<String>,
}

impl Archive {
    /// The robots of a page.
    pub(super) fn robots(&mut self, filter: &Filter) -> Result<Found<RobotState>, Diagnostic> {
        let decision = match filter.decision {
            Decided::Any => "1 = 1",
            Decided::Pass => "decision = 'pass'",
            Decided::Fail => "decision = 'fail'",
            Decided::Undecided => "decision = 'undecided'",
            Decided::None => "decision IS NULL",
        };
        let order = match filter.order {
            Order::Name => "robot",
            Order::Check => "coalesce(checked, ''), robot",
        };
        let from = format!(
            "SELECT {ROBOT}, count(*) OVER () FROM robot_state \
             WHERE (lower(robot) LIKE $1 ESCAPE '\\' OR lower(type) LIKE $1 ESCAPE '\\') AND {decision} ORDER BY {order}"
        );
        self.paged(&from, filter, 6, RobotState::of_row)
    }

    /// The bars of a page.
    pub(super) fn bars(&mut self, filter: &Filter) -> Result<Found<BarState>, Diagnostic> {
        let from = format!(
            "SELECT {BAR}, count(*) OVER () FROM bar_state \
             WHERE lower(bar) LIKE $1 ESCAPE '\\' OR lower(certificate) LIKE $1 ESCAPE '\\' ORDER BY bar"
        );
        self.paged(&from, filter, 5, BarState::of_row)
    }

    fn paged<T>(
        &mut self,
        sql: &str,
        filter: &Filter,
        count: usize,
        read: impl Fn(&Row) -> Result<T, Diagnostic>,
    ) -> Result<Found<T>, Diagnostic> {
        let before = PAGE_ROWS * u64::from(filter.page.saturating_sub(1));
        let values = [like(&filter.q), PAGE_ROWS.into(), before.into()];
        let rows = self.database.query(&format!("{sql} LIMIT $2 OFFSET $3"), &values)?;
        let count = rows.first().map_or(Ok(0), |row| row.count(count))?;
        Ok(Found { rows: rows.iter().map(read).collect::<Result<_, _>>()?, count })
    }

    pub(super) fn robot(&mut self, robot: &str) -> Result<RobotState, Diagnostic> {
        let sql = format!("SELECT {ROBOT} FROM robot_state WHERE robot = $1");
        let rows = self.database.query(&sql, &[robot.into()])?;
        let row = rows.first().ok_or_else(|| Diagnostic::new(NoSuchRobot { robot: robot.into() }))?;
        RobotState::of_row(row)
    }

    pub(super) fn bar(&mut self, bar: &str) -> Result<BarState, Diagnostic> {
        let sql = format!("SELECT {BAR} FROM bar_state WHERE bar = $1");
        let rows = self.database.query(&sql, &[bar.into()])?;
        let row = rows.first().ok_or_else(|| Diagnostic::new(NoSuchBar { bar: bar.into() }))?;
        BarState::of_row(row)
    }

    /// How many robots there are by decision, and how many were checked before this date alone or failed.
    pub(super) fn totals(&mut self, cutoff: &str) -> Result<Totals, Diagnostic> {
        let sql = "SELECT coalesce(decision, 'none'), count(*), count(CASE WHEN checked < $1 OR decision = 'fail' THEN 1 END) \
            FROM robot_state GROUP BY coalesce(decision, 'none')";
        let mut totals = Totals::default();
        let mut counts = [("pass", 0), ("fail", 0), ("undecided", 0), ("none", 0)];
        for row in self.database.query(sql, &[cutoff.into()])? {
            let (word, count) = (row.text(0)?, row.count(1)?);
            totals.robots += count;
            totals.overdue += row.count(2)?;
            // What no version writes was not decided.
            let at = counts.iter().position(|(known, _)| *known == word).unwrap_or(3);
            counts[at].1 += count;
        }
        totals.decisions = counts.to_vec();
        Ok(totals)
    }

    /// The newest results of the usual settings, one of each run, in the order of time; those of runs without a date are
    /// left out.
    pub(super) fn history(&mut self, subject: Subject<'_>, most: u64) -> Result<Vec<Past>, Diagnostic> {
        let (name, from) = subject.results();
        let sql = format!("{from} ORDER BY run.measured DESC, run.sha256, result.made_at DESC LIMIT $3");
        let rows = self.database.query(&sql, &[name.into(), Settings::USUAL.into(), most.into()])?;
        let mut found: Vec<Past> = Vec::new();
        for past in rows.iter().map(Past::of_row) {
            // Of a run the newest version's result comes first.
            found.extend(past?.filter(|past| found.last().is_none_or(|last| last.run != past.run)));
        }
        found.reverse();
        Ok(found)
    }

    /// About so many results of a bar, spread over its life: a bar of many robots has hundreds in a month.
    pub(super) fn life_of_bar(&mut self, bar: &str, most: u64) -> Result<Vec<Past>, Diagnostic> {
        let newest = self.history(Subject::Bar(bar), most)?;
        let sql = "SELECT min(measured), max(measured) FROM run WHERE bar = $1 AND measured > ''";
        let ends = self.database.query(sql, &[bar.into()])?;
        let end = |column| ends.first().map(|row| row.some_text(column)).transpose();
        let [first, last] = [end(0)?, end(1)?].map(|end| end.flatten().and_then(|end| day_of(&end)));
        let (Some(first), Some(last), true) = (first, last, newest.len() as u64 == most) else {
            return Ok(newest);
        };
        let step = ((last - first) / most as f64).max(1.0);
        let (name, from) = Subject::Bar(bar).results();
        let sql = format!("{from} AND run.measured >= $3 ORDER BY run.measured, run.sha256 LIMIT 1");
        let mut found: Vec<Past> = Vec::new();
        for part in 0..most {
            let since = day_text(first + step * part as f64);
            let values = [name.into(), Settings::USUAL.into(), (&since).into()];
            let next = self.database.query(&sql, &values)?.first().map(Past::of_row).transpose()?.flatten();
            found.extend(next.filter(|past| found.last().is_none_or(|last| last.run != past.run)));
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
        let values: Vec<Value> = runs.iter().map(|run| Value::from(&run.sha256)).collect();
        let read = |row: &Row| {
            let [run, settings, version, state] = [0, 1, 2, 3].map(|at| row.text(at));
            let (code, message) = (row.some_text(4)?, row.some_text(5)?);
            Ok(RunJob { run: run?, settings: settings?, version: version?, state: state?, code, message })
        };
        self.database.query(&sql, &values)?.iter().map(read).collect()
    }

    /// All results of a run, the newest last.
    pub(super) fn results_of(&mut self, run: &ArchivedRun) -> Result<Vec<ArchivedResult>, Diagnostic> {
        self.results_where("run.sha256 = $1", &[(&run.sha256).into()])
    }

    /// How many runs and results there are, and the age of the job that waits the longest, s.
    pub(super) fn sizes(&mut self) -> Result<([u64; 2], f64), Diagnostic> {
        let sql = "SELECT (SELECT count(*) FROM run), (SELECT count(*) FROM result), \
            (SELECT {now} - min(asked_at) FROM job WHERE state = 'waiting')";
        let rows = self.database.query(sql, &[])?;
        let Some(row) = rows.first() else { return Ok(([0; 2], 0.0)) };
        let age_s = row.some_real(2)?.map_or(0.0, |ms| 1e-3 * ms.max(0.0));
        Ok(([row.count(0)?, row.count(1)?], age_s))
    }
}

impl Queue {
    /// The counts with their names.
    pub(super) fn named(&self) -> Vec<(&'static str, u64)> {
        let Self { waiting, running, done, failed } = *self;
        vec![("waiting", waiting), ("running", running), ("done", done), ("failed", failed)]
    }
}
