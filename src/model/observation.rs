//! Lengths with the axis angles they were read at: the observations CSV.

use std::fmt::Write;
use std::iter;

use super::{AXES, Further};
use crate::diag::Diagnostic;
use crate::table::{self, Columns};

/// One length at one pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// The user's number for it; the plan's, where there is a plan.
    pub index: u32,
    /// The number of its further cells in [`Observations::further`]; 0 where it has none.
    pub further: u32,
    /// Number of the base ball, from 1.
    pub centre: usize,
    /// Number of the bar that read it, from 1.
    pub bar: usize,
    /// The controller's axis angles, degrees.
    pub axes_deg: [f64; AXES],
    /// Distance between the ball centres (bar length plus reading; longer is positive), mm.
    pub length_mm: f64,
    /// Standard deviation of the length, mm, where it is known.
    pub sigma_mm: Option<f64>,
}

impl Observation {
    /// The axis angles in rad.
    pub fn axes(&self) -> [f64; AXES] {
        self.axes_deg.map(f64::to_radians)
    }

    /// Its line of the CSV.
    fn append(&self, bars: bool, further: &Further, text: &mut String) {
        // Writing to a string does not fail.
        let _ = write!(text, "{},{}", self.index, self.centre);
        for angle in self.axes_deg {
            let _ = write!(text, ",{angle}");
        }
        let _ = write!(text, ",{},", self.length_mm);
        if let Some(sigma) = self.sigma_mm {
            let _ = write!(text, "{sigma}");
        }
        if bars {
            let _ = write!(text, ",{}", self.bar);
        }
        text.push_str(further.line(self.further));
        text.push('\n');
    }
}

/// A set of observations with the names of its further columns.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observations {
    /// The rows.
    pub rows: Vec<Observation>,
    /// The further columns.
    pub further: Further,
}

/// The columns that a row must have, in the order in which they are written.
const REQUIRED: [&str; 9] =
    ["index", "centre", "a1_deg", "a2_deg", "a3_deg", "a4_deg", "a5_deg", "a6_deg", "length_mm"];
const SIGMA: &str = "sigma_mm";
const BAR: &str = "bar";

/// Rows of a piece of CSV.
const PIECE: usize = 4096;

impl Observations {
    /// Reads the CSV `index,centre,a1_deg,..,a6_deg,length_mm[,sigma_mm][,bar][,..]`; columns in any order,
    /// an absent bar is bar 1.
    ///
    /// # Errors
    /// Names the line and column of what is missing, not a number, not finite, or impossible.
    pub fn from_csv(file: &str, text: &str) -> Result<Self, Diagnostic> {
        let mut reader = table::reader().from_reader(text.as_bytes());
        let header = reader.headers().map_err(|error| Diagnostic::csv(file, &error))?.clone();
        Self::from_records(file, &header, |record| reader.read_record(record))
    }

