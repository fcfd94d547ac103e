//! The pages of a plant.

use std::io::{Seek as _, Write as _};
use std::sync::Mutex;

use serde::Serialize;
use serde_json::{Value, json};

use super::drift::{CheckDue, ErrorTrend, Forecast, LineWeights, MIN_TREND_VALUES, day_of, day_text};
use super::plant::{HistorySubject, PAGE_ROWS, PageRows, PastResult, RobotState};
use super::query::{ArchivedRun, RunCursor, RunSelection};
use super::question::{Filter, Name, PlantNumbers, Question, RunFilter};
use super::{Archive, ArchiveAddresses, WrittenPosterior, is_away};
use crate::ArchiveFinding::{NoReport, NotACursor, NotADate};
use crate::archive::html::{PlantPage, SIGN_IN_JS, STYLE};
use dbbd_device::clock;
use dbbd_device::sync::lock;
use dbbd_job::page::{Download, PageFile};
use dbbd_job::report::plot::{TrendPlot, TrendPoint};
use dbbd_model::base::InternalFinding::NoSystem;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::math::distributions::coverage_95;

/// Results in a chart and a forecast.
const MAX_TREND_POINTS: u64 = 60;
/// Runs on the page of a robot or a bar.
const LAST_RUNS: u64 = 10;
const REPORT: &str = "report.html";
const FILES: [PageFile; 2] = [
    PageFile { path: "/style.css", kind: "text/css; charset=utf-8", content: STYLE },
    PageFile { path: "/sign-in.js", kind: "text/javascript; charset=utf-8", content: SIGN_IN_JS },
];

/// Requirements of the plant. Both numbers are positive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantOptions {
    /// Interval between the checks of a robot.
    pub interval_days: f64,
    /// Limit of a robot's mean position error, mm.
    pub limit_mm: Option<f64>,
}

/// The pages, with a pool of connections.
pub struct PlantPages {
    addresses: ArchiveAddresses,
    options: PlantOptions,
    idle: Mutex<Vec<Archive>>,
}

#[derive(Serialize)]
struct RunLine {
    #[serde(flatten)]
    run: ArchivedRun,
    /// State of the run's newest job.
    job: Option<String>,
}

#[derive(Serialize)]
struct RobotLine {
    #[serde(flatten)]
    state: RobotState,
    due: Option<CheckDue>,
    error_mm: Option<f64>,
}

struct ErrorHistory {
    points: Vec<TrendPoint>,
    trend: Option<ErrorTrend>,
}

impl PlantPages {
    pub fn open(addresses: ArchiveAddresses, options: PlantOptions) -> Result<Self, Diagnostic> {
        let first = Archive::open(&addresses)?;
        Ok(Self { addresses, options, idle: Mutex::new(vec![first]) })
    }

    /// Runs queries on an idle connection. A broken connection is replaced once.
    fn ask<T>(&self, question: impl Fn(&mut Archive) -> Result<T, Diagnostic>) -> Result<T, Diagnostic> {
        let idle = || lock(&self.idle);
        let kept = idle().pop();
        let used = kept.is_some();
        let mut archive = kept.map_or_else(|| Archive::open(&self.addresses), Ok)?;
        let mut answer = question(&mut archive);
        if used && answer.as_ref().is_err_and(is_away) {
            idle().clear();
            archive = Archive::open(&self.addresses)?;
            answer = question(&mut archive);
        }
        if !answer.as_ref().is_err_and(is_away) {
            idle().push(archive);
        }
        answer
    }

    fn history(
        &self,
        archive: &mut Archive,
        subject: HistorySubject<'_>,
    ) -> Result<ErrorHistory, Diagnostic> {
        let past = match subject {
            HistorySubject::Robot(_) => archive.history(subject, MAX_TREND_POINTS)?,
            HistorySubject::Bar(bar) => archive.life_of_bar(bar, MAX_TREND_POINTS)?,
        };
        let points: Vec<TrendPoint> = past.iter().filter_map(|past| point(past, subject)).collect();
        let (weights, limit_mm) = match subject {
            HistorySubject::Robot(_) => (LineWeights::Equal, self.options.limit_mm),
            HistorySubject::Bar(_) => (LineWeights::Uncertainties, None),
        };
        let trend = ErrorTrend::of(&points, weights, limit_mm);
        Ok(ErrorHistory { points, trend })
    }

    fn due(&self, robot: &RobotState, history: &ErrorHistory) -> Option<CheckDue> {
        let trend = history.trend.as_ref().zip(self.options.limit_mm);
        CheckDue::of(&robot.checked(), self.options.interval_days, trend, today())
    }

