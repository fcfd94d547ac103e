//! What all pages share: style, provenance, and the template engine.

use minijinja::value::Serde;
use minijinja::{Environment, UndefinedBehavior};
use serde::Serialize;

use super::scale::typeset;
use super::svg::plot_css;
use crate::identify::result::{Warning, WarningKind};

const PAGE_CSS: &str = include_str!("page.css");
/// Head, style and provenance, about what a page has of its own.
const PAGE_HTML: &str = include_str!("page.html");

/// A page could not be made: a fault of its template, not of the data.
#[derive(Debug, thiserror::Error)]
#[error("the page could not be laid out")]
pub struct ReportError(#[from] minijinja::Error);

/// Where a page's content comes from.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Provenance {
    /// Version of this program.
    pub dbbd_version: String,
    /// Name of the robot.
    pub robot: String,
    /// Hash of the plan, where there is one.
    pub plan_hash: Option<String>,
    /// When it was measured or made, as text; the caller's to know.
    pub date: Option<String>,
    /// The files that were read.
    pub sources: Vec<Source>,
}

/// A file that was read.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Source {
    /// What it is, such as `observations`.
    pub role: String,
    /// Its name.
    pub name: String,
    /// A hash of its content, where one is known.
    pub hash: Option<String>,
}

/// A line of a list of facts.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Fact {
    /// What, such as `Bar length`.
    pub label: String,
    /// How much, with unit.
    pub value: String,
}

impl Fact {
    /// A line of a list of facts.
    pub fn new(label: impl Into<String>, value: impl Into<String>) -> Self {
        Self { label: label.into(), value: value.into() }
    }
}

/// The texts of the warnings of one kind.
pub(super) fn texts(warnings: &[Warning], kind: WarningKind) -> Vec<&str> {
    warnings.iter().filter(|warning| warning.kind == kind).map(|warning| warning.text.as_str()).collect()
}

/// Fills a template that extends `page.html`; its name ends in `.html`, which turns escaping on.
pub(super) fn render(name: &str, template: &str, page: &impl Serialize) -> Result<String, ReportError> {
    #[derive(Serialize)]
    struct Context<'a, T> {
        style: String,
        page: &'a T,
    }
    let mut engine = Environment::new();
    engine.set_undefined_behavior(UndefinedBehavior::Strict);
    engine.add_filter("typeset", typeset);
    engine.add_template("page.html", PAGE_HTML)?;
    engine.add_template(name, template)?;
    let style = format!("{}{PAGE_CSS}", plot_css());
    Ok(engine.get_template(name)?.render(Serde(Context { style, page }))?)
}
