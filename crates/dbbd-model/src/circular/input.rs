//! The CSV of a circular test: `run,direction,angle_deg,length_mm[,t_s,temp_c]`, columns in any order.

use super::{CirclePoint, CircleSense, CircleTrace};
use crate::base::table::{TableReader, TableRow};
use crate::circular::CircularFinding;
use crate::diagnostic::Diagnostic;

/// Larger numbers are in other units.
const LONGEST_MM: f64 = 10_000.0;
const HOTTEST_C: f64 = 150.0;

const REQUIRED: [&str; 4] = ["run", "direction", "angle_deg", "length_mm"];

/// As [`traces_from_table`].
pub fn traces_from_csv(file: &str, text: &str) -> Result<Vec<CircleTrace>, Diagnostic> {
    traces_from_table(&mut TableReader::of(file, text)?)
}

/// Reads one trace per run and direction, in the order of their first rows.
pub fn traces_from_table(table: &mut TableReader<'_>) -> Result<Vec<CircleTrace>, Diagnostic> {
    let [run, direction, angle, length] = table.required(REQUIRED).map_err(|absent| {
        absent.help("a circular test has the columns run,direction,angle_deg,length_mm[,t_s,temp_c]")
    })?;
    let (time, temperature) = (table.optional("t_s")?, table.optional("temp_c")?);
    let mut traces: Vec<CircleTrace> = Vec::new();
    while let Some(row) = table.row()? {
        let sense = match row.text(direction).to_ascii_lowercase().as_str() {
            "ccw" => CircleSense::CounterClockwise,
            "cw" => CircleSense::Clockwise,
            _ => return Err(row.line(CircularFinding::Direction { cell: row.text(direction).into() })),
        };
        let point = CirclePoint {
            angle_deg: row.number(angle)?,
            length_mm: millimetres(&row, length)?,
            sigma_mm: None,
            t_s: row.given(time, |at| row.number(at))?,
            temp_c: row.given(temperature, |at| celsius(&row, at))?,
            axes_deg: None,
            drives: None,
        };
        // Search from the last trace: the rows of a trace follow each other.
        match traces.iter_mut().rev().find(|trace| trace.run == row.text(run) && trace.sense == sense) {
            Some(trace) => trace.points.push(point),
            None => traces.push(CircleTrace { run: row.text(run).to_owned(), sense, points: vec![point] }),
        }
    }
    if traces.is_empty() {
        return Err(Diagnostic::file(table.file(), CircularFinding::NoLength));
    }
    Ok(traces)
}

fn millimetres(row: &TableRow<'_>, at: usize) -> Result<f64, Diagnostic> {
    match row.number(at)? {
        length_mm if length_mm <= 0.0 => Err(row.line(CircularFinding::NoLengthOfBar { length_mm })),
        length_mm if length_mm > LONGEST_MM => Err(row.line(CircularFinding::LengthTooLong { length_mm })),
        mm => Ok(mm),
    }
}

fn celsius(row: &TableRow<'_>, at: usize) -> Result<f64, Diagnostic> {
    match row.number(at)? {
        temp_c if temp_c > HOTTEST_C => Err(row.line(CircularFinding::TooHot { temp_c })),
        celsius => Ok(celsius),
    }
}