    fn robots(&self, archive: &mut Archive, filter: &Filter) -> Result<String, Diagnostic> {
        let PlantOptions { interval_days, limit_mm } = self.options;
        let totals = archive.totals(&day_text(today() - interval_days))?;
        let found = archive.robots(filter)?;
        let pager = pager("/", filter, &found);
        let mut robots = Vec::new();
        for state in found.rows {
            let history = self.history(archive, HistorySubject::Robot(&state.robot))?;
            let due = self.due(&state, &history);
            robots.push(RobotLine { state, due, error_mm: history.points.last().map(|point| point.value) });
        }
        PlantPage::Robots.html(&ListPage {
            pager,
            content: json!({
                "totals": totals, "filter": filter, "robots": robots, "interval_days": interval_days,
                "limit_mm": limit_mm,
            }),
        })
    }

    fn robot(&self, archive: &mut Archive, name: &str) -> Result<String, Diagnostic> {
        let state = archive.robot(name)?;
        let history = self.history(archive, HistorySubject::Robot(name))?;
        let due = self.due(&state, &history);
        let last =
            RunSelection { robot: Some(name.into()), limit: Some(LAST_RUNS), ..RunSelection::default() };
        let runs = run_lines(archive, &last)?;
        let limit_mm = self.options.limit_mm;
        let chart = history.chart("Mean position error of the nominal model", limit_mm);
        PlantPage::Robot.html(&json!({
            "robot": RobotLine { state, due, error_mm: None }, "runs": runs, "chart": chart, "least": MIN_TREND_VALUES,
            "trend": history.forecast(), "points": history.points.len(), "limit_mm": limit_mm,
        }))
    }

    fn bars(&self, archive: &mut Archive, filter: &Filter) -> Result<String, Diagnostic> {
        let found = archive.bars(filter)?;
        let pager = pager("/bars", filter, &found);
        let mut bars = Vec::new();
        for state in found.rows {
            let subject = HistorySubject::Bar(&state.bar);
            let newest = archive.history(subject, 1)?.iter().find_map(|past| point(past, subject));
            let mut line = json!(state);
            line["offset_mm"] = json!(newest.map(|newest| newest.value));
            bars.push(line);
        }
        PlantPage::Bars.html(&ListPage { pager, content: json!({ "filter": filter, "bars": bars }) })
    }

    fn bar(&self, archive: &mut Archive, name: &str) -> Result<String, Diagnostic> {
        let state = archive.bar(name)?;
        let history = self.history(archive, HistorySubject::Bar(name))?;
        let last = RunSelection { bar: Some(name.into()), limit: Some(LAST_RUNS), ..RunSelection::default() };
        let runs = run_lines(archive, &last)?;
        PlantPage::Bar.html(&json!({
            "bar": state, "runs": runs, "chart": history.chart("Offset of the bar", None), "least": MIN_TREND_VALUES,
            "trend": history.forecast(), "points": history.points.len(),
        }))
    }
}

impl ErrorHistory {
    fn chart(&self, title: &str, limit: Option<f64>) -> String {
        let line = self.trend.map(|trend| trend.line());
        TrendPlot::against_dates(title, &self.points, line, limit).to_svg()
    }

    fn forecast(&self) -> Option<Forecast> {
        self.trend.map(|trend| trend.forecast())
    }
}

/// The point of a result in the chart of its subject.
fn point(past: &PastResult, subject: HistorySubject<'_>) -> Option<TrendPoint> {
    let (value, u95) = match subject {
        HistorySubject::Robot(_) => (past.error_mm?, 0.0),
        HistorySubject::Bar(_) => {
            let [offset, sd] = WrittenPosterior::read(past.posterior.as_ref()?)?.bar_offset()?;
            (offset, coverage_95(None) * sd)
        }
    };
    let finite = value.is_finite() && u95.is_finite();
    finite.then_some(TrendPoint { time: past.day, value, u95, has_warnings: past.has_warnings })
}

/// Days since 1970-01-01.
fn today() -> f64 {
    (clock::unix_ns() / 1_000_000_000) as f64 / 86_400.0
}

/// The page of a list with the links to its other pages.
#[derive(Serialize)]
struct ListPage {
    #[serde(flatten)]
    pager: Value,
    #[serde(flatten)]
    content: Value,
}

fn pager<T>(path: &str, filter: &Filter, found: &PageRows<T>) -> Value {
    let (page, pages) = (u64::from(filter.page.max(1)), found.count.div_ceil(PAGE_ROWS).max(1));
    let link_to =
        |page: u64| link(path, &Filter { page: u32::try_from(page).unwrap_or(u32::MAX), ..filter.clone() });
    let before = (page > 1).then(|| link_to((page - 1).min(pages)));
    let next = (page < pages).then(|| link_to(page + 1));
    json!({ "page": page, "pages": pages, "found": found.count, "before": before, "next": next })
}

