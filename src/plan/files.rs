//! `plan.csv` and `plan.json`: a pair that belongs together.

use serde::{Deserialize, Serialize};

use super::{Header, Kind, Motion, Plan, PlanRow, pass};
use crate::diag::Diagnostic;

/// Version of the form of `plan.json`.
pub(crate) const SCHEMA: u32 = 1;

/// A row as it stands in the file: its fields are the columns, in order.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    index: u32,
    circle: u32,
    centre: u32,
    kind: Kind,
    r#move: Motion,
    x_mm: f64,
    y_mm: f64,
    z_mm: f64,
    a_deg: f64,
    b_deg: f64,
    c_deg: f64,
    a1_deg: f64,
    a2_deg: f64,
    a3_deg: f64,
    a4_deg: f64,
    a5_deg: f64,
    a6_deg: f64,
    status: u8,
    turn: u8,
    length_mm: f64,
    dwell_s: f64,
}

impl From<&PlanRow> for Line {
    fn from(row: &PlanRow) -> Self {
        let ([x_mm, y_mm, z_mm], [a_deg, b_deg, c_deg]) = (row.xyz_mm, row.abc_deg);
        let [a1_deg, a2_deg, a3_deg, a4_deg, a5_deg, a6_deg] = row.axes_deg;
        Self {
            index: row.index,
            circle: row.circle,
            centre: row.centre,
            kind: row.kind,
            r#move: row.motion,
            x_mm,
            y_mm,
            z_mm,
            a_deg,
            b_deg,
            c_deg,
            a1_deg,
            a2_deg,
            a3_deg,
            a4_deg,
            a5_deg,
            a6_deg,
            status: row.status,
            turn: row.turn,
            length_mm: row.length_mm,
            dwell_s: row.dwell_s,
        }
    }
}

impl From<Line> for PlanRow {
    fn from(line: Line) -> Self {
        Self {
            index: line.index,
            circle: line.circle,
            centre: line.centre,
            kind: line.kind,
            motion: line.r#move,
            xyz_mm: [line.x_mm, line.y_mm, line.z_mm],
            abc_deg: [line.a_deg, line.b_deg, line.c_deg],
            axes_deg: [line.a1_deg, line.a2_deg, line.a3_deg, line.a4_deg, line.a5_deg, line.a6_deg],
            status: line.status,
            turn: line.turn,
            length_mm: line.length_mm,
            dwell_s: line.dwell_s,
        }
    }
}

impl PlanRow {
    /// What the columns' types do not say.
    fn check(&self, at: usize) -> Result<(), String> {
        if self.index as usize != at + 1 {
            return Err(format!("index = {} must be {}: rows count from 1", self.index, at + 1));
        }
        let numbers = [self.length_mm, self.dwell_s].into_iter();
        let numbers = numbers.chain(self.xyz_mm).chain(self.abc_deg).chain(self.axes_deg);
        if let Some(value) = numbers.into_iter().find(|value| !value.is_finite()) {
            return Err(format!("{value} is not a finite number"));
        }
        if self.status > 7 || self.turn > 63 {
            return Err(format!("status = {}, turn = {}: at most 7 and 63", self.status, self.turn));
        }
        if self.centre == 0 {
            return Err("centre = 0: base balls count from 1".into());
        }
        let passed = self.is_passed() && self.motion == Motion::Circ;
        if (self.kind != Kind::Transit) != (self.dwell_s > 0.0) && !passed {
            return Err(format!("dwell_s = {} in a {:?} row", self.dwell_s, self.kind).to_lowercase());
        }
        Ok(())
    }
}

impl Plan {
    /// The text of `plan.csv`.
    pub fn to_csv(&self) -> String {
        let mut writer = csv::Writer::from_writer(Vec::new());
        for row in &self.rows {
            // Plain numbers and words into memory: nothing here can fail.
            let _ = writer.serialize(Line::from(row));
        }
        String::from_utf8(writer.into_inner().unwrap_or_default()).unwrap_or_default()
    }

    /// CRC-64/XZ over the text of `plan.csv`, sixteen hexadecimal digits.
    pub(crate) fn hash(&self) -> String {
        hash_of(&self.to_csv())
    }

    /// The texts of `plan.csv` and `plan.json`.
    pub fn to_files(&self) -> (String, String) {
        let mut header = self.header.clone();
        let csv = self.to_csv();
        header.hash = hash_of(&csv);
        let json = serde_json::to_string_pretty(&header).unwrap_or_default();
        (csv, json + "\n")
    }

    /// Reads a plan from its two files.
    ///
    /// # Errors
    /// Names the line of what is not a plan, or says that the two do not belong together.
    pub fn from_files(
        csv_name: &str,
        csv_text: &str,
        json_name: &str,
        json_text: &str,
    ) -> Result<Self, Diagnostic> {
        let rows = read_rows(csv_name, csv_text)?;
        let header: Header = serde_json::from_str(json_text).map_err(|error| {
            Diagnostic::position(json_name, json_text, error.line(), error.column(), error.to_string())
        })?;
        if header.schema != SCHEMA {
            let message = format!("has schema {}: this version reads schema {SCHEMA}", header.schema);
            return Err(Diagnostic::file(json_name, message));
        }
        let hash = hash_of(csv_text);
        if header.hash != hash {
            let message =
                format!("belongs to another plan than {csv_name}: hash {}, not {hash}", header.hash);
            return Err(Diagnostic::file(json_name, message).help("plan again: `dbbd plan` writes both"));
        }
        if let Err((_, message)) = header.job.check() {
            return Err(Diagnostic::file(json_name, format!("its job cannot be: {message}")));
        }
        let indices = header.moves.iter().map(|time| time.index);
        if !indices.eq(rows.iter().map(|row| row.index)) {
            return Err(Diagnostic::file(json_name, "`moves` must have one entry for each row, in order"));
        }
        if let Some(message) = pass::mismatch(&rows, &header.passes) {
            return Err(Diagnostic::file(json_name, message));
        }
        let centres = header.job.centres.len();
        if let Some(row) = rows.iter().find(|row| row.centre as usize > centres) {
            let message = format!("centre = {}: the job has {centres} base ball(s)", row.centre);
            return Err(Diagnostic::line(csv_name, row.index as usize + 1, message));
        }
        Ok(Self { rows, header })
    }
}

fn read_rows(name: &str, text: &str) -> Result<Vec<PlanRow>, Diagnostic> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let mut rows: Vec<PlanRow> = Vec::new();
    for (at, line) in reader.deserialize::<Line>().enumerate() {
        let row = PlanRow::from(line.map_err(|error| Diagnostic::csv(name, &error))?);
        row.check(at).map_err(|message| Diagnostic::line(name, at + 2, message))?;
        rows.push(row);
    }
    if rows.is_empty() {
        return Err(Diagnostic::file(name, "has no rows: it is not a plan"));
    }
    pass::groups(&rows).map_err(|(at, message)| Diagnostic::line(name, at + 2, message))?;
    Ok(rows)
}

fn hash_of(text: &str) -> String {
    format!("{:016x}", crc::Crc::<u64>::new(&crc::CRC_64_XZ).checksum(text.as_bytes()))
}
