//! Ten questions of a customer about a calibration. Each is answered by values of result.json, and by a line of the terminal
//! with the same numbers.

use std::fs;

use serde_json::Value;
use tempfile::tempdir;

use crate::cell::{dbbd, stderr};
use crate::support::spoken::assert_spoken;

/// A question with the paths of its values in result.json, and the beginning of the line that answers it.
struct Question {
    asks: &'static str,
    values: &'static [&'static str],
    line: &'static str,
}

const QUESTIONS: [Question; 10] = [
    Question {
        asks: "how accurate is it now?",
        values: &[
            "/predicted_position_uncertainty_mm/nominal/mean",
            "/predicted_position_uncertainty_mm/identified/mean",
            "/budget/expanded_mm",
        ],
        line: "Mean error of the tool ball",
    },
    Question {
        asks: "what did it cost?",
        values: &["/measurements", "/effort/poses", "/effort/minutes"],
        line: "measured: ",
    },
    // How many have each status; the names with their standard deviations are in the report.
    Question { asks: "which parameters can I trust?", values: &[], line: "" },
    // The corrections of the zeros, which the file has in rad.
    Question { asks: "what do I enter?", values: &[], line: "zero errors for the controller: " },
    Question {
        asks: "may I use a heavy load?",
        values: &["/validity/rated_payload/kg", "/validity/rated_payload/expanded_uncertainty_mm"],
        line: "with the usual payload of such an arm",
    },
    Question {
        asks: "how long is it valid?",
        values: &["/validity/expanded_uncertainty_mm", "/validity/limit_mm"],
        line: "identified for the tool at ",
    },
    Question {
        asks: "where is it bad?",
        values: &[
            "/max_uncertainty/position_mm/0",
            "/max_uncertainty/position_mm/1",
            "/max_uncertainty/position_mm/2",
            "/max_uncertainty/expanded_uncertainty_mm",
        ],
        line: "largest uncertainty at ",
    },
    // Bar: its length, temperature and noise; the rest is the robot and its model.
    Question { asks: "is it the bar or the robot?", values: &["/budget/combined_mm"], line: "limited by " },
    Question {
        asks: "what would an hour more buy?",
        values: &["/effort/hour_more/measurements", "/effort/hour_more/expanded_uncertainty_mm"],
        line: "an hour more of the same poses",
    },
    Question { asks: "what limits it?", values: &["/budget/combined_mm"], line: "limited by " },
];

/// The numbers of a line. A full stop, bracket or sign beside one is not part of it.
fn numbers(line: &str) -> Vec<f64> {
    let words = line.split([' ', ',', ';', '(', ')']).map(|word| word.trim_end_matches('.'));
    words.filter_map(|word| word.replace('−', "-").parse().ok()).collect()
}

/// Whether a line has this value with two significant digits or more; a count as it is.
fn states(line: &str, value: f64) -> bool {
    let off = if value.fract() == 0.0 { 0.0 } else { 0.051 * value.abs() };
    numbers(line).iter().any(|number| (number - value).abs() <= off)
}

#[test]
fn each_is_answered_by_the_result_and_by_a_line_of_text() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let demo = dbbd(at, &["demo", "--circles", "--out", "demo"]);
    assert_eq!(demo.status.code(), Some(0), "{}", stderr(&demo));
    let done = dbbd(
        at,
        &["identify", "demo/run.dbbd", "--prior", "datasheet", "--tolerance", "3", "--out", "o", "--verbose"],
    );
    assert_eq!(done.status.code(), Some(0), "{}", stderr(&done));
    let stdout = String::from_utf8_lossy(&done.stdout).into_owned();
    let text = stdout.clone() + &stderr(&done);
    let result: Value = serde_json::from_str(&fs::read_to_string(at.join("o/result.json")).unwrap()).unwrap();
    let number = |path: &str| {
        let value = result.pointer(path).and_then(Value::as_f64);
        value.unwrap_or_else(|| panic!("result.json has no number {path}"))
    };
    let line = |begins: &str| {
        text.lines()
            .find(|line| line.trim_start().starts_with(begins))
            .unwrap_or_else(|| panic!("{begins}: {text}"))
    };
    for Question { asks, values, line: begins } in
        QUESTIONS.iter().filter(|question| !question.line.is_empty())
    {
        let said = line(begins);
        for path in *values {
            assert!(states(said, number(path)), "{asks} {path} is {}, but: {said}", number(path));
        }
    }

    // Which parameters: the numbers of each status.
    let parameters = result["parameters"].as_array().unwrap();
    let count = |status: &str| parameters.iter().filter(|one| one["status"] == status).count();
    let counts =
        format!("{} identified, {} with the prior's help", count("identified"), count("supported_by_prior"));
    line(&counts);

    // What to enter: the correction of each zero that is known, of a robot whose joints have the controller's sense or
    // the other.
    let entered = line("zero errors for the controller: ");
    let zero = |axis: usize| parameters.iter().find(|one| one["name"] == format!("theta{axis}")).unwrap();
    let is_known = |one: &Value| one["status"] == "identified" || one["status"] == "supported_by_prior";
    let mut known = 0;
    for one in (1..=6).map(zero).filter(|one| is_known(one)) {
        known += 1;
        let deg = one["correction"].as_f64().unwrap().to_degrees().abs();
        assert!(numbers(entered).iter().any(|said| (said.abs() - deg).abs() < 6e-5), "{deg}: {entered}");
    }
    assert!(known >= 3 && entered.contains("dbbd export"), "{entered}");

    // How long: the day is in the first line.
    let until = result["validity"]["until"].as_str().unwrap();
    assert!(stdout.lines().next().unwrap().ends_with(&format!("valid until {until}.")), "{stdout}");

    // Bar or robot: the roots of the sums of squares, and the largest contribution by its name.
    let limit = line("limited by ");
    let lines = result["budget"]["lines"].as_array().unwrap();
    let mm = |line: &&Value| line["position_mm"].as_f64().unwrap_or(0.0);
    let is_of_bar =
        |line: &&Value| ["bar", "temperature", "noise"].iter().any(|name| line["source"] == *name);
    let (bar, robot): (Vec<&Value>, Vec<&Value>) = lines.iter().partition(is_of_bar);
    for part in [bar, robot] {
        assert!(states(limit, part.iter().map(mm).fold(0.0, f64::hypot)), "{limit}");
    }
    let largest = lines.iter().max_by(|one, other| mm(one).total_cmp(&mm(other))).unwrap();
    assert!(states(limit, mm(&largest)), "{limit}");

    // The report begins with the line of the terminal.
    let report = fs::read_to_string(at.join("o/report.html")).unwrap();
    let first = stdout.lines().next().unwrap();
    let verdict = report.split_once("data-verdict=").unwrap().1;
    let said = verdict.split_once("</strong>").unwrap().1.split_once("</p>").unwrap().0.trim();
    assert_eq!(said, first);
    for next in stdout.lines().filter_map(|line| line.strip_prefix("next: ")) {
        assert!(verdict.contains(next), "{next}");
    }
    assert_spoken(&report);
}
