//! The CSV of a circular test: `run,direction,angle_deg,length_mm[,t_s,temp_c]`, columns in any order.

use super::{Point, Sense, Trace};
use crate::diag::Diagnostic;

const REQUIRED: [&str; 4] = ["run", "direction", "angle_deg", "length_mm"];

/// Reads the traces: one for each run and direction, in the order of their first rows.
///
/// # Errors
/// Names the line and column of what is missing, not a number, not finite, or impossible.
pub fn traces_from_csv(file: &str, text: &str) -> Result<Vec<Trace>, Diagnostic> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
    let header = reader.headers().map_err(|error| Diagnostic::csv(file, &error))?.clone();
    let place = |name: &str| header.iter().position(|column| column == name);
    let mut places = [0; REQUIRED.len()];
    for (to, name) in places.iter_mut().zip(REQUIRED) {
        *to = place(name).ok_or_else(|| {
            Diagnostic::line(file, 1, format!("the column `{name}` is missing"))
                .help("a circular test has the columns run,direction,angle_deg,length_mm[,t_s,temp_c]")
        })?;
    }
    let [run, direction, angle, length] = places;
    let (time, temperature) = (place("t_s"), place("temp_c"));
    let mut traces: Vec<Trace> = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|error| Diagnostic::csv(file, &error))?;
        let line = record.position().map_or(0, |position| position.line() as usize);
        let cell = |at: usize| record.get(at).unwrap_or("");
        let wrong = |at: usize, why: &str| {
            let name = header.get(at).unwrap_or("");
            Diagnostic::line(file, line, format!("column `{name}`: `{}`: {why}", cell(at)))
        };
        let number = |at: usize| match cell(at).parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            Ok(_) => Err(wrong(at, "is not a finite number")),
            Err(_) => Err(wrong(at, "is not a number")),
        };
        let optional = |at: Option<usize>| match at {
            Some(at) if !cell(at).is_empty() => number(at).map(Some),
            _ => Ok(None),
        };
        let sense = match cell(direction).to_ascii_lowercase().as_str() {
            "ccw" => Sense::CounterClockwise,
            "cw" => Sense::Clockwise,
            _ => return Err(wrong(direction, "must be cw or ccw")),
        };
        let length_mm = number(length)?;
        if length_mm <= 0.0 {
            return Err(wrong(length, "a length between ball centres is positive, in mm"));
        }
        let point = Point {
            angle_deg: number(angle)?,
            length_mm,
            sigma_mm: None,
            t_s: optional(time)?,
            temp_c: optional(temperature)?,
            axes_deg: None,
            drives: None,
        };
        // The last trace first: rows of one trace stand together.
        match traces.iter_mut().rev().find(|trace| trace.run == cell(run) && trace.sense == sense) {
            Some(trace) => trace.points.push(point),
            None => traces.push(Trace { run: cell(run).to_owned(), sense, points: vec![point] }),
        }
    }
    if traces.is_empty() {
        return Err(Diagnostic::file(file, "holds no length: only a header, or nothing"));
    }
    Ok(traces)
}
