//! Lengths with the axis angles they were read at: the observations CSV, and the base balls' CSV.

use std::fmt::Write;
use std::iter;

use nalgebra::Vector3;

use super::{AXES, Further};
use crate::diag::Diagnostic;

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
        let mut reader = csv_reader().from_reader(text.as_bytes());
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
        let places = find_columns(file, header, &REQUIRED)?;
        let optional = |name: &str| match header.iter().any(|column| column == name) {
            true => find_columns(file, header, &[name]).map(|places| places.first().copied()),
            false => Ok(None),
        };
        let (sigma, bar) = (optional(SIGMA)?, optional(BAR)?);
        let known = |at: &usize| places.contains(at) || Some(*at) == sigma || Some(*at) == bar;
        let others: Vec<usize> = (0..header.len()).filter(|at| !known(at)).collect();
        let mut further = Further::new(others.iter().map(|&at| &header[at]));
        let mut rows = Vec::new();
        let mut record = csv::StringRecord::new();
        while next(&mut record).map_err(|error| Diagnostic::csv(file, &error))? {
            let cell = Cells { file, header, record: &record };
            let mut axes_deg = [0.0; AXES];
            for (axis, value) in axes_deg.iter_mut().enumerate() {
                *value = cell.number(places[2 + axis])?;
            }
            let length_mm = cell.number(places[8])?;
            if length_mm <= 0.0 {
                return Err(cell.wrong(places[8], "a length between ball centres is positive, in mm"));
            }
            let sigma_mm = match sigma {
                Some(at) if !record[at].is_empty() => Some(cell.number(at)?),
                _ => None,
            };
            if let (Some(at), Some(value)) = (sigma, sigma_mm)
                && value <= 0.0
            {
                return Err(cell.wrong(at, "a standard deviation is positive, in mm"));
            }
            rows.push(Observation {
                index: cell.whole(places[0], 0)?,
                further: further.add(others.iter().map(|&at| &record[at])),
                centre: cell.whole(places[1], 1)? as usize,
                bar: match bar {
                    Some(at) if !record[at].is_empty() => cell.whole(at, 1)? as usize,
                    _ => 1,
                },
                axes_deg,
                length_mm,
                sigma_mm,
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
        let mut reader = csv_reader().from_reader(text.as_bytes());
        let header = reader.headers().map_err(|error| Diagnostic::csv(file, &error))?.clone();
        let places = find_columns(file, &header, &REQUIRED[2..2 + AXES])?;
        let mut poses = Vec::new();
        for record in reader.records() {
            let record = record.map_err(|error| Diagnostic::csv(file, &error))?;
            let cell = Cells { file, header: &header, record: &record };
            let mut axes_deg = [0.0; AXES];
            for (axis, value) in axes_deg.iter_mut().enumerate() {
                *value = cell.number(places[axis])?;
            }
            poses.push(axes_deg);
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

/// A base ball: its number (from 1) and its centre in the robot base, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Centre {
    /// Number, from 1.
    pub id: usize,
    /// Centre in the robot base, mm.
    pub position: Vector3<f64>,
}

impl Centre {
    /// Reads the CSV `centre,x_mm,y_mm,z_mm`: the balls in order of their numbers, which run from 1.
    ///
    /// # Errors
    /// Names the line of what is missing, not a number, or a number that is twice there or absent.
    pub fn from_csv(file: &str, text: &str) -> Result<Vec<Self>, Diagnostic> {
        let mut reader = csv_reader().from_reader(text.as_bytes());
        let header = reader.headers().map_err(|error| Diagnostic::csv(file, &error))?.clone();
        let places = find_columns(file, &header, &["centre", "x_mm", "y_mm", "z_mm"])?;
        let mut centres = Vec::new();
        for record in reader.records() {
            let record = record.map_err(|error| Diagnostic::csv(file, &error))?;
            let cell = Cells { file, header: &header, record: &record };
            let mut position = Vector3::zeros();
            for axis in 0..3 {
                position[axis] = cell.number(places[1 + axis])?;
            }
            centres.push(Self { id: cell.whole(places[0], 1)? as usize, position });
        }
        centres.sort_by_key(|centre| centre.id);
        for (at, centre) in centres.iter().enumerate() {
            if centre.id != at + 1 {
                let message =
                    format!("the numbers in column `centre` must run 1, 2, ..: {} is next", centre.id);
                return Err(Diagnostic::file(file, message));
            }
        }
        Ok(centres)
    }

    /// Writes the CSV.
    pub fn to_csv(centres: &[Self]) -> String {
        let mut text = String::from("centre,x_mm,y_mm,z_mm\n");
        for Self { id, position } in centres {
            text.push_str(&format!("{id},{},{},{}\n", position.x, position.y, position.z));
        }
        text
    }
}

/// How the CSV files are read.
pub fn csv_reader() -> csv::ReaderBuilder {
    let mut reader = csv::ReaderBuilder::new();
    reader.trim(csv::Trim::All);
    reader
}

/// The places of the `required` columns in the header.
fn find_columns(file: &str, header: &csv::StringRecord, required: &[&str]) -> Result<Vec<usize>, Diagnostic> {
    required
        .iter()
        .map(|name| {
            if header.iter().filter(|column| column == name).count() > 1 {
                return Err(Diagnostic::line(file, 1, format!("the column `{name}` is there twice")));
            }
            header.iter().position(|column| column == *name).ok_or_else(|| {
                let found: Vec<&str> = header.iter().collect();
                Diagnostic::line(file, 1, format!("the column `{name}` is missing"))
                    .help(format!("the header has: {}", found.join(",")))
            })
        })
        .collect()
}

/// A record with what is needed to say where a cell stands.
struct Cells<'a> {
    file: &'a str,
    header: &'a csv::StringRecord,
    record: &'a csv::StringRecord,
}

impl Cells<'_> {
    fn number(&self, at: usize) -> Result<f64, Diagnostic> {
        let value: f64 = self.record[at].parse().map_err(|_| self.wrong(at, "is not a number"))?;
        if value.is_finite() { Ok(value) } else { Err(self.wrong(at, "is not a finite number")) }
    }

    fn whole(&self, at: usize, least: u32) -> Result<u32, Diagnostic> {
        match self.record[at].parse() {
            Ok(value) if value >= least => Ok(value),
            _ => Err(self.wrong(at, &format!("must be a whole number from {least}"))),
        }
    }

    fn wrong(&self, at: usize, why: &str) -> Diagnostic {
        let line = self.record.position().map_or(0, |position| position.line() as usize);
        let message = format!("column `{}`: `{}`: {why}", &self.header[at], &self.record[at]);
        Diagnostic::line(self.file, line, message)
    }
}
