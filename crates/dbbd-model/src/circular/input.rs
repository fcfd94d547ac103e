//! The CSV of a circular test: `run,direction,angle_deg,length_mm[,t_s,temp_c]`, columns in any order.

use super::trace::{CirclePoint, CircleSense, CircleTrace};
use crate::base::table::{TableReader, TableRow};
use crate::circular::CircularFinding;
use crate::diagnostic::Diagnostic;
use crate::plausibility::Quantity;

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
    let length_mm = row.number(at)?;
    checked(row, at, length_mm, Quantity::BarLength).map_err(|why| {
        if length_mm > 0.0 { why } else { why.help("give lengths, not deviations from the radius") }
    })
}

fn checked(row: &TableRow<'_>, at: usize, value: f64, quantity: Quantity) -> Result<f64, Diagnostic> {
    quantity.check(row.column(at), value).map_or_else(|why| Err(row.line(why)), |()| Ok(value))
}

fn celsius(row: &TableRow<'_>, at: usize) -> Result<f64, Diagnostic> {
    checked(row, at, row.number(at)?, Quantity::SensorTemperature)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_become_a_trace_for_each_run_and_direction() {
        let text = "direction,run,length_mm,angle_deg,temp_c\nCCW,a,150.01,0,21\ncw,a,150.02,90,\nccw,a,150.03,10,22\n";
        let traces = traces_from_csv("t.csv", text).unwrap();
        assert_eq!(
            traces.iter().map(|trace| (trace.sense.word(), trace.points.len())).collect::<Vec<_>>(),
            [("ccw", 2), ("cw", 1)]
        );
        assert_eq!(traces[0].points[1].length_mm, 150.03);
        assert_eq!((traces[1].points[0].angle_deg, traces[1].points[0].temp_c), (90.0, None));
        for wrong in ["ccw,a,0,0,20", "ccw,a,10000.1,0,20", "ccw,a,150,0,150.1", "left,a,150,0,20"] {
            assert!(traces_from_csv("t.csv", &format!("{text}{wrong}\n")).is_err(), "{wrong}");
        }
        assert!(traces_from_csv("t.csv", &format!("{text}ccw,b,10000,0,150\n")).is_ok());
        assert!(traces_from_csv("t.csv", "direction,run,length_mm,angle_deg\n").is_err());
    }
}
