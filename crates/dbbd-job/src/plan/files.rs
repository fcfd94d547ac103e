//! `plan.csv` and `plan.json`: a pair that belongs together.

use super::{MotionKind, Plan, PlanHeader, PlanRow, PoseKind, pass};
use crate::plan::PlanFinding;
use dbbd_model::base::InternalFinding;
use dbbd_model::base::serialised;
use dbbd_model::base::table::wrong_csv;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::table::APPROACH;
use dbbd_model::provenance::{Artefact, ArtefactRole, TracedArtefact};
use dbbd_model::robot::Approach;

/// Version of the form of `plan.json`.
pub(crate) const PLAN_FILE_SCHEMA: u32 = 1;

/// The columns of `plan.csv`. The senses of approach come after them: they follow from the rows, are not read, and are absent
/// in files of older versions.
const COLUMNS: &str = "index,circle,centre,kind,move,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,\
    a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,status,turn,length_mm,dwell_s";

fn all_columns() -> String {
    format!("{COLUMNS},{}", APPROACH.join(","))
}

impl PlanRow {
    /// Checks what the types of the columns do not say; `at` is the position from 0.
    fn check(&self, at: usize) -> Result<(), PlanFinding> {
        let &Self { index, status, turn, dwell_s, .. } = self;
        if index as usize != at + 1 {
            return Err(PlanFinding::RowIndex { index, expected: at + 1 });
        }
        let numbers = [self.length_mm, dwell_s].into_iter();
        let mut numbers = numbers.chain(self.xyz_mm).chain(self.abc_deg).chain(self.axes_deg);
        if let Some(value) = numbers.find(|value| !value.is_finite()) {
            return Err(PlanFinding::NotFinite { value });
        }
        if status > 7 || turn > 63 {
            return Err(PlanFinding::StatusTurn { status, turn });
        }
        if self.centre == 0 {
            return Err(PlanFinding::BallZero);
        }
        let passed = self.is_passed() && self.motion == MotionKind::Circ;
        if (self.kind != PoseKind::Transit) != (dwell_s > 0.0) && !passed {
            return Err(PlanFinding::Dwell { dwell_s, kind: format!("{:?}", self.kind).to_lowercase() });
        }
        Ok(())
    }
}

impl Plan {
    pub fn to_csv(&self) -> Result<String, InternalFinding> {
        let rows = self.rows.iter().zip(self.approaches()).map(|(row, approach)| (row, approach.senses()));
        serialised::csv_table(all_columns().split(','), rows)
    }

    /// How the moves bring the axes to each row.
    pub fn approaches(&self) -> impl Iterator<Item = Approach> {
        Approach::along(self.rows.iter().map(|row| row.axes_deg.map(f64::to_radians)))
    }

    /// What `hash` of the header must be.
    pub(crate) fn hash(&self) -> Result<String, InternalFinding> {
        let PlanHeader { job, robot, moves, passes, .. } = &self.header;
        Ok(hash_of([self.to_csv()?.as_str(), &serialised::json_line(&(job, robot, moves, passes))?]))
    }

    /// The plan as an artefact.
    pub fn traced(&self) -> Result<TracedArtefact, InternalFinding> {
        let artefact = Artefact::new(ArtefactRole::Plan, &self.header.hash, self.to_csv()?);
        Ok(TracedArtefact { artefact, provenance: self.header.provenance.clone() })
    }

    /// The texts of `plan.csv` and `plan.json`.
    pub fn to_files(&self) -> Result<(String, String), InternalFinding> {
        let mut header = self.header.clone();
        let csv = self.to_csv()?;
        header.hash = self.hash()?;
        header.text_hash = BLANK.into();
        let json = serialised::json(&header)? + "\n";
        let json = json.replacen(&text_hash(BLANK), &text_hash(&hash_of([csv.as_str(), &json])), 1);
        Ok((csv, json))
    }

    /// Reads a plan from its two files, and checks that they belong together.
    pub fn from_files(
        csv_name: &str,
        csv_text: &str,
        json_name: &str,
        json_text: &str,
    ) -> Result<Self, Diagnostic> {
        let rows = read_rows(csv_name, csv_text)?;
        let mut header: PlanHeader = serde_json::from_str(json_text).map_err(|error| {
            let finding = PlanFinding::NotHeader { why: error.to_string() };
            Diagnostic::position(json_name, json_text, error.line(), error.column(), finding)
        })?;
        let wrong = |finding: PlanFinding| Diagnostic::file(json_name, finding);
        if header.schema != PLAN_FILE_SCHEMA {
            return Err(wrong(PlanFinding::Schema { schema: header.schema, known: PLAN_FILE_SCHEMA }));
        }
        header.job.check().map_err(|misplaced| misplaced.finding.in_file(json_name))?;
        let indices = header.moves.iter().map(|time| time.index);
        if !indices.eq(rows.iter().map(|row| row.index)) {
            return Err(wrong(PlanFinding::Moves { rows: rows.len(), moves: header.moves.len() }));
        }
        pass::check_passes(&rows, &header.passes).map_err(wrong)?;
        let balls = header.job.centres.len();
        if let Some(row) = rows.iter().find(|row| header.job.ball(row.centre).is_none()) {
            let finding = PlanFinding::NoSuchBall { ball: row.centre, balls };
            return Err(Diagnostic::line(csv_name, row.index as usize + 1, finding));
        }
        let written = std::mem::take(&mut header.text_hash);
        let (hash, found) = if written.is_empty() {
            (header.hash.clone(), hash_of([csv_text]))
        } else {
            let blank = json_text.replacen(&text_hash(&written), &text_hash(BLANK), 1);
            (written, hash_of([csv_text, blank.as_str()]))
        };
        if hash != found {
            return Err(wrong(PlanFinding::OtherHash { other: csv_name.into(), hash, found }));
        }
        Ok(Self { rows, header })
    }
}

fn read_rows(name: &str, text: &str) -> Result<Vec<PlanRow>, Diagnostic> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let columns = reader.headers().map_err(|error| wrong_csv(name, &error))?;
    let columns = columns.iter().collect::<Vec<_>>().join(",");
    if columns != COLUMNS && columns != all_columns() {
        return Err(Diagnostic::line(name, 1, PlanFinding::OtherColumns { columns: all_columns() }));
    }
    let mut rows: Vec<PlanRow> = Vec::new();
    for (at, record) in reader.records().enumerate() {
        let row = record.and_then(|record| record.deserialize(None));
        let row: PlanRow = row.map_err(|error| wrong_csv(name, &error))?;
        row.check(at).map_err(|finding| Diagnostic::line(name, at + 2, finding))?;
        rows.push(row);
    }
    if rows.is_empty() {
        return Err(Diagnostic::file(name, PlanFinding::NoRows));
    }
    pass::groups(&rows).map_err(|wrong| Diagnostic::line(name, wrong.at + 2, wrong.finding))?;
    Ok(rows)
}

fn hash_of<'a>(texts: impl IntoIterator<Item = &'a str>) -> String {
    let crc = crc::Crc::<u64>::new(&crc::CRC_64_XZ);
    let mut digest = crc.digest();
    texts.into_iter().for_each(|text| digest.update(text.as_bytes()));
    format!("{:016x}", digest.finalize())
}

/// The digits of a hash that is not computed yet.
const BLANK: &str = "0000000000000000";

/// The hash of both files as `plan.json` has it.
fn text_hash(digits: &str) -> String {
    format!("\"text_hash\": \"{digits}\"")
}
