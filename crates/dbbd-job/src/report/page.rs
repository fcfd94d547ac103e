//! The frame of all pages: style, provenance, and the template engine with its filters.

use std::borrow::Cow;

use minijinja::value::Serde;
use minijinja::{Environment, UndefinedBehavior, escape_formatter};
use serde::Serialize;

use super::scale::{fixed, index, plain, rounded, signed, significant, typeset};
use super::svg::plot_css;
use dbbd_model::base::InternalFinding::NoPage;
use dbbd_model::base::serialised;
use dbbd_model::base::text::escape_controls;
use dbbd_model::diagnostic::{Diagnostic, Finding};
use dbbd_model::math::distributions::COVERAGE_95;

const PAGE_CSS: &str = include_str!("page.css");
/// The script of a report: its texts in the reader's language, and its scene.
pub const REPORT_JS: &str = concat!(include_str!("language.js"), include_str!("viewer.js"));
/// Title and cure of the codes that the workbench can show, in other languages; English texts come with the findings.
pub const CODES: &str = concat!("{\"de\":", include_str!("texts/codes.de.json"), "}");
/// The texts of the reports in other languages, by the English texts. A new language is a file and a line here.
const LANGUAGES: &str = concat!("{\"de\":", include_str!("texts/de.json"), "}");
/// The skeleton of every page, also of a service.
const FRAME_HTML: &str = include_str!("frame.html");
/// The skeleton of a report, with style and provenance.
const PAGE_HTML: &str = include_str!("page.html");
const MACROS: &str = include_str!("macros.html");

/// Name and text of a template.
pub type Template<'a> = (&'a str, &'a str);

/// Fills a template that extends `page.html`; its name ends in `.html`, which turns escaping on.
pub(super) fn render(name: &str, template: &str, page: &impl Serialize) -> Result<String, Diagnostic> {
    #[derive(Serialize)]
    struct Context<'a, T> {
        style: String,
        script: &'static str,
        texts: String,
        codes: String,
        version: &'static str,
        page: &'a T,
    }
    let style = format!("{}{PAGE_CSS}", plot_css());
    let version = crate::artefact::VERSION;
    let context = Context {
        style,
        script: REPORT_JS,
        texts: within_script(LANGUAGES),
        codes: within_script(CODES),
        version,
        page,
    };
    fill(&[&[("page.html", PAGE_HTML), ("macros.html", MACROS)], &[(name, template)][..]].concat(), &context)
        .map(|page| folded(&page))
}

/// Start of a part of a page that is folded: a heading with an anchor. Text of users is escaped, so it has none.
const PART: &str = "<h2 id=\"";

/// Folds the parts of a page after its contents; a link in the contents opens its part.
fn folded(page: &str) -> String {
    let end = page.rfind("</main>").unwrap_or(page.len());
    let (body, foot) = page.split_at(end);
    let mut pieces = body.split(PART);
    let head = pieces.next().unwrap_or_default();
    let parts: Vec<(&str, &str, &str)> = pieces
        .filter_map(|piece| {
            let (id, rest) = piece.split_once("\">")?;
            let (title, content) = rest.split_once("</h2>")?;
            Some((id, title, content))
        })
        .collect();
    // One part is no reason for contents.
    if parts.len() < 2 {
        return page.to_owned();
    }
    let links: String =
        parts.iter().map(|(id, title, _)| format!("<li><a href=\"#{id}\">{title}</a></li>\n")).collect();
    // A link to an anchor inside a closed part opens it.
    let part = |(id, title, content): &(&str, &str, &str)| {
        format!(
            "<details class=\"part\"><summary><h2>{title}</h2></summary>\n<div id=\"{id}\">{content}</div></details>\n"
        )
    };
    let details: String = parts.iter().map(part).collect();
    format!("{head}<nav class=\"contents\" aria-label=\"Contents\"><ul>\n{links}</ul></nav>\n{details}{foot}")
}