fn link(path: &str, filter: &impl Serialize) -> String {
    // Filters have plain fields, which this form can hold.
    format!("{path}?{}", serde_urlencoded::to_string(filter).unwrap_or_default())
}

fn run_lines(archive: &mut Archive, selection: &RunSelection) -> Result<Vec<RunLine>, Diagnostic> {
    let runs = archive.list(selection)?;
    let jobs = archive.jobs(&runs)?;
    let line = |run: ArchivedRun| {
        let job = jobs.iter().rfind(|job| job.run == run.sha256).map(|job| job.state.clone());
        RunLine { run, job }
    };
    Ok(runs.into_iter().map(line).collect())
}

fn runs(archive: &mut Archive, filter: &RunFilter) -> Result<String, Diagnostic> {
    let some = |text: &String| Some(text.trim().to_owned()).filter(|text| !text.is_empty());
    for date in [&filter.since, &filter.until].into_iter().filter_map(some) {
        if day_of(&date).is_none() {
            return Err(NotADate { text: date }.into());
        }
    }
    let after = |text: String| match text.split_once(' ') {
        Some((measured, sha256)) => Ok(RunCursor { measured: measured.into(), sha256: sha256.into() }),
        None => Err(Diagnostic::new(NotACursor { text })),
    };
    let selection = RunSelection {
        robot: some(&filter.robot),
        bar: some(&filter.bar),
        cell: some(&filter.cell),
        since: some(&filter.since),
        until: some(&filter.until),
        search: some(&filter.q),
        after: Some(&filter.after).filter(|text| !text.is_empty()).cloned().map(after).transpose()?,
        limit: Some(PAGE_ROWS),
        kind: None,
    };
    let found = run_lines(archive, &selection)?;
    let place = |after: String| link("/runs", &RunFilter { after, ..filter.clone() });
    let last = found.last().filter(|_| found.len() as u64 == PAGE_ROWS);
    let next = last.map(|last| place(format!("{} {}", last.run.measured, last.run.sha256)));
    let page = json!({ "filter": filter, "runs": found, "first": place(String::new()), "next": next });
    PlantPage::Runs.html(&page)
}

fn run(archive: &mut Archive, digits: &str) -> Result<String, Diagnostic> {
    let run = archive.run(digits)?;
    let files = archive.files(&run)?;
    let results = archive.results_of(&run)?;
    let jobs = archive.jobs(std::slice::from_ref(&run))?;
    let has_report = archive.result_object(&run.sha256, REPORT)?.is_some();
    let page =
        json!({ "run": run, "files": files, "results": results, "jobs": jobs, "has_report": has_report });
    PlantPage::Run.html(&page)
}

impl PlantPages {
    /// HTML of a page.
    pub fn page(&self, question: &Question) -> Result<String, Diagnostic> {
        self.ask(|archive| match question {
            Question::Robots(filter) => self.robots(archive, filter),
            Question::Robot(Name { name }) => self.robot(archive, name),
            Question::Bars(filter) => self.bars(archive, filter),
            Question::Bar(Name { name }) => self.bar(archive, name),
            Question::Runs(filter) => runs(archive, filter),
            Question::Run(digits) => run(archive, digits),
        })
    }

    /// HTML of the page for an error.
    pub fn refusal(&self, why: &Diagnostic) -> Result<String, Diagnostic> {
        PlantPage::Refusal.html(why)
    }

    /// HTML of the page that asks for the token.
    pub fn sign_in(&self) -> Result<String, Diagnostic> {
        PlantPage::SignIn.html(&())
    }

    pub fn files(&self) -> &'static [PageFile] {
        &FILES
    }

    /// The report of a run's newest result.
    pub fn report(&self, run: &str) -> Result<Download, Diagnostic> {
        self.ask(|archive| {
            let run = archive.run(run)?.sha256;
            let found = archive.result_file(&run, REPORT)?;
            let content = found.ok_or_else(|| Diagnostic::new(NoReport { run }))?;
            let system = |error: std::io::Error| NoSystem { why: error.to_string() };
            let mut file = tempfile::tempfile().map_err(system)?;
            file.write_all(&content).and_then(|()| file.rewind()).map_err(system)?;
            Ok(Download { file, name: REPORT.into(), bytes: content.len() as u64 })
        })
    }

    pub fn numbers(&self) -> Result<PlantNumbers, Diagnostic> {
        self.ask(|archive| {
            let ([runs, results], oldest_waiting_s) = archive.sizes()?;
            let (jobs, robots) = (archive.queue()?.named(), archive.totals("")?.decisions);
            Ok(PlantNumbers { runs, results, jobs, robots, oldest_waiting_s })
        })
    }
}