    /// Reads the same from the records of a CSV: `next` puts the next one into its argument, or says that there is none.
    ///
    /// # Errors
    /// As [`Observations::from_csv`], and what `next` says.
    pub fn from_records(
        file: &str,
        header: &csv::StringRecord,
        mut next: impl FnMut(&mut csv::StringRecord) -> csv::Result<bool>,
    ) -> Result<Self, Diagnostic> {
        let columns = Columns { file, header };
        let places = columns.required(REQUIRED)?;
        let (sigma, bar) = (columns.optional(SIGMA)?, columns.optional(BAR)?);
        let known = |at: &usize| places.contains(at) || Some(*at) == sigma || Some(*at) == bar;
        let others: Vec<usize> = (0..header.len()).filter(|at| !known(at)).collect();
        let mut further = Further::new(others.iter().map(|&at| &header[at]));
        let [index, centre, axes @ .., length] = places;
        let mut rows = Vec::new();
        let mut record = csv::StringRecord::new();
        while next(&mut record).map_err(|error| Diagnostic::csv(file, &error))? {
            let row = columns.row(&record);
            rows.push(Observation {
                index: row.whole(index, 0)?,
                further: further.add(others.iter().map(|&at| row.text(at))),
                centre: row.whole(centre, 1)? as usize,
                bar: row.given(bar, |at| row.whole(at, 1))?.unwrap_or(1) as usize,
                axes_deg: angles(&row, axes)?,
                length_mm: row.positive(length, "a length between ball centres is positive, in mm")?,
                sigma_mm: row
                    .given(sigma, |at| row.positive(at, "a standard deviation is positive, in mm"))?,
            });
        }
        if rows.is_empty() {
            return Err(Diagnostic::file(file, "holds no observation: only a header, or nothing"));
        }
        let set = Self { rows, further };
        match (1..=set.bars()).find(|bar| set.rows.iter().all(|row| row.bar != *bar)) {
            None => Ok(set),
            Some(absent) => {
                let message =
                    format!("column `{BAR}`: the numbers must run 1, 2, ..: bar {absent} has no length");
                Err(Diagnostic::file(file, message))
            }
        }
    }

    /// Reads only the axis angles (degrees) of a CSV with the columns a1_deg..a6_deg.
    ///
    /// # Errors
    /// Names the line and column of what is missing or not a finite number.
    pub fn poses_from_csv(file: &str, text: &str) -> Result<Vec<[f64; AXES]>, Diagnostic> {
        let mut reader = table::reader().from_reader(text.as_bytes());
        let header = reader.headers().map_err(|error| Diagnostic::csv(file, &error))?.clone();
        let columns = Columns { file, header: &header };
        let [_, _, names @ .., _] = REQUIRED;
        let axes = columns.required::<AXES>(names)?;
        let mut poses = Vec::new();
        for record in reader.records() {
            let record = record.map_err(|error| Diagnostic::csv(file, &error))?;
            poses.push(angles(&columns.row(&record), axes)?);
        }
        if poses.is_empty() {
            return Err(Diagnostic::file(file, "holds no pose: only a header, or nothing"));
        }
        Ok(poses)
    }

    /// Writes the CSV; every number reads back bit for bit.
    pub fn to_csv(&self) -> String {
        self.csv_pieces(|_| true).collect()
    }

    /// The CSV of the rows that `keep` wants by their places, in pieces, so that a long one need never be whole in memory.
    pub fn csv_pieces(&self, keep: impl Fn(usize) -> bool) -> impl Iterator<Item = String> {
        let bars = self.bars() > 1;
        let pieces = self.rows.chunks(PIECE).enumerate().map(move |(piece, rows)| {
            let mut text = String::new();
            for (at, row) in rows.iter().enumerate() {
                if keep(PIECE * piece + at) {
                    row.append(bars, &self.further, &mut text);
                }
            }
            text
        });
        iter::once(self.header(bars)).chain(pieces)
    }

    fn header(&self, bars: bool) -> String {
        let mut text = format!("{},{SIGMA}", REQUIRED.join(","));
        if bars {
            text.push_str(&format!(",{BAR}"));
        }
        text.push_str(&self.further.header());
        text.push('\n');
        text
    }

    /// The number of bars: the highest number of one.
    pub fn bars(&self) -> usize {
        self.rows.iter().map(|row| row.bar).max().unwrap_or(1)
    }

    /// The highest number of a base ball.
    pub fn centres(&self) -> usize {
        self.rows.iter().map(|row| row.centre).max().unwrap_or(0)
    }
}

/// The axis angles of a row, degrees.
fn angles(row: &table::Row<'_>, places: [usize; AXES]) -> Result<[f64; AXES], Diagnostic> {
    let mut axes_deg = [0.0; AXES];
    for (angle, at) in axes_deg.iter_mut().zip(places) {
        *angle = row.number(at)?;
    }
    Ok(axes_deg)
}