/// Fills the last of these templates, which may use the earlier ones and `frame.html`.
pub fn fill(templates: &[Template<'_>], context: &impl Serialize) -> Result<String, Diagnostic> {
    let name = templates.last().map_or("", |(name, _)| name);
    filled(name, templates, context).map_err(|error| {
        let why = error.detail().map_or_else(|| error.to_string(), str::to_owned);
        Diagnostic::new(NoPage { page: name.into(), why })
    })
}

fn filled(
    name: &str,
    templates: &[Template<'_>],
    context: &impl Serialize,
) -> Result<String, minijinja::Error> {
    let mut engine = Environment::new();
    engine.set_undefined_behavior(UndefinedBehavior::Strict);
    // Names and remarks must not change the direction of the text on a page.
    engine.set_formatter(|out, state, value| match value.as_str().map(escape_controls) {
        Some(Cow::Owned(text)) if !value.is_safe() => escape_formatter(out, state, &text.into()),
        _ => escape_formatter(out, state, value),
    });
    type Format = fn(f64, usize) -> String;
    let formats: [(&str, Format); 5] = [
        ("fixed", fixed),
        ("signed", signed),
        ("plain", plain),
        ("significant", significant),
        ("rounded", rounded),
    ];
    for (name, format) in formats {
        engine.add_filter(name, move |value: Option<f64>, digits: usize| {
            value.map_or_else(dash, |value| format(value, digits))
        });
    }
    engine.add_filter("index", |value: Option<f64>| value.map_or_else(dash, index));
    engine.add_filter("degrees", |value: Option<f64>| value.map(f64::to_degrees));
    engine.add_filter("times", |value: Option<f64>, factor: f64| value.map(|value| value * factor));
    engine.add_global("COVERAGE_95", COVERAGE_95);
    engine.add_filter("um", um);
    engine.add_filter("typeset", typeset);
    engine.add_filter("capitalise", |text: String| capitalised(&text));
    engine.add_filter("css", css);
    engine.add_template("frame.html", FRAME_HTML)?;
    for (name, template) in templates {
        engine.add_template(name, template)?;
    }
    engine.get_template(name)?.render(Serde(context))
}

/// The text for a value that does not exist.
fn dash() -> String {
    "–".into()
}

/// A length in mm as micrometres, with the decimals that its uncertainty needs.
fn um(value: Option<f64>, u95: Option<f64>) -> String {
    let decimals = match u95.map(|u| 1e3 * u) {
        Some(u) if u >= 10.0 => 0,
        Some(u) if u >= 1.0 => 1,
        Some(u) if u >= 0.1 => 2,
        _ => 3,
    };
    value.map_or_else(dash, |value| fixed(1e3 * value, decimals))
}

/// A value as JSON within a script element.
pub(super) fn script_json(value: &impl Serialize) -> Result<String, Diagnostic> {
    Ok(within_script(&serialised::json_line(value)?))
}

/// JSON escaped so that nothing closes the script element around it.
fn within_script(json: &str) -> String {
    json.replace('<', "\\u003c").replace('/', "\\/")
}

pub(super) fn capitalised(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// A text escaped for the quotes of a style sheet.
fn css(text: String) -> String {
    let escaped = |c: char| {
        if c.is_alphanumeric() || " .,:-".contains(c) {
            c.to_string()
        } else {
            format!("\\{:x} ", u32::from(c))
        }
    };
    text.chars().map(escaped).collect()
}

/// The findings of a result with code and text.
pub(super) fn findings<F: Finding + Clone>(findings: &[F]) -> Vec<Diagnostic> {
    findings.iter().cloned().map(Diagnostic::new).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_folded_after_their_contents() {
        let page = "<main><h1>T</h1><p>first</p><h2 id=\"a\">A</h2>1<h2 id=\"b\">B</h2>2</main></body>";
        let part = |id: &str, title: &str, content: &str| {
            format!(
                "<details class=\"part\"><summary><h2>{title}</h2></summary>\n<div id=\"{id}\">{content}</div></details>\n"
            )
        };
        let links = "<li><a href=\"#a\">A</a></li>\n<li><a href=\"#b\">B</a></li>\n";
        let contents = format!("<nav class=\"contents\" aria-label=\"Contents\"><ul>\n{links}</ul></nav>\n");
        let parts = part("a", "A", "1") + &part("b", "B", "2");
        assert_eq!(folded(page), format!("<main><h1>T</h1><p>first</p>{contents}{parts}</main></body>"));
        let single = "<main><h2 id=\"a\">A</h2>1</main>";
        assert_eq!(folded(single), single);
    }

    #[test]
    fn a_template_error_is_a_finding() {
        let wrong = render("wrong.html", "{{ page.no_such_field }}", &[0]);
        assert_eq!(wrong.unwrap_err().code().as_str(), "E0009");
    }
}
